"""Reading mesh files through trimesh, without its repairs: faces and vertices keep their order."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .mesh_source import placed_geometries


class Part(NamedTuple):
    """One triangle mesh of a file, moved to its place."""

    vertices: np.ndarray  # [V, 3]
    faces: np.ndarray  # [F, 3]
    normals: np.ndarray | None  # [V, 3]
    uv: np.ndarray | None  # [V, 2]


def read_mesh(path: Path) -> dict[str, Any]:
    """The fields of a :class:`Mesh` (numpy arrays) from a file; scenes are put together into one mesh."""
    parts = _parts(path)
    if not parts:
        raise ValueError(f"load_mesh: {path} holds no faces (a point cloud, or lines); export it as a triangle mesh")
    counts = [len(p.vertices) for p in parts]
    starts = np.cumsum([0, *counts[:-1]])
    faces = np.concatenate([p.faces + s for p, s in zip(parts, starts, strict=True)]).astype(np.int64)
    fields: dict[str, Any] = {"vertices": _single([p.vertices for p in parts]), "faces": faces}
    if all(p.normals is not None for p in parts):
        fields["normals"] = _single([p.normals for p in parts])
    if any(p.uv is not None for p in parts):
        fields["uv"] = _single([np.zeros((n, 2)) if p.uv is None else p.uv for p, n in zip(parts, counts, strict=True)])
    if len(parts) > 1:
        fields["material"] = np.repeat(np.arange(len(parts)), [len(p.faces) for p in parts])[:, None]
    return _join_seams(fields) if "uv" in fields else fields


def _parts(path: Path) -> list[Part]:
    import trimesh

    return [_part(m, where) for m, where in placed_geometries(path) if isinstance(m, trimesh.Trimesh) and len(m.faces)]


@np.errstate(over="ignore", invalid="ignore")  # what overflows is found, and named, by Mesh.check
def _part(mesh: Any, where: np.ndarray) -> Part:
    vertices, faces, normals, uv = np.asarray(mesh.vertices), np.asarray(mesh.faces), _normals(mesh), _uv(mesh)
    if not np.array_equal(where, np.eye(4)):
        turn = where[:3, :3]
        cofactors = np.cross(turn[[1, 2, 0]], turn[[2, 0, 1]])  # det times the inverse transpose, which turns normals
        cofactors /= np.abs(cofactors).max() or 1.0  # a small part keeps normals that float32 can hold
        mirrored = np.linalg.det(turn) < 0
        vertices = vertices @ turn.T + where[:3, 3]
        normals = None if normals is None else normals @ (-cofactors if mirrored else cofactors).T
        faces = faces[:, ::-1] if mirrored else faces  # mirroring turns the winding
    return Part(vertices, faces, normals, uv)


@np.errstate(over="ignore")
def _single(parts: list[Any]) -> np.ndarray:
    return np.concatenate(parts).astype(np.float32)


def _normals(part: Any) -> np.ndarray | None:
    """The vertex normals that the file gave; asking for the attribute itself would make them up."""
    return part.vertex_normals if "vertex_normals" in getattr(part, "_cache", ()) else None


def _uv(part: Any) -> np.ndarray | None:
    uv = getattr(part.visual, "uv", None)
    return uv if uv is not None and np.shape(uv) == (len(part.vertices), 2) else None


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
