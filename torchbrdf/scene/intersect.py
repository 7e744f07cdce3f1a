"""From the triangle behind each pixel to everything that is known there, differentiably.

Distance and barycentrics follow from the ray and the plane of the triangle in float64, and are rounded once at the end:
differences of float32 positions would cost the digits that the position is asked for.
"""

from typing import Any

import torch
from torch import Tensor

from .. import vector
from ..vector import Vec, cross, dot, stack, subtract
from .camera import Camera
from .mesh import Mesh
from .raycast import NOTHING, caster_of
from .vertex_normals import gather, gather_vectors


def gbuffer_fields(mesh: Mesh, camera: Camera) -> dict[str, Any]:
    """The fields of :class:`GBuffer` for ``camera [...]``, each ``[..., H, W, k]`` in planar memory."""
    kind = mesh.vertices.dtype
    view_from = camera.to_double(mesh.vertices.device)
    origin, direction = view_from.rays()
    triangle = caster_of(mesh).first_hit(origin, direction)
    o, d = vector.components(origin), vector.components(direction)
    found = triangle != NOTHING
    face = torch.where(found, triangle, 0)
    corners = tuple(c.unflatten(0, face.shape) for c in mesh.faces.t().to(torch.int64).index_select(1, face.reshape(-1)).unbind(0))
    a, b, c = (gather_vectors(mesh.vertices.double(), i) for i in corners)
    edges = subtract(b, a), subtract(c, a)
    plane = cross(*edges)
    hit, distance, weights = _intersect(o, d, a, edges, plane, found)
    normals = mesh.shading_normals() if mesh.normals is not None else mesh.replace(vertices=mesh.vertices.double()).shading_normals()
    usable = torch.isfinite(normals).all(-1)
    finite = torch.where(usable.unsqueeze(-1), normals.double(), 0.0)  # NaN in a corner would be NaN in the gradient of the weights
    normal = interpolate([gather(finite, i) for i in corners], weights)
    normal = tuple(torch.where(usable[torch.stack(corners)].all(0), c, 0.0) for c in normal)
    position = vector.add(o, vector.scale(d, distance))

    def out(parts: Any) -> Tensor:
        return stack(tuple(torch.where(hit, p, 0.0) for p in parts)).to(kind)

    fields = {
        "position": out(position),
        "normal": out(vector.normalize_components(Vec(*normal))),
        "view": vector.planar(-direction).to(kind),
        "geometric_normal": out(vector.normalize_components(plane)),
        "depth": out((distance,)),
        "mask": hit.unsqueeze(-1),
        "triangle": torch.where(hit, triangle, NOTHING).unsqueeze(-1),
        "barycentric": out(weights),
    }
    if mesh.uv is not None:
        uv_corners = corners if mesh.uv_faces is None else tuple(mesh.uv_faces.t().to(torch.int64)[:, face].unbind(0))
        finite = torch.where(torch.isfinite(mesh.uv).all(-1, keepdim=True), mesh.uv.double(), 0.0)  # as the normals
        uv = [gather(finite, i) for i in uv_corners]
        fields["uv"] = out(interpolate(uv, weights))
        fields["tangent"] = out(_tangent(edges, uv))
    if mesh.material is not None:
        fields["material"] = torch.where(hit, mesh.material.squeeze(-1)[face], 0).unsqueeze(-1)
    return fields


def _intersect(o: Vec, d: Vec, a: Vec, edges: tuple[Vec, Vec], plane: Vec, found: Tensor) -> tuple[Tensor, Tensor, tuple[Tensor, ...]]:
    """Whether there is a proper hit, its distance, and its barycentric weights (Möller & Trumbore 1997).

    ``plane`` is the cross product of the edges. Rays in the plane, and degenerate triangles, are no hits.
    """
    against = dot(plane, d)
    hit = found & (against != 0)
    inverse = 1.0 / torch.where(hit, against, 1.0)
    from_corner = subtract(o, a)
    distance = -dot(plane, from_corner) * inverse
    turned = cross(d, from_corner)
    second = dot(edges[1], turned) * inverse
    third = -dot(edges[0], turned) * inverse
    return hit & (distance.detach() > 0), distance, (1.0 - second - third, second, third)


def interpolate(corners: list[Any], weights: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
    """Barycentric mean of values at the three corners, component by component."""
    return tuple(sum(w * p for w, p in zip(weights, parts, strict=True)) for parts in zip(*corners, strict=True))


def _tangent(edges: tuple[Vec, Vec], uv: list[Any]) -> Vec:
    """Unit direction along which u grows and v does not; 0 with gradient 0 where the texture coordinates are degenerate."""
    (u0, v0), (u1, v1), (u2, v2) = uv
    first, second = (u1 - u0, v1 - v0), (u2 - u0, v2 - v0)
    area = (first[0] * second[1] - second[0] * first[1]).detach()
    along = subtract(vector.scale(edges[0], second[1]), vector.scale(edges[1], first[1]))
    unit = vector.normalize_components(vector.scale(along, torch.sign(area)))
    return Vec(*(torch.where(area != 0, c, 0.0) for c in unit))
