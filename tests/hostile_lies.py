"""Small files that lie: about sizes, shapes and counts, about each other, and about being data. Each is one regression.

``LIES[file name] = (write(path), what the refusal must say)``; a file that may be read, because its lie concerns nothing that is
looked at, has ``None``.
"""

import json
import os
import pickle
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from hostile import png

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32).tobytes() + np.arange(3, dtype=np.uint32).tobytes()
MARKER = "marker"  # the file that hostile code would make, beside the hostile file


def text(content: str) -> Callable[[Path], Any]:
    return lambda path: path.write_text(content)


def raw(content: bytes) -> Callable[[Path], Any]:
    return lambda path: path.write_bytes(content)


# --- meshes --------------------------------------------------------------------------------------------------------------


def ply(vertices: int, faces: int, body: bytes, form: str = "ascii", count: str = "uchar") -> Callable[[Path], Any]:
    head = f"ply\nformat {form} 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n"
    return raw(f"{head}element face {faces}\nproperty list {count} int vertex_indices\nend_header\n".encode() + body)


def tree(**changes: Any) -> dict[str, Any]:
    """The glTF tree of one triangle."""
    corner = {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}
    index = {"bufferView": 1, "componentType": 5125, "count": 3, "type": "SCALAR"}
    views = [{"buffer": 0, "byteOffset": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 12}]
    mesh = {"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}
    scene = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "meshes": [mesh]}
    return {**scene, "accessors": [corner, index], "bufferViews": views, "buffers": [{"byteLength": 48}], **changes}


def accessor(which: int, view: bool = True, **changes: Any) -> dict[str, Any]:
    t = tree()
    t["accessors"][which] |= changes
    if not view:
        del t["accessors"][which]["bufferView"]
    return t


def glb(t: dict[str, Any], data: bytes = POINTS) -> Callable[[Path], Any]:
    j = json.dumps(t).encode()
    j += b" " * (-len(j) % 4)
    chunks = struct.pack("<I4s", len(j), b"JSON") + j + struct.pack("<I4s", len(data), b"BIN\0") + data
    return raw(b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks)


def gltf(uri: str) -> Callable[[Path], Any]:
    return text(json.dumps(tree(buffers=[{"byteLength": 48, "uri": uri}])))


