"""Measure a formula on its grid: value, slope and second derivative in one dtype against the truth."""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import gmpy2
import numpy as np
import torch
from torch import Tensor

from . import dual
from .case import Case, Draw, everywhere

BITS = {torch.float64: 53, torch.float32: 24, torch.float16: 11, torch.bfloat16: 8}
SECOND_POINTS = 600  # of the everyday range, at which all second derivatives are compared
BAD = 1e-4  # a mixed error, relative or to 1, beyond this is called bad
Formula = Callable[..., Sequence[Tensor]]


@dataclasses.dataclass(frozen=True)
class Figures:
    """What was found. Errors are None where nothing was compared."""

    points: int
    excluded: dict[str, int]
    values_not_finite: int
    slopes_not_finite: int
    seconds_not_finite: int
    negative: int
    above_one: int
    p999: float
    worst: float
    value_everyday: float
    slope_everyday: float | None
    slopes_bad: float
    second_everyday: float | None


@dataclasses.dataclass(frozen=True)
class Truth:
    """Exact results of a case on its grid: values and slopes by output, slopes by input of their weighted sum."""

    points: np.ndarray  # [N, n]
    values: list[np.ndarray]
    slopes: list[np.ndarray]
    sensitivity: list[np.ndarray]  # by output: sum of |input| |slope|, a vector counting as one input
    everyday: np.ndarray


def weights(count: int) -> list[float]:
    """Several results are contracted to one with these, so that each input has one slope."""
    return [1.0, 0.75, -0.5, 0.375, -0.625, 0.875, -0.25, 0.5625, 0.4375][:count]


def contracted(outs: Sequence[Any]) -> Any:
    """The weighted sum of the results."""
    total = outs[0] * 1.0
    for out, w in zip(outs[1:], weights(len(outs))[1:], strict=True):
        total = total + out * w
    return total


@functools.lru_cache(maxsize=None)
def truth_of(case: Case, dtype: torch.dtype) -> Truth:
    """Exact values and slopes on the grid of ``dtype``."""
    dual.set_precision(dtype)
    points = case.grid(Draw(dtype))
    outs = case.truth(*dual.inputs(points))
    slopes = contracted(outs).parts if isinstance(contracted(outs), dual.Dual) else {}
    zero = np.full(len(points), gmpy2.mpfr(0), dtype=object)
    everyday = np.asarray(case.everyday(case.columns(points, dtype)), dtype=bool)
    by_input = [slopes.get(j, 0) + zero for j in range(len(case.inputs))]
    return Truth(points, [dual.plain(o) + zero for o in outs], by_input, [sensitivity(case, points, o) + zero for o in outs], everyday)


def sensitivity(case: Case, points: np.ndarray, out: Any) -> Any:
    """How much a relative change of 1 in every input changes a result: what rounding the inputs may cost is eps times this."""
    groups: dict[str, list[int]] = {}
    for j, name in enumerate(case.inputs):
        groups.setdefault(name.partition(".")[0], []).append(j)
    parts = out.parts if isinstance(out, dual.Dual) else {}
    total: Any = 0
    for members in groups.values():
        size, slope = (sum((x * x for x in xs), gmpy2.mpfr(0)) for xs in (points.T[members].astype(object), [parts[j] for j in members if j in parts]))
        total = total + dual.sqrt(size * slope)
    return total


