r"""Conductors of complex index :math:`\eta + ik`: the exact reflectance, by several methods.

With :math:`c = \cos\theta_i`, :math:`s^2 = (1-c)(1+c)`, :math:`z^2 = (\eta + ik)^2 - s^2`, a the real part of z and m = \|z\|^2:

:math:`F = R_s\,u/(u + w)` with :math:`R_s = |z^2 - c^2|^2/d^2`, :math:`d = |z + c|^2 = m + c^2 + 2ac`,
:math:`u = c^2 m + s^4` and :math:`w = 2acs^2`,

as R_p = R_s (u - w)/(u + w): Born & Wolf 1999, sec. 14.2, so arranged that of z its real part is enough. All cancellation is in
Re z^2, which alone is taken in more digits.
"""

import math
from collections.abc import Callable

import torch
from torch import Tensor
from torch.nn import functional as nnf

from .. import arguments, numerics
from .amplitudes import at_edge, refracted


def conductor(cos_i: Tensor, eta: Tensor | float, k: Tensor | float, method: str = "standard") -> Tensor:
    """Exact unpolarised reflectance of a conductor of complex index ``eta + i k``, in [0, 1].

    ``cos_i`` in [0, 1], ``eta`` > 0, ``k`` >= 0, broadcast. ``k = 0`` is the dielectric, one-sided derivative included.
    ``method``: ``"standard"`` is within 16 ulp everywhere (float32: indices up to 1e18, second derivatives at normal incidence
    from 1e-12 on); ``"extended"`` scales everything, and takes about twice the time; ``"plain"`` is a little
    faster than ``"standard"`` and, for small k, loses all digits in float32 at the critical angle.
    """
    formula = METHODS[arguments.one_of(method, "method", METHODS)]
    (c, n, k), dtype = numerics.working(cos_i, eta, k)
    return numerics.rounded_back(formula(numerics.unit_interval(c), n, k), dtype)


def _standard(c: Tensor, n: Tensor, k: Tensor) -> Tensor:
    return _from_real_part(c, n, k, numerics.eta2_minus_sin2_widened(c, n, k))


def _plain(c: Tensor, n: Tensor, k: Tensor) -> Tensor:
    return _from_real_part(c, n, k, (n - 1.0) * (n + 1.0) - k * k + c * c)


def _from_real_part(c: Tensor, n: Tensor, k: Tensor, real: Tensor) -> Tensor:
    """The reflectance from ``real``, the real part of z^2. What is small beside 1 is scaled as z is, see :func:`_lift`."""
    half_imag, lift = n * k, _lift(real, n * k)
    lift2 = lift * lift
    real, half_imag, z2_less_c2 = real * lift2, half_imag * lift2, ((n - 1.0) * (n + 1.0) - k * k) * lift2
    imag = 2.0 * half_imag
    m2 = real * real + imag * imag
    m = torch.sqrt(nnf.threshold(m2, 0.0, 1.0))
    a2, cos, s2 = 2.0 * _real_root(m, real, half_imag), c * lift, (1.0 - c) * (1.0 + c) * lift
    lost = a2 * cos
    d = m + cos * cos + lost
    x, y = z2_less_c2 / d, imag / d
    # Each where its slopes do not cancel. By numbers for masks, as a mask kept for the backward pass would not be vectorised.
    r_s = torch.lerp(x * x + y * y, 1.0 - 2.0 * lost / d, numerics.step(m - 16.0 * cos * cos))
    u = c * c * m + s2 * s2
    found = numerics.at_most(r_s * (u / (u + a2 * c * s2)), 1.0)
    inside = numerics.step(m2)
    return found * inside + (1.0 - inside) * at_edge(n)


def _lift(real: Tensor, half_imag: Tensor) -> Tensor:
    """A power of two: 1, but where the square of z^2 would underflow or overflow; z times this has a square and a fourth power.

    Small it is at the critical angle, at grazing between nearly equal media, and for a tiny index at normal incidence.
    """
    least, up, most, down = _lifts(real.dtype)
    size = torch.maximum(real.detach().abs(), half_imag.detach())
    small, large = (size < least).to(size.dtype), (size > most).to(size.dtype)
    return (1.0 + up * small - large) + down * large  # exactly the powers: 1 is less than half of the last bit of the larger


def _lifts(dtype: torch.dtype) -> tuple[float, float, float, float]:
    """Below what z^2 is lifted, and by how much z is; above what it is lowered, and by how much: to numbers of safe squares."""
    least = numerics.negligible(dtype)
    smallest = numerics.tiny(dtype) * torch.finfo(dtype).eps
    quarter = round(0.25 * math.log2(torch.finfo(dtype).max))
    return 8.0 * least, 2.0 ** math.ceil(0.5 * (math.log2(least) - math.log2(smallest))), 4.0**quarter / 64.0, 2.0 ** (-quarter - 2)


def _real_root(m: Tensor, real: Tensor, half_imag: Tensor) -> Tensor:
    """Re z: the part of the root that does not cancel by a square root, the other by division.

    Not by real.abs(), whose slope of 0 at 0 would halve the gradient there.
    """
    forward = (real >= 0).to(real.dtype)
    large = torch.sqrt(0.5 * (m + real * (2.0 * forward - 1.0)))
    return torch.lerp(half_imag / large, large, forward)


def _extended(c: Tensor, n: Tensor, k: Tensor) -> Tensor:
    """By both reflectances of the whole complex root, scaled so that no square leaves the dtype."""
    (a, b), edge = refracted(c, n, k)
    r_s = _perpendicular(c, a, b, (n - 1.0) * (n + 1.0) - k * k, 2.0 * n * k)
    both = 0.5 * r_s * (1.0 + _parallel_share(c, a, b))
    return torch.where(edge, at_edge(n), numerics.at_most(both, 1.0))


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


METHODS: dict[str, Callable[[Tensor, Tensor, Tensor], Tensor]] = {"standard": _standard, "extended": _extended, "plain": _plain}