def laughing(parts: int, vertices: int) -> Callable[[Path], Any]:
    """A mesh of a megabyte, placed thousands of times."""
    points, faces = np.zeros((vertices, 3), np.float32).tobytes(), np.arange(vertices // 3 * 3, dtype=np.uint32).tobytes()
    t = tree(nodes=[{"mesh": 0}] * parts, scenes=[{"nodes": list(range(parts))}], buffers=[{"byteLength": len(points) + len(faces)}])
    t["accessors"][0]["count"], t["accessors"][1]["count"] = vertices, vertices // 3 * 3
    t["bufferViews"] = [{"buffer": 0, "byteLength": len(points)}, {"buffer": 0, "byteOffset": len(points), "byteLength": len(faces)}]
    return glb(t, points + faces)


def with_fifo(write: Callable[[Path], Any]) -> Callable[[Path], Any]:
    """Beside a pipe, from which reading would wait for ever."""

    def both(path: Path) -> None:
        if not (path.parent / "pipe").exists():
            os.mkfifo(path.parent / "pipe")
        write(path)

    return both


def packed(name: str, unpacked: int) -> Callable[[Path], Any]:
    """A zip file whose directory says that it unpacks to so much."""

    def write(path: Path) -> None:
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as z:
            z.writestr(name, bytes(1 << 16))
        data = bytearray(path.read_bytes())
        at = data.index(b"PK\1\2") + 24
        data[at : at + 4] = unpacked.to_bytes(4, "little")
        path.write_bytes(data)

    return write


CHAIN = [{"mesh": 0, "children": [k + 1]} for k in range(9999)] + [{"mesh": 0}]
MESHES = {
    "vertices.ply": (ply(10**12, 1, b"0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"), "holds no faces"),
    "vertices_binary.ply": (ply(10**12, 1, bytes(48), "binary_little_endian"), "unexpected length"),
    "faces.ply": (ply(3, 10**12, bytes(40), "binary_little_endian"), "unexpected length"),
    "list.ply": (ply(3, 1, bytes(36) + b"\xff" * 4 + bytes(12), "binary_little_endian", "uint"), "cannot read"),
    "index.ply": (ply(3, 1, b"0 0 0\n1 0 0\n0 1 0\n3 0 1 1000000000\n"), "Mesh.faces: legal are 0 to 2"),
    "faces.stl": (raw(bytes(80) + struct.pack("<I", 4 * 10**9) + bytes(50)), "cannot read"),
    "vertices.off": (text("OFF\n1000000000000 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"), "cannot read"),
    "index.obj": (text(TRIANGLE + "f 1 2 1000000000000\n"), "out of bounds"),
    "huge_index.obj": (text(TRIANGLE + f"f 1 2 {10**30}\n"), "out of bounds"),
    "negative_index.obj": (text(TRIANGLE + "f -1 -2 -1000000000000\n"), "out of bounds"),
    "nan.obj": (text(TRIANGLE + "v nan 0 0\nf 1 2 4\n"), "1 of 3 are NaN or infinite"),
    "inf.obj": (text(TRIANGLE + "v 1e999 0 0\nf 1 2 4\n"), "1 of 3 are NaN or infinite"),
    "beyond_float32.obj": (text(TRIANGLE + "v 1e300 0 0\nf 1 2 4\n"), "1 of 3 are NaN or infinite"),
    "largest_float32.obj": (text(TRIANGLE + "v 3e38 0 0\nv -3e38 0 0\nf 3 4 5\n"), None),
    "columns.obj": (text("v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n"), r"columns.obj: Mesh.vertices: expected shape \[..., V, 3\]"),
    "uv_index.obj": (text(TRIANGLE + "vt 0 0\nf 1/1000000000 2/1 3/1\n"), None),
    "uv_nan.obj": (text(TRIANGLE + "vt nan inf\nf 1/1 2/1 3/1\n"), None),
    "normal_nan.obj": (text(TRIANGLE + "vn nan inf 0\nf 1//1 2//1 3//1\n"), None),
    "latin_1.obj": (raw(b"# caf\xe9\no caf\xe9\n" + TRIANGLE.encode() + b"f 1 2 3\n"), None),
    "polygon.obj": (text(TRIANGLE + "f " + "1 2 3 " * 3000 + "\n"), None),
    "library_without_end.obj": (text("mtllib /dev/zero\n" + TRIANGLE + "f 1 2 3\n"), None),
    "library_pipe.obj": (with_fifo(text("mtllib pipe\n" + TRIANGLE + "f 1 2 3\n")), None),
    "materials.obj": (text(TRIANGLE + "".join(f"usemtl m{k}\nf 1 2 3\n" for k in range(20000))), "20000 materials"),
    "count.glb": (glb(accessor(0, count=10**12)), "accessors and primitives claim: .* GiB"),
    "indices.glb": (glb(accessor(1, count=10**12)), "accessors and primitives claim: .* GiB"),
    "no_view.glb": (glb(accessor(0, view=False, count=3 * 10**8)), "accessors and primitives claim: 6.71 GiB"),
    "no_view_indices.glb": (glb(accessor(1, view=False, count=3 * 10**8)), "accessors and primitives claim: 2.24 GiB"),
    "negative_count.glb": (glb(accessor(0, count=-5)), "a count in it is -5"),
    "float_count.glb": (glb(accessor(0, count=1e300)), r"a count in it is 1e\+300"),
    "primitives.glb": (glb(tree(meshes=[{"primitives": tree()["meshes"][0]["primitives"] * 60}]) | {"accessors": accessor(0, view=False, count=2 * 10**6)["accessors"]}), "primitives claim"),
    "placed.glb": (laughing(3000, 100_000), "its 3000 parts, put together: 8.94 GiB"),
    "circle.glb": (glb(tree(nodes=[{"mesh": 0, "children": [1]}, {"children": [0]}])), "form a circle"),
    "own_child.glb": (glb(tree(nodes=[{"mesh": 0, "children": [0]}])), "form a circle"),
    "chain.glb": (glb(tree(nodes=CHAIN)), None),
    "flat_part.glb": (glb(tree(nodes=[{"mesh": 0, "scale": [0, 1, 1]}], meshes=[{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 0}, "indices": 1}]}])), None),
    "nan_part.glb": (glb(tree(nodes=[{"mesh": 0, "scale": [float("nan"), 1, 1]}])), "3 of 3 are NaN or infinite"),
    "deep.glb": (raw(b"glTF" + struct.pack("<III4s", 2, 200_020, 200_000, b"JSON") + b"[" * 200_000), "RecursionError"),
    "chunk.glb": (raw(b"glTF" + struct.pack("<III4s", 2, 100, 0xFFFFFFF0, b"JSON") + b"{}"), "holds no faces"),
    "device.gltf": (gltf("/dev/zero"), "'/dev/zero', which is no file in its folder"),
    "outside.gltf": (gltf("../../../../../../../../dev/zero"), "dev/zero', which is no file in its folder"),
    "pipe.gltf": (with_fifo(gltf("pipe")), "'pipe', which is no file in its folder"),
    "remote.gltf": (gltf("http://127.0.0.1:9/x.bin"), "which is no file in its folder"),
    "digits.gltf": (text('{"asset":' + "9" * 100_000 + "}"), "4300 digits"),
    "archive.zip": (packed("a.obj", 2**31), "archives are not unpacked"),
    "archive.stl.bz2": (raw(b"BZh9"), "archives are not unpacked"),
    "inside.ply": (packed("a.ply", 2**31), "what it unpacks to: 2 GiB"),
}  # fmt: skip


