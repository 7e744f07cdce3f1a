"""Measure a rough surface with rays, and compare it with the law: a Gaussian height field of mirrors against Beckmann and Smith.

    python examples/height_field.py                                            # alpha 0.5; half a minute
    python examples/height_field.py --alpha 0.5 1 --steps 10 20 --fields 4    # as in docs/rough-surfaces.md; minutes
    python examples/height_field.py --side 20 --fields 4 --rays 50000          # some seconds

The surface has normally distributed heights whose correlation is exp(-r^2), r in correlation lengths; its slopes have the variance
alpha^2 / 2 along x and along y, measured on the facets of the mesh. Each facet is a white mirror. Light of angle theta_i and any azimuth
falls on it; rays follow it from facet to facet until it leaves, and are counted by direction. Nothing of the law goes into that.

Smith's law takes the heights of a facet and of what hides it as independent. So it is compared up to 60 degrees and more than 30 degrees
from the light; by how much it is off elsewhere is in the table and in the picture, too.
"""

import argparse
import math
import time
from pathlib import Path
from typing import Any, NamedTuple

import torch
from facets.bins import STEP, coarse, compared, from_light, histogram, predicted
from facets.surface import arriving, heights, surface, trace
from torch import Tensor

import torchbrdf as tb

REAL = torch.float64
THETAS = (15, 30, 60)  # degrees


class Measured(NamedTuple):
    """Energy per bin ``[fields, rows, columns]`` of 1 that arrives, and the share that bounced again ``[fields]``."""

    alpha: float
    steps: int
    theta: int
    once: Tensor  # after one bounce
    every: Tensor  # after any number
    again: Tensor  # the share of what leaves that bounced more than once


