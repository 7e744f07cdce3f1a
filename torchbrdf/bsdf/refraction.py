r"""The facet that refracts wi into wo, and what it lets through, without cancellation (Walter et al. 2007, sec. 4.2).

Its normal m lies along :math:`H = n_i\omega_i + n_o\omega_o`, with the index 1 outside and n inside. Let :math:`\delta = |n - 1|`,
:math:`a = |\omega_i + \omega_o|^2/2`, q the larger of n and 1 and r the smaller. Then :math:`|H|^2 = \delta^2 + 2na`, and the products of
H with the two directions are :math:`\delta - qa` in the thinner medium and :math:`\delta + ra` in the denser one. There is a facet where
the first is positive; total reflection does not occur. Of the cosines c (thinner) and d (denser) at the facet,
:math:`1 - F = 2n\,cd\,\big((rc + qd)^{-2} + (qc + rd)^{-2}\big)`. Near eta = 1 only :math:`\delta - qa` cancels, as it must.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from .. import numerics, vector
from ..geometry import Geometry
from ..vector import Vec, add, scale
from .shadowing import TEXTBOOK, Length, smith_separable


class Refraction(NamedTuple):
    """The facet of a pair of directions across a surface; finite, and ``there`` 0, where there is none."""

    n_i: Tensor  # index on the side of wi, 1 outside
    n_o: Tensor  # on that of wo
    turn: Tensor  # 1 where H points outside, -1 where inside
    half: Vec  # H turned outside
    length2: Tensor  # |H|^2
    inverse: Tensor  # 1 / |H|
    cos_n: Tensor  # n.m
    thin: Tensor  # |w.m| of the direction in the medium of the smaller index; below 0 where there is no facet
    dense: Tensor  # of the other
    there: Tensor  # 1 where both directions see it from the right sides
    transmitted: Tensor  # 1 - F

    @staticmethod
    def of(g: Geometry, n: Tensor) -> "Refraction":
        """For ``n`` = n(inside) / n(outside)."""
        below, denser = g.viewer.side < 0, n > 1.0
        n_i, n_o = torch.where(below, 1.0, n), torch.where(below, n, 1.0)
        turn = torch.where(denser, -1.0, 1.0).to(n.dtype)
        half = scale(add(scale(g.wi, n_i), scale(g.wo, n_o)), turn)
        apart, delta = 0.5 * g.half2, turn * (1.0 - n)
        q, r = torch.where(denser, n, 1.0), torch.where(denser, 1.0, n)
        length2 = delta * delta + 2.0 * n * apart
        inverse = numerics.reciprocal_or_zero(numerics.safe_sqrt(length2, numerics.negligible(length2.dtype)))
        thin, dense, cos_n = (delta - q * apart) * inverse, (delta + r * apart) * inverse, vector.dot(g.n, half) * inverse
        there = numerics.step(thin) * numerics.step(cos_n) * g.across.to(thin.dtype)
        return Refraction(n_i, n_o, turn, half, length2, inverse, cos_n, thin, dense, there, _transmitted(thin * there, dense, n, q, r))

    def local(self, g: Geometry) -> Vec:
        """H in the local frame."""
        return scale(add(scale(g.wi_local, self.n_i), scale(g.viewer.local.wo, self.n_o)), self.turn)

    @property
    def wi_m(self) -> Tensor:
        """The cosine of wi and the facet, without its sign."""
        return torch.where(self.n_i < self.n_o, self.thin, self.dense)

    @property
    def wo_m(self) -> Tensor:
        """That of wo."""
        return torch.where(self.n_i < self.n_o, self.dense, self.thin)

    @property
    def jacobian(self) -> Tensor:
        """\\|wi.m\\| \\|wo.m\\| / \\|H\\|^2, 0 where there is no facet; times n_i^2 over \\|wo.m\\|, that of m by wi."""
        return self.thin * self.there * self.dense * (self.inverse * self.inverse)


def _transmitted(thin: Tensor, dense: Tensor, n: Tensor, q: Tensor, r: Tensor) -> Tensor:
    least = numerics.negligible(n.dtype)
    s, p = (numerics.reciprocal_or_zero(x * thin + y * dense, least) for x, y in ((r, q), (q, r)))
    return numerics.at_most(2.0 * n * thin * dense * (s * s + p * p), 1.0)


# Masking and shadowing over 4 |cos_i cos_o|, as in :mod:`torchbrdf.bsdf.shadowing` --------------------------------------


def separable(g: Geometry, at: Refraction, length_i: Length, length_o: Length) -> Tensor:
    """Smith's, each side for itself."""
    return smith_separable(g, length_i, length_o)


def v_cavity(g: Geometry, at: Refraction, length_i: Length, length_o: Length) -> Tensor:
    """The least of 1, 2 n.m n.wi / wi.m and 2 n.m n.wo / wo.m."""
    ci, co = g.cos_i.abs(), g.cos_o.abs()
    hidden = torch.maximum(co * at.wi_m, ci * at.wo_m) * numerics.reciprocal_or_zero(at.cos_n, numerics.negligible(co.dtype))
    return numerics.reciprocal_or_zero(torch.maximum(4.0 * ci * co, 2.0 * hidden), numerics.negligible(co.dtype))


def v_cavity_kink(g: Geometry, at: Refraction) -> Tensor:
    """The distance from ridges, where two of the three that :func:`v_cavity` takes the least of are equal; on one side of it, too."""
    ci, co = g.cos_i.abs(), g.cos_o.abs()
    wi_m, wo_m, cos_n = (torch.where(g.across, x, y) for x, y in ((at.wi_m, g.wi_h), (at.wo_m, g.wi_h), (at.cos_n, g.cos_h.abs())))
    i, o = 2.0 * cos_n * ci - wi_m, 2.0 * cos_n * co - wo_m
    lit, between = torch.minimum(i, o), (ci * wo_m - co * wi_m).abs()
    return torch.minimum(lit.abs(), torch.where(lit < 0, between, torch.ones_like(lit)))


ACROSS: dict[str, Callable[[Geometry, Refraction, Length, Length], Tensor]] = {
    "smith_correlated": separable,
    "smith_separable": separable,
    "v_cavity": v_cavity,
}


class Seen(NamedTuple):
    """What textbook formulas of masking and shadowing read of a facet; no cosine below 0."""

    cos_i: Any
    cos_o: Any
    cos_h: Any
    wi_h: Any
    wo_h: Any


TEXTBOOK_ACROSS = {
    **dict.fromkeys(("smith_correlated", "smith_separable"), TEXTBOOK["smith_separable"]),
    "v_cavity": lambda m, p, lam: least(m, 1, least(m, 2 * p.cos_h * p.cos_i / p.wi_h, 2 * p.cos_h * p.cos_o / p.wo_h)),
}


def least(m: Any, a: Any, b: Any) -> Any:
    """The smaller of two numbers in an arithmetic."""
    return m.where(m.positive(b - a), a, b)
