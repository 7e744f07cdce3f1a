"""Measure a formula on its grid: value, slope and second derivative in one dtype against the truth."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor

from . import dual
from .case import Case
from .claims import claims_of
from .errors import BITS, floored, relative, slope_errors, value_errors
from .truth import Truth, contracted, second_representable, second_truth, truth_of

BAD = 1e-4  # a mixed error, relative or to the value, beyond this is called bad
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
    slopes = (
        torch.autograd.grad(total, columns, create_graph=second, allow_unused=True, materialize_grads=True) if total.requires_grad else ()
    )
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
        row = (
            torch.autograd.grad(slope.sum(), columns, retain_graph=True, allow_unused=True, materialize_grads=True)
            if slope.requires_grad
            else ()
        )
        rows.append(np.stack([as_array(r) for r in row], 1) if row else np.zeros((len(columns[0]), len(columns))))
    return np.stack(rows, 1)


def as_array(x: Tensor) -> np.ndarray:
    """To float64, exactly."""
    return x.detach().double().cpu().numpy()


def compare(case: Case, dtype: torch.dtype, values: list[np.ndarray], slopes: list[np.ndarray], seconds: np.ndarray | None) -> Figures:
    """Figures of results that somebody computed in ``dtype`` on the case's grid."""
    truth, claims = truth_of(case, dtype), claims_of(case, dtype)
    errors = value_errors(case, dtype, truth, values)[claims.values]
    slope_error = slope_errors(case, dtype, truth, slopes)
    mixed = slope_error[claims.slopes]
    today = truth.everyday & claims.slopes
    slopes_finite = np.isfinite(np.stack(slopes, 1)).all(1) if slopes else claims.finite_slopes
    seconds_bad, second_error = _compare_second(case, dtype, truth, seconds, claims.seconds)
    return Figures(
        points=len(truth.points),
        excluded=claims.excluded,
        values_not_finite=int((~np.isfinite(np.stack(values, 1)).all(1) & claims.finite_values).sum()),
        slopes_not_finite=int((~slopes_finite & claims.finite_slopes).sum()),
        seconds_not_finite=seconds_bad,
        negative=0 if case.signed else int(sum((v < 0).sum() for v in values)),
        above_one=int(sum((v > 1).sum() for v in values)) if case.at_most_one else 0,
        p999=float(np.quantile(errors, 0.999, method="higher")) if len(errors) else 0.0,
        worst=float(errors.max()) if len(errors) else 0.0,
        value_everyday=relative(truth, values, claims.values & truth.everyday),
        slope_everyday=float(np.max(slope_error[today])) if today.any() else None,
        slopes_bad=float((~(mixed <= max(BAD, 4 * torch.finfo(dtype).eps))).mean()) if len(mixed) else 0.0,
        second_everyday=second_error,
    )


def _compare_second(
    case: Case, dtype: torch.dtype, truth: Truth, seconds: np.ndarray | None, claimed: np.ndarray
) -> tuple[int, float | None]:
    if seconds is None:
        return 0, None
    bad = np.flatnonzero(~np.isfinite(seconds).all((1, 2)) & claimed)
    bad = bad[second_representable(case, dtype, truth.points[bad])] if len(bad) else bad
    chosen, exact = second_truth(case, dtype) if BITS[dtype] >= 24 else ((), None)
    if not len(chosen):
        return len(bad), None
    size = np.maximum(np.abs(exact), np.abs(contracted(truth.values))[chosen][:, None, None])
    if case.vectors:
        size = np.maximum(size, dual.sqrt((exact * exact).sum((1, 2)))[:, None, None])
    errors = (np.abs(seconds[chosen] - exact) / floored(size, dtype)).astype(np.float64)
    return len(bad), float(errors[claimed[chosen]].max())
