"""The exact results of a case on its grid: values, slopes, second derivatives."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import gmpy2
import numpy as np
import torch

from . import dual
from .case import FEWER, Case
from .kept import kept, shortened

SECOND_POINTS = 600  # of the everyday range, at which all second derivatives are compared; of a smaller grid, a sixth of them

TAME = 64  # a power of two


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
    everyday = np.asarray(case.everyday(case.columns(points, dtype)), dtype=bool)
    found = by_bits(lambda some: values_and_slopes(case, some), points, dtype).T
    outs = (len(found) - len(case.inputs)) // 2
    values, sizes, slopes = (list(some) for some in np.split(found, [outs, 2 * outs]))
    return Truth(points, values, slopes, sizes, everyday)


def values_and_slopes(case: Case, points: np.ndarray) -> np.ndarray:
    """In a row each: the values, how sensitive they are, and the slopes by input of their weighted sum."""
    outs = case.truth(*dual.inputs(points))
    total = contracted(outs)
    slopes = total.parts if isinstance(total, dual.Dual) else {}
    row = [
        *(dual.plain(o) for o in outs),
        *(sensitivity(case, points, o) for o in outs),
        *(slopes.get(j, 0) for j in range(len(case.inputs))),
    ]
    return np.stack([x + np.full(len(points), gmpy2.mpfr(0), dtype=object) for x in row], 1)


def by_bits(compute: Callable[[np.ndarray], np.ndarray], points: np.ndarray, dtype: torch.dtype) -> np.ndarray:
    """``compute`` of some points, row by row: of float64 in half the bits where no input is huge or tiny.

    Numbers of 53 bits within 2^+-TAME, squared twice, need 4 (53 + TAME) bits beside the :data:`~stability.kept.DIGITS` that are kept;
    and what is left of two terms that cancel must lie as far below the smallest normal number, 2^-1022.
    """
    sizes = np.abs(points)
    tame = ((sizes == 0) | ((sizes > 2.0**-TAME) & (sizes < 2.0**TAME))).all(1) & (dtype == torch.float64)
    found: dict[bool, np.ndarray] = {}
    for which, bits in ((True, dual.BITS[dtype] // 2), (False, dual.BITS[dtype])):
        if (tame == which).any():
            gmpy2.get_context().precision = bits
            found[which] = shortened(compute(points[tame == which]))
    dual.set_precision(dtype)
    result = np.empty((len(points), *next(iter(found.values())).shape[1:]), dtype=object)
    for which, rows in found.items():
        result[tame == which] = rows
    return result


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
    chosen = chosen[:: max(1, len(chosen) // (SECOND_POINTS if case.points > FEWER else SECOND_POINTS // 6))]
    return chosen, by_bits(lambda some: hessian(case, some), truth.points[chosen], dtype)


def hessian(case: Case, points: np.ndarray) -> np.ndarray:
    """Of the weighted sum of the results ``[M, n, n]``."""
    n = len(case.inputs)
    found = np.full((len(points), n, n), gmpy2.mpfr(0), dtype=object)
    for j in range(n):
        total = contracted(case.truth(*dual.inputs(points, along=j)))
        for i, part in total.parts.items() if isinstance(total, dual.Dual) else ():
            if isinstance(part, dual.Dual) and 0 in part.parts:
                found[:, i, j] = found[:, j, i] = part.parts[0]
    return found


def second_representable(case: Case, dtype: torch.dtype, points: np.ndarray) -> np.ndarray:
    """Whether every true second derivative at these points is a number of the dtype."""
    dual.set_precision(dtype)
    return representable(hessian(case, points), torch.finfo(dtype).max).all((1, 2))


_magnitude_at_most = np.frompyfunc(lambda t, most: bool(gmpy2.is_finite(t)) and abs(t) <= most, 2, 1)


def representable(t: np.ndarray, most: float) -> np.ndarray:
    """Whether the truth is a finite number no larger than ``most``."""
    return _magnitude_at_most(t, most).astype(bool)