@functools.lru_cache(maxsize=None)
def second_truth(case: Case, dtype: torch.dtype) -> tuple[np.ndarray, np.ndarray]:
    """Some everyday points (their numbers) and all second derivatives there ``[M, n, n]``."""
    dual.set_precision(dtype)
    truth = truth_of(case, dtype)
    chosen = np.flatnonzero(truth.everyday)
    chosen = chosen[:: max(1, len(chosen) // SECOND_POINTS)]
    n = len(case.inputs)
    found = np.full((len(chosen), n, n), gmpy2.mpfr(0), dtype=object)
    for j in range(n):
        total = contracted(case.truth(*dual.inputs(truth.points[chosen], along=j)))
        for i, part in total.parts.items() if isinstance(total, dual.Dual) else ():
            if isinstance(part, dual.Dual) and 0 in part.parts:
                found[:, i, j] = part.parts[0]
    return chosen, found


def columns_of(case: Case, dtype: torch.dtype, device: str) -> list[Tensor]:
    """The grid as leaves ``[N]``, one an input."""
    return [torch.from_numpy(c.copy()).to(device=device, dtype=dtype).requires_grad_() for c in truth_of(case, dtype).points.T]


def total_of(outs: Sequence[Tensor], columns: list[Tensor]) -> Tensor:
    """One number whose slopes by each point's inputs are those of its weighted results."""
    return contracted([o.expand_as(columns[0]).to(torch.promote_types(o.dtype, torch.float32)) for o in outs]).sum()


def run(case: Case, dtype: torch.dtype, formula: Formula | None = None, device: str = "cpu", second: bool = True) -> Figures:
    """All figures of a formula (the library's own, unless another is given) in ``dtype``, eagerly."""
    columns = columns_of(case, dtype, device)
    outs = [o.expand_as(columns[0]) for o in (formula or case.call)(*columns)]
    total = total_of(outs, columns)
    slopes = torch.autograd.grad(total, columns, create_graph=second, allow_unused=True, materialize_grads=True) if total.requires_grad else ()
    seconds = _second(slopes, columns) if second else None
    return compare(case, dtype, [as_array(o) for o in outs], [as_array(s) for s in slopes], seconds)


def run_compiled(cases: Sequence[Case], dtype: torch.dtype, device: str = "cpu") -> list[Figures]:
    """Figures of several formulas compiled together, with values and first derivatives (a compiled graph has no second ones)."""
    columns = [columns_of(case, dtype, device) for case in cases]

    def everything(columns: list[list[Tensor]]) -> list[list[Tensor]]:
        return [list(case.call(*c)) for case, c in zip(cases, columns, strict=True)]

    torch.compiler.reset()
    results = torch.compile(everything, fullgraph=True, dynamic=False)(columns)
    total = sum(total_of(outs, c) for outs, c in zip(results, columns, strict=True))
    leaves = [x for c in columns for x in c]
    slopes = iter(torch.autograd.grad(total, leaves, allow_unused=True, materialize_grads=True))
    found = []
    for case, c, outs in zip(cases, columns, results, strict=True):
        found.append(compare(case, dtype, [as_array(o.expand_as(c[0])) for o in outs], [as_array(next(slopes)) for _ in c], None))
    return found


def _second(slopes: Sequence[Tensor], columns: list[Tensor]) -> np.ndarray:
    rows = []
    for slope in slopes:
        row = torch.autograd.grad(slope.sum(), columns, retain_graph=True, allow_unused=True, materialize_grads=True) if slope.requires_grad else ()
        rows.append(np.stack([as_array(r) for r in row], 1) if row else np.zeros((len(columns[0]), len(columns))))
    return np.stack(rows, 1)


def as_array(x: Tensor) -> np.ndarray:
    """To float64, exactly."""
    return x.detach().double().cpu().numpy()


def compare(case: Case, dtype: torch.dtype, values: list[np.ndarray], slopes: list[np.ndarray], seconds: np.ndarray | None) -> Figures:
    """Figures of results that somebody computed in ``dtype`` on the case's grid."""
    truth = truth_of(case, dtype)
    x = case.columns(truth.points, dtype)
    claimed, slope_claimed, excluded = _claims(case, dtype, truth, x)
    errors = value_errors(case, dtype, truth, values)[claimed]
    slope_error = slope_errors(case, dtype, truth, slopes)
    mixed = slope_error[slope_claimed]
    today = truth.everyday & slope_claimed
    not_finite = ~np.isfinite(np.stack(slopes, 1)).all(1) if slopes else ~everywhere(x)
    twice = {f"second: {reason}": np.asarray(mask(x), dtype=bool) & slope_claimed for reason, mask in case.outside_twice.items()}
    excluded |= {reason: int(mask.sum()) for reason, mask in twice.items() if mask.any()}
    second_claimed = slope_claimed & ~np.logical_or.reduce([*twice.values(), ~everywhere(x)])
    seconds_bad, second_error = _compare_second(case, dtype, truth, seconds, second_claimed)
    return Figures(
        points=len(truth.points),
        excluded=excluded,
        values_not_finite=int((~np.isfinite(np.stack(values, 1)).all(1) & claimed).sum()),
        slopes_not_finite=int((not_finite & slope_claimed).sum()),
        seconds_not_finite=seconds_bad,
        negative=0 if case.signed else int(sum((v < 0).sum() for v in values)),
        above_one=int(sum((v > 1).sum() for v in values)) if case.at_most_one else 0,
        p999=float(np.quantile(errors, 0.999, method="higher")) if len(errors) else 0.0,
        worst=float(errors.max()) if len(errors) else 0.0,
        value_everyday=relative(truth, values, claimed & truth.everyday),
        slope_everyday=float(np.max(slope_error[today])) if today.any() else None,
        slopes_bad=float((~(mixed <= max(BAD, 4 * torch.finfo(dtype).eps))).mean()) if len(mixed) else 0.0,
        second_everyday=second_error,
    )


def _claims(case: Case, dtype: torch.dtype, truth: Truth, x: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, dict[str, int]]:
    """Where values, and where slopes, are claimed; and how many points are excluded, by reason."""
    most = torch.finfo(dtype).max
    excluded = {f"{reason}": np.asarray(mask(x), dtype=bool) for reason, mask in case.outside.items()}
    excluded["value overflows"] = ~np.logical_and.reduce([representable(v, most) for v in truth.values])
    claimed = ~np.logical_or.reduce(list(excluded.values()))
    slope = {f"slope: {reason}": np.asarray(mask(x), dtype=bool) for reason, mask in case.kinks.items()}
    slope["slope overflows"] = ~np.logical_and.reduce([representable(s, most) for s in truth.slopes]) & claimed
    slope_claimed = claimed & ~np.logical_or.reduce(list(slope.values()))
    return claimed, slope_claimed, {reason: int(mask.sum()) for reason, mask in (excluded | slope).items() if mask.any()}


_magnitude_at_most = np.frompyfunc(lambda t, most: bool(gmpy2.is_finite(t)) and abs(t) <= most, 2, 1)


def representable(t: np.ndarray, most: float) -> np.ndarray:
    """Whether the truth is a finite number no larger than ``most``."""
    return _magnitude_at_most(t, most).astype(bool)


def spacing(t: np.ndarray, dtype: torch.dtype, flushed_below: Any = 1) -> np.ndarray:
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
    unit = [spacing(t, dtype, 1 + c / _nonzero(np.abs(t)) if lobe else 1) for t, c in zip(truth.values, truth.sensitivity, strict=True)]
    if case.error == "scale":
        unit = [np.maximum(u, spacing(np.full(len(t), gmpy2.mpfr(case.scale), dtype=object), dtype)) for u, t in zip(unit, truth.values, strict=True)]
    if case.error == "length":
        length = dual.sqrt(sum(t * t for t in truth.values))
        unit = [spacing(length, dtype)] * len(unit)
    if case.error == "backward":
        unit = [np.maximum(u, torch.finfo(dtype).eps * (np.abs(t) + c)) for u, t, c in zip(unit, truth.values, truth.sensitivity, strict=True)]
    if case.error == "exp":
        unit = [np.maximum(_exponential_unit(case, dtype, truth, t), u) for t, u in zip(truth.values, unit, strict=True)]
    errors = [np.abs(v - t) / u for v, t, u in zip(values, truth.values, unit, strict=True)]
    return np.max([e.astype(np.float64) for e in errors], 0)


def relative(truth: Truth, values: list[np.ndarray], mask: np.ndarray) -> float:
    """The largest relative error of a result at some points, of several results relative to the largest."""
    size = np.max([np.abs(t) for t in truth.values], 0)[mask]
    errors = [np.abs(v[mask] - t[mask]) / _nonzero(size) for v, t in zip(values, truth.values, strict=True)]
    return float(np.max(errors)) if mask.any() else 0.0


def _exponential_unit(case: Case, dtype: torch.dtype, truth: Truth, t: np.ndarray) -> np.ndarray:
    assert case.peak is not None
    below_peak = np.frompyfunc(lambda f, p: abs(gmpy2.log(f / p)) if f > 0 and p > 0 else gmpy2.mpfr(0), 2, 1)(t, case.peak(case.columns(truth.points, dtype)))
    return (4 + 2 * below_peak) * torch.finfo(dtype).eps * np.abs(t)


def slope_errors(case: Case, dtype: torch.dtype, truth: Truth, slopes: list[np.ndarray]) -> np.ndarray:
    """Of each point, relative to the slope, or to the value where that is larger; of vectors, to the length of the gradient."""
    if not slopes:
        return np.zeros(len(truth.points))
    size = np.abs(contracted(truth.values))
    if case.vectors:
        length = dual.sqrt(sum(t * t for t in truth.slopes))
        size = np.maximum(size, length)
    size = np.maximum(size, gmpy2.mpfr(torch.finfo(dtype).smallest_normal))  # flushed to 0, or rounded to few bits, below
    errors = [np.abs(s - t) / np.maximum(np.abs(t), size) for s, t in zip(slopes, truth.slopes, strict=True)]
    return np.max([e.astype(np.float64) for e in errors], 0)


def _nonzero(x: np.ndarray) -> np.ndarray:
    return np.where(x == 0, gmpy2.mpfr(1), x)


def _compare_second(
    case: Case, dtype: torch.dtype, truth: Truth, seconds: np.ndarray | None, claimed: np.ndarray
) -> tuple[int, float | None]:
    if seconds is None:
        return 0, None
    bad = np.flatnonzero(~np.isfinite(seconds).all((1, 2)) & claimed)
    bad = bad[_second_representable(case, dtype, truth.points[bad])] if len(bad) else bad
    chosen, exact = second_truth(case, dtype)
    if not len(chosen) or BITS[dtype] < 24:
        return len(bad), None
    size = np.maximum(np.abs(exact), np.abs(contracted(truth.values))[chosen][:, None, None])
    if case.vectors:
        size = np.maximum(size, dual.sqrt((exact * exact).sum((1, 2)))[:, None, None])
    errors = (np.abs(seconds[chosen] - exact) / _nonzero(size)).astype(np.float64)
    return len(bad), float(errors[claimed[chosen]].max())


def _second_representable(case: Case, dtype: torch.dtype, points: np.ndarray) -> np.ndarray:
    """Whether every true second derivative at these points is a number of the dtype."""
    good = np.ones(len(points), dtype=bool)
    dual.set_precision(dtype)
    for j in range(len(case.inputs)):
        total = contracted(case.truth(*dual.inputs(points, along=j)))
        for part in total.parts.values() if isinstance(total, dual.Dual) else ():
            if isinstance(part, dual.Dual) and 0 in part.parts:
                good &= representable(part.parts[0] + np.full(len(points), gmpy2.mpfr(0), dtype=object), torch.finfo(dtype).max)
    return good
