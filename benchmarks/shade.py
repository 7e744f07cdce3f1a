"""What `shade` costs beside textbook code: Lambert + Schlick * Phong at one million pixels, one point light, float32.

    python benchmarks/shade.py [--side 1024] [--repeat 15] [--threads 2]

The rival is competent eager PyTorch on interleaved [N, 3] memory: the same G-buffer, mask and light. Values and gradients are
checked to agree to 1e-5 before anything is timed, all of them in float64 and 99 % of them in the float32 that is timed
(there the textbook's own rounding passes 1e-5 in a few pixels). Rivals are interleaved, so that a noisy machine disturbs all
alike; medians and ratios are printed (ratios hold from machine to machine, milliseconds do not).
"""

import argparse
import math
import os
import statistics
import sys
import time
from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor
from tqdm import tqdm

import torchbrdf as tb

# glibc is told to keep what is freed: else every rival's time is mostly page faults, more or fewer as it happens to trim.
ALLOCATOR = {"MALLOC_TRIM_THRESHOLD_": str(2**33), "MALLOC_MMAP_THRESHOLD_": str(2**25), "MALLOC_TOP_PAD_": str(2**28)}
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


def dot(a: Tensor, b: Tensor) -> Tensor:
    return (a * b).sum(-1, keepdim=True)


def reflected(w: Tensor, n: Tensor) -> Tensor:
    return 2 * dot(w, n) * n - w


def schlick(f0: Tensor, cosine: Tensor) -> Tensor:
    return f0 + (1 - f0) * (1 - cosine).clamp(0, 1) ** 5


def phong(specular: Tensor, exponent: Tensor, n: Tensor, wi: Tensor, wo: Tensor) -> Tensor:
    return specular * (exponent + 2) / (2 * math.pi) * dot(reflected(wo, n), wi).clamp_min(1e-6) ** exponent


def textbook(s: dict[str, Tensor]) -> Tensor:
    """What a competent user pastes. It normalises what `shade` normalises: normals, views, directions to the light."""
    n, wo = F.normalize(s["normal"], dim=-1), F.normalize(s["view"], dim=-1)
    to_light = torch.tensor(LIGHT, dtype=n.dtype) - s["position"]
    wi, r2 = F.normalize(to_light, dim=-1), dot(to_light, to_light)
    h = F.normalize(wi + wo, dim=-1)
    f = s["albedo"] / math.pi + schlick(s["f0"], dot(wi, h)) * phong(s["specular"], s["exponent"], n, wi, wo)
    cos_i, cos_o = dot(n, wi), dot(n, wo)
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
    if not ALLOCATOR.items() <= os.environ.items():
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, **ALLOCATOR})
    main()