# --- pictures ------------------------------------------------------------------------------------------------------------


def exr(change: Callable[[bytes], bytes], **header: Any) -> Callable[[Path], Any]:
    def write(path: Path) -> None:
        import OpenEXR

        channels = {c: np.zeros((16, 16), np.float32) for c in "RGB"}
        file = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **{k: v() for k, v in header.items()}}
        OpenEXR.File(file, channels).write(str(path))
        path.write_bytes(change(path.read_bytes()))

    return write


def tiled() -> dict[str, Callable[[], Any]]:
    import OpenEXR

    return {"type": lambda: OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription}


def attribute(name: bytes, kind: bytes, skip: int, *integers: int) -> Callable[[bytes], bytes]:
    def change(data: bytes) -> bytes:
        at = data.index(name + b"\0" + kind + b"\0") + len(name + kind) + 2 + 4 + skip
        return data[:at] + struct.pack(f"<{len(integers)}i", *integers) + data[at + 4 * len(integers) :]

    return change


def many_parts(path: Path) -> None:
    """Each part is believable, all together are not."""
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    zeros = np.zeros((8, 8), np.float32)
    OpenEXR.File([OpenEXR.Part(dict(header), {"Y": zeros}, f"part{k}") for k in range(20)]).write(str(path))
    data = path.read_bytes()
    for name in (b"dataWindow", b"displayWindow"):
        data = data.replace(
            name + b"\0box2i\0\x10\0\0\0" + struct.pack("<4i", 0, 0, 7, 7),
            name + b"\0box2i\0\x10\0\0\0" + struct.pack("<4i", 0, 0, 8999, 8999),
        )
    path.write_bytes(data)


