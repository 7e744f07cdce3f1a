"""How far the values and slopes of a method are from the exact ones."""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import gmpy2
import numpy as np
import torch
from torch import Tensor

from ..method import Law, Method
from . import points as where
from .points import Points
from .truth import BITS, Truth, truth

OFF = 1e-4  # a relative error beyond this is counted
SLOPES = {False: 1e-4, True: 1e-3}  # of exact methods, float32, at p99.9: by numbers alone, and from directions, as tests/stability bounds


class Results(NamedTuple):
    """Of a method at some points: values ``[N]``, and slopes by input."""

    values: np.ndarray
    slopes: dict[str, np.ndarray]


@dataclasses.dataclass(frozen=True)
class Spread:
    """Of the errors of many points: what 99.9 % do not exceed, the largest, the mean, the share beyond 1e-4."""

    p999: float
    worst: float
    mean: float
    off: float

    @staticmethod
    def of(errors: np.ndarray) -> "Spread":
        """Of one error a point."""
        p999 = float(np.quantile(errors, 0.999, method="higher"))
        return Spread(p999, float(errors.max()), float(errors.mean()), float((errors > OFF).mean()))


@dataclasses.dataclass(frozen=True)
class Errors:
    """Relative errors of values and slopes; those of values as they are; on the pixels of Spot, by angle, the sum of errors of values
    over the sum of values; and at hard points, where there are such.
    """

    value: Spread
    slope: Spread
    absolute: Spread
    spot: dict[str, float] = dataclasses.field(default_factory=dict)
    hard_value: Spread | None = None
    hard_slope: Spread | None = None


class Measured:
    """A law in one dtype, its points and their truths: made once, and each method compared with it."""

    def __init__(self, law: Law, dtype: torch.dtype, count: int) -> None:
        self.law, self.dtype = law, dtype
        self.everyday, self.pixels, self.hard = where.everyday(law, dtype, count), where.pixels(law, dtype), where.hard(law, dtype, count)
        self.truth = truth(law, self.everyday)
        self.pixel_truths = {angle: truth(law, x) for angle, x in self.pixels.items()}
        self.hard_truth = None if self.hard is None else truth(law, self.hard)

    def errors(self, formula: Callable[..., Tensor], count: int | None = None) -> Errors:
        """Of a method, everywhere; ``count`` is how many points it is given at once, as :func:`run`."""
        found = run(formula, self.everyday, self.dtype, count)
        at_pixels = {angle: run(formula, x, self.dtype, count).values for angle, x in self.pixels.items()}
        everywhere = Errors(
            Spread.of(relative(found, self.truth)),
            Spread.of(of_slopes(found, self.truth)),
            Spread.of(_distance(found.values, self.truth.values)),
            {angle: _share(values, self.pixel_truths[angle].values) for angle, values in at_pixels.items()},
        )
        if self.hard is None or self.hard_truth is None:
            return everywhere
        at_edge = run(formula, self.hard, self.dtype, count)
        value, slope = (Spread.of(by(at_edge, self.hard_truth)) for by in (relative, of_slopes))
        return dataclasses.replace(everywhere, hard_value=value, hard_slope=slope)


def run(formula: Callable[..., Tensor], points: Points, dtype: torch.dtype, count: int | None = None) -> Results:
    """A method at some points, which are repeated until there are ``count`` of them (a compiled method knows one size)."""
    inputs = where.tensors(points, dtype, None if count is None else max(count, len(next(iter(points.values())))))
    return results(formula(*inputs), inputs, points)


def results(value: Tensor, inputs: list[Tensor], points: Points) -> Results:
    """Values, differentiated by the inputs; of inputs that repeat the points, the first of each."""
    value = value.reshape(-1)
    slopes = torch.autograd.grad(value.sum(), inputs, allow_unused=True, materialize_grads=True)
    count = len(next(iter(points.values())))
    first = [x.detach()[:count].double().numpy() for x in (value, *slopes)]
    along_sphere = [g - (g * w).sum(1, keepdims=True) * w if w.ndim > 1 else g for g, w in zip(first[1:], points.values(), strict=True)]
    return Results(first[0], dict(zip(points, along_sphere, strict=True)))


def relative(found: Results, truth: Truth) -> np.ndarray:
    """Errors of values."""
    return _quotient(_distance(found.values, truth.values), np.abs(truth.values).astype(np.float64))


def of_slopes(found: Results, truth: Truth) -> np.ndarray:
    """Errors of slopes, relative to the slope (of directions, its length) or the value, whichever is larger; the largest of a point."""
    value = np.abs(truth.values).astype(np.float64)
    errors = [
        _quotient(_distance(f, t), np.maximum(_length(t.astype(np.float64)), value)) for f, t in zip(*_slopes(found, truth), strict=True)
    ]
    return np.asarray(np.max(errors, 0))


def broken(method: Method, errors: Errors, law: Law) -> list[str]:
    """What an eager method of float32 does not keep of its claim, in words."""
    claimed, is_relative = method.claimed()
    worst, found = (errors.value if is_relative else errors.absolute).worst, []
    if not worst <= claimed:
        found.append(f"{law.name}, {method.name}: value wrong by {worst:.3g}, claimed {claimed:.3g} ({method.claim})")
    if method.exact and not errors.slope.p999 <= SLOPES[bool(law.vectors)]:
        found.append(f"{law.name}, {method.name}: slope wrong by {errors.slope.p999:.3g}, allowed {SLOPES[bool(law.vectors)]:.3g}")
    return found


def _slopes(found: Results, truth: Truth) -> tuple[list[np.ndarray], list[np.ndarray]]:
    return list(found.slopes.values()), [truth.slopes[name] for name in found.slopes]


def _distance(found: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """|found - exact| of numbers, or the length of that of directions; infinite where it is not finite."""
    with gmpy2.context(gmpy2.get_context(), precision=BITS), np.errstate(invalid="ignore"):
        difference = (found - exact).astype(np.float64)
    return np.nan_to_num(_length(difference), nan=np.inf)


def _length(x: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.norm(x, axis=1)) if x.ndim > 1 else np.abs(x)


def _quotient(error: np.ndarray, size: np.ndarray) -> np.ndarray:
    """0 where there is no error."""
    with np.errstate(over="ignore"):
        return np.divide(error, size, out=np.where(error > 0, np.inf, 0.0), where=(size > 0) & (error > 0))


def _share(found: np.ndarray, exact: np.ndarray) -> float:
    """The sum of errors over the sum of magnitudes."""
    size = _length(exact.astype(np.float64)).sum()
    error = _distance(found, exact).sum()
    return float(error / size) if size else float(error)
