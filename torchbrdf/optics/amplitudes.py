r"""Fresnel's amplitude ratios of dielectrics and conductors: the complex numbers whose squared moduli are the reflectances.

With :math:`c = \cos\theta_i`, :math:`s^2 = (1-c)(1+c)`, :math:`\varepsilon = (\eta + ik)^2` and
:math:`z = \sqrt{\varepsilon - s^2}` (both parts >= 0; under total reflection :math:`z = i\sqrt{s^2 - \eta^2}`):

:math:`r_s = (c - z)/(c + z) = (1 - \varepsilon)/(c + z)^2`,
:math:`r_p = (\varepsilon c - z)/(\varepsilon c + z) = (\varepsilon - 1)(\varepsilon c^2 - s^2)/(\varepsilon c + z)^2`:
Fresnel 1823; Born & Wolf 1999, sec. 1.5.2 and 14.2. The second forms do not cancel. Complex numbers are pairs of real tensors
here, which compile, and whose gradients are plain.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from .. import numerics

__all__ = ["Amplitudes", "amplitudes", "at_edge", "refracted"]


class Amplitudes(NamedTuple):
    """Complex amplitude ratios, reflected over incident, as four real tensors; :attr:`s` and :attr:`p` put them together."""

    s_re: Tensor
    s_im: Tensor
    p_re: Tensor
    p_im: Tensor

    @property
    def s(self) -> Tensor:
        """``r_s``, of the field perpendicular to the plane of incidence, as a complex tensor (half types: complex64)."""
        return torch.complex(numerics.widen(self.s_re), numerics.widen(self.s_im))

    @property
    def p(self) -> Tensor:
        """``r_p``, of the field in the plane of incidence, as a complex tensor (half types: complex64)."""
        return torch.complex(numerics.widen(self.p_re), numerics.widen(self.p_im))


class Complex(NamedTuple):
    """A complex number in planar memory."""

    re: Tensor
    im: Tensor

    def times(self, other: "Complex") -> "Complex":
        return Complex(self.re * other.re - self.im * other.im, self.re * other.im + self.im * other.re)

    def scaled(self, by: Tensor) -> "Complex":
        return Complex(self.re * by, self.im * by)

    def plus(self, other: "Complex") -> "Complex":
        return Complex(self.re + other.re, self.im + other.im)

    def square_modulus(self) -> Tensor:
        return self.re * self.re + self.im * self.im

    def reciprocal(self) -> "Complex":
        below = self.square_modulus()
        return Complex(self.re / below, -self.im / below)

    def where(self, mask: Tensor, re: Tensor | float) -> "Complex":
        """This number where the mask holds, elsewhere a real one."""
        return Complex(torch.where(mask, self.re, re), torch.where(mask, self.im, 0.0))


def amplitudes(cos_i: Tensor, eta: Tensor | float, k: Tensor | float = 0.0) -> Amplitudes:
    """Complex amplitude ratios ``r_s`` and ``r_p`` of a smooth interface to a medium of index ``eta + i k``, as their real parts
    and imaginary parts ``(s_re, s_im, p_re, p_im)``, each in [-1, 1]; ``.s`` and ``.p`` are complex tensors.

    ``cos_i`` in [0, 1], ``eta`` > 0, ``k`` >= 0, broadcast. Time runs as exp(-i omega t), so k >= 0 absorbs. The axes of p before
    and after, with that of s and the ray, are right-handed: ``r_p = -r_s`` at normal incidence, -1 both at grazing (Born & Wolf).
    Mitsuba's are the complex conjugates, of time exp(+i omega t).
    A dielectric's are real up to the critical angle, of modulus 1 with a phase beyond; ``(|r_s|^2 + |r_p|^2)/2`` is the
    reflectance of :func:`dielectric` or :func:`conductor`. Between equal media 0, grazing included.
    Slopes are infinite to both sides of the critical angle, and at eta = 1, k = 0 by eta and k as 1/c^2 towards grazing: at that
    angle itself, and where c^2 underflows, the gradient is 0.
    """
    (c, n, k), dtype = numerics.working(cos_i, eta, k)
    c = numerics.unit_interval(c)
    index2 = Complex(n * n - k * k, 2.0 * n * k)
    more = Complex((n - 1.0) * (n + 1.0) - k * k, index2.im)  # than in the vacuum
    z, edge = refracted(c, n, k)
    s = _ratio(Complex(c, torch.zeros_like(c)), z, Complex(-more.re, -more.im)).where(~edge, at_edge(n))
    p = _ratio(index2.scaled(c), z, more.times(_brewster_difference(c, n, k, index2)))
    p = p.where(~edge, torch.where(c < 1, at_edge(n), -1.0))
    return Amplitudes(*(numerics.rounded_back(x, dtype) for x in (*s, *p)))


def at_edge(n: Tensor) -> Tensor:
    """What is reflected there, amplitude or power: nothing where matched media graze, elsewhere everything."""
    return (n != 1).to(n.dtype)


def refracted(c: Tensor, n: Tensor, k: Tensor) -> tuple[Complex, Tensor]:
    """``z``, and the edge where it is 0 and has no slopes, with 1 in its place: critical angles, grazing matched media.

    There, z = c: slopes by eta grow as 1/c^2, so that the edge is where c^2 underflows. So does the square of a tiny index at
    normal incidence.
    """
    real, half_imag = numerics.eta2_minus_sin2(c, n, k), n * k
    edge = (half_imag == 0) & (real.abs() <= numerics.tiny(real.dtype))
    return _root(torch.where(edge, 1.0, real), half_imag), edge


def _root(real: Tensor, half_imag: Tensor) -> Complex:
    """``sqrt(real + 2i half_imag)``, not of 0: the part that does not cancel by a square root, the other by division."""
    modulus = torch.hypot(real, 2.0 * half_imag)
    forward = real >= 0
    # not real.abs(), whose slope of 0 at 0 would halve the gradient there
    large = torch.sqrt(0.5 * (modulus + torch.where(forward, real, -real)))
    small = half_imag / large
    return Complex(torch.where(forward, large, small), torch.where(forward, small, large))


def _ratio(t: Complex, z: Complex, difference: Complex) -> Complex:
    """``(t - z)/(t + z)``, of which ``difference = t^2 - z^2`` is known without cancellation; z is not 0.

    Where t is small, 1 - 2/(1 + t/z) has the better slopes; elsewhere difference/(t + z)^2.
    """
    scale = 1.0 / torch.maximum(torch.maximum(t.re.abs(), t.im), torch.maximum(z.re, z.im)).detach()  # squares may underflow
    t, z = t.scaled(scale), z.scaled(scale)
    small = 16.0 * t.square_modulus() < z.square_modulus()
    quotient = t.where(small, 0.0).times(z.where(small, 1.0).reciprocal())
    below = Complex(1.0 + quotient.re, quotient.im).reciprocal()
    scale = torch.where(small, 1.0, scale)
    inverse = t.plus(z).where(~small, 1.0).reciprocal()
    other = difference.where(~small, 0.0).scaled(scale).scaled(scale).times(inverse.times(inverse))
    found = (torch.where(small, 1.0 - 2.0 * below.re, other.re), torch.where(small, -2.0 * below.im, other.im))
    return Complex(*(numerics.at_least(numerics.at_most(x, 1.0), -1.0) for x in found))


def _brewster_difference(c: Tensor, n: Tensor, k: Tensor, index2: Complex) -> Complex:
    """``epsilon c^2 - (1 - c^2)``, its real part in twice the precision: all digits cancel at Brewster's angle."""
    re, im = index2.re * c * c - (1.0 - c) * (1.0 + c), index2.im * c * c
    c, n, k = torch.broadcast_tensors(c.detach(), n.detach().to(c.dtype), k.detach().to(c.dtype))
    x, y, one = n * c, k * c, torch.ones_like(c)
    low = numerics.product_error(n, c, x)
    return Complex(numerics.with_slope_of(numerics.sum_of_products((one, -one), (x, x), (c, c), (x, 2.0 * low), (y, -y))[0], re), im)
