"""How far results are from the truth, in the unit of the case."""

import gmpy2
import numpy as np
import torch

from . import dual
from .case import Case
from .truth import Truth, contracted

BITS = {torch.float64: 53, torch.float32: 24, torch.float16: 11, torch.bfloat16: 8}


def spacing(t: np.ndarray, dtype: torch.dtype, flushed_below: np.ndarray | int = 1) -> np.ndarray:
    """One ulp at ``t``; where ``t`` may be flushed to 0, ``flushed_below`` times four smallest normal numbers of the dtype computed in."""
    info, bits = torch.finfo(dtype), BITS[dtype]
    least = gmpy2.mpfr(info.smallest_normal * info.eps)
    ulp = np.frompyfunc(lambda x: max(gmpy2.mpfr(2) ** (gmpy2.frexp(x)[0] - bits), least) if x else least, 1, 1)(t)
    flush = flushed_below * gmpy2.mpfr(4 * torch.finfo(torch.float32 if bits < 24 else dtype).smallest_normal)
    return np.where(np.less_equal(np.abs(t), flush).astype(bool), np.maximum(ulp, flush), ulp)


def value_errors(case: Case, dtype: torch.dtype, truth: Truth, values: list[np.ndarray]) -> np.ndarray:
    """The error of each point in the unit of the case; the largest over its results."""
    # A lobe is flushed before its normalisation, which grows as fast as its logarithmic slope, multiplies it.
    lobe = case.error in ("exp", "backward")
    unit = [spacing(t, dtype, 1 + c / nonzero(np.abs(t)) if lobe else 1) for t, c in zip(truth.values, truth.sensitivity, strict=True)]
    if case.error == "scale":
        unit = [
            np.maximum(u, spacing(np.full(len(t), gmpy2.mpfr(case.scale), dtype=object), dtype))
            for u, t in zip(unit, truth.values, strict=True)
        ]
    if case.error == "length":
        length = dual.sqrt(sum(t * t for t in truth.values))
        unit = [spacing(length, dtype)] * len(unit)
    if case.error == "backward":
        unit = [
            np.maximum(u, torch.finfo(dtype).eps * (np.abs(t) + c)) for u, t, c in zip(unit, truth.values, truth.sensitivity, strict=True)
        ]
    if case.error == "exp":
        unit = [np.maximum(_exponential_unit(case, dtype, truth, t), u) for t, u in zip(truth.values, unit, strict=True)]
    with np.errstate(invalid="ignore"):  # what is not finite is counted elsewhere
        errors = [np.abs(v - t) / u for v, t, u in zip(values, truth.values, unit, strict=True)]
    return np.max([e.astype(np.float64) for e in errors], 0)


def _exponential_unit(case: Case, dtype: torch.dtype, truth: Truth, t: np.ndarray) -> np.ndarray:
    assert case.peak is not None
    below_peak = np.frompyfunc(lambda f, p: abs(gmpy2.log(f / p)) if f > 0 and p > 0 else gmpy2.mpfr(0), 2, 1)(
        t, case.peak(case.columns(truth.points, dtype))
    )
    return (4 + 2 * below_peak) * torch.finfo(dtype).eps * np.abs(t)


def relative(truth: Truth, values: list[np.ndarray], mask: np.ndarray) -> float:
    """The largest relative error of a result at some points, of several results relative to the largest."""
    size = np.max([np.abs(t) for t in truth.values], 0)[mask]
    errors = [np.abs(v[mask] - t[mask]) / nonzero(size) for v, t in zip(values, truth.values, strict=True)]
    return float(np.max(errors)) if mask.any() else 0.0


def slope_errors(case: Case, dtype: torch.dtype, truth: Truth, slopes: list[np.ndarray]) -> np.ndarray:
    """Of each point, relative to the slope, or to the value where that is larger; of vectors, to the length of the gradient."""
    if not slopes:
        return np.zeros(len(truth.points))
    size = np.abs(contracted(truth.values))
    if case.vectors:
        length = dual.sqrt(sum(t * t for t in truth.slopes))
        size = np.maximum(size, length)
    size = floored(size, dtype)
    with np.errstate(invalid="ignore"):
        errors = [np.abs(s - t) / np.maximum(np.abs(t), size) for s, t in zip(slopes, truth.slopes, strict=True)]
    return np.max([e.astype(np.float64) for e in errors], 0)


def floored(size: np.ndarray, dtype: torch.dtype) -> np.ndarray:
    """What an error is relative to: no less than the smallest normal number, below which results are flushed or lose bits."""
    return np.maximum(size, gmpy2.mpfr(torch.finfo(dtype).smallest_normal))


def nonzero(x: np.ndarray) -> np.ndarray:
    return np.where(x == 0, gmpy2.mpfr(1), x)
