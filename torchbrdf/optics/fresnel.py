r"""Fresnel reflectance of smooth interfaces: the exact laws, and Schlick's approximation below them.

With :math:`c = \cos\theta_i`, :math:`s^2 = (1-c)(1+c)`, :math:`\delta = (\eta-1)(\eta+1)`, :math:`g = \sqrt{\delta + c^2}`:

======================  =====================================================================  ==========================
dielectric (exact)      :math:`r_s = -\delta/A^2,\ r_p = \delta(\eta^2c^2-s^2)/B^2`            Fresnel 1823; Cook & Torrance
                        with :math:`A = c+g,\ B = \eta^2c+g`; :math:`F = (r_s^2+r_p^2)/2`      1982 for the form in g
conductor (exact)       complex index :math:`\eta + ik` (k >= 0, time :math:`e^{-i\omega t}`)  Born & Wolf 1999, sec. 14.2
Schlick                 :math:`F_0 + (1-F_0)(1-c)^5`                                           Schlick 1994, eq. 15
======================  =====================================================================  ==========================

Schlick's error against the dielectric, with the exact F_0, is at most 0.07 for eta in [1.3, 1.8] and 0.12 in [1.2, 2.5], worst
near grazing; against measured metals it is at most 0.04 (Cu, Ag, Au) to 0.2 (Al, Cr, Fe, Ni, Ti).

The functions are elementwise and broadcast. ``eta`` is n(far side) / n(side of the ray). Cosines lie in [0, 1]; beyond, they
act as at the nearest end, with gradient 0. Not smooth at: the critical angle, where the slope outside is -inf and inside 0.
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor

from .. import arguments, numerics, parameters
from ..geometry import Channels, Layout, each
from ..interval import UNIT, Interval
from ..value import COLOUR, Value, param, value
from ..vector import stack
from .amplitudes import Amplitudes, amplitudes, at_edge, refracted

__all__ = ["Amplitudes", "amplitudes", "conductor", "dielectric", "refraction_cosine", "schlick"]
ETA = Interval(0.0, open_low=True, typical=(1.2, 2.5), hard=(0.5, 1.0, 1.0 + 2.0**-20, 10.0), flat=(1.0,))


def dielectric(cos_i: Tensor, eta: Tensor | float) -> Tensor:
    """Exact unpolarised reflectance of a dielectric interface, in [0, 1].

    ``cos_i`` in [0, 1], ``eta`` > 0, broadcast. 1 under total internal reflection (``g^2 <= 0``), with gradient 0; 0
    everywhere at eta = 1, grazing included.
    """
    (c, n), dtype = numerics.working(cos_i, eta)
    at = _interface(c, n)
    r_s, r_p = (numerator / (denominator * denominator) for numerator, denominator in (at.perpendicular(), at.parallel()))
    exact = numerics.at_most(0.5 * (r_s * r_s + r_p * r_p), 1.0)
    return numerics.rounded_back(at.elsewhere(exact, matched=0.0, total=1.0), dtype)


def refraction_cosine(cos_i: Tensor, eta: Tensor | float) -> Tensor:
    """Cosine in [0, 1] of the refracted ray, by Snell's law; 0 under total internal reflection, with gradient 0.

    ``cos_i`` in [0, 1], ``eta`` > 0, broadcast. Accurate to the last bits at the critical angle, where the slope is infinite outside.
    """
    (c, n), dtype = numerics.working(cos_i, eta)
    at = _interface(c, n)
    ratio = at.g / n
    cos_t = at.elsewhere(numerics.value_of(torch.where(at.matched, at.cos, ratio), ratio), matched=at.cos, total=0.0)
    return numerics.rounded_back(numerics.at_most(cos_t, 1.0), dtype)


class _Interface(NamedTuple):
    """What the amplitudes of a dielectric share. ``partial``: no total reflection, nor grazing matched media; elsewhere g is 1."""

    cos: Tensor
    eta: Tensor
    g: Tensor
    partial: Tensor
    matched: Tensor
    grazing: Tensor

    def perpendicular(self) -> tuple[Tensor, Tensor]:
        """``(delta, A)`` of ``r_s = -delta / A^2``."""
        delta, a = (self.eta - 1.0) * (self.eta + 1.0), self.cos + self.g
        return torch.where(self.grazing, numerics.value_of(delta, (self.g - self.cos) * a), delta), a

    def parallel(self) -> tuple[Tensor, Tensor]:
        """``(delta (eta^2 c^2 - s^2), B)`` of ``r_p``, the quotient by ``B^2``."""
        c, n = self.cos, self.eta
        delta, along = (n - 1.0) * (n + 1.0), n * n * c
        b = along + self.g
        s2 = (1.0 - c) * (1.0 + c)
        difference = torch.where(n < 1.0, self.g * self.g - n * n * s2, along * c - s2)  # whichever subtracts the smaller terms
        top = delta * difference
        return torch.where(self.grazing, numerics.value_of(top, (along - self.g) * b), top), b

    def elsewhere(self, result: Tensor, matched: Tensor | float, total: float) -> Tensor:
        """The result of a partial reflection; ``matched`` where matched media graze, ``total`` under total reflection."""
        return torch.where(self.partial, result, torch.where(self.matched, matched, total))


def _interface(c: Tensor, n: Tensor) -> _Interface:
    c = numerics.unit_interval(c)
    g2 = numerics.eta2_minus_sin2(c, n)
    # Not 0: between matched media g^2 = c^2, and slopes by eta grow as 1/c^2. Otherwise it is 0 or above by far.
    partial = g2 > numerics.tiny(g2.dtype)
    g = torch.sqrt(torch.where(partial, g2, 1.0))
    # Each numerator has two forms, equal in exact arithmetic. Derivatives by eta of delta/A^2 cancel for c << g, those by c of
    # (g - c)/A for c ~ g; here each is used where it is accurate, for its derivatives: the value is that of the first.
    return _Interface(c, n, g, partial, n == 1, 16.0 * c * c < g2)


def conductor(cos_i: Tensor, eta: Tensor | float, k: Tensor | float) -> Tensor:
    """Exact unpolarised reflectance of a conductor of complex index ``eta + i k``, in [0, 1].

    ``cos_i`` in [0, 1], ``eta`` > 0, ``k`` >= 0, broadcast. ``k = 0`` is the dielectric, one-sided derivative included.
    """
    (c, n, k), dtype = numerics.working(cos_i, eta, k)
    c = numerics.unit_interval(c)
    (a, b), edge = refracted(c, n, k)
    senkrecht = _perpendicular(c, a, b, (n - 1.0) * (n + 1.0) - k * k, 2.0 * n * k)
    both = 0.5 * senkrecht * (1.0 + _parallel_share(c, a, b))
    return numerics.rounded_back(torch.where(edge, at_edge(n), numerics.at_most(both, 1.0)), dtype)


def _parallel_share(c: Tensor, a: Tensor, b: Tensor) -> Tensor:
    """R_p / R_s."""
    ac, bc, s2 = a * c, b * c, (1.0 - c) * (1.0 + c)
    scale = 1.0 / torch.maximum(torch.maximum(ac, bc), s2).detach()  # squares of a tiny index underflow at normal incidence
    ac, b2c2, s2 = ac * scale, (bc * scale) ** 2, s2 * scale
    return ((ac - s2) ** 2 + b2c2) / ((ac + s2) ** 2 + b2c2)


def _perpendicular(c: Tensor, a: Tensor, b: Tensor, real: Tensor, imag: Tensor) -> Tensor:
    r"""R_s = \|z - c\|^2 / \|z + c\|^2 for z = a + ib, of which z^2 - c^2 = real + i imag is known without cancellation."""
    scale = 1.0 / torch.maximum(torch.maximum(a, b), c).detach()  # grazing, between nearly equal media, the squares underflow
    c, a, b, real, imag = c * scale, a * scale, b * scale, real * scale * scale, imag * scale * scale
    below = (a + c) * (a + c) + b * b
    above = torch.where(4.0 * c < 1.0, ((a - c) * (a - c) + b * b) * below, real * real + imag * imag)
    return above / (below * below)


def schlick(cos_i: Tensor, f0: Tensor | float) -> Tensor:
    """Schlick's approximation from the reflectance ``f0`` in [0, 1] at normal incidence; ``cos_i`` in [0, 1], broadcast."""
    (c, f0), dtype = numerics.working(cos_i, f0)
    grazing = _fifth_power(1.0 - numerics.unit_interval(c))
    return numerics.rounded_back(f0 * (1.0 - grazing) + grazing, dtype)


