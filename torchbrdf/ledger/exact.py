"""Exact derivatives: dual numbers over arrays of arbitrary-precision floats.

A :class:`Dual` is a value and its derivatives by some inputs; its value may itself be a Dual of a lower level, which gives
second derivatives. The bottom is a numpy array of ``gmpy2.mpfr``, so a formula is written once and runs over a whole grid.
Precision is brute force: with :data:`BITS` bits, textbook formulas lose hundreds of digits and have enough left. What the
formulas mean at their edges is said with :func:`where`, the one place in which a truth branches.
"""

from collections.abc import Callable
from typing import Any, Union

import gmpy2
import numpy as np
import torch

Number = Union["Dual", np.ndarray, float, int]
BITS = {torch.float64: 2600, torch.float32: 640, torch.bfloat16: 640, torch.float16: 320}  # (1 + x)^2 - 1 keeps the smallest denormal x


def set_precision(dtype: torch.dtype) -> None:
    """Enough bits for the inputs of ``dtype``, squared twice."""
    gmpy2.get_context().precision = BITS[dtype]


class Dual:
    """``value`` and ``parts {input: derivative}``; an absent part is 0. Of two levels the higher one sees the other as a constant."""

    __array_ufunc__ = None  # numpy arrays leave the operators to us

    def __init__(self, value: Any, parts: dict[int, Any], level: int = 0) -> None:
        self.value, self.parts, self.level = value, parts, level

    def _chain(self, value: Any, slope: Any) -> "Dual":
        return Dual(value, {i: p * slope for i, p in self.parts.items()}, self.level)

    def __add__(self, other: Number) -> "Dual":
        if not isinstance(other, Dual) or other.level < self.level:
            return Dual(self.value + other, self.parts, self.level)
        if other.level > self.level:
            return other + self
        return Dual(self.value + other.value, _merge(self.parts, other.parts), self.level)

    def __mul__(self, other: Number) -> "Dual":
        if not isinstance(other, Dual) or other.level < self.level:
            return self._chain(self.value * other, other)
        if other.level > self.level:
            return other * self
        by_self = {i: p * other.value for i, p in self.parts.items()}
        by_other = {i: p * self.value for i, p in other.parts.items()}
        return Dual(self.value * other.value, _merge(by_self, by_other), self.level)

    def __neg__(self) -> "Dual":
        return self * -1

    def __sub__(self, other: Number) -> "Dual":
        return self + (-1 * other)

    def __rsub__(self, other: Number) -> "Dual":
        return (-1 * self) + other

    def __truediv__(self, other: Number) -> "Dual":
        return self * inverse(other)

    def __rtruediv__(self, other: Number) -> "Dual":
        return inverse(self) * other

    __radd__, __rmul__ = __add__, __mul__


def _merge(a: dict[int, Any], b: dict[int, Any]) -> dict[int, Any]:
    return {i: a[i] + b[i] if i in a and i in b else a.get(i, b.get(i)) for i in (*a, *(k for k in b if k not in a))}


def _function(name: str, slope: Callable[[Any, Any], Any]) -> Callable[[Any], Any]:
    on_arrays = np.frompyfunc(getattr(gmpy2, name), 1, 1)

    def call(x: Any) -> Any:
        if not isinstance(x, Dual):
            return on_arrays(np.asarray(x, dtype=object))
        y = call(x.value)
        return x._chain(y, slope(x.value, y))

    return call


sqrt = _function("sqrt", lambda x, y: inverse(2 * y))
exp = _function("exp", lambda x, y: y)
log = _function("log", lambda x, y: inverse(x))
erf = _function("erf", lambda x, y: exp(-1 * (x * x)) * (2 / gmpy2.sqrt(gmpy2.const_pi())))
_atan = _function("atan", lambda x, y: inverse(1 + x * x))


def inverse(x: Any) -> Any:
    """1 / x."""
    if not isinstance(x, Dual):
        return gmpy2.mpfr(1) / x
    y = inverse(x.value)
    return x._chain(y, -1 * (y * y))


def pi() -> Any:
    """To the present precision."""
    return gmpy2.const_pi()


def plain(x: Any) -> np.ndarray:
    """The bare values, which branches and comparisons look at."""
    return plain(x.value) if isinstance(x, Dual) else x


def where(mask: Any, a: Any, b: Any) -> Any:
    """``a`` where the mask holds, else ``b``, with the derivatives of the one chosen."""
    level = max((x.level for x in (a, b) if isinstance(x, Dual)), default=None)
    if level is None:
        return np.where(np.asarray(mask, dtype=bool), a, b)
    a, b = (x if isinstance(x, Dual) and x.level == level else Dual(x, {}, level) for x in (a, b))
    parts = {i: where(mask, a.parts.get(i, _ZERO), b.parts.get(i, _ZERO)) for i in {*a.parts, *b.parts}}
    return Dual(where(mask, a.value, b.value), parts, level)


_ZERO = gmpy2.mpfr(0)


def power(x: Any, s: Any) -> Any:
    """``x ** s`` for x >= 0, with 0 ** 0 = 1 and no slope at x = 0."""
    alive = plain(x) > 0
    return where(alive, exp(s * log(where(alive, x, 1))), where(plain(s) == 0, 1, 0))


class Exact:
    """The arithmetic ``m`` in which textbook formulas are written (torchbrdf/testing/textbook.py), to the present precision."""

    sqrt, exp, log, erf, where, power = (staticmethod(f) for f in (sqrt, exp, log, erf, where, power))

    @property
    def pi(self) -> Any:
        return pi()

    @staticmethod
    def positive(x: Any) -> np.ndarray:
        """Where x > 0, a mask."""
        return np.asarray(plain(x) > 0, dtype=bool)


def atan2(y: Any, x: Any) -> Any:
    """The angle of (x, y) in [-pi, pi], the sign of y = -0 included; 0 with no slope at the origin. By the half angle."""
    px, py = plain(x), plain(y)
    origin = (px == 0) & (py == 0)
    length = sqrt(where(origin, 1, x * x + y * y))
    ahead = (px >= 0) & ~origin.astype(bool)
    behind = (px < 0).astype(bool)
    half_turn = where(np.frompyfunc(gmpy2.is_signed, 1, 1)(py), -pi(), pi())
    near = 2 * _atan(y / where(ahead, length + x, 1))
    far = half_turn - 2 * _atan(y / where(behind, length - x, 1))
    return where(ahead, near, where(behind, far, 0))


def inputs(columns: np.ndarray, along: int | None = None) -> list[Dual]:
    """Columns ``[N, n]`` of exact floats as variables; with ``along``, the parts of that input and of those after it carry the second
    derivatives by it (those of the inputs before it are the same, the other way round).
    """
    exact = np.frompyfunc(gmpy2.mpfr, 1, 1)(columns)
    xs = [exact[:, j].astype(object) for j in range(columns.shape[1])]
    if along is None:
        return [Dual(x, {j: gmpy2.mpfr(1)}) for j, x in enumerate(xs)]
    lower: list[Any] = [Dual(x, {0: gmpy2.mpfr(1)}) if j == along else x for j, x in enumerate(xs)]
    return [Dual(x, {j: gmpy2.mpfr(1)} if j >= along else {}, 1) for j, x in enumerate(lower)]
