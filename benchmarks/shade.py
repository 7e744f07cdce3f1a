"""What `shade` costs beside textbook code: Lambert + Schlick * Phong at one million pixels, one point light, float32.

    python benchmarks/shade.py [--side 1024] [--repeat 15] [--threads 2]

The rival is competent eager PyTorch on interleaved [N, 3] memory: the same G-buffer, mask and light. Values and gradients are
checked to agree to 1e-5 before anything is timed, all of them in float64 and 99 % of them in the float32 that is timed
(there the textbook's own rounding passes 1e-5 in a few pixels); rivals are interleaved, so that a noisy machine disturbs all alike; medians
and ratios are printed (ratios hold from machine to machine, milliseconds do not).
"""

import argparse
import math
import statistics
import time
from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor
from tqdm import tqdm

import torchbrdf as tb

LIGHT, INTENSITY = (1.5, 2.0, 3.0), (20.0, 18.0, 16.0)


def scene(side: int, dtype: torch.dtype) -> dict[str, Tensor]:
    """A bumpy sheet seen from above, with every material parameter varying from pixel to pixel."""
    gen = torch.Generator().manual_seed(0)
    axis = torch.linspace(-1, 1, side, dtype=dtype)
    y, x = torch.meshgrid(axis, axis, indexing="ij")
    position = torch.stack([x, y, 0.1 * torch.sin(5 * x) * torch.cos(4 * y)], -1)
    bump = 0.5 * torch.randn(side, side, 3, generator=gen, dtype=dtype)
    normal = F.normalize(torch.stack([-torch.sin(3 * x), torch.cos(2 * y) - 1, torch.ones_like(x)], -1) + 0.3 * bump, dim=-1)
    view = F.normalize(torch.tensor([0.0, 0.5, 4.0], dtype=dtype) - position, dim=-1)

    def rand(c: int) -> Tensor:
        return torch.rand(side, side, c, generator=gen, dtype=dtype)

    return {
        "position": position, "normal": normal, "view": view, "mask": x[..., None] ** 2 + y[..., None] ** 2 < 1.1,
        "albedo": rand(3), "specular": rand(3), "exponent": 2 + 60 * rand(1), "f0": 0.02 + 0.3 * rand(3),
    }  # fmt: skip


LEARNED = ("albedo", "specular", "exponent", "f0", "normal")


def textbook(s: dict[str, Tensor]) -> Tensor:
    """What a competent user pastes."""
    n, v = F.normalize(s["normal"], dim=-1), s["view"]
    to_light = torch.tensor(LIGHT, dtype=n.dtype) - s["position"]
    r2 = (to_light * to_light).sum(-1, keepdim=True)
    wi = F.normalize(to_light, dim=-1)
    cos_i, cos_o = (n * wi).sum(-1, keepdim=True), (n * v).sum(-1, keepdim=True)
    cos_r = ((2 * cos_o * n - v) * wi).sum(-1, keepdim=True)
    h = F.normalize(wi + v, dim=-1)
    fresnel = s["f0"] + (1 - s["f0"]) * (1 - (wi * h).sum(-1, keepdim=True).clamp(0, 1)) ** 5
    lobe = (s["exponent"] + 2) / (2 * math.pi) * cos_r.clamp_min(1e-6) ** s["exponent"]
    f = s["albedo"] / math.pi + s["specular"] * fresnel * lobe
    radiance = f * cos_i * torch.tensor(INTENSITY, dtype=n.dtype) / r2
    return torch.where(s["mask"] & (cos_i > 0) & (cos_o > 0), radiance, 0.0)


def ours(s: dict[str, Tensor]) -> Tensor:
    g = tb.GBuffer(position=s["position"], normal=s["normal"], view=s["view"], mask=s["mask"])
    brdf = tb.Lambert(s["albedo"]) + tb.Phong(s["specular"], s["exponent"], fresnel=tb.Schlick(s["f0"]))
    return tb.shade(g, brdf, tb.PointLight(LIGHT, INTENSITY))


def with_gradients(fn: Callable[[dict[str, Tensor]], Tensor], s: dict[str, Tensor]) -> list[Tensor]:
    leaves = {k: v.detach().requires_grad_(k in LEARNED) for k, v in s.items()}
    out = fn(leaves)
    return [out.detach(), *torch.autograd.grad(out.sum(), [leaves[k] for k in LEARNED])]


Rivals = dict[str, tuple[Callable[[dict[str, Tensor]], Tensor], dict[str, Tensor]]]


def check(rivals: Rivals, part: float) -> None:
    """Stop unless a part of all values and gradients agrees with the textbook to 1e-5 of their magnitude plus the mean one."""
    truth = with_gradients(*rivals["textbook eager"])
    for name, (fn, s) in rivals.items():
        for what, a, b in zip(("radiance", *LEARNED), with_gradients(fn, s), truth, strict=True):
            difference = ((a - b).abs() / (b.abs() + b.abs().mean())).reshape(-1)
            worst = float(difference.kthvalue(max(1, round(part * difference.numel()))).values)
            print(f"  {name:<16} {what:<9} {str(a.dtype)[6:]} differs by {worst:.1e}")
            if not worst < 1e-5:
                raise SystemExit(f"{name}: {what} disagrees with the textbook; nothing was timed")


def time_once(fn: Callable[[], object]) -> float:
    start = time.perf_counter()
    fn()
    return (time.perf_counter() - start) * 1e3


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--side", type=int, default=1024)
    parser.add_argument("--repeat", type=int, default=15)
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    torch.set_num_threads(args.threads)

    def rivals(side: int, dtype: torch.dtype) -> Rivals:
        interleaved = scene(side, dtype)
        flat = {k: tb.planar(v) for k, v in interleaved.items()}
        return {"textbook eager": (textbook, interleaved), "ours eager": (ours, flat), "ours compiled": (tb.compile(ours), flat)}

    check(rivals(256, torch.float64), 1.0)
    torch.compiler.reset()
    contestants = rivals(args.side, torch.float32)
    check(contestants, 0.99)
    forward: dict[str, list[float]] = {k: [] for k in contestants}
    both: dict[str, list[float]] = {k: [] for k in contestants}
    for k in tqdm(range(args.repeat + 2), desc="rounds", leave=False):
        for name, (fn, s) in contestants.items():
            with torch.no_grad():
                f = time_once(lambda fn=fn, s=s: fn(s))
            b = time_once(lambda fn=fn, s=s: with_gradients(fn, s))
            if k >= 2:  # the first rounds compile and warm up
                forward[name].append(f)
                both[name].append(b)
    print(f"\n{args.side**2 / 1e6:.2f}M pixels, {args.threads} threads    forward            forward + backward")
    base_f, base_b = statistics.median(forward["textbook eager"]), statistics.median(both["textbook eager"])
    for name in contestants:
        f, b = statistics.median(forward[name]), statistics.median(both[name])
        print(f"{name:<16} {f:9.2f} ms  {base_f / f:5.1f}x   {b:9.2f} ms  {base_b / b:5.1f}x")


if __name__ == "__main__":
    main()