def _fifth_power(m: Tensor) -> Tensor:
    m2 = m * m
    return m2 * m2 * m


class Fresnel(Value):
    """Interface of the Fresnel terms: what fraction of the power a smooth interface reflects at each angle."""

    textbook: ClassVar[Callable[..., Any] | None] = None  # the law as its source prints it: torchbrdf/testing/textbook.py

    @abstractmethod
    def terms(self, layout: Layout, cos: Tensor) -> Channels:
        """Channels at the cosine ``[...]`` of [0, 1] (up to rounding)."""

    def kink_distance(self, layout: Layout, cos: Tensor) -> Tensor:
        """How far the cosine ``[...]`` is from where the term is not smooth; nowhere, unless a term says otherwise."""
        return torch.ones_like(cos)

    @property
    def channels(self) -> int:
        """C, the number of colour channels of the result."""
        return self.own_channels

    def reflectance(self, cos_i: Tensor) -> Tensor:
        """Reflectance ``[..., C]`` at ``cos_i [..., 1]``."""
        parameters.check(self, arguments.floats(cos_i, "cos_i"), "cos_i")
        z = numerics.unit_interval(numerics.widen(cos_i.squeeze(-1) if cos_i.shape[-1:] == (1,) else _need_trailing_one(cos_i)))
        return stack(self.terms(Layout.beside(z), z)).to(cos_i.dtype)


