"""Small valid files of every kind, ways to damage them, and the reader that runs beside the tests, where it may die.

    python tests/hostile.py LIST SECONDS MEGABYTES

reads every file that LIST names, ``[path, megabytes to believe of it]`` a line, each within SECONDS, and all with no more than MEGABYTES
of address space beyond what the imports take. It prints ``[path, outcome, message]``, a line each; the path alone is printed before the
file is opened, so that a crash names its file.
"""

import json
import os
import re
import subprocess
import sys
import warnings
import zlib
from pathlib import Path
from typing import Any

import numpy as np

INTEGERS = (0, 1, 2**16, 10**6, 2**24, 10**9, 2**31 - 1, 2**31, 2**32 - 1)
HEADER = 600  # bytes in which damage is likeliest to be a lie


# --- files ---------------------------------------------------------------------------------------------------------------


def pictures(folder: Path) -> None:
    import torch
    from PIL import Image

    import torchbrdf as tb

    image = torch.rand(12, 10, 3)
    for suffix in ("exr", "png", "jpg"):
        tb.save_image(folder / f"a.{suffix}", image)
    bytes_ = Image.fromarray((image.numpy() * 255).astype(np.uint8))
    for suffix in ("tif", "gif", "webp", "bmp", "tga", "ppm", "jp2"):
        bytes_.save(folder / f"a.{suffix}")
    (folder / "deep.png").write_bytes(png(10, 12, 16, 2, zlib.compress(bytes(12 * 61))))
    (folder / "palette.png").write_bytes(png(10, 12, 1, 0, zlib.compress(bytes(12 * 3))))
    rows = np.random.default_rng(0).integers(2, 255, (6, 20, 4), dtype=np.uint8)
    start = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=2.5\n\n-Y 6 +X 20\n"
    (folder / "flat.hdr").write_bytes(start + rows.tobytes())
    runs = (bytes((2, 2, 0, 20)) + b"".join(bytes((10,)) + c[:10].tobytes() + bytes((138, c[11])) for c in row.T) for row in rows)
    (folder / "runs.hdr").write_bytes(start + b"".join(runs))


def exr_files(folder: Path) -> None:
    import OpenEXR

    import torchbrdf as tb

    half = np.random.default_rng(0).random((20, 24)).astype(np.float16)
    channels = {"R": half, "G": half.copy(), "B": half.copy()}
    for name in ("NO", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "B44", "DWAA"):
        header = {"compression": getattr(OpenEXR, f"{name}_COMPRESSION"), "type": OpenEXR.scanlineimage}
        OpenEXR.File(header, channels).write(str(folder / f"{name}.exr"))
    tiled = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}
    OpenEXR.File(tiled, channels).write(str(folder / "tiled.exr"))
    plain = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    single = half.astype(np.float32)
    vectors = {f"N.{c}": single for c in "XYZ"}
    OpenEXR.File([OpenEXR.Part(dict(plain), channels, "one"), OpenEXR.Part(dict(plain), vectors, "two")]).write(str(folder / "parts.exr"))
    ball().save(folder / "g.exr")
    assert tb.GBuffer.load(folder / "g.exr").valid.any()


def ball() -> Any:
    import torch
    import trimesh

    import torchbrdf as tb

    sphere = trimesh.creation.icosphere(subdivisions=1)
    uv = torch.rand(len(sphere.vertices), 2)
    mesh = tb.Mesh(torch.tensor(sphere.vertices).float(), torch.tensor(sphere.faces), uv=uv)
    return tb.GBuffer.from_mesh(mesh, tb.Camera.look_at([0.0, 0.0, 3.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], 40.0, (10, 12)))


def meshes(folder: Path) -> None:
    import trimesh
    from PIL import Image

    rng = np.random.default_rng(0)
    mesh = trimesh.creation.icosphere(subdivisions=1)
    _ = mesh.vertex_normals  # asked for, so that the exports write them
    texture = Image.fromarray(rng.integers(0, 255, (8, 8, 3), dtype=np.uint8))
    mesh.visual = trimesh.visual.TextureVisuals(uv=rng.random((len(mesh.vertices), 2)), image=texture)
    for suffix in ("obj", "glb", "ply", "stl", "off"):
        mesh.export(folder / f"a.{suffix}")
    mesh.export(folder / "text.ply", encoding="ascii")
    mesh.export(folder / "text.stl", file_type="stl_ascii")
    scene = trimesh.Scene()
    scene.add_geometry(mesh)
    scene.add_geometry(mesh.copy(), transform=trimesh.transformations.rotation_matrix(1.0, [1, 2, 3]))
    scene.export(folder / "two.glb")
    for file in (folder / "material.mtl", folder / "material_0.png"):
        file.unlink(missing_ok=True)


