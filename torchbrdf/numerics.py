"""Safe operations: each states its value *and* its gradient at its edges.

Two rules hold throughout. A ``where`` also masks its *input*, because a NaN in the branch that is not taken poisons the
gradient. Nothing is nudged by an epsilon: the only small literals are derived from ``torch.finfo`` below, with a reason.
And one of speed: eager ``where`` on a mask that changes from pixel to pixel costs as much as thirty products (mispredicted
branches), so what is finite on both sides is multiplied by its mask instead.
"""

import functools
import math

import torch
from torch import Tensor
from torch.nn import functional

FEW = 1 << 14  # numbers; measured: up to twice as many, one operation for all channels is no slower eagerly
HALF_TYPES = (torch.float16, torch.bfloat16)
TEXT_DIGITS = math.sqrt(torch.finfo(torch.float32).eps)  # half the digits of float32, as matrices and vectors have them in text files


def tiny(dtype: torch.dtype) -> float:
    """Smallest *normal* number of ``dtype``: below it arithmetic is denormal, inexact, and about 3x slower on a CPU."""
    return torch.finfo(dtype).tiny


def working_dtype(dtype: torch.dtype) -> torch.dtype:
    """Half types compute in float32 and round once at the end; every other type computes in itself."""
    return torch.float32 if dtype in HALF_TYPES else dtype


def widen(x: Tensor) -> Tensor:
    """``x`` in its working dtype (no copy unless it is a half type)."""
    return x.float() if x.dtype in HALF_TYPES else x


def rounded_back(x: Tensor, dtype: torch.dtype) -> Tensor:
    """A result of :func:`widen`-ed inputs in the dtype it is asked for: one rounding."""
    return x.to(dtype) if dtype in HALF_TYPES else x


def working(*xs: Tensor | float) -> tuple[list[Tensor], torch.dtype]:
    """Arguments of a formula, numbers included, in the dtype to compute in; and the dtype of its result.

    As torch promotes: tensors without axes follow those with axes, and numbers follow tensors (in float32 beside a half type).
    """
    tensors = [x for x in xs if isinstance(x, Tensor)] or [torch.zeros(())]
    leading = [x for x in tensors if x.dim()] or tensors
    dtype = functools.reduce(torch.promote_types, (x.dtype for x in leading))
    wide = working_dtype(dtype)
    made = [x.to(wide) if isinstance(x, Tensor) else torch.as_tensor(x, dtype=wide, device=leading[0].device) for x in xs]
    return made, dtype


def few(x: Tensor) -> bool:
    """Whether dispatching an operation on x takes about as long as the operation; never inside graphs, where nothing is dispatched."""
    return not torch.compiler.is_compiling() and x.numel() <= FEW


def positive(x: Tensor) -> Tensor:
    """``max(x, 0)``. Gradient: 1 for x >= 0 (at 0 that of the lit side), 0 below."""
    info = torch.finfo(x.dtype)
    return torch.threshold(x, -info.smallest_normal * info.eps, 0.0)  # "greater than the number below 0"


def finite_or_zero(x: Tensor) -> Tensor:
    """``x``, and 0 with gradient 0 where it is not finite. (Each form is the fast one: nan_to_num eagerly, where compiled.)"""
    return torch.where(x.abs() < math.inf, x, 0.0) if torch.compiler.is_compiling() else torch.nan_to_num(x, 0.0, 0.0, 0.0)


def step(x: Tensor) -> Tensor:
    """1 for x > 0, else 0, in the dtype of x. No gradient."""
    return torch.sign(torch.relu(x.detach()))


def unit_interval(x: Tensor) -> Tensor:
    """x held to [0, 1] against rounding. The gradient passes at exactly 0 and 1 (``clamp`` would kill it) and is 0 beyond."""
    return torch.where(x < 0, 0.0, torch.where(x > 1, 1.0, x))


