"""Safe operations: each states its value *and* its gradient at its edges.

Two rules hold throughout. A ``where`` also masks its *input*, because a NaN in the branch that is not taken poisons the
gradient. Nothing is nudged by an epsilon: the only small literals are derived from ``torch.finfo`` below, with a reason.
And one of speed: eager ``where`` on a mask that changes from pixel to pixel costs as much as thirty products (mispredicted
branches), so what is finite on both sides is multiplied by its mask instead.
"""

import math

import torch
from torch import Tensor
from torch.nn import functional

HALF_TYPES = (torch.float16, torch.bfloat16)


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


def positive(x: Tensor) -> Tensor:
    """``max(x, 0)``. Gradient: 1 for x >= 0 (at 0 that of the lit side), 0 below."""
    info = torch.finfo(x.dtype)
    return functional.threshold(x, -info.smallest_normal * info.eps, 0.0)  # "greater than the number below 0"


def finite_or_zero(x: Tensor) -> Tensor:
    """``x``, and 0 with gradient 0 where it is not finite. (Each form is the fast one: nan_to_num eagerly, where compiled.)"""
    return torch.where(x.abs() < math.inf, x, 0.0) if torch.compiler.is_compiling() else torch.nan_to_num(x, 0.0, 0.0, 0.0)


def step(x: Tensor) -> Tensor:
    """1 for x > 0, else 0, in the dtype of x. No gradient."""
    return torch.sign(torch.relu(x.detach()))


def unit_interval(x: Tensor) -> Tensor:
    """x held to [0, 1] against rounding. The gradient passes at exactly 0 and 1 (``clamp`` would kill it) and is 0 beyond."""
    return torch.where(x < 0, 0.0, torch.where(x > 1, 1.0, x))


def at_most_one(x: Tensor) -> Tensor:
    """``min(x, 1)`` for a value that exceeds 1 only by rounding: the excess is taken off, the gradient always passes."""
    return x - torch.relu(x.detach() - 1.0)


def negligible(dtype: torch.dtype) -> float:
    """sqrt of :func:`tiny`: a reciprocal down to here has a derivative, ``-1/x^2``, that does not overflow."""
    return math.sqrt(tiny(dtype))


def safe_sqrt(x: Tensor, least: float = 0.0) -> Tensor:
    """``sqrt(x)`` for x > ``least``, else 0. Gradient: the true one there (not capped); else 0, at 0 in place of infinity."""
    return torch.sqrt(functional.threshold(x, least, 1.0)) * step(x - least)


def reciprocal_or_zero(x: Tensor, least: float = 0.0) -> Tensor:
    """``1/x`` for x > ``least`` >= 0; 0 with gradient 0 elsewhere."""
    return step(x - least) / functional.threshold(x, least, 1.0)


def log1p_power(m: Tensor, exponent: Tensor) -> Tensor:
    """``(1 - m) ** exponent`` for a complement ``m = 1 - cosine``, accurate near m = 0 where the cosine itself has no digits left.

    Value 0 for m > 1 (the far hemisphere); at m = 1 the cosine counts as eps/2, half the spacing of m there, and 0 ** 0 as 1.
    Results below the smallest normal number are flushed to 0. Gradient: 0 wherever the value is 0 or flushed, and at m = 1.
    Range: exponent >= 0, m >= 0; relative error about (2 + \\|ln value\\|) * eps.
    """
    last_below_one = 1.0 - 0.5 * torch.finfo(m.dtype).eps  # there the logarithm is still finite
    log_value = exponent * torch.log1p(-m.clamp_max(last_below_one))
    return flushed_exp(log_value) * (1.0 - step(m - 1.0))


def flushed_exp(log_value: Tensor) -> Tensor:
    """``exp`` of a finite number where the result is a normal number; 0 with gradient 0 below."""
    lowest = math.log(2.0 * tiny(log_value.dtype))  # twice, because exp() of the bound itself rounds to a denormal
    return torch.exp(functional.threshold(log_value, lowest, -math.inf))


def cosine_power(cos: Tensor, sin2: Tensor, exponent: Tensor) -> Tensor:
    """``cos ** exponent`` for ``cos`` in [0, 1] of which ``sin2 = 1 - cos^2`` is known without cancellation.

    Near the pole by the sine, near the horizon by the cosine. Value, gradient and range as :func:`log1p_power`.
    """
    near_pole = (cos > 0.5).to(cos.dtype)
    log_near = 0.5 * torch.log1p(-sin2.clamp_max(0.875))  # sin^2 = 0.75 where the two meet
    log_far = torch.log(cos.clamp_min(tiny(cos.dtype)))
    log_value = exponent * torch.lerp(log_far, log_near, near_pole)  # exact at weights 0 and 1
    return torch.where((cos == 0) & (exponent > 0), 0.0, flushed_exp(log_value))


def _square_error(x: Tensor, square: Tensor) -> Tensor:
    """The rounding error of ``square = fl(x * x)``, exactly (Dekker 1971, by Veltkamp's splitting)."""
    bits = 12 if x.dtype == torch.float32 else 27  # half of the significand, rounded up
    carry = x * (2.0**bits + 1.0)
    high = carry - (carry - x)
    low = x - high
    return ((high * high - square) + 2.0 * high * low) + low * low


def eta2_minus_sin2(cos_i: Tensor, eta: Tensor) -> Tensor:
    """``eta^2 - (1 - cos_i^2)``, the square of Fresnel's ``g``, accurate to the last bits at the critical angle.

    There the sum cancels and loses every digit, so the rounding errors of both squares and of both sums are added back
    (compensated product and sum; Knuth 1969, Dekker 1971). Gradient: exactly (2 cos_i, 2 eta).
    """
    plain = (eta - 1.0) * (eta + 1.0) + cos_i * cos_i
    c, n = cos_i.detach().to(plain.dtype), eta.detach().to(plain.dtype)
    n2, c2 = n * n, c * c
    first = n2 - 1.0
    rounding_first = (n2 - (first + 1.0)) + ((first + 1.0) - first - 1.0)
    total = first + c2
    part = total - first
    rounding_total = (first - (total - part)) + (c2 - part)
    exact = total + (rounding_first + rounding_total + _square_error(n, n2) + _square_error(c, c2))
    # A huge eta would overflow the splitting; there nothing cancels and the plain form is already accurate.
    exact = torch.where(torch.isfinite(exact), exact, plain.detach())
    return plain + (exact - plain).detach()
