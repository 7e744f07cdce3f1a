"""Reading mesh files through trimesh, without its repairs: faces and vertices keep their order."""

from pathlib import Path
from typing import Any

import numpy as np


def read_mesh(path: Path) -> dict[str, Any]:
    """The fields of a :class:`Mesh` (numpy arrays) from a file; scenes are put together into one mesh."""
    parts = _parts(path)
    if not parts:
        raise ValueError(f"load_mesh: {path} holds no faces (a point cloud, or lines); export it as a triangle mesh")
    counts = [len(p.vertices) for p in parts]
    starts = np.cumsum([0, *counts[:-1]])
    faces = np.concatenate([np.asarray(p.faces) + s for p, s in zip(parts, starts, strict=True)]).astype(np.int64)
    fields: dict[str, Any] = {"vertices": np.concatenate([p.vertices for p in parts]).astype(np.float32), "faces": faces}
    if all(map(_has_normals, parts)):
        fields["normals"] = np.concatenate([p.vertex_normals for p in parts]).astype(np.float32)
    uvs = [_uv(p) for p in parts]
    if any(u is not None for u in uvs):
        filled = [np.zeros((n, 2)) if u is None else u for u, n in zip(uvs, counts, strict=True)]
        fields["uv"] = np.concatenate(filled).astype(np.float32)
    if len(parts) > 1:
        fields["material"] = np.repeat(np.arange(len(parts)), [len(p.faces) for p in parts])[:, None]
    return _join_seams(fields) if "uv" in fields else fields


def _parts(path: Path) -> list[Any]:
    import trimesh

    if not path.is_file():
        raise FileNotFoundError(f"load_mesh: no such file: {path}")
    try:
        scene = trimesh.load_scene(path, process=False)
    except Exception as error:
        kinds = ", ".join(sorted(trimesh.available_formats()))
        raise ValueError(f"load_mesh: cannot read {path} ({type(error).__name__}: {error}); formats that can be read: {kinds}") from None
    order = list(scene.geometry)  # that of the file; the graph's own is not
    nodes = sorted(scene.graph.nodes_geometry, key=lambda node: order.index(scene.graph[node][1]))
    placed = (_placed(scene, node) for node in nodes)
    return [p for p in placed if isinstance(p, trimesh.Trimesh) and len(p.faces)]


def _placed(scene: Any, node: str) -> Any:
    """A part of the scene moved to its place. (``Scene.dump`` would drop the normals that the file gave.)"""
    transform, name = scene.graph[node]
    part = scene.geometry[name]
    return part if np.array_equal(transform, np.eye(4)) else _moved(part, transform)


def _moved(part: Any, transform: np.ndarray) -> Any:
    given = part.vertex_normals if _has_normals(part) else None
    moved = part.copy().apply_transform(transform)
    if given is not None:  # normals turn with the inverse transpose, and mirroring turns the winding with them
        turn = np.linalg.inv(transform[:3, :3]).T
        moved.vertex_normals = given @ turn.T
    return moved


def _has_normals(part: Any) -> bool:
    """Whether the file gave vertex normals; asking for the attribute itself would make them up."""
    return "vertex_normals" in getattr(part, "_cache", ())


def _uv(part: Any) -> np.ndarray | None:
    uv = getattr(part.visual, "uv", None)
    return uv if uv is not None and len(uv) == len(part.vertices) else None


def _join_seams(fields: dict[str, Any]) -> dict[str, Any]:
    """Join vertices that agree in position and normal and differ only in uv; uv keeps the split indices."""
    keys = np.concatenate([fields[n] for n in ("vertices", "normals") if n in fields], 1)
    _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    if len(first) == len(keys):
        return fields
    order = np.argsort(first)  # keep the file's order: that of the first appearance
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    kept: dict[str, Any] = {n: fields[n][first[order]] for n in ("vertices", "normals") if n in fields}
    return {**fields, **kept, "faces": rank[inverse.reshape(-1)][fields["faces"]], "uv_faces": fields["faces"]}