def between(x: Tensor, low: float, high: float) -> Tensor:
    """x held to [low, high], NaN to itself. Gradient: 0 from either end on. (That of ``clamp`` takes five operations instead of one.)"""
    return functional.hardtanh(x, low, high)


def at_most(x: Tensor, most: float) -> Tensor:
    """``min(x, most)`` for a value that exceeds it only by rounding: the excess is taken off, the gradient always passes."""
    return x - torch.relu(x.detach() - most)


def at_least(x: Tensor, least: float) -> Tensor:
    """``max(x, least)`` for a value that falls below only by rounding, as :func:`at_most`."""
    return x + torch.relu(least - x.detach())


def negligible(dtype: torch.dtype) -> float:
    """sqrt of :func:`tiny`: a reciprocal down to here has a derivative, ``-1/x^2``, that does not overflow."""
    return math.sqrt(tiny(dtype))


def safe_sqrt(x: Tensor, least: float = 0.0) -> Tensor:
    """``sqrt(x)`` for finite x > ``least``, else 0. Gradient: the true one there (not capped); else 0, at 0 in place of infinity."""
    return finite_or_zero(torch.sqrt(torch.threshold(x, least, math.inf)))


def reciprocal_or_zero(x: Tensor, least: float = 0.0) -> Tensor:
    """``1/x`` for x > ``least`` >= 0; 0 with gradient 0 elsewhere."""
    return torch.reciprocal(torch.threshold(x, least, math.inf))


def log1p_power(m: Tensor, exponent: Tensor) -> Tensor:
    """``(1 - m) ** exponent`` for a complement ``m = 1 - cosine``, accurate near m = 0 where the cosine itself has no digits left.

    Value 0 for m > 1 (the far hemisphere), and for m = 1 unless the exponent is 0: 0 ** 0 is 1. Results below the smallest
    normal number are flushed to 0. Gradient: 0 wherever the value is 0 or flushed, and at m = 1.
    Range: exponent >= 0, m >= 0; relative error about (2 + \\|ln value\\|) * eps.
    """
    half_ulp = 0.5 * torch.finfo(m.dtype).eps
    log_value = exponent * torch.log1p(-m.clamp_max(1.0 - half_ulp))  # there the logarithm is still finite
    if few(m):
        return flushed_exp(log_value) * (m <= 1.0 - half_ulp * torch.sign(exponent))
    black_beyond = 1.0 - half_ulp * step(exponent)
    return flushed_exp(log_value) * (1.0 - step(m - black_beyond))


def flushed_exp(log_value: Tensor) -> Tensor:
    """``exp`` of a finite number where the result is a normal number; 0 with gradient 0 below."""
    lowest = math.log(2.0 * tiny(log_value.dtype))  # twice, because exp() of the bound itself rounds to a denormal
    return torch.exp(torch.threshold(log_value, lowest, -math.inf))


def cosine_power(cos: Tensor, sin2: Tensor, exponent: Tensor) -> Tensor:
    """``cos ** exponent`` for ``cos`` in [0, 1] of which ``sin2 = 1 - cos^2`` is known without cancellation.

    Near the pole by the sine, near the horizon by the cosine. Value, gradient and range as :func:`log1p_power`.
    """
    near_pole = (cos > 0.5).to(cos.dtype)
    log_near = 0.5 * torch.log1p(-sin2.clamp_max(0.875))  # sin^2 = 0.75 where the two meet
    log_far = torch.log(cos.clamp_min(tiny(cos.dtype)))
    log_value = exponent * (log_near * near_pole + log_far * (1.0 - near_pole))  # both are finite
    return torch.where((cos == 0) & (exponent > 0), 0.0, flushed_exp(log_value))


def with_slope_of(exact: Tensor, slopes_of: Tensor) -> Tensor:
    """The value of one formula, to the last bit, with the derivatives of another that is finite and equal in exact arithmetic."""
    return exact.detach() + (slopes_of - slopes_of.detach())