def sparse(content: bytes, size: int) -> Callable[[Path], Any]:
    """A file of a terabyte that takes a few bytes of the disk."""

    def write(path: Path) -> None:
        with path.open("wb") as file:
            file.write(content)
            file.truncate(size)

    return write


HDR = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n"
EPS = f"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 10 10\n%%EndComments\n({MARKER}) (w) file closefile\nshowpage\n".encode()
PICTURES = {
    "window.exr": (exr(attribute(b"dataWindow", b"box2i", 0, 0, 0, 10**9, 10**9)), "dataWindow claims 1000000001 x 1000000001 pixels"),
    "display.exr": (exr(attribute(b"displayWindow", b"box2i", 0, 0, 0, 10**6, 10**6)), "displayWindow claims 1000001 x 1000001 pixels"),
    "negative.exr": (exr(attribute(b"dataWindow", b"box2i", 0, 5, 5, -5, -5)), "damaged"),
    "whole_plane.exr": (exr(attribute(b"dataWindow", b"box2i", 0, -(2**31), -(2**31), 2**31 - 1, 2**31 - 1)), "damaged"),
    "tile.exr": (lambda path: exr(attribute(b"tiles", b"tiledesc", 0, 32, 14_811_168), **tiled())(path), "tile claims 32 x 14811168 pixels"),
    "parts.exr": (many_parts, "dataWindow claims 9000 x 9000 pixels of 1 channels: 1.21 GiB"),
    "huge.hdr": (raw(HDR + b"-Y 999999999 +X 999999999\n" + bytes(100)), "claims 999999999 x 999999999 pixels"),
    "tall.hdr": (raw(HDR + b"-Y 89000000 +X 1\n" + b"abcd" * 1000), "scanline 1000 of 89000000"),
    "cut_gigabyte.hdr": (raw(HDR + b"-Y 8000 +X 11000\n" + bytes(100)), "scanline 0 of 8000"),
    "sparse.hdr": (sparse(HDR + b"-Y 4 +X 4\n", 1 << 40), None),
    "huge.png": (raw(png(10**9, 10**9, 8, 2, zlib.compress(bytes(1000)))), "damaged"),
    "bomb.png": (raw(png(13000, 13000, 8, 2, zlib.compress(bytes(39001)))), "claims 13000 x 13000 pixels of 3 floats: 1.89 GiB"),
    "palette_bomb.png": (raw(png(13000, 13000, 1, 0, zlib.compress(bytes(1626 * 13000)))), "claims 13000 x 13000 pixels of 4 floats"),
    "deep_huge.png": (raw(png(10**9, 10**9, 16, 2, zlib.compress(bytes(1000)))), "claims 1000000000 x 1000000000 pixels"),
    "chunk.png": (raw(png(4, 4, 8, 2, b"")[:33] + b"\x7f\xff\xff\xffIDAT"), "damaged"),
    "program.png": (raw(EPS), "no picture that Pillow knows: none of AVIF, BMP"),
    "program.tif": (raw(EPS), "no picture that Pillow knows: none of AVIF, BMP"),
}  # fmt: skip


# --- saved values --------------------------------------------------------------------------------------------------------


