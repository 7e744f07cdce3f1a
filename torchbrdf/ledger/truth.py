"""The exact values and slopes of a law, by its textbook formula in hundreds of digits."""

from typing import Any, NamedTuple

import gmpy2
import numpy as np

from ..method import Law
from ..testing.textbook import Point
from . import exact
from .points import Points

BITS = 320  # everyday numbers are no denormals: their products and differences fit


class Truth(NamedTuple):
    """Arrays of arbitrary-precision numbers: values ``[N]``, slopes ``[N]`` or ``[N, 3]`` by input."""

    values: np.ndarray
    slopes: dict[str, np.ndarray]


def truth(law: Law, points: Points) -> Truth:
    """At every point."""
    with gmpy2.context(gmpy2.get_context(), precision=BITS):
        columns = np.concatenate([x.reshape(len(x), -1) for x in points.values()], 1)
        found = law.textbook(exact.Exact(), *_arguments(law, exact.inputs(columns)))
        zero = np.full(len(columns), gmpy2.mpfr(0), dtype=object)
        parts = found.parts if isinstance(found, exact.Dual) else {}
        slopes = np.stack([parts.get(j, 0) + zero for j in range(columns.shape[1])], 1)
        return Truth(exact.plain(found) + zero, _by_input(points, slopes))


def _arguments(law: Law, inputs: list[Any]) -> list[Any]:
    """Directions reach the textbook as one point."""
    k = 3 * len(law.vectors)
    return [*([Point(exact.Exact(), *(tuple(inputs[j : j + 3]) for j in range(0, k, 3)))] if k else []), *inputs[k:]]


def _by_input(points: Points, slopes: np.ndarray) -> dict[str, np.ndarray]:
    found, at = {}, 0
    for name, x in points.items():
        width = x.shape[1] if x.ndim > 1 else 1
        found[name] = slopes[:, at : at + width] if x.ndim > 1 else slopes[:, at]
        at += width
    return found
