"""Who is in whose shadow: rays from the shading points to the lights, against the true geometry (how they leave it: :mod:`.start`)."""

import math
from collections.abc import Iterator, Sequence
from typing import Any

import torch
from torch import Tensor

from .. import arguments, numerics
from ..value import Value
from ..vector import components, dot
from .gbuffer import GBuffer
from .mesh import Mesh
from .raycast import RayCaster, caster_of
from .start import Start, starts


@torch.no_grad()
def visibility(g: GBuffer, lights: Any, mesh: Mesh) -> Tensor:
    """``[L, ..., 1]`` in the dtype of ``g``: 1 where a light reaches the point, 0 where ``mesh`` is in the way.

    ``lights`` is one light or what its ``sample`` returned, or a list of either. L counts the single sources of lights that stand in
    one direction (point and directional lights), in order; other lights, such as environment maps, get no row. A sample has one row
    for each of its own, ``wi [L, ..., 3]`` and ``distance [L, ..., 1]``, whatever made it. Without gradient, and not for graphs. A light
    on the other side of the *geometric* surface than the viewer is invisible, whatever the shading normal says (hard terminator).
    Pixels that are not valid get 0.

    Rays start on the mesh's own surface. A point that is off the plane of its triangle by more than rounding (an average over a pixel,
    a half float), or that knows no triangle, is replaced by the point of its triangle and weights, or by the nearest hit along its line
    of sight (along its normal where ``g`` has no view), if that is within 1 % of the mesh's half diagonal: about a pixel where the
    mesh fills 200. Further off it stays: then ``g`` shows a surface that the mesh does not hold. The geometric normal is that of ``g``,
    or of the triangle found, or else the shading normal.
    """
    arguments.of_kind(g, "g", GBuffer, "tb.GBuffer.from_mesh(mesh, camera)")
    caster = caster_of(arguments.of_kind(mesh, "mesh", Mesh, "tb.load_mesh(path)"))
    at = starts(g, mesh, caster)
    rows = [_row(g, at, *target, caster) for target in _targets(lights, g)]
    shape = torch.broadcast_shapes(g.position.shape[:-1], at.normal.shape[:-1])
    return torch.stack(torch.broadcast_tensors(*rows)) if rows else g.position.new_zeros(0, *shape, 1)


def _targets(lights: Any, g: GBuffer) -> Iterator[tuple[Tensor, Tensor]]:
    """(direction, distance) of every single light that stands in one direction."""
    points = g.position
    several = isinstance(lights, Sequence) and not _is_sample(lights)
    for k, light in enumerate(lights if several else (lights,)):
        if _is_sample(light):
            yield from _sampled(light, points)
            continue
        if light is None or isinstance(light, int | float | str | Tensor | Sequence):
            arguments.of_kind(light, f"lights[{k}]", Value, "tb.PointLight(position, intensity)")
        if getattr(getattr(light, "kind", None), "name", "") == "DELTA":
            whole = points.expand(*g.batch_shape, 3) if getattr(light, "views", ()) else points  # lights by view, points for all
            yield from _sampled(light.sample(numerics.widen(whole)), whole)


def _is_sample(x: Any) -> bool:
    """Whether x is what a light's ``sample`` returns: a tuple, by its names."""
    return isinstance(x, tuple) and hasattr(x, "wi") and hasattr(x, "distance")


def _sampled(sample: Any, points: Tensor) -> Iterator[tuple[Tensor, Tensor]]:
    wi, distance = arguments.floats(sample.wi, "wi", 3), arguments.floats(sample.distance, "distance", 1)
    if wi.dim() < 2 or distance.shape[:-1] != wi.shape[:-1]:
        found = f"found wi {list(wi.shape)} and distance {list(distance.shape)}"
        raise ValueError(f"visibility: a sample has wi [L, ..., 3] and distance [L, ..., 1], {found}; pass what light.sample returns")
    arguments.broadcast({"g": points.shape[:-1], "wi[0]": wi.shape[1:-1]}, "visibility: batch shapes")
    yield from zip(wi.unbind(0), distance.unbind(0), strict=True)


def _row(g: GBuffer, at: Start, direction: Tensor, distance: Tensor, caster: RayCaster) -> Tensor:
    """Visibility ``[..., 1]`` of one light; rays are cast only where the light stands above the true surface."""
    above = dot(components(at.normal), components(direction)).unsqueeze(-1) > 0
    asked = (above & at.usable).squeeze(-1)

    def pick(t: Tensor) -> Tensor:
        return t.expand(*asked.shape, t.shape[-1])[asked].double()

    point, offset = pick(at.point), pick(at.offset)
    start = point + offset * pick(at.normal)
    towards, reach = _aim(start, point, pick(direction), pick(distance))
    free = ~caster.occluded(start, towards, reach - offset.squeeze(-1))
    return torch.zeros_like(asked).masked_scatter(asked, free).unsqueeze(-1).to(g.position.dtype)


def _aim(start: Tensor, point: Tensor, direction: Tensor, distance: Tensor) -> tuple[Tensor, Tensor]:
    """Unit direction and distance ``[N]`` from the moved start to the light; a light at infinity stays where it is."""
    far = torch.isinf(distance)
    to_light = point + torch.where(far, 0.0, distance) * direction - start
    length = torch.linalg.vector_norm(to_light, dim=-1, keepdim=True)
    towards = torch.where(far | (length == 0), direction, to_light / length)
    return towards, torch.where(far, math.inf, length).squeeze(-1)
