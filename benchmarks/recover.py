"""Iterations and time that the recovery example needs with each optimiser, on the scene that it makes.

    python benchmarks/recover.py [--seed 0] [--threads 1]

Loss goals are relative to the least loss that any of them finds. Adam runs with several step sizes, with its default memory; the best
one counts, goal by goal. Costs are processor time, in units of one evaluation of loss and gradient, measured in between the runs.
"""

import argparse
import statistics
import sys
import time
from pathlib import Path

import torch

import torchbrdf as tb

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "examples"))
from recovery import builtin
from recovery.fit import Model, Step, fit, squares
from recovery.problem import make_material

ADAM = 1200  # iterations
RATES = (0.01, 0.03, 0.1, 0.3)
EXCESS = (0.1, 0.01, 1e-3, 1e-4, 1e-6)


def start(seed: int) -> tuple[Model, list, dict[str, float]]:
    problem = builtin.build(seed)
    material = make_material("glossy", builtin.TEXELS, problem.start).double()
    points = [p for view in problem.views for p in view.points()]
    plan = tb.plan(points[0].g, material(points[0].g), problem.lights.one(points[0].g, 0))
    return Model(material, problem, plan), points, {k: float(v) for k, v in problem.truth.items() if v.numel() == 1}


def unit_seconds(seed: int, repeat: int = 10) -> float:
    model, points, _ = start(seed)
    squares(model, points).backward()
    began = time.process_time()
    for _ in range(repeat):
        squares(model, points).backward()
    return (time.process_time() - began) / repeat


def worst_error(model: Model, truth: dict[str, float]) -> float:
    """Of specular strength, exponent and eta - 1, relative."""
    found = {name.split(".")[-1]: float(m.value.detach()) for name, m in model.named_modules() if isinstance(m, tb.nn.Learned)}
    shift = {"eta": 1.0}
    return max(abs(found[k] - t) / (t - shift.get(k, 0.0)) for k, t in truth.items())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=1)
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    units: list[float] = []
    runs: dict[str, list[Step]] = {}
    errors: dict[str, float] = {}
    for name, optimizer, rate in [
        ("Gauss-Newton", "gauss-newton", 0.0),
        ("L-BFGS", "lbfgs", 0.0),
        *((f"Adam {r:g}", "adam", r) for r in RATES),
    ]:
        model, points, truth = start(args.seed)
        runs[name] = fit(model, points, ADAM if optimizer == "adam" else None, optimizer, rate, time.process_time)
        errors[name] = worst_error(model, truth)
        units.append(unit_seconds(args.seed))
    unit = statistics.median(units)
    least = min(step.loss for steps in runs.values() for step in steps)
    print(f"one evaluation of loss and gradient: {1e3 * unit:.1f} ms\n")
    print(
        "| | iterations to a loss within "
        + " | ".join(f"{e:g}" for e in EXCESS)
        + " | iterations in all | evaluations | seconds | worst error |"
    )
    print("| --- |" + " ---: |" * (len(EXCESS) + 4))
    for name, steps in runs.items():
        reached = [next((k for k, s in enumerate(steps) if s.loss <= least * (1 + e)), None) for e in EXCESS]
        cells = ["-" if k is None else f"{k} ({steps[k].seconds / unit:.0f})" for k in reached]
        total = steps[-1].seconds
        print(f"| {name} | {' | '.join(cells)} | {len(steps) - 1} | {total / unit:.0f} | {total:.1f} | {errors[name]:.2%} |")


if __name__ == "__main__":
    main()