def measure(alpha: float, steps: list[int], fields: int, side: int, rays: int) -> list[Measured]:
    """All resolutions see the same fields and the same rays, so that they differ by their triangles alone."""
    found: dict[tuple[int, int], list[Any]] = {}
    began = time.perf_counter()
    for seed in range(fields):
        fine = heights(side, max(steps), torch.Generator().manual_seed(seed))
        for n in steps:
            mesh = surface(fine[:: max(steps) // n, :: max(steps) // n], n, alpha)
            for theta in THETAS:
                rng = torch.Generator().manual_seed(1000 + seed)
                found.setdefault((n, theta), []).append(_counts(mesh, side, math.radians(theta), rays, rng))
        print(f"alpha {alpha:g}: field {seed + 1} of {fields}, {time.perf_counter() - began:.0f} s", flush=True)
    return [Measured(alpha, n, theta, *map(torch.stack, zip(*rows, strict=True))) for (n, theta), rows in found.items()]


def _counts(mesh: tb.Mesh, side: int, theta: float, rays: int, generator: torch.Generator) -> tuple[Tensor, Tensor, Tensor]:
    origin, wi = arriving(mesh, side, theta, rays, generator)
    wo, bounces = trace(mesh, origin, wi)
    once, every = (histogram(wo, wi, left / rays) for left in (bounces == 1, bounces > 0))
    return once, every, (bounces > 1).sum() / (bounces > 0).sum()


def deviation(bins: Tensor, law: Tensor, where: Tensor) -> tuple[float, float, float, float]:
    """In percent, where ``where``: of the sum, and its standard error; of the bins by themselves (rms), and their standard error (rms)."""
    part, wanted = coarse(bins)[:, where], coarse(law)[where]
    total, each = part.sum(-1) / wanted.sum() - 1.0, part / wanted - 1.0
    rows = math.sqrt(bins.shape[0])
    rms = (x.square().mean().sqrt() for x in (each.mean(0), each.std(0) / rows))
    return tuple(100.0 * float(x) for x in (total.mean(), total.std() / rows, *rms))


def laws(alpha: float) -> tuple[tb.RoughConductor, tb.RoughConductor]:
    """What one bounce is compared with, and what all are compared with."""
    law = tb.RoughConductor(torch.tensor([alpha], dtype=REAL), distribution="beckmann")
    return law, law.replace(energy="conserving")


def table(results: list[Measured], alpha: float | None = None) -> list[dict[str, Any]]:
    """Print a line for each resolution and angle, against the law of ``alpha`` (that of the surface); and return them."""
    print("\n                                one bounce, law of Smith: off by %             several bounces, %      all, conserving: %")
    print("alpha theta_i steps bins  sum (s.e.)    per bin (s.e.) | near light  beyond 60 | measured (s.e.)  law    sum (s.e.)    per bin")
    return [_line(m, *laws(m.alpha if alpha is None else alpha)) for m in results]


def _line(m: Measured, single: tb.RoughConductor, conserving: tb.RoughConductor) -> dict[str, Any]:
    theta = math.radians(m.theta)
    once, every = (predicted(law, theta) for law in (single, conserving))
    where = compared(theta)
    near = from_light(theta) <= 30.0
    near[60 // (3 * STEP) :] = False
    beyond = torch.zeros_like(where)
    beyond[60 // (3 * STEP) :] = True
    wi = torch.tensor([math.sin(theta), 0.0, math.cos(theta)], dtype=REAL)
    lost = 100.0 * (1.0 - float(single.directional_albedo(wi)))
    again, error = 100.0 * float(m.again.mean()), 100.0 * float(m.again.std()) / math.sqrt(len(m.again))
    a, b, c, d = (
        deviation(x, y, w) for x, y, w in ((m.once, once, where), (m.once, once, near), (m.once, once, beyond), (m.every, every, where))
    )
    print(
        f"{m.alpha:5g} {m.theta:7d} {m.steps:5d} {int(where.sum()):4d} {a[0]:5.2f} ({a[1]:.2f}) {a[2]:9.2f} ({a[3]:.2f}) "
        f"| {b[0]:5.1f} ({b[1]:.1f}) {c[0]:5.1f} ({c[1]:.1f}) | {again:7.2f} ({error:.2f}) {lost:6.2f} {d[0]:6.2f} ({d[1]:.2f}) {d[2]:9.2f}"
    )
    return {
        "alpha": m.alpha,
        "theta": m.theta,
        "steps": m.steps,
        "once": a,
        "near": b,
        "beyond": c,
        "all": d,
        "again": (again, error, lost),
    }


def picture(results: list[Measured], file: Path) -> None:
    """Left: the plane of incidence, measured (dots) and law (lines). Right: how far each bin is off, by its angle to the light."""
    from matplotlib.figure import Figure

    results = [m for m in results if m.steps == max(m.steps for m in results)]
    alphas = sorted({m.alpha for m in results})
    figure = Figure(figsize=(11, 4.2 * len(alphas)), layout="constrained")
    axes = figure.subplots(len(alphas), 2, squeeze=False)
    for m in results:
        row, color = axes[alphas.index(m.alpha)], f"C{THETAS.index(m.theta)}"
        _plane(row[0], m, color)
        _residual(row[1], m, color)
    for (left, right), alpha in zip(axes, alphas, strict=True):
        left.set(title=f"alpha = {alpha:g}: energy by angle, in the plane of incidence", xlabel="theta_o, degrees; light on the left")
        right.set(title="one bounce: measured / law - 1", xlabel="least angle to the light, degrees", ylim=(-0.4, 0.4))
        left.legend(fontsize=8)
        right.legend(fontsize=8)
        right.axhline(0.0, color="grey", lw=0.8)
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=80)


def _plane(axis: Any, m: Measured, color: str) -> None:
    angle = torch.arange(0.5 * STEP, 90.0, STEP)
    angle = torch.cat([-angle.flip(0), angle])
    single, conserving = (predicted(law, math.radians(m.theta)) for law in laws(m.alpha))
    for bins, style in ((single, "-"), (conserving, "--"), (m.once.mean(0), "."), (m.every.mean(0), "x")):
        label = f"theta_i = {m.theta}" if style == "-" else None
        axis.plot(angle, torch.cat([bins[:, 0].flip(0), bins[:, -1]]), style, color=color, ms=5, lw=1.2, label=label)


def _residual(axis: Any, m: Measured, color: str) -> None:
    law, part = coarse(predicted(laws(m.alpha)[0], math.radians(m.theta))), coarse(m.once)
    seen = law > 1e-4  # less, and there are no rays
    off, error = part.mean(0) / law - 1.0, part.std(0) / law / math.sqrt(len(part))
    angle, held = from_light(math.radians(m.theta)), compared(math.radians(m.theta))
    for where, face in ((seen & held, color), (seen & ~held, "none")):
        label = f"theta_i = {m.theta}, {'compared' if face == color else 'beyond'}"
        axis.errorbar(angle[where], off[where], error[where], fmt="o", color=color, mfc=face, ms=4, lw=0.8, label=label)


def main(argv: list[str] | None = None) -> list[dict[str, Any]]:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--alpha", type=float, nargs="+", default=[0.5])
    parser.add_argument("--steps", type=int, nargs="+", default=[10], help="of the mesh to a correlation length; each divides the largest")
    parser.add_argument("--fields", type=int, default=8, help="independent surfaces, at least 2; standard errors are from their spread")
    parser.add_argument("--side", type=int, default=40, help="of a period of the surface, in correlation lengths")
    parser.add_argument("--rays", type=int, default=200_000, help="for each surface, resolution and angle")
    parser.add_argument("--out", type=Path, default=Path("out/height_field.png"))
    args = parser.parse_args(argv)
    if args.fields < 2 or any(max(args.steps) % n for n in args.steps):
        parser.error(f"found --fields {args.fields} and --steps {args.steps}; take 2 fields or more, and steps that divide the largest")
    results = [m for alpha in args.alpha for m in measure(alpha, args.steps, args.fields, args.side, args.rays)]
    rows = table(results)
    picture(results, args.out)
    print(f"wrote {args.out}")
    return rows


if __name__ == "__main__":
    main()
