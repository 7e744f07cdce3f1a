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

__all__ = ["Amplitudes", "amplitudes", "refracted_root"]


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

    def where(self, mask: Tensor, re: float) -> "Complex":
        """This number where the mask holds, elsewhere a real one."""
        return Complex(torch.where(mask, self.re, re), torch.where(mask, self.im, 0.0))


def amplitudes(cos_i: Tensor, eta: Tensor | float, k: Tensor | float = 0.0) -> Amplitudes:
    """Complex amplitude ratios ``r_s`` and ``r_p`` of a smooth interface to a medium of index ``eta + i k``, as their real parts
    and imaginary parts ``(s_re, s_im, p_re, p_im)``, each in [-1, 1]; ``.s`` and ``.p`` are complex tensors.

    ``cos_i`` in [0, 1], ``eta`` > 0, ``k`` >= 0, broadcast. Time runs as exp(-i omega t), so k >= 0 absorbs. The axes of p before
    and after, with that of s and the ray, are right-handed: ``r_p = -r_s`` at normal incidence, -1 both at grazing (Born & Wolf).
    A dielectric's are real up to the critical angle, of modulus 1 with a phase beyond; ``(|r_s|^2 + |r_p|^2)/2`` is the
    reflectance of :func:`dielectric` or :func:`conductor`. Between equal media 0, grazing included. By eta and k they have
    slopes at eta = 1, too, which grow as 1/c^2: where c^2 underflows, and at the critical angle, the gradient is 0.
    """
    (c, n, k), dtype = numerics.working(cos_i, eta, k)
    c = numerics.unit_interval(c)
    zero = torch.zeros_like(c)
    index2 = Complex(n * n - k * k, 2.0 * n * k)
    more = Complex((n - 1.0) * (n + 1.0) - k * k, index2.im)  # than in the vacuum
    z, vacuum = refracted(c, n, k)
    s = _ratio(Complex(c, zero), z, more.scaled(-torch.ones_like(c)), vacuum)
    p = _ratio(index2.scaled(c), z, more.times(_brewster_difference(c, n, k, index2)), vacuum)
    return Amplitudes(*(numerics.rounded_back(x, dtype) for x in (*s, *p)))


def refracted(c: Tensor, n: Tensor, k: Tensor) -> tuple[Complex, Tensor]:
    """``z``, and where it vanishes because there is no interface, as c^2 underflows; 1 stands for it there."""
    g2 = numerics.eta2_minus_sin2(c, n, k)
    vacuum = (n == 1) & (k == 0) & (g2 <= numerics.tiny(g2.dtype))
    a, b = refracted_root(g2, n * k, c == 1, n, k)
    return Complex(torch.where(vacuum, 1.0, a), b), vacuum


def _ratio(t: Complex, z: Complex, difference: Complex, vacuum: Tensor) -> Complex:
    """``(t - z)/(t + z)``, of which ``difference = t^2 - z^2`` is known without cancellation.

    Where t is small, 1 - 2/(1 + t/z) has the better slopes; elsewhere difference/(t + z)^2.
    """
    largest = torch.maximum(torch.maximum(t.re.abs(), t.im), torch.maximum(z.re, z.im)).detach()
    scale = 1.0 / largest.clamp_min(numerics.tiny(largest.dtype))  # squares underflow at grazing between nearly equal media
    t, z = t.scaled(scale), z.scaled(scale)
    size = z.square_modulus()
    far = 16.0 * t.square_modulus() < size
    quotient = t.times(z.where(far, 1.0).reciprocal()).where(far, 0.0)
    below = Complex(1.0 + quotient.re, quotient.im).reciprocal()
    scale = torch.where(far, 1.0, scale)
    above = difference.where(~far, 0.0).scaled(scale).scaled(scale)
    inverse = t.plus(z).where(~far, 1.0).reciprocal()
    other = above.times(inverse.times(inverse))
    found = Complex(torch.where(far, 1.0 - 2.0 * below.re, other.re), torch.where(far, -2.0 * below.im, other.im))
    found = found.where(size > 0, 1.0).where(~vacuum, 0.0)
    return Complex(*(numerics.at_least(numerics.at_most(x, 1.0), -1.0) for x in found))


def _brewster_difference(c: Tensor, n: Tensor, k: Tensor, index2: Complex) -> Complex:
    """``epsilon c^2 - (1 - c^2)``, its real part in twice the precision: all digits cancel at Brewster's angle."""
    re, im = index2.re * c * c - (1.0 - c) * (1.0 + c), index2.im * c * c
    c, n, k = torch.broadcast_tensors(c.detach(), n.detach().to(c.dtype), k.detach().to(c.dtype))
    x, y, one = n * c, k * c, torch.ones_like(c)
    low = numerics.product_error(n, c, x)
    return Complex(numerics.value_of(numerics.sum_of_products((one, -one), (x, x), (c, c), (x, 2.0 * low), (y, -y))[0], re), im)


def refracted_root(real: Tensor, half_imag: Tensor, normal: Tensor, n: Tensor, k: Tensor) -> tuple[Tensor, Tensor]:
    """``sqrt(real + 2i half_imag)`` = a + ib: the part that does not cancel by a square root, the other by division.

    Where both are 0: 0, the critical angle; at ``normal`` incidence their squares underflowed, and the root is ``n + ik``.
    """
    degenerate = (real == 0) & (half_imag == 0)
    t = torch.where(degenerate, 1.0, real)
    modulus = torch.hypot(t, 2.0 * half_imag)
    forward = t >= 0
    # not t.abs(), whose slope of 0 at 0 would halve the gradient there
    large = torch.sqrt(0.5 * (modulus + torch.where(forward, t, -t)))
    small = half_imag / large
    a = torch.where(forward, large, small)
    b = torch.where(forward, small, large)
    index = n.clamp_min(4.0 * numerics.tiny(n.dtype)) * normal  # slopes of 4/eta are numbers
    return torch.where(degenerate, index, a), torch.where(degenerate, k * normal, b)
