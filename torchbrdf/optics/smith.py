"""Smith's masking and shadowing of GGX and Beckmann surfaces; the manual page is :mod:`torchbrdf.optics.microfacet`.

All of it goes through one number a direction, ``x = 1 / (1 + 2 Lambda)`` in [0, 1], which is ``cos / r`` for GGX and
``nu / (nu + w)`` for Beckmann: ``G1 = 2x / (1 + x)`` and ``G2 = 2xy / (x + y)``. Each ``x`` is a quotient of the smaller by the
larger of two lengths, in whichever of two forms does not cancel, because derivatives cancel long before values do.
"""

import math

import torch
from torch import Tensor
from torch.nn import functional

from .. import numerics
from ..numerics import step, working
from .erf_tail import exponential_tail


def projected_roughness(x: Tensor, y: Tensor, alpha_x: Tensor | float, alpha_y: Tensor | float) -> Tensor:
    """``sqrt((alpha_x x)^2 + (alpha_y y)^2)``: the ``alpha_sin`` of Smith's functions for a unit direction (x, y, z), ``[...]``.

    No overflow or underflow midway. Gradient: the true one, of length up to max(alpha); 0 at x = y = 0, the tip of a cone.
    """
    (x, y, alpha_x, alpha_y), dtype = working(x, y, alpha_x, alpha_y)
    scale = power_of_two_below(torch.maximum(x.abs(), y.abs()))
    u, v = alpha_x * (x / scale), alpha_y * (y / scale)
    off = step(u.abs() + v.abs())
    k, larger, _ = _smaller_over_larger(u + (1.0 - off), v)
    return numerics.rounded_back(larger.abs() * torch.sqrt(1.0 + k * k) * (scale * off), dtype)


def power_of_two_below(x: Tensor) -> Tensor:
    """The power of two at most ``x`` >= 0, a constant by which to divide without rounding; a normal number always."""
    lowest = math.log2(numerics.tiny(x.dtype))
    return torch.exp2(torch.floor(torch.log2(x.detach())).clamp(lowest, -lowest))


def ggx_lambda(cos: Tensor, alpha_sin: Tensor | float) -> Tensor:
    """Smith's Lambda of GGX, ``(sqrt(1 + (alpha_sin / cos)^2) - 1) / 2`` >= 0; ``cos``, ``alpha_sin`` >= 0 ``[...]``, broadcast.

    inf, its limit, with gradient 0 at and below the horizon: ``1 / (1 + Lambda)`` is 0 there, as G1 is.
    """
    (cos, a), dtype = working(cos, alpha_sin)
    c = _above(cos)
    k, larger, _ = _smaller_over_larger(c, a)
    root = torch.sqrt(1.0 + k * k)
    slope = a / c
    usual = 0.5 * slope * (a / (c + larger * root))
    # far above 1, Lambda is almost linear in a: written so, its curvature is not lost between terms that cancel
    value = torch.where(slope > 4.0, 0.5 * (slope * root - 1.0), usual)
    return numerics.rounded_back(value.masked_fill(cos <= 0, math.inf), dtype)


def ggx_g1(cos: Tensor, alpha_sin: Tensor | float) -> Tensor:
    """Smith's masking of GGX for one direction, in [0, 1]; ``cos``, ``alpha_sin`` >= 0 ``[...]``, broadcast.

    1 at ``alpha_sin = 0``; 0 with gradient 0 at and below the horizon, where it tends to 0 with the slope ``2 / alpha_sin``.
    """
    (cos, a), dtype = working(cos, alpha_sin)
    return numerics.rounded_back(_masking(_ggx_x(_above(cos), a)) * step(cos), dtype)


def ggx_g2(cos_i: Tensor, alpha_sin_i: Tensor | float, cos_o: Tensor, alpha_sin_o: Tensor | float) -> Tensor:
    """Height-correlated masking and shadowing of GGX, ``1 / (1 + Lambda_i + Lambda_o)``, in [0, 1]; arguments ``[...]``, broadcast.

    0 with gradient 0 unless both cosines are > 0.
    """
    (ci, ai, co, ao), dtype = working(cos_i, alpha_sin_i, cos_o, alpha_sin_o)
    i, o, above = _both_above(ci, co)
    return numerics.rounded_back(_correlated(_ggx_x(i, ai), _ggx_x(o, ao)) * above, dtype)


def ggx_visibility(cos_i: Tensor, alpha_sin_i: Tensor | float, cos_o: Tensor, alpha_sin_o: Tensor | float) -> Tensor:
    """``G2 / (4 cos_i cos_o)`` of GGX, finite towards grazing, so that f = D V F; arguments ``[...]``, broadcast.

    0 with gradient 0 unless both cosines are > 0; it jumps there. inf where it overflows (both cosines about 1e-38).
    """
    (ci, ai, co, ao), dtype = working(cos_i, alpha_sin_i, cos_o, alpha_sin_o)
    i, o, above = _both_above(ci, co)
    ri, ro = torch.hypot(i, ai), torch.hypot(o, ao)
    unit = power_of_two_below(o * ri + i * ro)  # so that no power of a small denominator overflows in derivatives
    value = (0.5 / unit) / ((o / unit) * ri + (i / unit) * ro)
    return numerics.rounded_back(value * above, dtype)


