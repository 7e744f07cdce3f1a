"""What is known at a point of a triangle: the attributes of its corners, interpolated differentiably in float64."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from .. import vector
from ..vector import Vec, cross, dot, stack, subtract
from .mesh import Mesh
from .raycast import NOTHING
from .vertex_normals import gather, gather_vectors


class Triangles(NamedTuple):
    """The triangles ``face [...]`` of a mesh: their corners by index and position, two edges and their cross product."""

    face: Tensor
    vertices: tuple[Tensor, ...]
    corners: tuple[Vec, ...]
    edges: tuple[Vec, Vec]
    plane: Vec


def triangles(mesh: Mesh, face: Tensor) -> Triangles:
    """The triangles ``face [...]``, in float64."""
    index = gather(mesh.faces.to(torch.int64), face)
    points = mesh.vertices.double()
    a, b, c = (gather_vectors(points, i) for i in index)
    edges = subtract(b, a), subtract(c, a)
    return Triangles(face, index, (a, b, c), edges, cross(*edges))


def interpolate(corners: Sequence[Any], weights: Sequence[Tensor]) -> tuple[Tensor, ...]:
    """Barycentric mean of values at the three corners, component by component."""
    return tuple(sum(w * p for w, p in zip(weights, parts, strict=True)) for parts in zip(*corners, strict=True))


def masked(parts: Sequence[Tensor], hit: Tensor, dtype: torch.dtype) -> Tensor:
    """Components as planar ``[..., k]``, 0 with gradient 0 where nothing was hit."""
    return stack(tuple(torch.where(hit, p, 0.0) for p in parts)).to(dtype)


def attributes(mesh: Mesh, at: Triangles, hit: Tensor, weights: tuple[Tensor, ...]) -> dict[str, Tensor]:
    """The fields of a G-buffer that follow from triangles and barycentric ``weights``: all but position, view and depth."""
    kind = mesh.vertices.dtype
    normal = _normal(mesh, at, weights)
    fields = {
        "normal": masked(vector.normalize_components(normal), hit, kind),
        "geometric_normal": masked(vector.normalize_components(at.plane), hit, kind),
        "mask": hit.unsqueeze(-1),
        "triangle": torch.where(hit, at.face, NOTHING).unsqueeze(-1),
        "barycentric": masked(weights, hit, kind),
    }
    if mesh.uv is not None:
        uv = _uv_corners(mesh, at)
        fields["uv"] = masked(interpolate(uv, weights), hit, kind)
        tangent, area = _tangent(at.edges, uv)
        fields["tangent"] = masked(tangent, hit, kind)
        # The bitangent is handedness (n x tangent), so what counts is the side of the shading normal.
        flipped = dot(normal, at.plane).detach() < 0
        fields["handedness"] = masked((torch.where(flipped, -area, area),), hit, kind)
    if mesh.material is not None:
        fields["material"] = torch.where(hit, mesh.material.squeeze(-1)[at.face], 0).unsqueeze(-1)
    return fields


def _normal(mesh: Mesh, at: Triangles, weights: tuple[Tensor, ...]) -> Vec:
    """The shading normal, not normalised; 0 where that of a corner is not finite."""
    normals = mesh.shading_normals() if mesh.normals is not None else mesh.replace(vertices=mesh.vertices.double()).shading_normals()
    usable = torch.isfinite(normals).all(-1)
    finite = torch.where(usable.unsqueeze(-1), normals.double(), 0.0)  # NaN in a corner would be NaN in the gradient of the weights
    normal = interpolate([gather(finite, i) for i in at.vertices], weights)
    return Vec(*(torch.where(usable[torch.stack(at.vertices)].all(0), c, 0.0) for c in normal))


def _uv_corners(mesh: Mesh, at: Triangles) -> list[tuple[Tensor, ...]]:
    """Texture coordinates of the corners; those that are not finite count as 0."""
    assert mesh.uv is not None
    index = at.vertices if mesh.uv_faces is None else tuple(mesh.uv_faces.t().to(torch.int64)[:, at.face].unbind(0))
    finite = torch.where(torch.isfinite(mesh.uv).all(-1, keepdim=True), mesh.uv.double(), 0.0)  # as the normals
    return [gather(finite, i) for i in index]


def _tangent(edges: tuple[Vec, Vec], uv: list[tuple[Tensor, ...]]) -> tuple[Vec, Tensor]:
    """Unit direction along which u grows and v does not, and the sign of the uv triangle's area.

    Both are 0, with gradient 0, where the texture coordinates are degenerate.
    """
    (u0, v0), (u1, v1), (u2, v2) = uv
    first, second = (u1 - u0, v1 - v0), (u2 - u0, v2 - v0)
    area = torch.sign((first[0] * second[1] - second[0] * first[1]).detach())
    along = subtract(vector.scale(edges[0], second[1]), vector.scale(edges[1], first[1]))
    unit = vector.normalize_components(vector.scale(along, area))
    return Vec(*(torch.where(area != 0, c, 0.0) for c in unit)), area
