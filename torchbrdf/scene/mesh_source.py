"""Mesh files from outside, read by trimesh into geometries and where they stand, after adding up what they claim.

trimesh believes a file: a glTF accessor without data becomes zeros of any length, a buffer or a picture may be any file of
the disk, an archive unpacks to any size. So what is read beside the file lies in its folder, pictures are left alone, archives
are refused, and the counts of a glTF tree are added up first (:mod:`torchbrdf.files`).
"""

import io
import json
import math
import re
import struct
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from ..io import files

MOST_MATERIALS = 4096  # of an OBJ file: trimesh's time grows with their square
_ITEMS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}


def placed_geometries(path: Path) -> list[tuple[Any, np.ndarray]]:
    """(geometry, world matrix [4, 4]) of every part of a mesh file, in the order of the file's geometries."""
    import trimesh

    kinds = sorted(trimesh.exchange.load.mesh_formats())
    kind = path.suffix.lower().removeprefix(".")
    try:
        if kind not in kinds:
            raise ValueError(f"its name ends in {path.suffix!r}, which is no mesh format; archives are not unpacked")
        data = path.read_bytes()
        _check_claims(kind, data, path.parent)
        if kind in ("obj", "off"):  # a name or a comment may be in any encoding
            data = data.decode(errors="replace").encode()
        scene = trimesh.load_scene(io.BytesIO(data), file_type=kind, **_options(kind, path.parent))
        placed = _placed(scene)
        files.check_claim(sum(map(_held, (geometry for geometry, _ in placed))), len(data), f"its {len(placed)} parts, put together")
    except Exception as error:
        why = "it is not UTF-8 text" if "charset_normalizer" in str(error) else files.reason(error)  # which guesses other encodings
        raise ValueError(f"load_mesh: cannot read {path} ({why}); formats that can be read: {', '.join(kinds)}") from None
    return placed


class _Beside:
    """What trimesh may read besides the file itself: regular files in its folder or below."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def get(self, name: str) -> bytes:
        return _beside(self.folder, name).read_bytes()

    __getitem__ = get


def _beside(folder: Path, name: str) -> Path:
    inside = not Path(name).is_absolute() and ".." not in Path(name).parts
    if not inside or not (folder / name).is_file():
        raise FileNotFoundError(f"it refers to {name!r}, which is no file in its folder")
    return folder / name


def _options(kind: str, folder: Path) -> dict[str, Any]:
    pictures = {"skip_materials": True} if kind in ("obj", "ply", "glb", "gltf") else {}
    return {"resolver": _Beside(folder), "process": False, **pictures}


def _check_claims(kind: str, data: bytes, folder: Path) -> None:
    if kind in ("glb", "gltf"):
        _check_gltf(json.loads(data if kind == "gltf" else data[20 : 20 + struct.unpack("<I", data[12:16])[0]]), len(data), folder)
    if kind == "obj":
        count = len(set(re.findall(rb"^usemtl[^\n]*", data, re.MULTILINE)))
        if count > MOST_MATERIALS:
            raise ValueError(f"it has {count} materials, and at most {MOST_MATERIALS} are read; join some")
    if zipfile.is_zipfile(io.BytesIO(data)):  # 3MF and others are zip files by another name
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            files.check_claim(sum(record.file_size for record in archive.infolist()), len(data), "what it unpacks to")


def _check_gltf(tree: dict[str, Any], size: int, folder: Path) -> None:
    uris = [b["uri"] for b in tree.get("buffers", []) if not b.get("uri", "data:").startswith("data:")]
    size += sum(_beside(folder, uri).stat().st_size for uri in uris)
    files.check_claim(_claimed(tree), size, "what its views, accessors and primitives claim")


def _claimed(tree: dict[str, Any]) -> int:
    """Bytes that the views, the accessors, and the accessors of every primitive of a glTF tree come to."""
    accessors = [_natural(a["count"]) * _ITEMS[a["type"]] * _BYTES[a["componentType"]] for a in tree.get("accessors", [])]
    primitives = (p for mesh in tree.get("meshes", []) for p in mesh["primitives"])
    used = (i for p in primitives for i in (*p["attributes"].values(), *([p["indices"]] if "indices" in p else [])))
    return sum(_natural(v["byteLength"]) for v in tree.get("bufferViews", [])) + sum(accessors) + sum(accessors[i] for i in used)


def _natural(count: Any) -> int:
    if not isinstance(count, int) or count < 0:
        raise ValueError(f"a count in it is {count!r}")
    return count


def _held(geometry: Any) -> int:
    return sum(math.prod(np.shape(getattr(geometry, n, ()))) * 8 for n in ("vertices", "faces"))


def _placed(scene: Any) -> list[tuple[Any, np.ndarray]]:
    """The scene graph laid flat. (trimesh walks up from every node, which takes the square of the depth, and circles on.)"""
    root = scene.graph.base_frame
    edges = [edge for edge in scene.graph.to_edgelist() if (edge[0], edge[1]) != (root, root)]  # trimesh 4 joins the root to itself
    above = {child: (parent, np.asarray(data.get("matrix", np.eye(4))), data.get("geometry")) for parent, child, data in edges}
    world: dict[Any, np.ndarray] = {}
    for node in above:
        way = []
        while node in above and node not in world:
            way.append(node)
            node = above[node][0]
            if len(way) > len(above):
                raise ValueError("its nodes form a circle")
        for step in reversed(way):
            world[step] = world.get(above[step][0], np.eye(4)) @ above[step][1]
    order = {name: k for k, name in enumerate(scene.geometry)}  # that of the file; the graph's own is not
    nodes = sorted((n for n in above if above[n][2] in order), key=lambda n: order[above[n][2]])
    return [(scene.geometry[above[n][2]], world[n]) for n in nodes]
