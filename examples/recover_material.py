"""Recover a material from photographs: albedo, specular strength, exponent, index of refraction; or a metal's roughness and colour.

    python examples/recover_material.py                                # a scene of its own, made, rendered and recovered
    python examples/recover_material.py --scene scene.json --material lambert

Writes `sheet.png` (target, start, recovered, error x 10, loss), `material.json` and the recovered textures to --out. The format
of scene files stands in docs/recover.md.
"""

import argparse
import time
from pathlib import Path
from typing import Any

import torch
from recovery import builtin, scene_file
from recovery.confidence import Confidence
from recovery.fit import ITERATIONS, Model, fit
from recovery.problem import MODELS, Problem, make_material
from recovery.sheet import render, save_material, save_sheet
from torch import Tensor, nn

import torchbrdf as tb


def quantities(material: nn.Module, lights: nn.Module, shown: Tensor | None) -> dict[str, Tensor]:
    """The numbers that the report is about, differentiable; a texture counts through the mean of its shown texels."""
    found: dict[str, Tensor] = {}
    for name, module in (*material.named_modules(), *lights.named_modules()):
        if not (isinstance(module, tb.nn.Learned | tb.nn.Texture)):
            continue
        *_, owner, label = ["", *name.split(".")]
        label = f"{owner} {label}" if owner.startswith("light ") else label
        axes = "xyz" if label.endswith(("position", "direction")) else "RGB"
        value = module.value if isinstance(module, tb.nn.Learned) else module.value[shown].mean(0)
        parts = value.reshape(-1)
        found |= {f"{label} {axes[k]}": p for k, p in enumerate(parts)} if len(parts) == 3 else {label: parts[0]}
    return found


def shown_texels(texture: tb.nn.Texture, points: list[Any], noise: float) -> Tensor:
    """Texels with the footprints of at least two measured, bright pixel-light pairs on them, bool [Ht, Wt]."""
    probe = tb.nn.Texture(torch.zeros_like(texture.raw[..., :1]), wrap=texture.wrap)
    for p in points:
        bright = p.image.sum(-1, keepdim=True) > 4 * noise
        (probe(p.g) * bright).sum().backward()
    return probe.raw.grad[..., 0] > 2


def true_values(problem: Problem, shown: Tensor | None) -> dict[str, float]:
    found: dict[str, float] = {}
    for name, value in problem.truth.items():
        parts = (value[shown].mean(0) if value.dim() == 3 else value).reshape(-1).tolist()
        found |= {f"{name} {'RGB'[k]}": p for k, p in enumerate(parts)} if len(parts) == 3 else {name: parts[0]}
    return found


def report(truth: dict[str, float], start: dict[str, float], recovered: dict[str, Tensor], sure: dict[str, float]) -> list[dict[str, Any]]:
    """Print truth | start | recovered | error | confidence; eta's error is that of eta - 1, which is what reflects.

    Errors are relative to the truth, and absolute where the truth is 0.
    """
    print(f"\n{'':<20}{'truth':>10}{'start':>10}{'recovered':>11}{'error':>9}   confidence (1 sigma)")
    rows = []
    for name, value in recovered.items():
        got, true = float(value.detach()), truth.get(name)
        size = None if true is None else abs(true - 1 if name == "eta" else true)
        error = None if true is None else abs(got - true) / (size or 1.0)
        rows.append({"name": name, "truth": true, "start": start[name], "recovered": got, "error": error, "sigma": sure[name]})
        truly = "         -" if true is None else f"{true:10.4f}"
        off = "      -" if error is None else f"{error:8.2%}" if size else f"{error:8.4f}"
        print(f"{name:<20}{truly}{start[name]:10.4f}{got:11.4f}{off:>8}   +- {sure[name]:.5f}")
    return rows


