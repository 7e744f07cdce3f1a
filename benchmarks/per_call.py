"""What one call costs apart from arithmetic: a training step on 64 x 64 pixels, eagerly, beside the hand-written formula.

    python benchmarks/per_call.py [--points 4096] [--rounds 200] [--threads 1] [--write]

Both learn a colour, a specular strength, an exponent and f0 in the same way (a sigmoid, an exponential), one number or colour each, of
the scene of benchmarks/shade.py. Dispatched operations are what torch sends to its kernels, views among them.
"""

import math
from collections.abc import Callable
from typing import Any

import torch
from common import Race, machine, milliseconds, need_agreement, options, publish, race, ratio, steady, table
from shade import INTENSITY, LIGHT, gbuffer, ours, scene, textbook
from torch import Tensor, nn
from torch.utils._python_dispatch import TorchDispatchMode

import torchbrdf as tb

START = {"albedo": [0.5, 0.4, 0.3], "specular": [0.5, 0.4, 0.3], "exponent": [12.0], "f0": [0.1, 0.05, 0.04]}


class Count(TorchDispatchMode):
    """Counts the operations that torch dispatches."""

    def __init__(self) -> None:
        super().__init__()
        self.count = 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        self.count += 1
        return func(*args, **(kwargs or {}))


def operations(fn: Callable[[], Any]) -> int:
    with Count() as counter:
        fn()
    return counter.count


class HandWritten(nn.Module):
    """The textbook with learned parameters."""

    def __init__(self, s: dict[str, Tensor]) -> None:
        super().__init__()
        self.scene = s
        start = {name: torch.tensor(v) for name, v in START.items()}
        self.raw = nn.ParameterDict({k: nn.Parameter(v.log() if k == "exponent" else v.logit()) for k, v in start.items()})

    def forward(self) -> Tensor:
        return textbook({**self.scene, **{k: raw.exp() if k == "exponent" else raw.sigmoid() for k, raw in self.raw.items()}})


class WithShader(nn.Module):
    """The same by `tb.nn.Shader`."""

    def __init__(self, s: dict[str, Tensor]) -> None:
        super().__init__()
        self.g, self.light = gbuffer(s), tb.PointLight(LIGHT, INTENSITY)
        learned = {name: tb.nn.Learned(v) for name, v in START.items()}
        fresnel = tb.nn.Material(tb.Schlick, f0=learned["f0"])
        gloss = tb.nn.Material(tb.Phong, specular=learned["specular"], exponent=learned["exponent"], fresnel=fresnel)
        made = tb.nn.Material(tb.Lambert, albedo=learned["albedo"]) + gloss
        self.shader = tb.nn.Shader(made, tb.plan(self.g, made(self.g), self.light))

    def forward(self) -> Tensor:
        return self.shader(self.g, self.light)


def step(module: nn.Module, target: Tensor) -> None:
    module.zero_grad()
    (module() - target).square().mean().backward()


def rows(side: int, rounds: int) -> list[list[str]]:
    s = scene(side, torch.float32)
    flat = {k: tb.planar(v) for k, v in s.items()}
    whole = {**flat, **{name: torch.tensor(v) for name, v in START.items()}}
    hand, shader, target = HandWritten(s), WithShader(flat), torch.full((side, side, 3), 0.2)
    need_agreement("Shader", {"value": shader().detach()}, {"value": hand().detach()}, 0.99)
    calls = {
        "hand-written": (hand, lambda: step(hand, target)),
        "`tb.nn.Shader`": (shader, lambda: step(shader, target)),
        "`tb.shade`": (lambda: ours(whole), None),
    }
    runs: Race = {(who, what): fn for who, pair in calls.items() for what, fn in zip(("call", "step"), pair, strict=True) if fn}
    times, found = race(runs, rounds, "per call"), []
    for who, pair in calls.items():
        cells = [who]
        for what, fn in zip(("call", "step"), pair, strict=True):
            mine, base = times.get((who, what)), times["hand-written", what]
            cells += [str(operations(fn)), milliseconds(mine), f"{ratio(base, mine):.2f}"] if fn and mine else ["–"] * 3
        found.append(cells)
    return found


def main() -> None:
    args = options(__doc__, points=4096, rounds=200, threads=1).parse_args()
    torch.set_num_threads(args.threads)
    side = round(math.sqrt(args.points))
    head = ["eager", "call: operations", "ms", "time / hand-written", "training step: operations", "ms", "time / hand-written"]
    intro = f"{side} × {side} pixels, {args.rounds} rounds, {machine(args.threads)}. Medians, quartiles in brackets."
    publish("per call", f"{intro}\n\n{table(head, rows(side, args.rounds))}", args.write)


if __name__ == "__main__":
    steady()
    main()