def _need_trailing_one(cos_i: Tensor) -> Tensor:
    raise ValueError(f"cos_i: expected shape [..., 1], found {list(cos_i.shape)}; did you mean cos_i.unsqueeze(-1)?")


@value
class Dielectric(Fresnel):
    """Exact dielectric term (:func:`dielectric`). ``eta``: n(inside) / n(outside); 1.5 is glass in air."""

    eta: Tensor = param(ETA, COLOUR, "index of refraction, inside over outside")

    @staticmethod
    def textbook(m: Any, cos: Any, eta: Any) -> Any:
        """Fresnel 1823, by Snell's law."""
        cos2 = 1 - (1 - cos * cos) / (eta * eta)
        through = m.positive(cos2)
        cos_t = m.sqrt(m.where(through, cos2, 1))
        r_s, r_p = (cos - eta * cos_t) / (cos + eta * cos_t), (eta * cos - cos_t) / (eta * cos + cos_t)
        return m.where(through, (r_s * r_s + r_p * r_p) / 2, m.where(m.positive(1 - eta), 1, 0))

    def terms(self, layout: Layout, cos: Tensor) -> Channels:
        return each(lambda eta: dielectric(cos, eta), layout.colour(self.eta))

    def kink_distance(self, layout: Layout, cos: Tensor) -> Tensor:
        """The distance of g^2 from 0, its value at the critical angle."""
        away = [(cos * cos - (1.0 - eta) * (1.0 + eta)).abs() for eta in layout.colour(self.eta)]
        return torch.stack(torch.broadcast_tensors(*away)).amin(0)


@value
class Conductor(Fresnel):
    """Exact conductor term (:func:`conductor`) of the complex index ``eta + i k``, one value per channel."""

    eta: Tensor = param(Interval(0.0, open_low=True, typical=(0.1, 3.0), hard=(0.5, 1.0, 10.0)), COLOUR, "real part of the index")
    k: Tensor = param(Interval(0.0, typical=(0.5, 7.0), hard=(1e3,), flat=(0.0,)), COLOUR, "imaginary part of the index")

    def terms(self, layout: Layout, cos: Tensor) -> Channels:
        return each(lambda eta, k: conductor(cos, eta, k), layout.colour(self.eta), layout.colour(self.k))

    @staticmethod
    def named(metal: str, wavelengths: tuple[float, ...] = (0.65, 0.55, 0.45)) -> "Conductor":
        """A measured metal ("Cu", "Au", "Ag", "Al", "Cr", "Fe", "Ni", "Ti") at wavelengths in micrometres (red, green, blue)."""
        from .metals import index_at

        eta, k = index_at(metal, wavelengths)
        return Conductor(torch.tensor(eta, dtype=torch.float64), torch.tensor(k, dtype=torch.float64))


@value
class Schlick(Fresnel):
    """Schlick's approximation (:func:`schlick`) from the colour ``f0`` at normal incidence."""

    f0: Tensor = param(UNIT, COLOUR, "reflectance at normal incidence")

    @staticmethod
    def textbook(m: Any, cos: Any, f0: Any) -> Any:
        return f0 + (1 - f0) * (1 - cos) * (1 - cos) * (1 - cos) * (1 - cos) * (1 - cos)

    def terms(self, layout: Layout, cos: Tensor) -> Channels:
        grazing = _fifth_power(numerics.positive(1.0 - cos))  # once for all channels; cos may exceed 1 by rounding
        rest = 1.0 - grazing
        return each(lambda f0: f0 * rest + grazing, layout.colour(self.f0))
