"""What is measured of a law, one row each: every method, eager and compiled; the default otherwise compiled and in other dtypes; the
textbook's formula as pasted.
"""

import dataclasses
import math
from collections.abc import Callable, Iterator
from typing import Any

import torch
from torch import Tensor

from ..method import Law, Method

EAGER, COMPILED, WITHOUT = "eager", "compiled", "compiled, nothing recomputed"
OTHER_DTYPES = {torch.float64: True, torch.bfloat16: True, torch.float16: False}  # compiled, too: both half types compute in float32
TEXTBOOK = "textbook"


@dataclasses.dataclass(frozen=True)
class Row:
    """A formula in a dtype, eager or compiled. ``method`` is None for the textbook's formula."""

    name: str
    formula: Callable[..., Tensor]
    method: Method | None
    dtype: torch.dtype = torch.float32
    how: str = EAGER

    @property
    def label(self) -> str:
        """Such as ``standard, float64, compiled``."""
        return ", ".join([self.name, *([] if self.dtype == torch.float32 else [dtype_name(self.dtype)]), self.how])


def dtype_name(dtype: torch.dtype) -> str:
    """Without ``torch.``"""
    return str(dtype).removeprefix("torch.")


def rows_of(law: Law, compiled: bool = True) -> list[Row]:
    """All of a law, the default first."""
    found = [row for method in law.methods for row in _both(Row(method.name, method.formula, method), compiled)]
    if compiled:
        found.append(Row(law.default.name, law.default.formula, law.default, how=WITHOUT))
    if not law.vectors:  # of directions, a textbook's Point computes what its formula does not need; such laws bring it as a method
        found += _both(Row(TEXTBOOK, lambda *x: law.textbook(Plain, *x), None), compiled)
    for dtype, both in OTHER_DTYPES.items():
        found += _both(Row(law.default.name, law.default.formula, law.default, dtype), compiled and both)
    return found


def _both(row: Row, compiled: bool) -> Iterator[Row]:
    yield row
    if compiled:
        yield dataclasses.replace(row, how=COMPILED)


class Plain:
    """The arithmetic ``m`` of tensors as they come, in which a textbook's formula is what a user pastes."""

    pi = math.pi
    exp, where, power, erf = torch.exp, torch.where, torch.pow, torch.erf

    @staticmethod
    def sqrt(x: Any) -> Any:
        """Of numbers, too."""
        return torch.sqrt(x) if isinstance(x, Tensor) else math.sqrt(x)

    @staticmethod
    def log(x: Any) -> Any:
        """Of numbers, too."""
        return torch.log(x) if isinstance(x, Tensor) else math.log(x)

    @staticmethod
    def positive(x: Tensor) -> Tensor:
        """A mask."""
        return x > 0
