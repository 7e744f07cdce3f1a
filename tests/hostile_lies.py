"""Small files that lie: about sizes, shapes and counts, about each other, and about being data. Each is one regression.

``LIES[file name] = (write(path), what the refusal must say)``; a file that may be read, because its lie concerns nothing that is
looked at, has ``None``.
"""

import json
import os
import pickle
import struct
import sys
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


# --- saved states --------------------------------------------------------------------------------------------------------


class Code:
    """A pickle that runs a command when it is read."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> Any:
        return os.system, (f"touch '{self.marker}'",)


def state(value: Any, **fields: Any) -> dict[str, Any]:
    return {"value": value, "fields": fields}


def torch_file(make: Callable[[], Any], **options: Any) -> Callable[[Path], Any]:
    def write(path: Path) -> None:
        import torch

        allowed = sys.getrecursionlimit()
        sys.setrecursionlimit(10 * allowed)  # the writer may go deeper than the reader
        torch.save(make(), path, **options)
        sys.setrecursionlimit(allowed)

    return write


def with_code(where: Callable[[Code], Any], **options: Any) -> Callable[[Path], Any]:
    return lambda path: torch_file(lambda: where(Code(path.parent / MARKER)), **options)(path)


def rewritten(change: Callable[[str, bytes], bytes], method: int = zipfile.ZIP_STORED) -> Callable[[Path], Any]:
    """A saved Lambert whose records are changed behind torch's back."""

    def write(path: Path) -> None:
        import torch

        torch.save(state("Lambert", albedo=torch.zeros(1000, 3)), path)
        with zipfile.ZipFile(path) as z:
            records = {i.filename: z.read(i) for i in z.infolist()}
        with zipfile.ZipFile(path, "w", method, compresslevel=1) as z:
            for name, data in records.items():
                z.writestr(name, change(name, data))

    return write


def pickled(before: bytes, after: bytes) -> Callable[[str, bytes], bytes]:
    return lambda name, data: data.replace(before, after) if name.endswith("data.pkl") else data


def lambert(**changes: Any) -> Callable[[Path], Any]:
    def make() -> Any:
        import torch

        return state("Lambert", albedo=eval(changes["albedo"], {"torch": torch}))

    return torch_file(make)


def nested(depth: int) -> Any:
    """Lists in lists, each holding the one below ten times: ten lines of pickle, 10^depth elements."""
    inner: list[Any] = []
    for _ in range(depth):
        inner = [inner] * 10
    return inner


def ouroboros() -> Any:
    snake: list[Any] = []
    snake.append(snake)
    return snake


def deep_values(depth: int) -> Any:
    inner: Any = state("Lambert", albedo=0.5)
    for _ in range(depth):
        inner = state("Scaled", inner=inner, factor=1.0)
    return inner


def deep_file(path: Path) -> None:
    """Written by hand: torch.save itself cannot go so deep."""
    rewritten(lambda name, data: b"\x80\x02" + b"(" * 20_000 + b"]" + b"t" * 20_000 + b"." if name.endswith("data.pkl") else data)(path)


SAVED = {
    "code.pt": (with_code(lambda code: state("Lambert", albedo=code)), "names code, posix.system, which is never run"),
    "code_beside.pt": (with_code(lambda code: {**state("Lambert", albedo=0.5), "note": code}), "names code, posix.system"),
    "old_code.pt": (with_code(lambda code: code, _use_new_zipfile_serialization=False), "not a zip file"),
    "bare_code.pt": (lambda path: path.write_bytes(pickle.dumps(Code(path.parent / MARKER))), "not a zip file"),
    "class_of_torch.pt": (torch_file(lambda: state("Module")), "found 'Module' for a value"),
    "module_of_ours.pt": (torch_file(lambda: state("importlib")), "found 'importlib' for a value"),
    "base_class.pt": (torch_file(lambda: state("Value")), "found 'Value' for a value"),
    "unhashable_name.pt": (torch_file(lambda: state([1])), "found list for a value"),
    "no_name.pt": (torch_file(lambda: state(None)), "found None for a value"),
    "expanded.pt": (lambert(albedo="torch.ones(1, 3).expand(10**12, 3)"), r"claims the shape \[1000000000000, 3\]"),
    "sparse.pt": (lambert(albedo="torch.ones(2, 3).to_sparse()"), "sparse_coo tensor"),
    "eight_bits.pt": (lambert(albedo="torch.ones(3).to(torch.float8_e4m3fn)"), "Lambert.albedo: expected a tensor of floats"),
    "no_channel.pt": (lambert(albedo="torch.ones(0)"), "with one channel at least"),
    "list_for_ever.pt": (torch_file(lambda: state("Sum", terms=ouroboros())), "hold each other, or one of them twice"),
    "laughing.pt": (torch_file(lambda: state("Sum", terms=nested(12))), "hold each other, or one of them twice"),
    "deep.pt": (deep_file, "not a saved torchbrdf value"),
    "deep_values.pt": (torch_file(lambda: deep_values(300)), "more than 64 deep"),
    "wrong_slot.pt": (torch_file(lambda: state("Scaled", inner=state("Dielectric", eta=1.5), factor=1.0)), "Scaled.inner: expected a BSDF"),
    "number_for_terms.pt": (torch_file(lambda: state("Sum", terms=5)), "does not fit this version"),
    "index.pt": (torch_file(lambda: state("Mesh", vertices=[[0.0] * 3 for _ in range(3)], faces=[[0, 1, 99]])), "Mesh.faces: legal are 0 to 2"),
    "big_number.pt": (torch_file(lambda: state("Mesh", vertices=[[0.0] * 3 for _ in range(3)], faces=[[0, 1, 10**30]])), "Mesh.faces: expected a number"),
    "bomb.pt": (rewritten(lambda name, data: bytes(1 << 28) if "/data/" in name else data, zipfile.ZIP_DEFLATED), "records unpack to 2684"),
    "shape.pt": (rewritten(pickled(b"M\xe8\x03K\x03\x86", b"J\0\0\1\0K\x03\x86")), "not a saved torchbrdf value"),
    "storage.pt": (rewritten(pickled(b"M\xb8\x0b", b"J\0\0\0\x10")), "does not match expected size"),
    "stride.pt": (rewritten(pickled(b"K\x03K\x01\x86", b"J\xff\xff\xff\x7fK\x01\x86")), "not a saved torchbrdf value"),
}  # fmt: skip

LIES = MESHES | PICTURES | SAVED
