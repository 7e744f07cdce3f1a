"""What the bare formula costs, `evaluate` times the cosine, beside textbook code and beside Dr.Jit's frozen function.

    python benchmarks/formulas.py [--points 1000000] [--rounds 15] [--threads 2] [--only W1c] [--write]

Workloads: benchmarks/workloads.py. Values and gradients (of a weighted sum, by every parameter and the normal) are compared before
anything is timed. Rivals take turns within each round. Last, unless ``--only`` one, exponents from 2 to 1000 are timed beside
the constant 10.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import torch
import workloads
from common import Race, comparison, machine, milliseconds, need_agreement, options, publish, race, ratio, steady, table, version
from drjit_rival import DrJit, find
from torch import Tensor
from workloads import DIRECTIONS, Points, Torch

import torchbrdf as tb

FORWARD, BOTH = "forward", "forward + backward"
DRJIT = "Dr.Jit frozen"


class Rival(NamedTuple):
    """``forward() -> values``; ``both() -> gradients`` of the sum of ``weight * values``, by name."""

    forward: Callable[[], Tensor] | None
    both: Callable[[], dict[str, Tensor]]


def learned(p: Points) -> Points:
    return {name: v for name, v in p.items() if name not in DIRECTIONS}


def by_autograd(fn: Callable[[Points], Tensor], p: Points, weight: Tensor) -> Rival:
    def forward() -> Tensor:
        with torch.no_grad():
            return fn(p)

    def both() -> dict[str, Tensor]:
        leaves = {name: v.detach().requires_grad_() for name, v in learned(p).items()}
        return dict(zip(leaves, torch.autograd.grad(fn({**p, **leaves}), list(leaves.values()), weight), strict=True))

    return Rival(forward, both)


def one_graph(fn: Callable[[Points], Tensor], p: Points, weight: Tensor) -> Rival:
    step = tb.value_and_grad(lambda own, p, weight: (fn({**p, **own}) * weight).sum())
    return Rival(None, lambda: step(learned(p), p, weight)[1])


def by_drjit(dj: DrJit, name: str, p: Points, weight: Tensor) -> Rival:
    q, w = {k: dj.array(v) for k, v in p.items()}, dj.array(weight)
    forward, both = dj.forward(workloads.textbook(name)), dj.both(workloads.textbook(name))
    rest = {k: q[k] for k in DIRECTIONS if k in q}
    return Rival(lambda: forward(q), lambda: both(learned(q), rest, w))


def rivals(name: str, p: Points, weight: Tensor, dj: DrJit | None) -> dict[str, Rival]:
    lean, mine = partial(workloads.textbook(name), Torch), workloads.ours(name)
    q, w = {k: tb.planar(v) for k, v in p.items()}, tb.planar(weight)
    found = {
        "textbook eager": by_autograd(lean, p, weight),
        "textbook compiled": by_autograd(torch.compile(lean), p, weight),
        "ours eager": by_autograd(mine, q, w),
        "ours compiled": by_autograd(tb.compile(mine), q, w),
        "ours as one graph": one_graph(mine, q, w),
    }
    return found | ({DRJIT: by_drjit(dj, name, p, weight)} if dj and p["wi"].dtype == torch.float32 else {})


def tangential(gradient: Tensor, n: Tensor) -> Tensor:
    """What counts of a gradient by a unit normal: along it, formulas that are equal for unit vectors alone differ."""
    return gradient - (gradient * n).sum(-1, keepdim=True) * n


def agreed(found: dict[str, Rival], normal: Tensor, part: float, dj: DrJit | None) -> dict[str, Rival]:
    """The same rivals, checked against the textbook."""

    def results(name: str) -> Iterator[tuple[str, Tensor]]:
        as_tensor = dj.tensor if dj and name == DRJIT else torch.Tensor.detach
        rival = found[name]
        yield from [("value", as_tensor(rival.forward()))] if rival.forward else []
        for k, v in rival.both().items():
            yield k, tangential(as_tensor(v), normal) if k == "normal" else as_tensor(v)

    truth = dict(results("textbook eager"))
    for name in found:
        mine = dict(results(name))
        need_agreement(name, mine, {k: v for k, v in truth.items() if k in mine}, part)
    return found


def measure(name: str, count: int, rounds: int, dj: DrJit | None) -> str:
    """The table of one workload. All numbers of the eager rivals must agree in float64; 90 % of everybody's in float32."""
    print(f"{name}: differences from the textbook")
    for dtype, size, part in ((torch.float64, 1000, 1.0), (torch.float32, count, 0.9)):
        torch.compiler.reset()
        weight = torch.rand(size, 3, generator=torch.Generator().manual_seed(1), dtype=dtype)
        p = workloads.points(name, size, dtype)
        found = rivals(name, p, weight, dj)
        if dtype == torch.float64:  # compiling for this as well would double the minutes
            found = {who: rival for who, rival in found.items() if "eager" in who}
        agreed(found, p["normal"], part, dj)
    runs: Race = {(who, BOTH): rival.both for who, rival in found.items()}
    runs |= {(who, FORWARD): rival.forward for who, rival in found.items() if rival.forward}
    if name == "W2a":
        runs |= isotropic(count, weight)
    times = race(runs, rounds, name)
    text = comparison(times, [FORWARD, BOTH], "textbook eager", DRJIT if dj else None)
    return f"{text}\n\n{by_isotropic(times)}" if name == "W2a" else text


