"""What a parameter of a value is: its legal values, its shape, its meaning. Said once, by :func:`param`.

That one declaration serves validation, the draws of tests, learning and the docs table.
"""

import dataclasses
from typing import Any

import torch
from torch import Tensor

from . import arguments
from .constraint import Constraint

SCALAR, PAIR, VECTOR, COLOUR = (1,), (2,), (3,), ("C",)  # the usual shapes of one parameter


@dataclasses.dataclass(frozen=True)
class Param:
    """What :func:`param` declares. ``event`` is the shape of one parameter, the axes behind the batch axes."""

    constraint: Constraint
    event: tuple[int | str, ...]
    doc: str = ""
    kind: str = "float"  # "float", "int" or "bool"

    @property
    def is_colour(self) -> bool:
        """Whether the last axis is one of colour channels."""
        return self.event[-1] == "C"

    @property
    def shape(self) -> str:
        """In words, such as ``"[..., 3]"``."""
        return f"[..., {', '.join(map(str, self.event))}]"

    def batch(self, t: Tensor) -> torch.Size:
        """The batch axes of a tensor of this parameter."""
        return t.shape[: t.dim() - len(self.event)]

    def fits(self, t: Tensor) -> bool:
        """Whether a tensor has the event axes, each of its size, a named one of any size but 0 where it counts colours."""
        sizes = t.shape[t.dim() - len(self.event) :]
        return len(sizes) == len(self.event) and all(isinstance(e, str) or e == n for e, n in zip(self.event, sizes, strict=True))

    def tensor(self, raw: Any, where: str) -> Tensor:
        """What was given for a parameter as a tensor, of a legal kind and shape; ``where`` names it in errors. Looks at no values."""
        t = _to_tensor(raw, where, self.kind)
        if not self.fits(t):
            raise ValueError(f"{where}: expected shape {self.shape}, found {list(t.shape)}{arguments.moved(t.shape, self.event)}")
        if self.is_colour and not t.shape[-1]:
            raise ValueError(f"{where}: expected shape {self.shape} with one channel at least, found {list(t.shape)}")
        return t


def param(
    constraint: Constraint, event: tuple[int | str, ...], doc: str = "", default: Any = dataclasses.MISSING, kind: str = "float"
) -> Any:
    """A tensor field ``[..., *event]`` that must lie in ``constraint``.

    A name in ``event`` stands for any size, the same wherever a value says it; but ``"C"``, the channels of a colour, may also be 1.
    """
    return dataclasses.field(default=default, metadata={"param": Param(constraint, event, doc, kind)})


def _to_tensor(x: Any, where: str, kind: str) -> Tensor:
    try:
        t = x if isinstance(x, Tensor) else torch.as_tensor(x, dtype=None if hasattr(x, "dtype") or kind != "float" else torch.float64)
    except (TypeError, ValueError, RuntimeError) as error:
        raise TypeError(f"{where}: expected a number, list, array or tensor, found {type(x).__name__} ({error})") from None
    if t.dtype not in _LEGAL[kind]:
        raise TypeError(f"{where}: expected a tensor of {kind}s, found {t.dtype}; {_remedy(t.dtype, kind)}")
    if t.layout != torch.strided:
        raise TypeError(f"{where}: expected a dense tensor, found one of layout {t.layout}; convert it with .to_dense()")
    return t.reshape(1) if t.dim() == 0 else t


_LEGAL = {
    "float": arguments.FLOATS,
    "int": (torch.int64, torch.int32, torch.int16, torch.int8, torch.uint8),
    "bool": (torch.bool,),
}


def _remedy(found: torch.dtype, kind: str) -> str:
    if kind == "bool":  # as bools, a weight of 0.1 and NaN are true
        return "compare it, for example x > 0.5"
    if kind == "int":  # a cast cuts 2.9999999 to 2
        return "round it: x.round().to(torch.int64)" if found in arguments.FLOATS else "convert it, for example with .to(torch.int64)"
    return arguments.as_floats(found)
