"""What each light costs: 1, 8 and 64 point lights at 262 144 pixels, forward and backward, compiled; as numbers, and learned.

    python benchmarks/lights.py [--points 262144] [--rounds 7] [--threads 2] [--write]

The material is that of benchmarks/shade.py, varying from pixel to pixel. Learned lights are tensors that require a gradient, by
position and intensity, beside those by the material and the normal.
"""

import math
import time
from collections.abc import Callable
from functools import partial

import torch
from common import Times, machine, milliseconds, options, publish, race, ratio, steady, table
from shade import LEARNED, gbuffer, material, scene
from torch import Tensor

import torchbrdf as tb

COUNTS, KINDS = (1, 8, 64), ("numbers", "learned")


def numbers(count: int) -> tuple[list[list[float]], list[list[float]]]:
    """Positions on a spiral above the sheet, and intensities that add up to one light's."""
    turns = [2.4 * k for k in range(count)]
    positions = [[1.5 * math.cos(t), 1.5 * math.sin(t), 2.0 + k / count] for k, t in enumerate(turns)]
    return positions, [[20 / count, 18 / count, 16 / count]] * count


def image(render: Callable[..., Tensor], s: dict[str, Tensor], light: tb.PointLight) -> Tensor:
    return render(gbuffer(s), material(s), light)


def gradients(render: Callable[..., Tensor], s: dict[str, Tensor], light: tb.PointLight) -> tuple[Tensor, ...]:
    leaves = {k: v.detach().requires_grad_(k in LEARNED) for k, v in s.items()}
    wanted = [*(leaves[k] for k in LEARNED), *(t for _, t in light.named_tensors() if t.requires_grad)]
    return torch.autograd.grad(image(render, leaves, light).sum(), wanted)


def kept(render: Callable[..., Tensor], s: dict[str, Tensor], light: tb.PointLight) -> float:
    """Bytes per pixel that forward keeps for backward, the G-buffer and the material among them; each memory counts once."""
    sizes = {}

    def pack(t: Tensor) -> Tensor:
        sizes[t.untyped_storage().data_ptr()] = t.untyped_storage().nbytes()
        return t

    with torch.autograd.graph.saved_tensors_hooks(pack, lambda t: t):
        image(render, {k: v.detach().requires_grad_(k in LEARNED) for k, v in s.items()}, light)
    return sum(sizes.values()) / s["mask"].numel()


def lights(count: int) -> dict[str, tb.PointLight]:
    given = numbers(count)
    return {"numbers": tb.PointLight(*given), "learned": tb.PointLight(*(torch.tensor(x, requires_grad=True) for x in given))}


def first_call(run: Callable[[], object]) -> float:
    """Seconds, nearly all of them to compile (less where torch has it in its cache)."""
    began = time.perf_counter()
    run()
    return time.perf_counter() - began


def row(count: int, times: Times, first: dict[tuple[str, str], float], memory: dict[tuple[str, str], float]) -> list[str]:
    each = {kind: [t / count for t in times[kind, str(count)]] for kind in KINDS}
    cells = []
    for kind in KINDS:
        beside, k = ratio(times[kind, "1"], each[kind]), (kind, str(count))
        cells += [milliseconds(each[kind]), f"{beside:.2f}", f"{first[k]:.1f}", f"{memory[k]:.0f}"]
    return [str(count), *cells, f"{ratio(each['numbers'], each['learned']):.2f}"]


def main() -> None:
    args = options(__doc__, points=262_144, rounds=7).parse_args()
    torch.set_num_threads(args.threads)
    side = round(math.sqrt(args.points))
    s = {k: tb.planar(v) for k, v in scene(side, torch.float32).items()}
    every = {(kind, str(count)): light for count in COUNTS for kind, light in lights(count).items()}
    render = tb.compile(tb.plan(gbuffer(s), material(s), every["numbers", "1"]))
    runs = {k: partial(gradients, render, s, light) for k, light in every.items()}
    first = {k: first_call(run) for k, run in runs.items()}
    memory = {k: kept(render, s, light) for k, light in every.items()}
    times = race(runs, args.rounds, "lights")
    columns = ("ms a light", "of one light's", "first call, s", "bytes kept per pixel")
    head = ["lights", *(f"{kind}: {cell}" for kind in KINDS for cell in columns), "learned / numbers"]
    rows = [row(count, times, first, memory) for count in COUNTS]
    graphs = torch._dynamo.utils.counters["stats"]["unique_graphs"]
    what = f"{side} × {side} pixels, forward + backward, one compiled plan ({graphs} compilations), {args.rounds} rounds"
    intro = f"{what}, {machine(args.threads)}. Medians, quartiles in brackets."
    publish("lights", f"{intro}\n\n{table(head, rows)}", args.write)


if __name__ == "__main__":
    steady()
    main()