def product_error(x: Tensor, y: Tensor, product: Tensor) -> Tensor:
    """The rounding error of ``product = fl(x * y)``, exactly (Dekker 1971, by Veltkamp's splitting), below 1e34 in float32."""
    (x_high, x_low), (y_high, y_low) = _halves(x), _halves(y)
    return (((x_high * y_high - product) + x_high * y_low) + x_low * y_high) + x_low * y_low


def _halves(x: Tensor) -> tuple[Tensor, Tensor]:
    carry = x * (2.0 ** (12 if x.dtype == torch.float32 else 27) + 1.0)  # half of the significand, rounded up
    high = carry - (carry - x)
    return high, x - high


def two_sum(x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """``fl(x + y)`` and its rounding error, exactly (Knuth 1969)."""
    total = x + y
    part = total - x
    return total, (x - (total - part)) + (y - part)


def sum_of_products(*pairs: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
    """``sum x_j y_j`` as if in twice the precision, and what is left when it is rounded (Ogita, Rump & Oishi 2005, Dot2).

    Without derivatives. Where a product is so large that splitting it overflows, the plain sum.
    """
    (x, y), *rest = [(x.detach(), y.detach()) for x, y in pairs]
    plain = total = x * y
    low = product_error(x, y, total)
    for x, y in rest:
        product = x * y
        plain = plain + product
        total, error = two_sum(total, product)
        low = low + (error + product_error(x, y, product))
    exact = total + low
    split = exact.abs() < math.inf
    return torch.where(split, exact, plain), torch.where(split, low - (exact - total), 0.0)


def eta2_minus_sin2(cos_i: Tensor, eta: Tensor, k: Tensor | None = None, cos_low: Tensor | None = None) -> Tensor:
    """``eta^2 - k^2 - (1 - cos_i^2)``, the square of Fresnel's ``g``, accurate to the last bit wherever it cancels.

    At the critical angle the plain sum loses every digit, so it is taken in twice the precision; ``cos_low`` is
    what the cosine had to leave off, where that is known. Gradient: exactly (2 cos_i, 2 eta, -2 k).
    """
    slopes = eta * eta + cos_i * cos_i  # a small eta would lose its own in a product (eta - 1)(eta + 1)
    c, n = cos_i.detach().abs().to(slopes.dtype), eta.detach().to(slopes.dtype)
    # Cosine and index play the same part: of the larger one, 1 is taken off. Where anything cancels it lies in [0.5, 2], and the
    # difference is exact.
    small, large = torch.minimum(c, n), torch.maximum(c, n)
    less = large - 1.0
    more, more_low = two_sum(large, torch.ones_like(large))
    pairs = [(less, more), (small, small), (less, more_low)]
    if k is not None:
        slopes = slopes - k * k
        pairs.insert(1, (k.to(slopes.dtype), -k.to(slopes.dtype)))
    if cos_low is not None:
        pairs.append((2.0 * cos_i.detach(), cos_low))
    return with_slope_of(sum_of_products(*pairs)[0], slopes)


def eta2_minus_sin2_widened(cos_i: Tensor, eta: Tensor, k: Tensor | None = None) -> Tensor:
    """The same by float64, rounded once, which is faster; of float64, or where a device has none, as above."""
    if cos_i.dtype == torch.float64 or cos_i.device.type == "mps":
        return eta2_minus_sin2(cos_i, eta, k)
    c, n = cos_i.detach().double(), eta.detach().double()  # squares of float32 numbers are exact
    slopes, index2 = eta * eta, n * n
    if k is not None:
        slopes, index2 = slopes - k * k, index2 - k.detach().double() ** 2
    less = index2 - 1.0
    tiny_index = index2 - (less + 1.0)  # what of it the difference had to leave off
    return with_slope_of(((less + c * c) + tiny_index).to(cos_i.dtype), slopes + cos_i * cos_i)