def saved(folder: Path) -> None:
    import torch
    import trimesh

    import torchbrdf as tb

    lobe = tb.Phong(torch.rand(4, 5, 3), torch.rand(4, 5, 1), fresnel=tb.Schlick(0.04))
    (tb.Lambert([0.1, 0.2, 0.3]) + 0.5 * lobe).save(folder / "sum.safetensors")
    box = trimesh.creation.box()
    tb.Mesh(torch.tensor(box.vertices), torch.tensor(box.faces)).save(folder / "mesh.safetensors")
    tb.Value.save(ball()[:3, :4], folder / "g.safetensors")


def scenes(folder: Path) -> None:
    import trimesh

    import torchbrdf as tb

    mesh = trimesh.creation.icosphere(subdivisions=1)
    mesh.export(folder / "ball.obj")
    camera = {"eye": [0, 0, 4], "target": [0, 0, 0], "up": [0, 1, 0], "fov_y_deg": 40.0, "size": [8, 10]}
    lamp = {"type": "point", "position": [2.0, 2.5, 3.0], "intensity": [40.0], "learn": ["intensity"]}
    sun = {"type": "directional", "direction": [1, 0, 2], "irradiance": [2, 1, 0.5]}
    g = tb.GBuffer.from_mesh(tb.load_mesh(folder / "ball.obj"), tb.Camera.look_at([0, 0, 4.0], [0, 0, 0.0], [0, 1.0, 0], 40.0, (8, 10)))
    image = tb.shade(g, tb.Lambert([0.5, 0.4, 0.3]), tb.PointLight([2.0, 2.5, 3.0], 40.0))
    for k in range(2):
        tb.save_image(folder / f"photo_{k}.exr", image)
    view = {**camera, "images": {"paint": ["photo_0.exr", "photo_1.exr"]}}
    scene = {"mesh": "ball.obj", "lights": [lamp, sun], "views": [view], "materials": {"paint": {"albedo": [0.5, 0.4, 0.3]}}}
    (folder / "scene.json").write_text(json.dumps(scene))


KINDS = {"pictures": pictures, "exr": exr_files, "meshes": meshes, "saved": saved, "scenes": scenes}


