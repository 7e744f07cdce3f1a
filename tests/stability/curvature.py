"""Second derivatives along one direction, by forward over reverse, which a compiled graph can hold; eager for comparison.

(A compiled graph cannot be differentiated twice from outside, so the derivatives are taken inside of it.)
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from . import dual
from .case import Case
from .claims import claims_of
from .errors import floored
from .measure import as_array, columns_of, total_of
from .truth import contracted, second_representable, second_truth, truth_of


class Curvature(NamedTuple):
    """Of the derivatives of all slopes along (1, ..., 1): how many are not finite, and the largest error on everyday ranges."""

    not_finite: int
    worst: float | None


def along(case: Case, columns: list[Tensor]) -> list[Tensor]:
    """The Hessian of every point times (1, ..., 1)."""

    def total(*x: Tensor) -> Tensor:
        return total_of(case.call(*x), list(x))

    primals = tuple(c.detach() for c in columns)
    slopes = torch.func.grad(total, argnums=tuple(range(len(primals))))
    return list(torch.func.jvp(slopes, primals, tuple(torch.ones_like(c) for c in primals))[1])


def run(cases: Sequence[Case], dtype: torch.dtype, device: str = "cpu", compiled: bool = False) -> list[Curvature]:
    """Of several formulas; compiled, they share one graph."""
    columns = [columns_of(case, dtype, device) for case in cases]

    def everything(columns: list[list[Tensor]]) -> list[list[Tensor]]:
        return [along(case, c) for case, c in zip(cases, columns, strict=True)]

    torch.compiler.reset()
    call = torch.compile(everything, fullgraph=True, dynamic=False) if compiled else everything
    return [compare(case, dtype, np.stack([as_array(x) for x in found], 1)) for case, found in zip(cases, call(columns), strict=True)]


def compare(case: Case, dtype: torch.dtype, found: np.ndarray) -> Curvature:
    """Against the sum of each row of the exact Hessian, relative to the sum of its magnitudes or to the value."""
    truth = truth_of(case, dtype)
    claimed = claims_of(case, dtype).seconds
    bad = np.flatnonzero(~np.isfinite(found).all(1) & claimed)
    not_finite = int(second_representable(case, dtype, truth.points[bad]).sum()) if len(bad) else 0
    chosen, exact = second_truth(case, dtype)
    if not len(chosen):
        return Curvature(not_finite, None)
    size = np.maximum(np.abs(exact).sum(2), np.abs(contracted(truth.values))[chosen][:, None])
    if case.vectors:
        size = np.maximum(size, dual.sqrt((exact * exact).sum((1, 2)))[:, None])
    errors = (np.abs(found[chosen] - exact.sum(2)) / floored(size, dtype)).astype(np.float64)
    return Curvature(not_finite, float(errors[claimed[chosen]].max()))
