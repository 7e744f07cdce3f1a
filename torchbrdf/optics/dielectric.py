r"""Dielectrics: the exact reflectance, by several methods, and the refracted cosine.

With :math:`c = \cos\theta_i`, :math:`s^2 = (1-c)(1+c)`, :math:`\delta = (\eta-1)(\eta+1)`, :math:`g = \sqrt{\delta + c^2}`:

:math:`F = (\delta/A^2)^2 (1 - 2q(1-q))` with :math:`A = c+g`, :math:`q = cg/(cg + s^2)`.

:math:`\delta/A^2` is the amplitude r_s but for its sign, and r_p = r_s (s^2 - cg)/(s^2 + cg). Nothing here cancels and nothing underflows
but g^2 at the critical angle: that sum alone is taken in more digits.
"""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from .. import arguments, numerics


def dielectric(cos_i: Tensor, eta: Tensor | float, method: str = "standard") -> Tensor:
    """Exact unpolarised reflectance of a dielectric interface, in [0, 1].

    ``cos_i`` in [0, 1], ``eta`` > 0, broadcast. 1 under total internal reflection (``g^2 <= 0``), with gradient 0; 0
    everywhere at eta = 1, grazing included.
    ``method``: ``"standard"`` is within 16 ulp everywhere; ``"extended"`` keeps more digits of slopes towards grazing and between
    nearly equal media, and takes about twice the time; ``"plain"`` is a little faster than ``"standard"`` and loses all digits in
    float32 at the critical angle (within 1e-3 of it in g^2, half of them), elsewhere none.
    """
    formula = METHODS[arguments.one_of(method, "method", METHODS)]
    (c, n), dtype = numerics.working(cos_i, eta)
    return numerics.rounded_back(formula(numerics.unit_interval(c), n), dtype)


def refraction_cosine(cos_i: Tensor, eta: Tensor | float) -> Tensor:
    """Cosine in [0, 1] of the refracted ray, by Snell's law; 0 under total internal reflection, with gradient 0.

    ``cos_i`` in [0, 1], ``eta`` > 0, broadcast. Accurate to the last bits at the critical angle, where the slope is infinite outside.
    """
    (c, n), dtype = numerics.working(cos_i, eta)
    at = _interface(numerics.unit_interval(c), n)
    ratio = at.g / n
    cos_t = at.choose(numerics.with_slope_of(torch.where(at.matched, at.cos, ratio), ratio), matched=at.cos, total=0.0)
    return numerics.rounded_back(numerics.at_most(cos_t, 1.0), dtype)


def _standard(c: Tensor, n: Tensor) -> Tensor:
    return _from_g2(c, n, numerics.eta2_minus_sin2_widened(c, n))


def _plain(c: Tensor, n: Tensor) -> Tensor:
    return _from_g2(c, n, (n - 1.0) * (n + 1.0) + c * c)


def _from_g2(c: Tensor, n: Tensor, g2: Tensor) -> Tensor:
    """The reflectance in one quotient a factor, selected once."""
    least = numerics.tiny(g2.dtype)  # not 0: between matched media g^2 = c^2, and slopes by eta grow as 1/c^2
    return _reflected(c, n, torch.sqrt(functional.threshold(g2, least, 1.0)), numerics.step(g2 - least))


def _reflected(c: Tensor, n: Tensor, g: Tensor, partial: Tensor) -> Tensor:
    """The reflectance where ``partial`` is 1; where it is 0, that of total reflection and of matched media grazing."""
    along, across, both = c * g, (1.0 - c) * (1.0 + c), c + g
    r_s, share = (n - 1.0) * (n + 1.0) / (both * both), along / (along + across)
    found = numerics.at_most(r_s * r_s * (1.0 - 2.0 * share * (1.0 - share)), 1.0)
    return found * partial + (1.0 - partial) * (n < 1.0).to(found.dtype)


class Split(NamedTuple):
    """What an interface does with unit power at one angle."""

    reflected: Tensor  # the reflectance F
    transmitted: Tensor  # 1 - F, with all its digits where F is near 1
    g: Tensor  # eta times the refracted cosine; 0 under total reflection


