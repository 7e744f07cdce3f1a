"""At which points of a grid something is claimed, and why not at the others."""

from typing import NamedTuple

import numpy as np
import torch

from .case import Case
from .truth import representable, truth_of


class Claims(NamedTuple):
    """Masks of points: where accurate values, slopes, second derivatives are claimed, each a part of the one before; ``excluded``
    counts those left out, by reason. Finite results are claimed at more points: wherever the truth is a number of the dtype.
    """

    values: np.ndarray
    slopes: np.ndarray
    seconds: np.ndarray
    finite_values: np.ndarray
    finite_slopes: np.ndarray
    excluded: dict[str, int]


def claims_of(case: Case, dtype: torch.dtype) -> Claims:
    """The case's own exceptions, and truths that are no number of the dtype."""
    truth, most = truth_of(case, dtype), torch.finfo(dtype).max
    x = case.columns(truth.points, dtype)
    reasons = {reason: mask(x) for reason, mask in case.outside.items()}
    finite = np.logical_and.reduce([representable(v, most) for v in truth.values])
    finite_slopes = np.logical_and.reduce([representable(s, most) for s in truth.slopes]) & finite
    reasons["value overflows"] = ~finite
    values = ~_any(reasons, truth.everyday)
    once = {f"slope: {reason}": mask(x) & values for reason, mask in case.kinks.items()}
    once["slope overflows"] = ~finite_slopes & values
    slopes = values & ~_any(once, truth.everyday)
    twice = {f"second: {reason}": mask(x) & slopes for reason, mask in case.outside_twice.items()}
    counts = {reason: int(np.sum(mask)) for reason, mask in (reasons | once | twice).items()}
    excluded = {reason: n for reason, n in counts.items() if n}
    return Claims(values, slopes, slopes & ~_any(twice, truth.everyday), finite, finite_slopes, excluded)


def _any(masks: dict[str, np.ndarray], like: np.ndarray) -> np.ndarray:
    return np.logical_or.reduce([np.zeros(len(like), dtype=bool), *(np.asarray(m, dtype=bool) for m in masks.values())])