ISOTROPIC = ", isotropic"


def isotropic(count: int, weight: Tensor) -> Race:
    """W2 by us, to run beside W2a."""
    p = {k: tb.planar(v) for k, v in workloads.points("W2", count, torch.float32).items()}
    mine, w = workloads.ours("W2"), tb.planar(weight)
    found = {"ours compiled": by_autograd(tb.compile(mine), p, w), "ours as one graph": one_graph(mine, p, w)}
    runs: Race = {(who + ISOTROPIC, BOTH): rival.both for who, rival in found.items()}
    return runs | {(who + ISOTROPIC, FORWARD): rival.forward for who, rival in found.items() if rival.forward}


def by_isotropic(times: dict[tuple[str, str], list[float]]) -> str:
    """What the second number of roughness, and the tangent, cost."""
    pairs = [(who.removesuffix(ISOTROPIC), column) for who, column in times if who.endswith(ISOTROPIC)]
    parts = [f"{who}, {c}: {ratio(times[who + ISOTROPIC, c], times[who, c]):.2f}" for who, c in pairs]
    return f"Anisotropic, in units of isotropic: {'; '.join(parts)}."


def exponents(count: int, rounds: int) -> str:
    """W1 with exponents from 2 to 1000 at random, and with 10 everywhere: powers of small cosines are denormal numbers."""
    weight = tb.planar(torch.rand(count, 3))
    runs: Race = {}
    for low, high in ((10.0, 10.0), (2.0, 1000.0)):
        p = {k: tb.planar(v) for k, v in workloads.points("W1", count, torch.float32, (low, high)).items()}
        for who, fn in (("eager", workloads.ours("W1")), ("compiled", COMPILED)):
            rival = by_autograd(fn, p, weight)
            runs |= {(f"{who}, {high:g}", FORWARD): rival.forward, (f"{who}, {high:g}", BOTH): rival.both}  # type: ignore[dict-item]
    times = race(runs, rounds, "exponents")
    rows = []
    for who in ("eager", "compiled"):
        pairs = [(times[f"{who}, 10", c], times[f"{who}, 1000", c]) for c in (FORWARD, BOTH)]
        rows.append([who, *(cell for a, b in pairs for cell in (milliseconds(a), milliseconds(b), f"{ratio(a, b):.2f}"))])
    head = [cell for c in (FORWARD, BOTH) for cell in (f"{c}, 10: ms", "2–1000: ms", "ratio")]
    return table(["W1 by exponent", *head], rows)


COMPILED = tb.compile(workloads.ours("W1"))


def main() -> None:
    parser = options(__doc__, points=1_000_000, rounds=15)
    parser.add_argument("--only", choices=workloads.NAMES, help="one workload alone; nothing is written")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    dj = find(args.threads)
    names = [args.only] if args.only else list(workloads.NAMES)
    parts = [f"**{n}.** {TITLES[n]}\n\n{measure(n, args.points, args.rounds, dj)}" for n in names]
    torch.compiler.reset()
    parts += [] if args.only else [exponents(args.points, args.rounds)]
    with_drjit = f", {version('drjit')} (LLVM)" if dj else ""
    head = f"{args.points:,} points, {args.rounds} rounds, {machine(args.threads)}{with_drjit}. Medians, quartiles in brackets."
    publish("formulas", "\n\n".join([head, *parts]), args.write and not args.only)


TITLES = {
    "W1": "Lambert + Schlick · Phong",
    "W1x": "Lambert + exact dielectric · Phong",
    "W1c": "Lambert + exact conductor · Phong",
    "W2": "Lambert + Schlick · GGX, height-correlated",
    "W2a": "Lambert + Schlick · GGX, height-correlated, anisotropic",
}

if __name__ == "__main__":
    steady()
    main()
