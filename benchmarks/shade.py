"""What `shade` costs beside textbook code: Lambert + Schlick * Phong at one million pixels, one point light, float32.

    python benchmarks/shade.py [--points 1000000] [--rounds 15] [--threads 2] [--write]

The rival is competent eager PyTorch on interleaved [N, 3] memory: the same G-buffer, mask and light. Values and gradients are
checked to agree to 1e-5 before anything is timed, all of them in float64 and 99 % of them in the float32 that is timed
(there the textbook's own rounding passes 1e-5 in a few pixels). "Bare formula" is what is left of `shade` when unit vectors are
given and there is no light, no mask and no plan: benchmarks/formulas.py checks and times it by itself.
"""

import math
from collections.abc import Callable
from functools import partial

import torch
import torch.nn.functional as F
import workloads
from common import Race, comparison, machine, need_agreement, options, publish, race, steady
from torch import Tensor

import torchbrdf as tb

LIGHT, INTENSITY = (1.5, 2.0, 3.0), (20.0, 18.0, 16.0)
FORWARD, BOTH = "forward", "forward + backward"


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


def material(s: dict[str, Tensor]) -> tb.Bsdf:
    return tb.Lambert(s["albedo"]) + tb.Phong(s["specular"], s["exponent"], fresnel=tb.Schlick(s["f0"]))


def gbuffer(s: dict[str, Tensor]) -> tb.GBuffer:
    return tb.GBuffer(position=s["position"], normal=s["normal"], view=s["view"], mask=s["mask"])


def ours(s: dict[str, Tensor]) -> Tensor:
    return tb.shade(gbuffer(s), material(s), tb.PointLight(LIGHT, INTENSITY))


def bare_scene(s: dict[str, Tensor]) -> dict[str, Tensor]:
    """The unit vectors that `shade` computes, given."""
    wi = F.normalize(torch.tensor(LIGHT, dtype=s["position"].dtype) - s["position"], dim=-1)
    return {"wi": tb.planar(wi), "wo": s["view"], **{name: s[name] for name in LEARNED}}


def with_gradients(fn: Callable[[dict[str, Tensor]], Tensor], s: dict[str, Tensor]) -> dict[str, Tensor]:
    leaves = {k: v.detach().requires_grad_(k in LEARNED) for k, v in s.items()}
    out = fn(leaves)
    return {"radiance": out.detach(), **dict(zip(LEARNED, torch.autograd.grad(out.sum(), [leaves[k] for k in LEARNED]), strict=True))}


Rivals = dict[str, tuple[Callable[[dict[str, Tensor]], Tensor], dict[str, Tensor]]]


def rivals(side: int, dtype: torch.dtype) -> Rivals:
    interleaved = scene(side, dtype)
    flat = {k: tb.planar(v) for k, v in interleaved.items()}
    return {"textbook eager": (textbook, interleaved), "ours eager": (ours, flat), "ours compiled": (tb.compile(ours), flat)}


def agreed(found: Rivals, part: float) -> Rivals:
    """The same, checked: part of all values and gradients agrees with the textbook to 1e-5 of their magnitude plus the mean one."""
    truth = with_gradients(*found["textbook eager"])
    for name, (fn, s) in found.items():
        need_agreement(name, with_gradients(fn, s), truth, part)
    return found


def no_grad(fn: Callable[[dict[str, Tensor]], Tensor], s: dict[str, Tensor]) -> Tensor:
    with torch.no_grad():
        return fn(s)


def main() -> None:
    args = options(__doc__, points=1_000_000, rounds=15).parse_args()
    torch.set_num_threads(args.threads)
    side = round(math.sqrt(args.points))
    print("shade: differences from the textbook")
    agreed(rivals(256, torch.float64), 1.0)
    torch.compiler.reset()
    found = agreed(rivals(side, torch.float32), 0.99)
    bare = "ours compiled, bare formula"
    found[bare] = (tb.compile(workloads.ours("W1")), bare_scene(found["ours compiled"][1]))
    runs: Race = {(name, FORWARD): partial(no_grad, *r) for name, r in found.items()}
    runs |= {(name, BOTH): partial(with_gradients, *r) for name, r in found.items()}
    head = f"{side} × {side} pixels, one point light, {args.rounds} rounds, {machine(args.threads)}. Medians, quartiles in brackets."
    text = comparison(race(runs, args.rounds, "shade"), [FORWARD, BOTH], "textbook eager", bare)
    publish("shade", f"{head}\n\n{text}", args.write)


if __name__ == "__main__":
    steady()
    main()
