"""Methods: the ways to compute a law, and to approximate it, side by side. What each is wrong by, and costs, the ledger measures.

A law stands once, as its source prints it, in any arithmetic (``textbook(m, *inputs)``, see ``torchbrdf/testing/textbook.py``); its
methods are functions of the same inputs, one line each. The first is the default: the cheapest that is finite and within the bounds
of the stability tests everywhere. The others are asked for by name.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

from torch import Tensor


@dataclasses.dataclass(frozen=True)
class Method:
    """One way to compute a law: ``formula(*inputs)`` of tensors that broadcast."""

    name: str
    formula: Callable[..., Tensor]
    call: str  # how a user asks for it, such as 'tb.Dielectric(eta, method="extended")'
    source: str  # author, year, equation; "this package" for an arrangement of our own
    claim: str  # its error, and where: "16 ulp everywhere", "0.07 for eta in [1.3, 1.8]"
    exact: bool = True  # the law itself, in some arithmetic; or an approximation of it


@dataclasses.dataclass(frozen=True)
class Law:
    """What is to be computed, where it is wanted every day, and how it can be done."""

    name: str
    inputs: dict[str, tuple[float, float]]  # everyday range of each
    textbook: Callable[..., Any]
    methods: tuple[Method, ...]

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
