r"""The reflectance of a dielectric averaged over the hemisphere: what diffuse light loses to an interface.

.. math:: \bar F(\eta) = 2 \int_0^1 F(\mu, \eta)\, \mu\, d\mu

The closed form (Walsh 1926; Duntley 1942, eq. 14) has poles at eta = 1 that cancel. With :math:`t = (\eta-1)/(\eta+1)`, eta > 1, and
:math:`q(t) = (\mathrm{artanh}\,t - t)/t^3` the poles divide out exactly:

.. math::
    \bar F = \frac{t}{(1+t^2)^3} \left[ P(t) + \tfrac14 (1+t)^4 (1-t)^2 (1 + 6t^2 + t^4)\, q(t) + 2t(1+t)^2 \ln t \right]

with :math:`12 P = 7 + 44t - 24t^3 + 6t^4 + 36t^5 + 16t^6 + 8t^7 + 3t^8`. What is left cancels by a factor of 3 at most. Below 1 the
law is that of the other side, :math:`(1 - \bar F(\eta))/\eta = (1 - \bar F(1/\eta))\,\eta`.
"""

from typing import Any

import torch
from torch import Tensor

from .. import numerics

P = tuple(p / 12.0 for p in (7.0, 44.0, 0.0, -24.0, 6.0, 36.0, 16.0, 8.0, 3.0))
FAR = 0.5  # of t, eta = 3: beyond, artanh t - t keeps its digits
# Gauss's rule of 16 nodes on [-1, 1], the positive half: of x^2/(1 - t^2 x^2) its error is 5e-19 at t = 1/2.
NODES = (
    (0.0950125098376374402, 0.189450610455068496),
    (0.281603550779258913, 0.182603415044923589),
    (0.458016777657227386, 0.169156519395002538),
    (0.617876244402643748, 0.149595988816576732),
    (0.755404408355003034, 0.124628971255533872),
    (0.865631202387831744, 0.0951585116824927848),
    (0.944575023073232576, 0.0622535239386478929),
    (0.989400934991649933, 0.0271524594117540949),
)


def dielectric_average(eta: Tensor | float) -> Tensor:
    """Reflectance of a dielectric interface for diffuse light: 2 times the integral of F(cos) cos over cos in [0, 1].

    ``eta`` > 0 is n(far side) / n(side of the light), any shape. 0 at eta = 1, where the slope jumps from -7/3 to 1/3 (light at grazing
    angles is reflected between nearly equal media, too); the derivative there is 1/3, that towards a denser far side. Diffuse light inside
    a medium of index eta meets ``dielectric_average(1 / eta)``. Source: Walsh 1926; Duntley 1942.
    """
    (n,), dtype = numerics.working(eta)
    return numerics.rounded_back(_average(n), dtype)


def textbook(m: Any, eta: Any) -> Any:
    """Duntley's closed form, in an arithmetic of :mod:`~torchbrdf.testing.textbook`; below 1 that of the other side.

    At 1, where the slope jumps, it is that from above.
    """
    below, above = m.positive(1 - eta), m.positive(eta - 1)
    n = m.where(below, 1 / eta, m.where(above, eta, 2))
    n2, n4 = n * n, n * n * n * n
    total = 0.5 + (n - 1) * (3 * n + 1) / (6 * (n + 1) * (n + 1))
    total = total + n2 * (n2 - 1) * (n2 - 1) / ((n2 + 1) * (n2 + 1) * (n2 + 1)) * m.log((n - 1) / (n + 1))
    total = total - 2 * n * n2 * (n2 + 2 * n - 1) / ((n2 + 1) * (n4 - 1))
    total = total + 8 * n4 * (n4 + 1) / ((n2 + 1) * (n4 - 1) * (n4 - 1)) * m.log(n)
    return m.where(below, 1 - eta * eta * (1 - total), m.where(above, total, (eta - 1) / 3))


def _average(n: Tensor) -> Tensor:
    below = n < 1.0
    low = torch.where(below, n, 1.0)
    t = torch.where(below, 1.0 - n, n - 1.0) / (n + 1.0)
    log_eta = torch.log(n)
    dense = _denser(t, torch.where(below, -log_eta, log_eta))
    return numerics.at_most(low * low * dense + (1.0 - low) * (1.0 + low), 1.0)


def _denser(t: Tensor, log_eta: Tensor) -> Tensor:
    """For eta >= 1, of which t is known to the last digits near 1, and the logarithm far from it."""
    r, one = t * t, 1.0 + t
    both = one * one
    root = both * (1.0 - t)
    smooth = _polynomial(t) + 0.25 * root * root * (1.0 + r * (6.0 + r)) * _excess(t, log_eta)
    logarithm = torch.log(torch.where(t > 0, t, 1.0))
    inverse = 1.0 / (1.0 + r)
    return t * (inverse * inverse * inverse) * (smooth + 2.0 * t * both * logarithm)


def _polynomial(t: Tensor) -> Tensor:
    total = torch.full_like(t, P[-1])
    for p in P[-2::-1]:
        total = total * t + p
    return total


def _excess(t: Tensor, log_eta: Tensor) -> Tensor:
    """``(artanh t - t) / t^3``, which is the integral of x^2 / (1 - t^2 x^2) over x in [0, 1]; ``artanh t`` is ``ln(eta) / 2``."""
    far = t > FAR
    near, large = torch.where(far, FAR, t), torch.where(far, t, FAR)
    r = near * near
    total = torch.zeros_like(t)
    for x, weight in NODES:
        total = total + (weight * x * x) / (1.0 - (x * x) * r)
    direct = (0.5 * log_eta - large) / (large * large * large)
    return torch.where(far, direct, total)