def split(cos_i: Tensor, eta: Tensor) -> Split:
    """The reflectance (:func:`dielectric`, standard) and what is left of 1, which adds up to 1 within an ulp or two.

    ``cos_i`` in [0, 1], ``eta`` > 0, of a working dtype. Under total internal reflection exactly 1, 0 and 0, with gradient 0; between
    matched media exactly 0, 1 and ``cos_i``.
    """
    c, n = numerics.unit_interval(cos_i), eta
    g2 = numerics.eta2_minus_sin2_widened(c, n)
    least = numerics.tiny(g2.dtype)
    partial = numerics.step(g2 - least)
    g = torch.sqrt(functional.threshold(g2, least, 1.0))
    reflected = _reflected(c, n, g, partial)
    little = (reflected > 0.5) & (partial > 0.0)  # what is transmitted, of which a difference would have few digits left
    direct = _transmitted(c, n, g, little)
    matched = (n == 1.0) & (g2 <= least)  # and grazing
    return Split(
        torch.where(little, 1.0 - direct, reflected),
        torch.where(little, direct, 1.0 - reflected),
        torch.where(matched, c, g * partial),
    )


def _transmitted(c: Tensor, n: Tensor, g: Tensor, wanted: Tensor) -> Tensor:
    """``1 - F`` as ``2 c g (1/A^2 + eta^2/B^2)``, B = A (c g + s^2), finite where it is not wanted."""
    along = c * g
    a, s = torch.where(wanted, c + g, 1.0), torch.where(wanted, along + (1.0 - c) * (1.0 + c), 1.0)
    return 2.0 * along / (a * a) * (1.0 + (n / s) * (n / s))


def _extended(c: Tensor, n: Tensor) -> Tensor:
    """By both amplitudes, in the form that keeps the most digits of their slopes."""
    at = _interface(c, n)
    r_s, r_p = (numerator / (denominator * denominator) for numerator, denominator in (at.perpendicular(), at.parallel()))
    return at.choose(numerics.at_most(0.5 * (r_s * r_s + r_p * r_p), 1.0), matched=0.0, total=1.0)


METHODS: dict[str, Callable[[Tensor, Tensor], Tensor]] = {"standard": _standard, "extended": _extended, "plain": _plain}


class _Interface(NamedTuple):
    """What the amplitudes of a dielectric share. ``partial``: no total reflection, nor grazing matched media; choose g is 1."""

    cos: Tensor
    eta: Tensor
    g: Tensor
    partial: Tensor
    matched: Tensor
    grazing: Tensor

    def perpendicular(self) -> tuple[Tensor, Tensor]:
        """``(delta, A)`` of ``r_s = -delta / A^2``."""
        delta, a = (self.eta - 1.0) * (self.eta + 1.0), self.cos + self.g
        return torch.where(self.grazing, numerics.with_slope_of(delta, (self.g - self.cos) * a), delta), a

    def parallel(self) -> tuple[Tensor, Tensor]:
        """``(delta (eta^2 c^2 - s^2), B)`` of ``r_p``, the quotient by ``B^2``."""
        c, n = self.cos, self.eta
        delta, along = (n - 1.0) * (n + 1.0), n * n * c
        b = along + self.g
        s2 = (1.0 - c) * (1.0 + c)
        difference = torch.where(n < 1.0, self.g * self.g - n * n * s2, along * c - s2)  # whichever subtracts the smaller terms
        top = delta * difference
        return torch.where(self.grazing, numerics.with_slope_of(top, (along - self.g) * b), top), b

    def choose(self, result: Tensor, matched: Tensor | float, total: float) -> Tensor:
        """The result where a part is reflected; ``matched`` where matched media graze, ``total`` under total reflection."""
        return torch.where(self.partial, result, torch.where(self.matched, matched, total))


def _interface(c: Tensor, n: Tensor) -> _Interface:
    g2 = numerics.eta2_minus_sin2(c, n)
    # Not 0: between matched media g^2 = c^2, and slopes by eta grow as 1/c^2. Otherwise it is 0 or above by far.
    partial = g2 > numerics.tiny(g2.dtype)
    g = torch.sqrt(torch.where(partial, g2, 1.0))
    # Each numerator has two forms, equal in exact arithmetic. Derivatives by eta of delta/A^2 cancel for c << g, those by c of
    # (g - c)/A for c ~ g; here each is used where it is accurate, for its derivatives: the value is that of the first.
    return _Interface(c, n, g, partial, n == 1, 16.0 * c * c < g2)
