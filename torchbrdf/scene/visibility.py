"""Who is in whose shadow: rays from the shading points to the lights, against the true geometry.

The start of a shadow ray must leave the surface it stands on, or rounding makes the surface shadow itself ("acne"); it must not
leave it further than that, or shadows come off. So the start moves along the geometric normal by a bound on what rounding can do
there (after Wächter & Binder 2019, who move by a fixed number of ulps), from the size of the numbers involved:

- a hit point is correct to :data:`POINT_ROUNDINGS` roundings in its own dtype (an interpolation: three products, two sums, and
  the rounding of the weights), projected on the normal: ``gamma sum |n_k p_k|``;
- the ray caster then works in float32 in a frame where the mesh has half diagonal 1: :data:`CAST_ROUNDINGS` roundings of numbers
  of that size (moving start and vertex into the frame, edges, their cross product, and its inner product with the offset).
"""

import math
from collections.abc import Iterator, Sequence
from typing import Any

import torch
from torch import Tensor

from .. import arguments, numerics, vector
from ..value import Value
from ..vector import components, dot, stack
from .gbuffer import GBuffer
from .intersect import gather_vectors
from .mesh import Mesh
from .raycast import RayCaster, caster_of

POINT_ROUNDINGS = 6
CAST_ROUNDINGS = 16


@torch.no_grad()
def visibility(g: GBuffer, lights: Any, mesh: Mesh) -> Tensor:
    """``[L, ..., 1]`` in the dtype of ``g``: 1 where a light reaches the point, 0 where ``mesh`` is in the way.

    ``lights`` is one light or a list; L counts the lights of all those that stand in one direction (those with the method
    ``shadow_targets``), in order. Others, such as environment maps, get no row. Without gradient, and not for graphs. A light on the
    other side of the *geometric* surface than the viewer is invisible, whatever the shading normal says (hard terminator).
    Pixels that are not valid get 0. Where ``g`` has no geometric normal, the mesh gives it by ``g.triangle``, or else the shading
    normal serves.
    """
    arguments.of_kind(g, "g", GBuffer, "tb.GBuffer.from_mesh(mesh, camera)")
    caster = caster_of(arguments.of_kind(mesh, "mesh", Mesh, "tb.load_mesh(path)"))
    normal = _facing_normal(g, mesh)
    offset = offset_bound(g.position, normal, caster)
    rows = [_row(g, normal, offset, *target, caster) for target in _targets(lights, g.position)]
    shape = torch.broadcast_shapes(g.position.shape[:-1], normal.shape[:-1])
    return torch.stack(rows) if rows else g.position.new_zeros(0, *shape, 1)


def offset_bound(points: Tensor, normal: Tensor, caster: RayCaster) -> Tensor:
    """How far ``[..., 1]`` (float64) rounding may have put ``points [..., 3]`` from the caster's surface, along ``normal [..., 3]``."""
    size = dot(components(normal.double().abs()), components(points.double().abs()))
    return (gamma(POINT_ROUNDINGS, points.dtype) * size + gamma(CAST_ROUNDINGS, torch.float32) * caster.scale).unsqueeze(-1)


def gamma(roundings: int, dtype: torch.dtype) -> float:
    """Bound on the relative error of so many roundings in sequence (Higham 2002, lemma 3.1)."""
    unit = 0.5 * torch.finfo(dtype).eps
    return roundings * unit / (1.0 - roundings * unit)


def _targets(lights: Any, points: Tensor) -> Iterator[tuple[Tensor, Tensor]]:
    """(direction, distance) of every single light that stands in one direction."""
    for k, light in enumerate(lights if isinstance(lights, Sequence) else (lights,)):
        if light is None or isinstance(light, int | float | str | Tensor | Sequence):
            arguments.of_kind(light, f"lights[{k}]", Value, "tb.PointLight(position, intensity)")
        if getattr(getattr(light, "kind", None), "name", "") == "DELTA":
            found = light.sample(numerics.widen(points))
            yield from zip(found.wi.unbind(0), found.distance.unbind(0), strict=True)


def _facing_normal(g: GBuffer, mesh: Mesh) -> Tensor:
    """The normal of the true surface, turned to the side it is seen from (or, without a view, to the shading normal's side)."""
    normal = g.geometric_normal
    if normal is None:
        normal = g.normal if g.triangle is None else _face_normals(mesh, g.triangle.squeeze(-1))
    side = dot(components(normal), components(g.normal if g.view is None else g.view))
    return torch.where((side < 0).unsqueeze(-1), -normal, normal)


def _face_normals(mesh: Mesh, triangle: Tensor) -> Tensor:
    if triangle.numel() and int(triangle.amax()) >= mesh.faces.shape[0]:
        found = f"found {int(triangle.amax())}, and the mesh has {mesh.faces.shape[0]} faces"
        raise ValueError(f"GBuffer.triangle: {found}; pass the mesh that the G-buffer was made from")
    faces = mesh.faces[triangle.clamp_min(0)].to(torch.int64)
    a, b, c = (gather_vectors(mesh.vertices, i) for i in faces.unbind(-1))
    return stack(vector.normalize_components(vector.cross(vector.subtract(b, a), vector.subtract(c, a))))


def _row(g: GBuffer, normal: Tensor, offset: Tensor, direction: Tensor, distance: Tensor, caster: RayCaster) -> Tensor:
    """Visibility ``[..., 1]`` of one light; rays are cast only where the light stands above the true surface."""
    above = dot(components(normal), components(direction)).unsqueeze(-1) > 0
    asked = (above & g.valid & torch.isfinite(g.position).all(-1, keepdim=True)).squeeze(-1)

    def pick(t: Tensor) -> Tensor:
        return t.expand(*asked.shape, t.shape[-1])[asked].double()

    start = pick(g.position) + pick(offset) * pick(normal)
    towards, reach = _aim(start, pick(g.position), pick(direction), pick(distance))
    free = ~caster.occluded(start, towards, reach - pick(offset).squeeze(-1))
    return torch.zeros_like(asked).masked_scatter(asked, free).unsqueeze(-1).to(g.position.dtype)


def _aim(start: Tensor, point: Tensor, direction: Tensor, distance: Tensor) -> tuple[Tensor, Tensor]:
    """Unit direction and distance ``[N]`` from the moved start to the light; a light at infinity stays where it is."""
    far = torch.isinf(distance)
    to_light = point + torch.where(far, 0.0, distance) * direction - start
    length = torch.linalg.vector_norm(to_light, dim=-1, keepdim=True)
    towards = torch.where(far | (length == 0), direction, to_light / length)
    return towards, torch.where(far, math.inf, length).squeeze(-1)
