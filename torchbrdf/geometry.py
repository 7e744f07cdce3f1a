"""The invariants that reflection models are written in, each computed once per shading point and only when asked for."""

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from . import numerics
from .vector import Vec, add, cross, dot, scale, subtract


def each(formula: Callable[..., Tensor], *colours: Sequence[Tensor]) -> tuple[Tensor, ...]:
    """Map a formula over channels; a colour with a single channel serves them all."""
    count = max(map(len, colours))
    if any(len(c) not in (1, count) for c in colours):
        raise ValueError(f"colours have different numbers of channels: {[len(c) for c in colours]}; use one C, or 1")
    return tuple(formula(*(c[k] if len(c) > 1 else c[0] for c in colours)) for k in range(count))


def memo(compute: Callable[[Any], Any]) -> property:
    """A property computed once per object. (``functools.cached_property`` takes a lock, which breaks full graphs on 3.11.)"""
    name = compute.__name__

    def get(self: Any) -> Any:
        if name not in self._memo:
            self._memo[name] = compute(self)
        return self._memo[name]

    return property(get, doc=compute.__doc__)


class Geometry:
    """The invariants of unit directions ``wi`` (to the light), ``wo`` (to the viewer) and normal ``n`` that formulas share.

    Each is ``[...]``, computed when first asked for and never twice, so that all lobes of a sum use one set and none pays
    for what it does not need. Isotropic models never build a frame. ``wide`` says how colours are laid out: False takes
    them apart into single channels (fastest for a few), True keeps them as one ``[..., C]`` tensor against which the
    components carry a trailing 1.
    """

    def __init__(
        self, wi: Vec, wo: Vec, n: Vec, tangent: Vec | None = None, wide: bool = False, known: dict[str, Tensor] | None = None
    ) -> None:
        self.wi, self.wo, self.n, self.tangent, self.wide = wi, wo, n, tangent, wide
        self._memo: dict[str, Any] = dict(known or {})

    @staticmethod
    def of_cosine(cos: Tensor) -> "Geometry":
        """A stand-in for formulas of one cosine ``[...]``, which need the layout alone."""
        up = Vec(torch.zeros_like(cos), torch.zeros_like(cos), cos)
        return Geometry(up, up, up)

    def wo_local(self) -> Vec:
        """A direction with the polar angle of ``wo`` in the local frame, for what depends on that angle alone."""
        cos = numerics.unit_interval(self.cos_o)
        return Vec(numerics.safe_sqrt((1.0 - cos) * (1.0 + cos)), torch.zeros_like(cos), cos)

    def colour(self, parameter: Tensor) -> tuple[Tensor, ...]:
        """A parameter ``[..., C]`` as the channels that a formula maps over."""
        return (self._beside(parameter),) if self.wide else numerics.widen(parameter).unbind(-1)

    def scalar(self, parameter: Tensor) -> Tensor:
        """A parameter ``[..., 1]`` in the shape of the invariants."""
        return self._beside(parameter) if self.wide else numerics.widen(parameter).squeeze(-1)

    def _beside(self, parameter: Tensor) -> Tensor:
        """Taken apart, an unbatched parameter follows the dtype and device of the points by itself; whole, it is converted."""
        p = numerics.widen(parameter)
        return p.to(self.wo.z) if p.dim() == 1 else p

    @memo
    def cos_i(self) -> Tensor:
        """n.wi"""
        return dot(self.n, self.wi)

    @memo
    def cos_o(self) -> Tensor:
        """n.wo"""
        return dot(self.n, self.wo)

    @memo
    def lit(self) -> Tensor:
        """Both directions strictly above the horizon (bool)."""
        return (self.cos_i > 0) & (self.cos_o > 0)

    @memo
    def half(self) -> Vec:
        """wi + wo, not normalised."""
        return add(self.wi, self.wo)

    @memo
    def half2(self) -> Tensor:
        """|wi + wo|^2, 0 where the two are opposite and there is no half vector."""
        return dot(self.half, self.half)

    @memo
    def wi_h(self) -> Tensor:
        """wi.h = wo.h = |wi + wo| / 2, in [0, 1]; 0 with gradient 0 where there is no half vector, or only rounding is left of it."""
        return 0.5 * numerics.safe_sqrt(self.half2, numerics.negligible(self.half2.dtype))

    @memo
    def inverse_half(self) -> Tensor:
        """1 / |wi + wo|, 0 where there is no half vector."""
        return numerics.reciprocal_or_zero(2.0 * self.wi_h)

    @memo
    def cos_h(self) -> Tensor:
        """n.h, 0 where there is no half vector."""
        return dot(self.n, self.half) * self.inverse_half

    @memo
    def sin2_h(self) -> Tensor:
        """|n x h|^2 by the cross product: no cancellation near the mirror direction."""
        c = scale(cross(self.n, self.half), self.inverse_half)
        return dot(c, c)

    @memo
    def mirror_complement(self) -> Tensor:
        """1 - wi.R(wo) as half the squared distance |R(wo) - wi|^2 / 2, accurate near the mirror direction."""
        d = subtract(scale(self.n, 2.0 * self.cos_o), self.half)
        return 0.5 * dot(d, d)
