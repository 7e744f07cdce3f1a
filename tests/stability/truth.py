"""The exact results of a case on its grid: values, slopes, second derivatives."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import gmpy2
import numpy as np
import torch

from . import dual
from .case import FEWER, Case
from .kept import kept, shortened

SECOND_POINTS = 600  # of the everyday range, at which all second derivatives are compared; of a smaller grid, a third of them


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


@kept
def truth_of(case: Case, dtype: torch.dtype) -> Truth:
    """Exact values and slopes on the grid of ``dtype``."""
    points = case.drawn(dtype)
    outs = case.truth(*dual.inputs(points))
    slopes = contracted(outs).parts if isinstance(contracted(outs), dual.Dual) else {}
    zero = np.full(len(points), gmpy2.mpfr(0), dtype=object)
    everyday = np.asarray(case.everyday(case.columns(points, dtype)), dtype=bool)
    values, sizes = [dual.plain(o) for o in outs], [sensitivity(case, points, o) for o in outs]
    by_input = [slopes.get(j, 0) for j in range(len(case.inputs))]
    return Truth(points, *([shortened(x + zero) for x in some] for some in (values, by_input, sizes)), everyday)


def sensitivity(case: Case, points: np.ndarray, out: Any) -> Any:
    """How much a relative change of 1 in every input changes a result: what rounding the inputs may cost is eps times this."""
    groups: dict[str, list[int]] = {}
    for j, name in enumerate(case.inputs):
        groups.setdefault(name.partition(".")[0], []).append(j)
    parts = out.parts if isinstance(out, dual.Dual) else {}
    total: Any = 0
    for members in groups.values():
        size, slope = (
            sum((x * x for x in xs), gmpy2.mpfr(0)) for xs in (points.T[members].astype(object), [parts[j] for j in members if j in parts])
        )
        total = total + dual.sqrt(size * slope)
    return total


@kept
def second_truth(case: Case, dtype: torch.dtype) -> tuple[np.ndarray, np.ndarray]:
    """Some everyday points (their numbers) and all second derivatives there ``[M, n, n]``."""
    truth = truth_of(case, dtype)
    chosen = np.flatnonzero(truth.everyday)
    chosen = chosen[:: max(1, len(chosen) // (SECOND_POINTS if case.points > FEWER else SECOND_POINTS // 3))]
    n = len(case.inputs)
    found = np.full((len(chosen), n, n), gmpy2.mpfr(0), dtype=object)
    for j in range(n):
        total = contracted(case.truth(*dual.inputs(truth.points[chosen], along=j)))
        for i, part in total.parts.items() if isinstance(total, dual.Dual) else ():
            if isinstance(part, dual.Dual) and 0 in part.parts:
                found[:, i, j] = part.parts[0]
    return chosen, shortened(found)


def second_representable(case: Case, dtype: torch.dtype, points: np.ndarray) -> np.ndarray:
    """Whether every true second derivative at these points is a number of the dtype."""
    good = np.ones(len(points), dtype=bool)
    dual.set_precision(dtype)
    for j in range(len(case.inputs)):
        total = contracted(case.truth(*dual.inputs(points, along=j)))
        for part in total.parts.values() if isinstance(total, dual.Dual) else ():
            if isinstance(part, dual.Dual) and 0 in part.parts:
                good &= representable(part.parts[0] + np.full(len(points), gmpy2.mpfr(0), dtype=object), torch.finfo(dtype).max)
    return good


_magnitude_at_most = np.frompyfunc(lambda t, most: bool(gmpy2.is_finite(t)) and abs(t) <= most, 2, 1)


def representable(t: np.ndarray, most: float) -> np.ndarray:
    """Whether the truth is a finite number no larger than ``most``."""
    return _magnitude_at_most(t, most).astype(bool)