def recover(
    problem: Problem, model: str, texels: int, iterations: int | None, out: Path, quiet: bool = False, optimizer: str = "gauss-newton"
) -> list[dict[str, Any]]:
    """Fit, report and write; returns the rows of the report."""
    material = make_material(model, texels, problem.start).double()
    view = problem.views[0]
    print(tb.plan(view.g, material(view.g), problem.lights(view.g), visibility=view.visibility))
    points = [p for v in problem.views for p in v.points()]
    shown = next((shown_texels(m, points, problem.noise or 0.0) for m in material.modules() if isinstance(m, tb.nn.Texture)), None)
    print(f"{sum(len(p.image) for p in points)} lit pixels in {len(points)} photographs")
    started = {k: float(v.detach()) for k, v in quantities(material, problem.lights, shown).items()}
    first = render(material, problem, view)
    both = Model(material, problem, tb.plan(points[0].g, material(points[0].g), problem.lights.one(points[0].g, 0)))
    history = fit(both, points, iterations, optimizer)
    print(f"{optimizer}: {len(history) - 1} iterations, {history[-1].seconds:.1f} s")
    sure = Confidence(both, points)
    recovered = quantities(material, problem.lights, shown)
    truth = true_values(problem, shown)
    rows = report(truth, started, recovered, {k: sure.of(v) for k, v in recovered.items()})
    rows += _texel_error(material, problem, shown)
    if model == "conductor":
        print("f0 is the reflectance at normal incidence; n and k, many pairs of which give it, are not identifiable from photographs")
    if not quiet:
        out.mkdir(parents=True, exist_ok=True)
        save_sheet(out / "sheet.png", view, first, render(material, problem, view), [step.loss for step in history])
        save_material(out, material, rows)
        print(f"\nwrote {out / 'sheet.png'}, {out / 'material.json'} and the recovered textures")
    return rows


def _texel_error(material: nn.Module, problem: Problem, shown: Tensor | None) -> list[dict[str, Any]]:
    """Mean relative error over the shown texels, where the true texture is known."""
    truth = problem.truth.get("albedo")
    texture = next((m for m in material.modules() if isinstance(m, tb.nn.Texture)), None)
    if texture is None or shown is None or truth is None or truth.dim() != 3:
        return []
    shown = shown & (truth > 0).all(-1)  # relative to a black texel there is no error
    if not shown.any():
        return []
    error = float(((texture.value.detach() - truth).abs() / truth)[shown].mean())
    print(f"texel by texel: mean error {error:.2%} over the {int(shown.sum())} of {shown.numel()} texels that the images show")
    return [{"name": "albedo texels", "error": error}]


def main(argv: list[str] | None = None) -> list[dict[str, Any]]:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", type=Path, help="a scene file; without one, a scene is made")
    parser.add_argument("--material", default="lambert", help="which images of the scene file to use")
    parser.add_argument(
        "--model", choices=MODELS, help="default: lambert for images of that name, conductor for those whose alpha is known, else glossy"
    )
    parser.add_argument("--texels", type=int, default=0, help="side of the albedo texture; 0: one colour")
    parser.add_argument("--shadow", choices=("auto", "off"), default="auto", help="off: ignore cast shadows, use the whole mask")
    parser.add_argument("--seed", type=int, default=0, help="of the scene that is made")
    parser.add_argument("--optimizer", choices=tuple(ITERATIONS), default="gauss-newton")
    parser.add_argument("--iterations", type=int, help=f"at most; default: {', '.join(f'{n} ({k})' for k, n in ITERATIONS.items())}")
    parser.add_argument("--out", type=Path, default=Path("out/recover_material"))
    args = parser.parse_args(argv)
    began = time.perf_counter()
    if args.scene is None:
        problem = builtin.build(args.seed)
        angle = builtin.largest_half_angle(problem)
        print(f"seed {args.seed}: {len(builtin.ANGLES)} lights, noise {problem.noise:.2g}, angle(wi, h) up to {angle:.0f} degrees")
        rows = recover(problem, "glossy", builtin.TEXELS, args.iterations, args.out, optimizer=args.optimizer)
    else:
        problem = scene_file.load(args.scene, args.material, args.shadow)
        model = args.model or ("lambert" if args.material == "lambert" else "conductor" if "alpha" in problem.truth else "glossy")
        rows = recover(problem, model, args.texels, args.iterations, args.out, optimizer=args.optimizer)
    print(f"{time.perf_counter() - began:.1f} s")
    return rows


if __name__ == "__main__":
    main()
