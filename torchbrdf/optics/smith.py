"""Smith's masking and shadowing of GGX and Beckmann surfaces; the manual page is :mod:`torchbrdf.optics.microfacet`.

All of it goes through one number a direction, ``x = 1 / (1 + 2 Lambda)`` in [0, 1], which is ``cos / r`` for GGX and
``nu / (nu + w)`` for Beckmann: ``G1 = 2x / (1 + x)`` and ``G2 = 2xy / (x + y)``. Each ``x`` is a quotient of the smaller by the
larger of two lengths, in whichever of two forms does not cancel, because derivatives cancel long before values do.
"""

import functools
import math

import torch
from torch import Tensor
from torch.nn import functional

from .. import numerics
from ..numerics import step
from .erf_tail import exponential_tail


def working(*xs: Tensor | float) -> tuple[list[Tensor], torch.dtype]:
    """The arguments in the dtype to compute in, numbers included, and the dtype of the result."""
    tensors = [x for x in xs if isinstance(x, Tensor)] or [torch.zeros(())]
    dtype = functools.reduce(torch.promote_types, (t.dtype for t in tensors))
    wide = numerics.working_dtype(dtype)
    made = [x.to(wide) if isinstance(x, Tensor) else torch.as_tensor(x, dtype=wide, device=tensors[0].device) for x in xs]
    return made, dtype


def ggx_lambda(cos: Tensor, alpha_sin: Tensor | float) -> Tensor:
    """Smith's Lambda of GGX, ``(sqrt(1 + (alpha_sin / cos)^2) - 1) / 2`` >= 0; ``cos``, ``alpha_sin`` >= 0 ``[...]``, broadcast.

    inf, its limit, with gradient 0 at and below the horizon: ``1 / (1 + Lambda)`` is 0 there, as G1 is.
    """
    (cos, a), dtype = working(cos, alpha_sin)
    c = _lit(cos)
    _, root, grazing = _smaller_over_larger(c, a)
    slope = a / c
    usual = 0.5 * slope * (a / (c + torch.lerp(c, a, grazing) * root))
    # far above 1, Lambda is almost linear in a: written so, its curvature is not lost between terms that cancel
    value = torch.where(slope > 4.0, 0.5 * (slope * root - 1.0), usual)
    return numerics.rounded_back(value.masked_fill(cos <= 0, math.inf), dtype)


def ggx_g1(cos: Tensor, alpha_sin: Tensor | float) -> Tensor:
    """Smith's masking of GGX for one direction, in [0, 1]; ``cos``, ``alpha_sin`` >= 0 ``[...]``, broadcast.

    1 at ``alpha_sin = 0``; 0 with gradient 0 at and below the horizon, where it tends to 0 with the slope ``2 / alpha_sin``.
    """
    (cos, a), dtype = working(cos, alpha_sin)
    return numerics.rounded_back(_masking(_ggx_x(_lit(cos), a)) * step(cos), dtype)


def ggx_g2(cos_i: Tensor, alpha_sin_i: Tensor | float, cos_o: Tensor, alpha_sin_o: Tensor | float) -> Tensor:
    """Height-correlated masking and shadowing of GGX, ``1 / (1 + Lambda_i + Lambda_o)``, in [0, 1]; arguments ``[...]``, broadcast.

    0 with gradient 0 unless both cosines are > 0.
    """
    (ci, ai, co, ao), dtype = working(cos_i, alpha_sin_i, cos_o, alpha_sin_o)
    value = _correlated(_ggx_x(_lit(ci), ai), _ggx_x(_lit(co), ao))
    return numerics.rounded_back(value * (step(ci) * step(co)), dtype)


def ggx_visibility(cos_i: Tensor, alpha_sin_i: Tensor | float, cos_o: Tensor, alpha_sin_o: Tensor | float) -> Tensor:
    """``G2 / (4 cos_i cos_o)`` of GGX, finite towards grazing, so that f = D V F; arguments ``[...]``, broadcast.

    0 with gradient 0 unless both cosines are > 0; it jumps there. inf where it overflows (both cosines about 1e-38).
    """
    (ci, ai, co, ao), dtype = working(cos_i, alpha_sin_i, cos_o, alpha_sin_o)
    i, o = _lit(ci), _lit(co)
    unit = _constant_unit(torch.maximum(i, o))
    value = (0.5 / unit) / ((o / unit) * torch.hypot(i, ai) + (i / unit) * torch.hypot(o, ao))
    return numerics.rounded_back(value * (step(ci) * step(co)), dtype)


def beckmann_lambda(cos: Tensor, alpha_sin: Tensor | float) -> Tensor:
    """Smith's Lambda of Beckmann, exact: ``(erf(nu) - 1) / 2 + exp(-nu^2) / (2 nu sqrt(pi))`` with ``nu = cos / alpha_sin``.

    ``cos``, ``alpha_sin`` >= 0 ``[...]``, broadcast. inf with gradient 0 at and below the horizon; 0 with gradient 0 where it is
    below the smallest normal number (nu > 8.8 in float32), ``alpha_sin = 0`` included.
    """
    (cos, a), dtype = working(cos, alpha_sin)
    nu, w = _beckmann_nu_w(_lit(cos), a)
    value = functional.threshold(w / (2.0 * nu), numerics.tiny(w.dtype), 0.0)
    return numerics.rounded_back(value.masked_fill(cos <= 0, math.inf), dtype)


