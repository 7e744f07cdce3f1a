"""What a method costs: time per pixel, memory kept for the backward pass, time to compile. Rivals take turns in every round."""

import dataclasses
import statistics
import time
import types
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from ..compiling import compile as compile_as_the_package_does
from ..method import Law
from . import points
from .errors import Errors, Measured
from .rows import COMPILED, EAGER, Row

WARM_UP = 2  # rounds that are not counted
Progress = Callable[[str], Any]


@dataclasses.dataclass(frozen=True)
class Quartiles:
    """Of the rounds, in nanoseconds a pixel."""

    low: float
    median: float
    high: float

    @staticmethod
    def of(times: list[float]) -> "Quartiles":
        """One round is its own quartiles."""
        return Quartiles(*(statistics.quantiles(times, n=4, method="inclusive") if len(times) > 1 else times * 3))


@dataclasses.dataclass(frozen=True)
class Cost:
    """Forward without gradients, and forward with all gradients; bytes a pixel kept between the two beside the inputs; seconds to
    compile both, nothing cached.
    """

    forward: Quartiles
    both: Quartiles
    kept: float
    compiling: float | None


class Contestant:
    """One row with its inputs, ready to be timed."""

    def __init__(self, row: Row, measured: Measured, pixels: int) -> None:
        self.row, self.measured, self.pixels = row, measured, pixels
        self.inputs = points.tensors(measured.everyday, row.dtype, pixels)
        self.call = row.formula if row.how == EAGER else compile_as_the_package_does(_own(row), recompute=row.how == COMPILED)
        self.ones = torch.ones((), dtype=row.dtype).expand(pixels)
        start = time.perf_counter()
        self.forward()
        self.both()
        self.compiling = None if row.how == EAGER else time.perf_counter() - start

    def forward(self) -> None:
        """Values alone."""
        with torch.no_grad():
            self.call(*self.inputs)

    def both(self) -> None:
        """Values, and gradients by every input."""
        out = self.call(*self.inputs)
        torch.autograd.grad(out, self.inputs, self.ones.view_as(out), allow_unused=True)

    def errors(self) -> Errors:
        """Of the call that is timed."""
        return self.measured.errors(self.call, self.pixels)

    def kept(self) -> float:
        """Bytes a pixel that the graph holds, the inputs apart."""
        own, found = {x.untyped_storage().data_ptr() for x in self.inputs}, {}

        def pack(x: Tensor) -> Tensor:
            storage = x.untyped_storage()
            if storage.data_ptr() not in own:
                found[storage.data_ptr()] = storage.nbytes()
            return x

        with torch.autograd.graph.saved_tensors_hooks(pack, lambda x: x):
            out = self.call(*self.inputs)  # held until the bytes are counted, so that no address is used twice
        total = sum(found.values())
        del out
        return total / self.pixels


def _own(row: Row) -> Callable[..., Tensor]:
    """The formula behind code of its own: what is compiled is counted by code, and only so often."""
    formula = row.formula

    def call(*x: Tensor) -> Tensor:
        return formula(*x)

    name = f"{row.label}".replace(" ", "_")
    return types.FunctionType(call.__code__.replace(co_name=name), call.__globals__, name, closure=call.__closure__)


def costs(
    law: Law, rows: list[Row], measured: dict[torch.dtype, Measured], pixels: int, rounds: int, say: Progress
) -> list[tuple[Cost, Errors]]:
    """Of every row, in order, with its errors; ``say`` hears of each step."""
    torch.compiler.reset()
    contestants = []
    for row in rows:
        say(f"{law.name}: {row.label}")
        contestants.append(Contestant(row, measured[row.dtype], pixels))
    forward: list[list[float]] = [[] for _ in rows]
    both: list[list[float]] = [[] for _ in rows]
    for k in range(WARM_UP + rounds):
        say(f"{law.name}: round {k + 1 - WARM_UP} of {rounds}" if k >= WARM_UP else f"{law.name}: warming up")
        for j, c in enumerate(contestants):
            times = _time(c.forward, pixels), _time(c.both, pixels)
            if k >= WARM_UP:
                forward[j].append(times[0])
                both[j].append(times[1])
    return [
        (Cost(Quartiles.of(f), Quartiles.of(b), c.kept(), c.compiling), c.errors())
        for c, f, b in zip(contestants, forward, both, strict=True)
    ]


def steps(rows: list[Row], rounds: int) -> int:
    """How often ``say`` is called."""
    return len(rows) + WARM_UP + rounds


def _time(call: Callable[[], None], pixels: int) -> float:
    start = time.perf_counter_ns()
    call()
    return (time.perf_counter_ns() - start) / pixels