def png(width: int, height: int, bits: int, colour: int, packed: bytes) -> bytes:
    def chunk(name: bytes, data: bytes) -> bytes:
        return len(data).to_bytes(4, "big") + name + data + zlib.crc32(name + data).to_bytes(4, "big")

    header = width.to_bytes(4, "big") + height.to_bytes(4, "big") + bytes((bits, colour, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", packed) + chunk(b"IEND", b"")


# --- damage --------------------------------------------------------------------------------------------------------------


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """Cut short, bits flipped, bytes or integers of the header replaced, a piece taken out or doubled."""
    b, head = bytearray(data), max(1, min(len(data), HEADER) - 4)
    kind = rng.integers(5)
    if kind == 0:
        return data[: rng.integers(len(data))]
    if kind == 1:
        for at in rng.integers(len(b), size=rng.integers(1, 4)):
            b[at] ^= 1 << rng.integers(8)
    elif kind == 2:
        for at in rng.integers(head, size=rng.integers(1, 4)):
            b[at] = rng.integers(256)
    elif kind == 3:
        at = rng.integers(head)
        b[at : at + 4] = INTEGERS[rng.integers(len(INTEGERS))].to_bytes(4, "little" if rng.random() < 0.7 else "big")
    else:
        p, q = sorted(rng.integers(len(b), size=2))
        b = b[:p] + b[q:] if rng.random() < 0.5 else b[:q] + b[p:]
    return bytes(b)


def damaged_json(text: str, rng: np.random.Generator) -> str:
    """One value or one key of the tree replaced or removed."""
    tree = json.loads(text)
    places: list[tuple[Any, Any]] = []

    def walk(node: Any) -> None:
        for key in node if isinstance(node, dict) else range(len(node)):
            places.append((node, key))
            if isinstance(node[key], dict | list):
                walk(node[key])

    walk(tree)
    node, key = places[rng.integers(len(places))]
    wrong = (None, True, -1, 0, 1e308, 10**12, 10**400, "x", "../../etc", "/dev/zero", "", [], {}, [[]], [1, 2], float("nan"), float("inf"))
    choice = rng.integers(len(wrong) + 1)
    if choice < len(wrong):
        node[key] = wrong[choice]
    else:
        del node[key]
    return json.dumps(tree)


# --- the reader ----------------------------------------------------------------------------------------------------------


def outcomes(files: dict[Path, int], seconds: int, megabytes: int) -> dict[Path, tuple[str, str]]:
    """``{file: (outcome, message)}`` of ``{file: megabytes to believe}``, read in a process of its own; what kills it has "died"."""
    found: dict[Path, tuple[str, str]] = {}
    env = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(Path(__file__).resolve().parents[1])}
    left = dict(files)
    while left:
        listing = next(iter(files)).parent / "listing"
        listing.write_text("\n".join(json.dumps([str(path), believed]) for path, believed in left.items()))
        command = [sys.executable, __file__, str(listing), str(seconds), str(megabytes)]
        run = subprocess.run(command, capture_output=True, text=True, env=env, timeout=60 + seconds * 20 + len(left))
        lines = [json.loads(line) for line in run.stdout.splitlines()]
        assert lines, run.stderr
        found |= {Path(path): (outcome, message) for path, outcome, message in lines if outcome != "reading"}
        if run.returncode:
            found[Path(lines[-1][0])] = ("died", f"with {run.returncode}: {run.stderr[-500:]}")
        left = {path: believed for path, believed in left.items() if path not in found}
    return found


def readers(path: Path) -> list[Any]:
    """Everything that the package does with a file of this name, up to a picture of what was in it."""
    import torch

    import torchbrdf as tb

    camera = tb.Camera.look_at([0.0, 0.0, 3.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], 40.0, (4, 4))

    def finite(g: Any) -> None:
        image = tb.shade(g, tb.Lambert(0.5), tb.DirectionalLight([0.0, 0.0, 1.0], 1.0))
        assert bool(torch.isfinite(image).all())

    def scene(p: Path) -> None:
        sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "examples"))
        from recovery import scene_file

        scene_file.load(p, "paint")

    def seen(p: Path) -> None:
        finite(tb.GBuffer.from_mesh(tb.load_mesh(p), camera))

    def gbuffer(p: Path) -> None:
        g = tb.GBuffer.load(p)
        finite(g.replace(view=g.normal))

    if path.suffix == ".json":
        return [scene]
    if path.suffix in (".safetensors", ".pt"):
        return [lambda p: repr(tb.load_value(p))]
    if path.suffix == ".exr":
        return [tb.read_image, gbuffer]
    if path.suffix in (".obj", ".glb", ".gltf", ".ply", ".stl", ".off", ".zip", ".bz2", ".gz"):
        return [seen]
    return [tb.read_image]


class TooLate(BaseException):
    """Not an Exception: no reader may catch it."""


def read_all(listing: Path, seconds: int, megabytes: int) -> None:
    import resource
    import signal

    def late(*_: Any) -> None:
        raise TooLate

    out = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what readers print is of no interest here
    warnings.simplefilter("ignore")
    warm_up(listing.parent / "warm")
    from torchbrdf.io import files

    resource.setrlimit(resource.RLIMIT_AS, (memory("VmSize") + (megabytes << 20),) * 2)
    signal.signal(signal.SIGALRM, late)
    for path, believed in map(json.loads, listing.read_text().splitlines()):
        files.MAX_DECODED_BYTES = believed << 20
        print(json.dumps([path, "reading", ""]), file=out, flush=True)
        print(json.dumps([path, *outcome(Path(path), seconds)]), file=out, flush=True)


def memory(what: str) -> int:
    """Bytes of this process, by the name that Linux has for it."""
    return 1024 * int(re.search(rf"{what}:\s+(\d+)", Path("/proc/self/status").read_text())[1])


def outcome(path: Path, seconds: int) -> tuple[str, str]:
    import signal

    signal.alarm(seconds)
    try:
        said = []
        for reader in readers(path):
            try:
                reader(path)
            except (ValueError, FileNotFoundError) as error:
                if type(error) not in (ValueError, FileNotFoundError):
                    raise
                said.append(f"{type(error).__name__}: {error}")
        return "refused" if len(said) == len(readers(path)) else "read", " | ".join(said)
    except TooLate:
        return "late", f"took more than {seconds} s"
    except BaseException as error:  # Rust's panics are no Exceptions
        return "escaped", f"{type(error).__name__}: {error}"
    finally:
        signal.alarm(0)


def warm_up(folder: Path) -> None:
    """Import whatever reading needs, so that the limit counts the files alone."""
    folder.mkdir(exist_ok=True)
    for make in KINDS.values():
        make(folder)
    for path in folder.iterdir():
        if path.suffix != ".mtl":
            outcome(path, 60)


if __name__ == "__main__":
    read_all(Path(sys.argv[1]), *map(int, sys.argv[2:]))
