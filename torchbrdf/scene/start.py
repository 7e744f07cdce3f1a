"""Where rays leave a surface: the mesh's own surface, and a little off it.

A start on the surface would let rounding make the surface shadow itself ("acne"); one too far off it would make shadows come off. So
it moves along the geometric normal by a bound on what rounding can do there (after Wächter & Binder 2019, who move by a fixed
number of ulps), from the size of the numbers involved:

- a hit point is correct to :data:`POINT_ROUNDINGS` roundings in its own dtype (an interpolation: three products, two sums, and
  the rounding of the weights), projected on the normal: ``gamma sum |n_k p_k|``;
- the ray caster then works in float32 in a frame where the mesh has half diagonal 1: :data:`CAST_ROUNDINGS` roundings of numbers
  of that size (moving start and vertex into the frame, edges, their cross product, and its inner product with the offset).

Points further off the plane of their triangle than that (averages over a pixel, half floats), and points that know no triangle, are
looked for on the mesh. First by triangle and weights, where there are any. Then on the line of sight, both ways, the nearer hit:
what lies between a point and its viewer cannot be in the way of light, because the viewer sees the point. At last along the
normal, on surfaces whose outside is on the same side: what stands on the surface turns its own to it. A hit further off than
:data:`REACH` is another surface, and the point stays where it is.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor

from .. import numerics, vector
from ..vector import Vec, components, dot, stack, subtract
from .gbuffer import GBuffer
from .interpolate import interpolate, triangles
from .mesh import Mesh
from .raycast import NOTHING, RayCaster, caster_of
from .vertex_normals import gather, gather_vectors

POINT_ROUNDINGS = 6
CAST_ROUNDINGS = 16
REACH = 0.01  # of the mesh's half diagonal: about a pixel, where the mesh fills 200
GRAZING = 0.1  # least cosine that shortens a distance along the ray to one across the surface
OVERLAP = 0.125  # of the reach: rays start so far behind a point, or rounding would hide a surface that the point lies on


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
    return _found(g, mesh, caster, given, lost) if bool(lost.any()) else given


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
    return origin, direction.expand(origin.shape), numerics.finite_or_zero(origin.detach() + side * offset * normal)


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


def _known(g: GBuffer, mesh: Mesh) -> Tensor:
    """Where ``g.triangle`` is a face of the mesh, ``[..., 1]``."""
    if g.triangle is None:
        return g.valid.new_zeros(())
    ids = g.triangle.to(torch.int64)
    return (ids >= 0) & (ids < mesh.faces.shape[0])


def _plane(caster: RayCaster, face: Tensor) -> tuple[Vec, Tensor]:
    """Unit normal of the triangles ``face [...]``, and its product with their points (float64)."""
    x, y, z, at = gather(caster.planes.to(face.device).t(), face)
    return Vec(x, y, z), at


def _on_its_triangle(g: GBuffer, mesh: Mesh, caster: RayCaster, given: Start) -> Tensor:
    """Where a point lies on the plane of its triangle, up to rounding, ``[..., 1]``. A half float lies on none."""
    known = _known(g, mesh)
    if g.triangle is None or g.position.dtype in numerics.HALF_TYPES:
        return torch.zeros_like(known)
    normal, at = _plane(caster, g.triangle.squeeze(-1).to(torch.int64).clamp(0, mesh.faces.shape[0] - 1))
    above = dot(normal, components(g.position.double())) - at
    return known & (above.abs().unsqueeze(-1) <= given.offset)


def _found(g: GBuffer, mesh: Mesh, caster: RayCaster, given: Start, lost: Tensor) -> Start:
    """The start with its ``lost [..., 1]`` points put on the mesh, where it is near."""
    shape = g.batch_shape
    where = lost.squeeze(-1).expand(shape)

    def pick(t: Tensor) -> Tensor:
        return t.expand(*shape, t.shape[-1])[where].double()

    def put(t: Tensor, new: Tensor) -> Tensor:
        return t.double().expand(*shape, t.shape[-1]).masked_scatter(where.unsqueeze(-1), new)

    point, normal = pick(g.position), vector.normalize(pick(g.normal))
    there, face = point.clone(), torch.full_like(point[:, 0], NOTHING, dtype=torch.int64)

    def ask(found: Callable[..., tuple[Tensor, Tensor]], *given: Tensor) -> None:
        """Ask one way for the points that no way before it has found."""
        left = face == NOTHING
        there[left], face[left] = found(point[left], *(t[left] for t in given), caster)

    if g.triangle is not None and g.barycentric is not None:
        own = torch.where(_known(g, mesh), g.triangle, NOTHING)
        ask(partial(_by_weights, mesh), pick(own), pick(g.barycentric))
    if g.view is not None:
        ask(_in_sight, vector.normalize(pick(g.view)))
    ask(_above, normal)
    towards = normal if g.view is None else pick(g.view)
    met = (face != NOTHING).unsqueeze(-1)
    plane = stack(_plane(caster, face.clamp_min(0))[0])
    normal = torch.where(met, _turned(plane, towards), pick(given.normal))
    offset = torch.where(met, offset_bound(there, normal, caster), pick(given.offset))
    return Start(put(g.position, there), put(given.normal, normal), put(given.offset, offset), given.usable)


def _by_weights(mesh: Mesh, point: Tensor, triangle: Tensor, weights: Tensor, caster: RayCaster) -> tuple[Tensor, Tensor]:
    """Where triangle and barycentric weights put each ``point [N, 3]``, and the face ``[N]``; itself, and NOTHING, out of reach."""
    face = triangle.squeeze(-1).to(torch.int64)
    whole = weights / weights.sum(-1, keepdim=True)  # rounded ones would leave the plane; those that sum to 0 are near nothing
    there = stack(interpolate(triangles(mesh, face.clamp_min(0)).corners, components(whole)))
    near = (face != NOTHING) & (torch.linalg.vector_norm(there - point, dim=-1) <= REACH * caster.scale)
    return torch.where(near.unsqueeze(-1), there, point), torch.where(near, face, NOTHING)


def _in_sight(point: Tensor, view: Tensor, caster: RayCaster) -> tuple[Tensor, Tensor]:
    """The nearest surface on the line of sight, before or behind each ``point [N, 3]``, and its face ``[N]``."""
    return _nearest(point, view, caster, lambda plane: torch.ones_like(plane.x, dtype=torch.bool))


def _above(point: Tensor, normal: Tensor, caster: RayCaster) -> tuple[Tensor, Tensor]:
    """The same along the normal, of surfaces whose outside is on its side alone: not what stands on the surface."""
    return _nearest(point, normal, caster, lambda plane: dot(plane, components(normal)) > 0)


def _nearest(point: Tensor, along: Tensor, caster: RayCaster, legal: Callable[[Vec], Tensor]) -> tuple[Tensor, Tensor]:
    """The nearest legal surface along unit ``along [N, 3]``, either way, and its face ``[N]``; the point, and NOTHING, out of reach."""
    reach = REACH * caster.scale
    best, face = torch.full_like(point[:, 0], torch.inf), torch.full_like(point[:, 0], NOTHING, dtype=torch.int64)
    for sign in (1.0, -1.0):
        seen = caster.first_hit(point - sign * OVERLAP * reach * along, sign * along)
        plane, at = _plane(caster, seen.clamp_min(0))
        cosine = dot(plane, components(along))
        distance = (at - dot(plane, components(point))) / cosine
        near = (distance.abs() * cosine.abs().clamp_min(GRAZING) <= reach) & (distance.abs() < best.abs())  # NaN is not near
        near = near & (seen != NOTHING) & legal(plane)
        best, face = torch.where(near, distance, best), torch.where(near, seen, face)
    step = torch.where(face != NOTHING, best, 0.0).unsqueeze(-1)
    return point + step * along, face