class Code:
    """A pickle that runs a command when it is read."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> Any:
        return os.system, (f"touch '{self.marker}'",)


def torch_file(**options: Any) -> Callable[[Path], Any]:
    """What torch.save makes of a state that holds code."""

    def write(path: Path) -> None:
        import torch

        torch.save(state("torchbrdf.Lambert", albedo=Code(path.parent / MARKER)), path, **options)

    return write


def state(value: Any, **fields: Any) -> dict[str, Any]:
    return {"value": value, "fields": fields}


def reference(name: Any = "albedo") -> dict[str, Any]:
    return {"$tensor": name, "planar": False}


def safe(header: Any, data: bytes = b"", length: int | None = None) -> Callable[[Path], Any]:
    """A safetensors file by hand: eight bytes that count the header, the header (a tree or its bytes), the data."""
    head = header if isinstance(header, bytes) else json.dumps(header).encode()
    return raw(struct.pack("<Q", len(head) if length is None else length) + head + data)


def holding(structure: Any, data: bytes = bytes(12), **tensors: Any) -> Callable[[Path], Any]:
    """One of a structure (a tree or its text) and the tensor ``albedo``, three float32 unless told otherwise."""
    text = structure if isinstance(structure, str) else json.dumps(structure)
    albedo = {"dtype": "F32", "shape": [3], "data_offsets": [0, 12], **tensors}
    return safe({"__metadata__": {"torchbrdf": text}, "albedo": albedo}, data)


def lambert(data: bytes = bytes(12), **tensor: Any) -> Callable[[Path], Any]:
    return holding(state("torchbrdf.Lambert", albedo=reference()), data, **tensor)


def deep_values(depth: int) -> Any:
    inner: Any = state("torchbrdf.Lambert", albedo=0.5)
    for _ in range(depth):
        inner = state("torchbrdf.Scaled", inner=inner, factor=1.0)
    return inner


def sum_of(terms: Any) -> dict[str, Any]:
    return state("torchbrdf.Sum", terms=terms)


def triangle(*face: int) -> dict[str, Any]:
    return state("torchbrdf.Mesh", vertices=[[0.0] * 3] * 3, faces=[list(face)])


NO_VALUE = "is not a saved torchbrdf value"
SAVED = {
    "code.pt": (torch_file(), "it is a pickle, as torch.save writes them, which could run code"),
    "old_code.pt": (torch_file(_use_new_zipfile_serialization=False), "it is a pickle"),
    "bare_code.pt": (lambda path: path.write_bytes(pickle.dumps(Code(path.parent / MARKER))), "it is a pickle"),
    "code.safetensors": (torch_file(), "it is a pickle"),
    # the container
    "empty.safetensors": (raw(b""), NO_VALUE),
    "long_header.safetensors": (safe({}, length=2**63 - 1), "SafetensorError"),
    "longest_header.safetensors": (safe({}, length=2**64 - 1), "SafetensorError"),
    "hundred_megabytes.safetensors": (safe({}, length=100_000_000), "SafetensorError"),
    "no_header.safetensors": (safe(b""), "SafetensorError"),
    "binary_header.safetensors": (safe(b"{\xff\xfe}"), "SafetensorError"),
    "list_header.safetensors": (safe([1, 2]), "SafetensorError"),
    "deep_header.safetensors": (safe(b'{"a":' + b"[" * 200_000), "SafetensorError"),
    "twice.safetensors": (safe(b'{"a":{"dtype":"U8","shape":[1],"data_offsets":[0,1]},"a":{"dtype":"U8","shape":[1],"data_offsets":[0,1]}}', b"1"), NO_VALUE),
    # tensors
    "shape.safetensors": (lambert(shape=[10**12, 3]), "SafetensorError"),
    "overflow.safetensors": (lambert(shape=[2**62, 2**62, 2**62]), "SafetensorError"),
    "wraps.safetensors": (lambert(shape=[2**62 + 3]), "SafetensorError"),
    "negative.safetensors": (lambert(shape=[-3]), "SafetensorError"),
    "nothing_wide.safetensors": (lambert(b"", shape=[0, 2**60], data_offsets=[0, 0]), None),
    "nothing_wider.safetensors": (lambert(b"", shape=[2**60, 2**60, 0], data_offsets=[0, 0]), NO_VALUE),
    "beyond.safetensors": (lambert(data_offsets=[0, 10**12], shape=[25 * 10**10]), "SafetensorError"),
    "backwards.safetensors": (lambert(data_offsets=[12, 0]), "SafetensorError"),
    "hole.safetensors": (lambert(bytes(24), data_offsets=[12, 24]), "SafetensorError"),
    "left_over.safetensors": (lambert(bytes(1000)), "SafetensorError"),
    "other_size.safetensors": (lambert(dtype="F64"), "SafetensorError"),
    "unknown_dtype.safetensors": (lambert(dtype="F31"), "SafetensorError"),
    "half_byte.safetensors": (lambert(bytes(2), dtype="F4", shape=[4], data_offsets=[0, 2]), NO_VALUE),
    "eight_bits.safetensors": (lambert(bytes(3), dtype="F8_E5M2", data_offsets=[0, 3]), "Lambert.albedo: expected a tensor of floats, found torch.float8_e5m2"),
    "complex.safetensors": (lambert(bytes(24), dtype="C64", data_offsets=[0, 24]), NO_VALUE),  # from safetensors 0.7 on a dtype
    "integers.safetensors": (lambert(dtype="I32"), "Lambert.albedo: expected a tensor of floats, found torch.int32"),
    "no_channel.safetensors": (lambert(b"", shape=[0], data_offsets=[0, 0]), "with one channel at least"),
    # the structure
    "weights.safetensors": (safe({"albedo": {"dtype": "F32", "shape": [3], "data_offsets": [0, 12]}}, bytes(12)), "it holds tensors alone"),
    "text.safetensors": (holding("hello"), "JSONDecodeError"),
    "number.safetensors": (holding(5), "found 'int' for a value"),
    "digits.safetensors": (holding("9" * 100_000), "4300 digits"),
    "deep_text.safetensors": (holding("[" * 200_000), "RecursionError"),
    "deep_list.safetensors": (holding(sum_of(json.loads("[" * 300 + "]" * 300))), "more than 64 deep"),
    "deep_values.safetensors": (holding(deep_values(150)), "more than 64 deep"),
    "bare_tensor.safetensors": (holding(reference()), "found 'Tensor' for a value"),
    "no_such_tensor.safetensors": (holding(state("torchbrdf.Lambert", albedo=reference("x"))), "KeyError: 'x'"),
    "tensor_by_list.safetensors": (holding(state("torchbrdf.Lambert", albedo=reference([1]))), "unhashable"),
    "class_of_torch.safetensors": (holding(state("torch.nn.Module")), "found 'torch.nn.Module' for a value"),
    "module_of_ours.safetensors": (holding(state("torchbrdf.importlib")), "found 'torchbrdf.importlib' for a value"),
    "function_of_ours.safetensors": (holding(state("torchbrdf.load_value", path="/dev/zero")), "found 'torchbrdf.load_value' for a value"),
    "base_class.safetensors": (holding(state("torchbrdf.Value")), "found 'torchbrdf.Value' for a value"),
    "unhashable_name.safetensors": (holding(state([1])), "found list for a value"),
    "no_name.safetensors": (holding(state(None)), "found None for a value"),
    "field_too_many.safetensors": (holding(state("torchbrdf.Lambert", albedo=reference(), colour=1.0)), "does not fit this version: .*'colour'"),
    "field_too_few.safetensors": (holding(state("torchbrdf.Lambert")), "does not fit this version: .*'albedo'"),
    "wrong_slot.safetensors": (holding(state("torchbrdf.Scaled", inner=state("torchbrdf.Dielectric", eta=1.5), factor=1.0)), "Scaled.inner: expected a BSDF"),
    "number_for_terms.safetensors": (holding(sum_of(5)), "does not fit this version"),
    "one_tensor_for_many.safetensors": (holding(sum_of([state("torchbrdf.Lambert", albedo=reference())] * 2000)), None),
    "index.safetensors": (holding(triangle(0, 1, 99)), "Mesh.faces: legal are 0 to 2"),
    "big_number.safetensors": (holding(triangle(0, 1, 10**30)), "Mesh.faces: expected a number"),
}  # fmt: skip

LIES = MESHES | PICTURES | SAVED
