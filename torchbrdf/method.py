"""Methods: the ways to compute a law, and to approximate it, side by side. What each is wrong by, and costs, the ledger measures.

A law stands once, as its source prints it, in any arithmetic (``textbook(m, *inputs)``, see ``torchbrdf/testing/textbook.py``); its
methods are functions of the same inputs, one line each. The first is the default: the cheapest that is finite and within the bounds
of the stability tests everywhere. The others are asked for by name.
"""

import dataclasses
import re
from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor

Ranges = Mapping[str, tuple[float, float]]
Draw = Callable[[Any, int], dict[str, Any]]  # (numpy generator, count) -> points by the name of the input, float64
CLAIM = re.compile(r"(?P<number>[0-9.]+(e-?[0-9]+)?)(?P<unit> ulp| of the value)?\b")


@dataclasses.dataclass(frozen=True)
class Method:
    """One way to compute a law: ``formula(*inputs)`` of tensors that broadcast.

    ``claim`` begins with the largest error of the value over the everyday domain of the law, in float32: ``"16 ulp"`` or
    ``"2e-5 of the value"`` (relative), or a number alone (absolute). The tests hold the method to it.
    """

    name: str
    formula: Callable[..., Tensor]
    call: str  # how a user asks for it, such as 'tb.Dielectric(eta, method="extended")'
    source: str  # author, year, equation; "this package" for an arrangement of our own
    claim: str  # its error, and where: "16 ulp everywhere", "0.07 for eta in [1.3, 1.8]"
    exact: bool = True  # the law itself, in some arithmetic; or an approximation of it

    def claimed(self, dtype: torch.dtype = torch.float32) -> tuple[float, bool]:
        """The error that is claimed, as a number, and whether it is relative to the value."""
        found = CLAIM.match(self.claim)
        if not found:
            raise ValueError(
                f"claim of {self.name!r}: found {self.claim!r}; begin with a number, such as '16 ulp', '2e-5 of the value', '0.07'"
            )
        unit = torch.finfo(dtype).eps if found["unit"] == " ulp" else 1.0
        return float(found["number"]) * unit, bool(found["unit"])


@dataclasses.dataclass(frozen=True)
class Law:
    """What is to be computed, where it is wanted every day, and how it can be done.

    Inputs are numbers ``[N]``, but for ``vectors``, the directions wi, wo, n ``[N, 3]``, if any, that come before them and reach
    ``textbook`` as one Point.
    Everyday points are spread evenly over the ranges, unless ``draw`` says otherwise.
    """

    name: str
    inputs: Ranges  # everyday range of each number
    textbook: Callable[..., Any]
    methods: tuple[Method, ...]
    vectors: tuple[str, ...] = ()  # of directions, ("wi", "wo", "n")
    draw: Draw | None = None  # everyday points
    hard: Draw | None = None  # points where methods lose digits: errors are measured there, too, and nothing is claimed
    hard_where: str = ""  # in words

    def __getitem__(self, name: str) -> Method:
        """A method by its name."""
        found = {m.name: m for m in self.methods}
        if name not in found:
            raise ValueError(f"method: found {name!r}; the methods of {self.name} are {list(found)}")
        return found[name]

    @property
    def default(self) -> Method:
        """The first."""
        return self.methods[0]
