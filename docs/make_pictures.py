"""Make the pictures of docs/models.md: rows of spheres over the roughness.

    python docs/make_pictures.py            # all of them, into docs/images; minutes
    python docs/make_pictures.py RoughDielectric --samples 16

Each pixel is the mean of what its samples see of a studio: `bsdf.sample` draws directions, the studio says how bright they are.
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor

import torchbrdf as tb

HERE = Path(__file__).resolve().parent
ALPHAS = (0.03, 0.1, 0.2, 0.4, 0.7, 1.0)
SIDE, EDGE = 96, 1.08  # pixels of a sphere, and half the side of its picture in radii
EXPOSURE = 0.0
Row = Callable[[float], tb.Bsdf]


def gold() -> tb.Conductor:
    """By its measured index."""
    return tb.Conductor.named("Au")


# The picture of a model: a caption, and its rows, each a material by alpha.
PICTURES: dict[str, tuple[str, tuple[Row, ...]]] = {
    "RoughConductor": (
        f"gold, GGX, alpha from {ALPHAS[0]:g} to {ALPHAS[-1]:g}; below, brushed around the vertical axis, alpha_y a fifth of alpha_x",
        (
            lambda alpha: tb.RoughConductor(alpha, gold()),
            lambda alpha: tb.RoughConductor([alpha, 0.2 * alpha], gold()),
        ),
    ),
    "RoughDielectric": (
        f"glass of eta = 1.5, alpha from {ALPHAS[0]:g} to {ALPHAS[-1]:g}: what it reflects, and the studio through its first surface",
        (lambda alpha: tb.RoughDielectric(alpha, 1.5, mode="flux"),),
    ),
}


def sphere() -> tuple[Tensor, Tensor, Tensor]:
    """Normals ``[SIDE, SIDE, 3]`` of a sphere seen from far along z, tangents across the vertical axis y, and where it is."""
    axis = EDGE * (2.0 * (torch.arange(SIDE) + 0.5) / SIDE - 1.0)
    y, x = torch.meshgrid(-axis, axis, indexing="ij")
    inside = 1.0 - x * x - y * y
    n = torch.stack([x, y, inside.clamp_min(0.0).sqrt()], -1)
    return n, torch.stack([n[..., 2], torch.zeros_like(x), -x], -1), inside.unsqueeze(-1) > 0


def studio(w: Tensor) -> Tensor:
    """Radiance ``[..., 3]``: a floor, a wall that brightens upwards, a large soft box, a strip, a small lamp."""
    x, y, z = w.unbind(-1)
    wall = torch.where(y > 0, 0.25 + 0.35 * y, 0.12 - 0.05 * y)
    box = _soft(0.45 - (x / w[..., 2].abs().clamp_min(0.1) + 0.9).abs()) * _soft(0.5 - (y - 0.45).abs()) * (z > 0)
    strip = _soft(0.12 - (x - 0.75).abs()) * _soft(0.7 - (y - 0.1).abs()) * (z > -0.3)
    lamp = _soft(w @ tb.normalize(torch.tensor([0.1, 0.9, 0.55])) - 0.985)
    return (wall + 2.5 * box + 1.8 * strip + 6.0 * lamp).unsqueeze(-1) * torch.tensor([1.0, 0.98, 0.95])


def _soft(x: Tensor) -> Tensor:
    return torch.sigmoid(60.0 * x)


@torch.no_grad()
def ball(bsdf: tb.Bsdf, samples: int) -> Tensor:
    """One sphere ``[SIDE, SIDE, 3]`` on white."""
    n, tangent, there = sphere()
    wo = torch.tensor([0.0, 0.0, 1.0]).expand_as(n)
    u = torch.quasirandom.SobolEngine(3, scramble=True, seed=0).draw(samples)
    total = torch.zeros_like(n)
    for one in u:  # the same for all pixels: what is left of the error is smooth, and the file small
        s = bsdf.sample(wo, one.expand(SIDE, SIDE, 3), n, tangent)
        total += s.weight * studio(s.wi)
    return torch.where(there, total / samples, 1.0)


def picture(rows: tuple[Row, ...], samples: int) -> Tensor:
    """The rows below one another, alpha growing to the right."""
    return torch.cat([torch.cat([ball(row(alpha), samples) for alpha in ALPHAS], 1) for row in rows], 0)


def main() -> None:
    """Write all of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("models", nargs="*", default=list(PICTURES), help=f"of {', '.join(PICTURES)}; all, unless some are named")
    parser.add_argument("--samples", type=int, default=512, help="of each pixel")
    parser.add_argument("--out", type=Path, default=HERE / "images")
    args = parser.parse_args()
    for name in args.models:
        rows = PICTURES[name][1]
        file = args.out / f"model-{name}.png"
        tb.save_image(file, picture(rows, args.samples), exposure=EXPOSURE)
        print(f"wrote {file}, {file.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
