"""From rays to everything that is known where they meet a mesh, differentiably.

Distance and barycentrics follow from the ray and the plane of the triangle in float64, and are rounded once at the end:
differences of float32 positions would cost the digits that the position is asked for.
"""

import torch
from torch import Tensor

from .. import arguments, numerics, vector
from ..vector import Vec, cross, dot, subtract
from .interpolate import Triangles, attributes, masked, triangles
from .mesh import Mesh
from .raycast import NOTHING, caster_of


def ray_fields(mesh: Mesh, origin: Tensor, direction: Tensor, start: Tensor | None = None) -> dict[str, Tensor]:
    """The fields of :class:`GBuffer`, ``[..., k]`` in planar memory, for rays from ``origin`` along unit ``direction [..., 3]`` (float64).

    The ray caster begins at ``start``, where that differs from the origin; everything else is counted from the origin.
    """
    kind = mesh.vertices.dtype
    triangle = caster_of(mesh).first_hit(origin if start is None else start, direction)
    o, d = vector.components(origin), vector.components(direction)
    found = triangle != NOTHING
    at = triangles(mesh, torch.where(found, triangle, 0))
    hit, distance, weights = _intersect(o, d, at, found)
    return {
        "position": masked(vector.add(o, vector.scale(d, distance)), hit, kind),
        "view": vector.planar(-direction).to(kind),
        "depth": masked((distance,), hit, kind),
        **attributes(mesh, at, hit, weights),
    }


def usable_rays(mesh: Mesh, origin: Tensor, direction: Tensor) -> tuple[Tensor, Tensor]:
    """Rays in float64 on the device of the mesh, with unit directions, in their common shape ``[..., 3]``.

    A ray whose direction is zero or not finite, or whose origin is not finite (or beyond what float64 can square), gets
    origin and direction 0, with gradient 0: it meets nothing.
    """
    shape = arguments.broadcast({"origin": origin.shape[:-1], "direction": direction.shape[:-1]}, "from_rays: batch shapes")
    o, d = (vector.components(t.to(mesh.vertices.device, torch.float64).expand(*shape, 3)) for t in (origin, direction))
    unit = vector.normalize_components(d)
    size = torch.maximum(torch.maximum(o.x.abs(), o.y.abs()), o.z.abs())
    usable = (size < 1.0 / numerics.negligible(size.dtype)) & (dot(unit, unit) > 0)  # NaN fails
    o, unit = (Vec(*(torch.where(usable, c, 0.0) for c in v)) for v in (o, unit))
    return vector.stack(o), vector.stack(unit)


def _intersect(o: Vec, d: Vec, at: Triangles, found: Tensor) -> tuple[Tensor, Tensor, tuple[Tensor, ...]]:
    """Whether there is a proper hit, its distance, and its barycentric weights (Möller & Trumbore 1997).

    Rays in the plane, and degenerate triangles, are no hits.
    """
    against = dot(at.plane, d)
    hit = found & (against != 0)
    inverse = 1.0 / torch.where(hit, against, 1.0)
    from_corner = subtract(o, at.corners[0])
    distance = -dot(at.plane, from_corner) * inverse
    turned = cross(d, from_corner)
    second = dot(at.edges[1], turned) * inverse
    third = -dot(at.edges[0], turned) * inverse
    return hit & (distance.detach() > 0), distance, (1.0 - second - third, second, third)