def beckmann_g1(cos: Tensor, alpha_sin: Tensor | float) -> Tensor:
    """Smith's masking of Beckmann for one direction, in [0, 1]; ``cos``, ``alpha_sin`` >= 0 ``[...]``, broadcast.

    1 at ``alpha_sin = 0``; 0 with gradient 0 at and below the horizon.
    """
    (cos, a), dtype = working(cos, alpha_sin)
    return numerics.rounded_back(_masking(_beckmann_x(_lit(cos), a)) * step(cos), dtype)


def beckmann_g2(cos_i: Tensor, alpha_sin_i: Tensor | float, cos_o: Tensor, alpha_sin_o: Tensor | float) -> Tensor:
    """Height-correlated masking and shadowing of Beckmann, in [0, 1]; arguments and edges as :func:`ggx_g2`."""
    (ci, ai, co, ao), dtype = working(cos_i, alpha_sin_i, cos_o, alpha_sin_o)
    value = _correlated(_beckmann_x(_lit(ci), ai), _beckmann_x(_lit(co), ao))
    return numerics.rounded_back(value * (step(ci) * step(co)), dtype)


def beckmann_lambda_walter(cos: Tensor, alpha_sin: Tensor | float) -> Tensor:
    """Walter's rational fit to :func:`beckmann_lambda`; arguments and edges as there, and 0 for nu >= 1.548.

    As published it is negative, down to -5e-5, between 1.548 and 1.6, and jumps to 0 there; here that stretch is 0.
    """
    (cos, a), dtype = working(cos, alpha_sin)
    c = _lit(cos)
    near = step(1.59 * a - c)  # just beyond the first root of the numerator, which is positive again past the second
    nu = (c * near + (1.0 - near)) / (a * near + (1.0 - near))
    value = torch.relu((0.396 * nu - 1.259) * nu + 1.0) * near / ((2.181 * nu + 3.535) * nu)
    return numerics.rounded_back(value.masked_fill(cos <= 0, math.inf), dtype)


def _lit(cos: Tensor) -> Tensor:
    """The cosine above the horizon; elsewhere 1 with gradient 0, so that nothing is divided by 0."""
    return functional.threshold(cos, 0.0, 1.0)


def _constant_unit(x: Tensor) -> Tensor:
    """What to divide by, as a constant, so that second derivatives of tiny numbers do not overflow midway; 1 for all others."""
    x = x.detach()
    return torch.where(x < torch.finfo(x.dtype).eps, x.clamp_min(numerics.tiny(x.dtype)), 1.0)


def _smaller_over_larger(c: Tensor, a: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Of two legs: k = smaller / larger, sqrt(1 + k^2), and 1.0 where ``c`` is the smaller."""
    grazing = step(a - c)
    less, more = torch.lerp(a, c, grazing), torch.lerp(c, a, grazing)  # exact at weights 0 and 1
    unit = _constant_unit(more)
    k = (less / unit) / (more / unit)
    return k, torch.sqrt(1.0 + k * k), grazing


def _ggx_x(c: Tensor, a: Tensor) -> Tensor:
    """``c / sqrt(c^2 + a^2)``."""
    k, root, grazing = _smaller_over_larger(c, a)
    return torch.lerp(torch.ones_like(k), k, grazing) / root


def _beckmann_nu_w(c: Tensor, a: Tensor) -> tuple[Tensor, Tensor]:
    """nu = c / a and w = 2 nu Lambda; (1, 0) where exp(-nu^2) is below the smallest normal number."""
    alive = step(a * math.sqrt(-math.log(numerics.tiny(a.dtype))) - c)
    c, a = c * alive + (1.0 - alive), a * alive + (1.0 - alive)
    return c / a, exponential_tail(c, a) * alive


def _beckmann_x(c: Tensor, a: Tensor) -> Tensor:
    """``nu / (nu + w)``."""
    nu, w = _beckmann_nu_w(c, a)
    total = nu + w
    return torch.lerp(1.0 - w / total, nu / total, step(0.5 - nu))


def _masking(x: Tensor) -> Tensor:
    return 2.0 * x / (1.0 + x)


def _correlated(x: Tensor, y: Tensor) -> Tensor:
    """``2xy / (x + y)``, as smaller / (1 + smaller / larger) so that neither it nor its derivatives cancel or underflow."""
    swapped = step(x - y)
    less, more = torch.lerp(x, y, swapped), torch.lerp(y, x, swapped)
    unit = _constant_unit(more)
    less, more = less / unit, more / unit
    return less / (1.0 + less / more) * (2.0 * unit)
