"""What effects share: the shading points, taken apart once, and the shape of an effect."""

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor

from .. import numerics, vector
from ..bsdf.base import Bsdf, Channels
from ..geometry import Geometry, each
from ..light.base import Light
from ..scene.gbuffer import GBuffer
from ..vector import Vec


class Surface(NamedTuple):
    """The shading points of a G-buffer in components."""

    position: Vec
    n: Vec
    wo: Vec
    tangent: Vec | None
    cos_o: Tensor
    seen: Tensor  # 1 where a usable surface faces the viewer, else 0; the one that always has the full shape
    wide: bool

    @staticmethod
    def of(g: GBuffer, wide: bool) -> "Surface":
        """Directions are normalised here, once; zero and non-finite ones become 0, and so does their radiance.

        What must not contribute is multiplied by 0, not selected by ``where``: on eager CPUs a ``where`` on a mask that changes
        from pixel to pixel costs as much as thirty products. That is exact because everything is finite from here on.
        """

        def parts(v: Tensor) -> Vec:
            return Vec(*((c.unsqueeze(-1) if wide else c) for c in vector.components(numerics.widen(v))))

        n, wo = (vector.normalize_components(parts(v)) for v in (g.normal, g.require_view()))
        tangent = None if g.tangent is None else parts(g.tangent)
        cos_o = vector.dot(n, wo)
        facing = cos_o.detach() > 0  # never so for a normal that is zero or not finite
        mask = True if g.mask is None else g.mask if wide else g.mask.squeeze(-1)
        seen = (facing & mask).to(cos_o.dtype).expand((*g.batch_shape, *(1,) * wide))
        return Surface(Vec(*map(numerics.finite_or_zero, parts(g.position))), n, wo, tangent, cos_o, seen, wide)

    def towards(self, wi: Vec) -> Geometry:
        """The geometry of light from ``wi``; what depends on the viewer alone is shared by all lights."""
        return Geometry(wi, self.wo, self.n, self.tangent, self.wide, {"cos_o": self.cos_o})


Contribution = tuple[int, Channels]


class Effect(Protocol):
    """One way in which light reaches the eye: ``(row of the light, radiance per channel)`` for each light it serves."""

    def __call__(self, bsdf: Bsdf, surface: Surface, lights: Sequence[Light], visibility: Tensor | None) -> list[Contribution]: ...


def rows_of(lights: Sequence[Light], kind: type[Any]) -> list[tuple[int, Any]]:
    """(first row, light) of each light of a kind; a light takes ``len(light)`` rows, in the order of the list."""
    row, found = 0, []
    for light in lights:
        if isinstance(light, kind):
            found.append((row, light))
        row += len(light)
    return found


def assemble(rows: Sequence[Channels | None], surface: Surface, count: int, per_light: bool) -> Tensor:
    """The sum of the rows ``[..., C]``, or all of them ``[L, ..., C]``, each in planar memory; rows that no effect served are dark."""
    if per_light:
        return torch.stack([_planes(r, surface, count) for r in rows]).movedim(1, -1)
    lit = [r for r in rows if r is not None]
    return _planes(functools.reduce(functools.partial(each, torch.add), lit) if lit else None, surface, count).movedim(0, -1)


def _planes(colour: Channels | None, surface: Surface, count: int) -> Tensor:
    """``[C, ...]`` in contiguous memory, of a colour that may have given one channel for all."""
    if colour is None:
        shape = surface.seen.squeeze(-1).shape if surface.wide else surface.seen.shape
        return surface.seen.new_zeros(count, *shape)
    if surface.wide:
        return colour[0].expand(*colour[0].shape[:-1], count).movedim(-1, 0).contiguous()
    return torch.stack(colour if len(colour) == count else colour * count)
