"""The mesh's own point for a point that lost digits on its way: an average over a pixel, a half float, another tessellation.

Asked in this order, until one answers: the point's triangle and weights; its line of sight, both ways, the nearer hit (what lies
between a point and its viewer cannot be in the way of light: the viewer sees the point); its normal, both ways, on surfaces
whose outside is on the same side (what stands on the surface turns its own to it). A hit further off than :data:`REACH` is
another surface: none answers.
"""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from .. import vector
from ..vector import Vec, components, dot, stack
from .interpolate import interpolate, triangles
from .mesh import Mesh
from .raycast import NOTHING, RayCaster
from .vertex_normals import gather

REACH = 0.01  # of the mesh's half diagonal: about a pixel, where the mesh fills 200
GRAZING = 0.1  # least cosine that shortens a distance along the ray to one across the surface


class Found(NamedTuple):
    """Points of a mesh."""

    point: Tensor  # [N, 3]
    face: Tensor  # [N], NOTHING where none was found, and the point is the one asked for


def plane_of(caster: RayCaster, face: Tensor) -> tuple[Vec, Tensor]:
    """Unit normal of the triangles ``face [...]``, and its product with their points (float64)."""
    x, y, z, at = gather(caster.planes.to(face.device).t(), face)
    return Vec(x, y, z), at


def own_point(
    mesh: Mesh,
    caster: RayCaster,
    point: Tensor,
    normal: Tensor,
    view: Tensor | None = None,
    triangle: Tensor | None = None,
    weights: Tensor | None = None,
) -> Found:
    """The mesh's points for ``point [N, 3]``, given ``normal``, ``view [N, 3]``, ``triangle [N, 1]``, ``weights [N, 3]`` (all float64)."""
    there, face = point.clone(), torch.full_like(point[:, 0], NOTHING, dtype=torch.int64)

    def ask(answer: Callable[..., Found], *given: Tensor) -> None:
        left = face == NOTHING
        there[left], face[left] = answer(point[left], *(t[left] for t in given))

    if triangle is not None and weights is not None:
        ask(lambda p, t, w: _by_weights(mesh, caster, p, t, w), triangle, weights)
    if view is not None:
        ask(lambda p, v: _nearest(caster, p, v), vector.normalize(view))
    ask(lambda p, n: _nearest(caster, p, n, outside=True), vector.normalize(normal))
    return Found(there, face)


def _by_weights(mesh: Mesh, caster: RayCaster, point: Tensor, triangle: Tensor, weights: Tensor) -> Found:
    face = triangle.squeeze(-1).to(torch.int64)
    whole = weights / weights.sum(-1, keepdim=True)  # rounded ones would leave the plane; those that sum to 0 are near nothing
    there = stack(interpolate(triangles(mesh, face.clamp_min(0)).corners, components(whole)))
    near = (face != NOTHING) & (torch.linalg.vector_norm(there - point, dim=-1) <= REACH * caster.scale)
    return Found(torch.where(near.unsqueeze(-1), there, point), torch.where(near, face, NOTHING))


def _nearest(caster: RayCaster, point: Tensor, along: Tensor, outside: bool = False) -> Found:
    """The nearest surface along unit ``along [N, 3]``, either way; with ``outside`` only those that turn their outside along it."""
    reach = REACH * caster.scale
    best, face = torch.full_like(point[:, 0], torch.inf), torch.full_like(point[:, 0], NOTHING, dtype=torch.int64)
    for sign in (1.0, -1.0):
        hit = caster.first_hit(point, sign * along)
        plane, at = plane_of(caster, hit.clamp_min(0))
        cosine = dot(plane, components(along))
        distance = (at - dot(plane, components(point))) / cosine
        near = (distance.abs() * cosine.abs().clamp_min(GRAZING) <= reach) & (distance.abs() < best.abs())  # NaN is not near
        near = near & (hit != NOTHING) & ((cosine > 0) | (not outside))
        best, face = torch.where(near, distance, best), torch.where(near, hit, face)
    step = torch.where(face != NOTHING, best, 0.0).unsqueeze(-1)
    return Found(point + step * along, face)