def beckmann_lambda(cos: Tensor, alpha_sin: Tensor | float) -> Tensor:
    """Smith's Lambda of Beckmann, exact: ``(erf(nu) - 1) / 2 + exp(-nu^2) / (2 nu sqrt(pi))`` with ``nu = cos / alpha_sin``.

    ``cos``, ``alpha_sin`` >= 0 ``[...]``, broadcast. inf with gradient 0 at and below the horizon; 0 with gradient 0 where it is
    below the smallest normal number (nu > 8.8 in float32), ``alpha_sin = 0`` included.
    """
    (cos, a), dtype = working(cos, alpha_sin)
    c, a, w = beckmann_tail(_above(cos), a)
    value = functional.threshold((0.5 * a * w) / c, numerics.tiny(w.dtype), 0.0)
    return numerics.rounded_back(value.masked_fill(cos <= 0, math.inf), dtype)


def beckmann_g1(cos: Tensor, alpha_sin: Tensor | float) -> Tensor:
    """Smith's masking of Beckmann for one direction, in [0, 1]; ``cos``, ``alpha_sin`` >= 0 ``[...]``, broadcast.

    1 at ``alpha_sin = 0``; 0 with gradient 0 at and below the horizon.
    """
    (cos, a), dtype = working(cos, alpha_sin)
    return numerics.rounded_back(_masking(_beckmann_x(_above(cos), a)) * step(cos), dtype)


def beckmann_g2(cos_i: Tensor, alpha_sin_i: Tensor | float, cos_o: Tensor, alpha_sin_o: Tensor | float) -> Tensor:
    """Height-correlated masking and shadowing of Beckmann, in [0, 1]; arguments and edges as :func:`ggx_g2`."""
    (ci, ai, co, ao), dtype = working(cos_i, alpha_sin_i, cos_o, alpha_sin_o)
    i, o, above = _both_above(ci, co)
    return numerics.rounded_back(_correlated(_beckmann_x(i, ai), _beckmann_x(o, ao)) * above, dtype)


def beckmann_lambda_walter(cos: Tensor, alpha_sin: Tensor | float) -> Tensor:
    """Walter's rational fit to :func:`beckmann_lambda`; arguments and edges as there, and 0 for nu >= 1.548.

    As published it is negative, down to -5e-5, between 1.548 and 1.6, and jumps to 0 there; here that stretch is 0.
    """
    (cos, a), dtype = working(cos, alpha_sin)
    share, nu = walter_share(_above(cos), a)
    return numerics.rounded_back((share / nu).masked_fill(cos <= 0, math.inf), dtype)


def walter_share(c: Tensor, a: Tensor) -> tuple[Tensor, Tensor]:
    """``nu Lambda`` of the fit, and nu = c / a >= 0; 0 and 1 where Lambda is 0."""
    near = step(1.59 * a - c)  # just beyond the first root of the numerator, which is positive again past the second
    nu = (c * near + (1.0 - near)) / (a * near + (1.0 - near))
    return torch.relu((0.396 * nu - 1.259) * nu + 1.0) * near / (2.181 * nu + 3.535), nu


def _above(cos: Tensor) -> Tensor:
    """The cosine above the horizon; elsewhere 1 with gradient 0, so that nothing is divided by 0."""
    return functional.threshold(cos, 0.0, 1.0)


def _both_above(ci: Tensor, co: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Both cosines where both are above the horizon, and 1.0 there; elsewhere 1, 1 and 0.0."""
    above = step(ci) * step(co)
    return ci * above + (1.0 - above), co * above + (1.0 - above), above


def _select(a: Tensor, b: Tensor, which: Tensor) -> Tensor:
    """a where ``which`` is 0, b where it is 1; both finite. (lerp would do, but refuses the float64 tangents of vmap over jvp.)"""
    return a * (1.0 - which) + b * which


def _smaller_over_larger(c: Tensor, a: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Of two legs, not both 0: k = smaller / larger, the larger, and 1.0 where that is ``a``."""
    swapped = step(a.abs() - c.abs())
    larger = _select(c, a, swapped)
    return _select(a, c, swapped) / larger, larger, swapped


def _ggx_x(c: Tensor, a: Tensor) -> Tensor:
    """``c / sqrt(c^2 + a^2)``."""
    k, _, grazing = _smaller_over_larger(c, a)
    return _select(torch.ones_like(k), k, grazing) / torch.sqrt(1.0 + k * k)


def beckmann_tail(c: Tensor, a: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """c, a and w = 2 nu Lambda; (1, 1, 0) where exp(-nu^2) is below the smallest normal number."""
    alive = step(a * math.sqrt(-math.log(numerics.tiny(a.dtype))) - c)
    c, a = c * alive + (1.0 - alive), a * alive + (1.0 - alive)
    return c, a, exponential_tail(c, a) * alive


def _beckmann_x(c: Tensor, a: Tensor) -> Tensor:
    """``nu / (nu + w)``."""
    c, a, w = beckmann_tail(c, a)
    nu = c / a
    total = nu + w
    return _select(1.0 - w / total, nu / total, step(0.5 - nu))


def _masking(x: Tensor) -> Tensor:
    return 2.0 * x / (1.0 + x)


def _correlated(x: Tensor, y: Tensor) -> Tensor:
    """``2xy / (x + y)``, as smaller / (1 + smaller / larger) so that neither it nor its derivatives cancel or underflow."""
    swapped = step(x - y)
    less, more = _select(x, y, swapped), _select(y, x, swapped)
    unit = power_of_two_below(more)
    less, more = less / unit, more / unit
    return less / (1.0 + less / more) * (2.0 * unit)
