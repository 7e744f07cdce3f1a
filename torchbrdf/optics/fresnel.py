r"""Fresnel reflectance of smooth interfaces: the exact laws, and Schlick's approximation below them.

With :math:`c = \cos\theta_i`, :math:`s^2 = (1-c)(1+c)`, :math:`\delta = (\eta-1)(\eta+1)`, :math:`g = \sqrt{\delta + c^2}`:

======================  =====================================================================  ==========================
dielectric (exact)      :math:`r_s = -\delta/A^2,\ r_p = r_s(s^2-cg)/(s^2+cg)`                Fresnel 1823; Cook & Torrance
                        with :math:`A = c+g`; :math:`F = (r_s^2+r_p^2)/2`                      1982 for the form in g
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
from typing import Any, ClassVar

import torch
from torch import Tensor

from .. import arguments, numerics, parameters, quadrature
from ..geometry import Channels, Layout, each
from ..interval import UNIT, Interval
from ..value import COLOUR, Value, param, value
from ..vector import stack
from .amplitudes import Amplitudes, amplitudes
from .conductor import METHODS as CONDUCTOR_METHODS
from .conductor import conductor
from .dielectric import METHODS as DIELECTRIC_METHODS
from .dielectric import dielectric, refraction_cosine
from .dielectric_average import dielectric_average

__all__ = ["Amplitudes", "amplitudes", "conductor", "dielectric", "dielectric_average", "refraction_cosine", "schlick"]
ETA = Interval(0.0, open_low=True, typical=(1.2, 2.5), hard=(0.5, 1.0, 1.0 + 2.0**-20, 10.0), flat=(1.0,))


def _average_rule(order: int) -> Tensor:
    """Cosines and weights ``[2, order]``, of the square of Gauss's nodes: 4 x^3 dx is 2 mu d mu."""
    x, weight = quadrature.gauss_legendre(order)
    return torch.stack([x * x, 4.0 * x**3 * weight])


AVERAGE = _average_rule(10)


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

    def average(self, layout: Layout) -> Channels:
        """Channels of the reflectance of diffuse light, 2 times the integral of F(cos) cos: by Gauss's rule in the root of the cosine.

        Of 10 nodes: to 1e-6 for conductors of k >= 1, to 5e-4 without edges inside; 0.04 at worst, where total reflection begins.
        """
        axes = len(self.batch_shape) + int(layout.wide) if layout.rank is None else 1 + layout.rank
        cos, weight = AVERAGE.to(layout.device, layout.dtype).reshape(2, -1, *(1,) * axes).unbind(0)
        return tuple((f * weight).sum(0) for f in self.terms(layout, cos))

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
    """Exact dielectric term (:func:`dielectric`, by one of its methods). ``eta``: n(inside) / n(outside); 1.5 is glass in air."""

    eta: Tensor = param(ETA, COLOUR, "index of refraction, inside over outside")
    method: str = "standard"

    variants = tuple({"method": name} for name in DIELECTRIC_METHODS)

    def __post_init__(self) -> None:
        super().__post_init__()
        arguments.one_of(self.method, "Dielectric.method", DIELECTRIC_METHODS)

    @staticmethod
    def textbook(m: Any, cos: Any, eta: Any, method: str = "standard") -> Any:
        """Fresnel 1823, by Snell's law."""
        cos2 = 1 - (1 - cos * cos) / (eta * eta)
        through = m.positive(cos2)
        cos_t = m.sqrt(m.where(through, cos2, 1))
        r_s, r_p = (cos - eta * cos_t) / (cos + eta * cos_t), (eta * cos - cos_t) / (eta * cos + cos_t)
        return m.where(through, (r_s * r_s + r_p * r_p) / 2, m.where(m.positive(1 - eta), 1, 0))

    def terms(self, layout: Layout, cos: Tensor) -> Channels:
        return each(lambda eta: dielectric(cos, eta, self.method), layout.colour(self.eta))

    def average(self, layout: Layout) -> Channels:
        """In closed form, :func:`dielectric_average`."""
        return each(dielectric_average, layout.colour(self.eta))

    def kink_distance(self, layout: Layout, cos: Tensor) -> Tensor:
        """The distance of g^2 from 0, its value at the critical angle."""
        away = [(cos * cos - (1.0 - eta) * (1.0 + eta)).abs() for eta in layout.colour(self.eta)]
        return torch.stack(torch.broadcast_tensors(*away)).amin(0)


@value
class Conductor(Fresnel):
    """Exact conductor term (:func:`conductor`, by one of its methods) of the complex index ``eta + i k``, one value per channel."""

    eta: Tensor = param(Interval(0.0, open_low=True, typical=(0.1, 3.0), hard=(0.5, 1.0, 10.0)), COLOUR, "real part of the index")
    k: Tensor = param(Interval(0.0, typical=(0.5, 7.0), hard=(1e3,), flat=(0.0,)), COLOUR, "imaginary part of the index")
    method: str = "standard"

    variants = tuple({"method": name} for name in CONDUCTOR_METHODS)

    def __post_init__(self) -> None:
        super().__post_init__()
        arguments.one_of(self.method, "Conductor.method", CONDUCTOR_METHODS)

    @staticmethod
    def textbook(m: Any, cos: Any, eta: Any, k: Any, method: str = "standard") -> Any:
        """Born & Wolf 1999, sec. 14.2: by a + ib, the root of (eta + ik)^2 - sin^2, in real numbers."""
        real, imag = eta * eta - k * k - (1 - cos * cos), 2 * eta * k
        nothing = ~(m.positive(real) | m.positive(-1 * real) | m.positive(imag))  # at the critical angle
        real = m.where(nothing, 1, real)
        forward = m.positive(real)
        large = m.sqrt((m.sqrt(real * real + imag * imag) + m.where(forward, real, -1 * real)) / 2)
        small = imag / (2 * large)
        a, b = m.where(forward, large, small), m.where(forward, small, large)
        re, im = (eta * eta - k * k) * cos, imag * cos
        r_s = ((cos - a) * (cos - a) + b * b) / ((cos + a) * (cos + a) + b * b)
        r_p = ((re - a) * (re - a) + (im - b) * (im - b)) / ((re + a) * (re + a) + (im + b) * (im + b))
        edge = m.where(m.positive(k) | m.positive((eta - 1) * (eta - 1)), 1, 0)  # nothing where matched media graze
        return m.where(nothing, edge, (r_s + r_p) / 2)

    def terms(self, layout: Layout, cos: Tensor) -> Channels:
        return each(lambda eta, k: conductor(cos, eta, k, self.method), layout.colour(self.eta), layout.colour(self.k))

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
        return each(lambda f0: torch.addcmul(grazing, f0, rest), layout.colour(self.f0))

    def average(self, layout: Layout) -> Channels:
        """``f0 + (1 - f0) / 21``"""
        return each(lambda f0: f0 + (1.0 - f0) * (1.0 / 21.0), layout.colour(self.f0))
