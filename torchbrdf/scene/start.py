"""Where rays leave a surface: the mesh's own surface, and a little off it.

A start on the surface would let rounding make the surface shadow itself ("acne"); one too far off it would make shadows come off. So
it moves along the geometric normal by a bound on what rounding can do there (after Wächter & Binder 2019, who move by a fixed
number of ulps), from the size of the numbers involved:

- a hit point is correct to :data:`POINT_ROUNDINGS` roundings in its own dtype (an interpolation: three products, two sums, and
  the rounding of the weights), projected on the normal: ``gamma sum |n_k p_k|``;
- the ray caster then works in float32 in a frame where the mesh has half diagonal 1: :data:`CAST_ROUNDINGS` roundings of numbers
  of that size (moving start and vertex into the frame, edges, their cross product, and its inner product with the offset).

Points further off the plane of their triangle than that (averages over a pixel, half floats), and points that know no triangle, are
looked for on the mesh (:mod:`.near`).
"""

from typing import NamedTuple

import torch
from torch import Tensor

from .. import numerics, vector
from ..vector import components, dot, stack, subtract
from .gbuffer import GBuffer
from .mesh import Mesh
from .near import own_point, plane_of
from .raycast import NOTHING, RayCaster, caster_of
from .vertex_normals import gather_vectors

POINT_ROUNDINGS = 6
CAST_ROUNDINGS = 16


class Start(NamedTuple):
    """Points of a surface that rays leave."""

    point: Tensor  # [..., 3]
    normal: Tensor  # [..., 3] unit, of the true surface, on the side it is seen from
    offset: Tensor  # [..., 1] float64, how far along the normal rays start
    usable: Tensor  # [..., 1] bool, where there is a point


def offset_bound(points: Tensor, normal: Tensor, caster: RayCaster) -> Tensor:
    """How far ``[..., 1]`` (float64) rounding may have put ``points [..., 3]`` from the caster's surface, along ``normal [..., 3]``."""
    size = dot(components(normal.double().abs()), components(points.double().abs()))
    return (gamma(POINT_ROUNDINGS, points.dtype) * size + gamma(CAST_ROUNDINGS, torch.float32) * caster.scale).unsqueeze(-1)


def gamma(roundings: int, dtype: torch.dtype) -> float:
    """Bound on the relative error of so many roundings in sequence (Higham 2002, lemma 3.1)."""
    unit = 0.5 * torch.finfo(dtype).eps
    return roundings * unit / (1.0 - roundings * unit)


@torch.no_grad()
def starts(g: GBuffer, mesh: Mesh, caster: RayCaster) -> Start:
    """Where rays leave the surface of ``g``; ``caster`` is that of ``mesh``."""
    mesh = mesh.to(g.position.device)
    normal = _facing_normal(g, mesh)
    x, y, z = components(g.position)
    usable = g.valid & (((x - x) + (y - y) + (z - z)) == 0).unsqueeze(-1)  # finite: infinity - infinity is NaN
    given = Start(g.position, normal, offset_bound(g.position, normal, caster), usable)
    lost = usable & ~_on_its_triangle(g, mesh, caster, given)
    return _mended(g, mesh, caster, given, lost) if bool(lost.any()) else given


def leave(g: GBuffer, mesh: Mesh, origin: Tensor, direction: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Origin, direction and start ``[..., 3]`` of rays that leave the surface of ``g``, from their origins and unit directions (float64).

    The origins become the mesh's own points (with the gradient of what they were), the starts lie off the surface on the side of
    the direction, and pixels that are not valid get the direction 0.
    """
    at = starts(g, mesh, caster_of(mesh))
    point, normal, offset = (t.detach().to(origin.device, torch.float64) for t in at[:3])
    off = stack(subtract(components(point), components(origin.detach())))
    origin = origin + numerics.finite_or_zero(off)
    direction = torch.where(at.usable.to(direction.device), direction, 0.0)
    side = torch.sign(dot(components(normal), components(direction.detach()))).unsqueeze(-1)
    return origin, direction.expand(origin.shape), origin.detach() + side * offset * normal


def _facing_normal(g: GBuffer, mesh: Mesh) -> Tensor:
    """The normal of the true surface, turned to the side it is seen from (or, without a view, to the shading normal's side)."""
    normal = g.geometric_normal
    if normal is None:
        normal = g.normal if g.triangle is None else _face_normals(mesh, g.triangle.squeeze(-1))
    return _turned(normal, g.normal if g.view is None else g.view)


def _turned(normal: Tensor, towards: Tensor) -> Tensor:
    return torch.where((dot(components(normal), components(towards)) < 0).unsqueeze(-1), -normal, normal)


def _face_normals(mesh: Mesh, triangle: Tensor) -> Tensor:
    if triangle.numel() and int(triangle.amax()) >= mesh.faces.shape[0]:
        found = f"found {int(triangle.amax())}, and the mesh has {mesh.faces.shape[0]} faces"
        raise ValueError(f"GBuffer.triangle: {found}; pass the mesh that the G-buffer was made from")
    faces = mesh.faces[triangle.clamp_min(0)].to(torch.int64)
    a, b, c = (gather_vectors(mesh.vertices, i) for i in faces.unbind(-1))
    return stack(vector.normalize_components(vector.cross(vector.subtract(b, a), vector.subtract(c, a))))


def _faces_of(mesh: Mesh, triangle: Tensor) -> Tensor:
    """``triangle [..., 1]`` where it is a face of the mesh, else NOTHING (int64)."""
    ids = triangle.to(torch.int64)
    return torch.where((ids >= 0) & (ids < mesh.faces.shape[0]), ids, NOTHING)


def _on_its_triangle(g: GBuffer, mesh: Mesh, caster: RayCaster, given: Start) -> Tensor:
    """Where a point lies on the plane of its triangle, up to rounding, ``[..., 1]``. A half float lies on none."""
    if g.triangle is None or g.position.dtype in numerics.HALF_TYPES:
        return torch.zeros_like(given.usable)
    face = _faces_of(mesh, g.triangle)
    normal, at = plane_of(caster, face.squeeze(-1).clamp_min(0))
    above = dot(normal, components(g.position.double())) - at
    return (face != NOTHING) & (above.abs().unsqueeze(-1) <= given.offset)


def _mended(g: GBuffer, mesh: Mesh, caster: RayCaster, given: Start, lost: Tensor) -> Start:
    """The start with its ``lost [..., 1]`` points put on the mesh, where it is near."""
    shape = g.batch_shape
    where = lost.squeeze(-1).expand(shape)

    def pick(t: Tensor) -> Tensor:
        return t.expand(*shape, t.shape[-1])[where].double()

    def put(t: Tensor, new: Tensor) -> Tensor:
        return t.double().expand(*shape, t.shape[-1]).masked_scatter(where.unsqueeze(-1), new)

    triangle = None if g.triangle is None else _faces_of(mesh, g.triangle)
    hints = {"normal": g.normal, "view": g.view, "triangle": triangle, "weights": g.barycentric}
    there, face = own_point(mesh, caster, pick(g.position), **{name: pick(t) for name, t in hints.items() if t is not None})
    met = (face != NOTHING).unsqueeze(-1)
    plane = stack(plane_of(caster, face.clamp_min(0))[0])
    normal = torch.where(met, _turned(plane, pick(g.normal if g.view is None else g.view)), pick(given.normal))
    offset = torch.where(met, offset_bound(there, normal, caster), pick(given.offset))
    return Start(put(g.position, there), put(given.normal, normal), put(given.offset, offset), given.usable)
