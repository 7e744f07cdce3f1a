"""The bare formulas that are timed: Lambert + a lobe, times the cosine, every parameter varying from point to point.

====  =============================  ===========================================================
name  Fresnel term, its parameters   lobe
====  =============================  ===========================================================
W1    Schlick: f0                    Phong
W1x   the exact dielectric: eta      Phong
W1c   the exact conductor: eta, k    Phong
W2    Schlick: f0                    GGX, height-correlated Smith
W2a   Schlick: f0                    the same, anisotropic, along a tangent
====  =============================  ===========================================================
"""

import math
from collections.abc import Callable
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

import torchbrdf as tb

Points = dict[str, Tensor]
DIRECTIONS = ("wi", "wo", "tangent")  # the rest is learned: all parameters, and the normal


def points(name: str, count: int, dtype: torch.dtype, exponent: tuple[float, float] = (2.0, 62.0)) -> Points:
    """Unit normals, directions mostly above the horizon and near one another's mirror images, and parameters; all ``[N, C]``."""
    gen = torch.Generator().manual_seed(0)

    def rand(c: int, low: float = 0.0, high: float = 1.0) -> Tensor:
        return low + (high - low) * torch.rand(count, c, generator=gen, dtype=torch.float64)

    n = F.normalize(torch.randn(count, 3, generator=gen, dtype=torch.float64), dim=-1)
    wo = F.normalize(n + 0.8 * F.normalize(torch.randn(count, 3, generator=gen, dtype=torch.float64), dim=-1), dim=-1)
    wi = F.normalize(2 * (n * wo).sum(-1, keepdim=True) * n - wo + 0.4 * torch.randn(count, 3, generator=gen, dtype=torch.float64), dim=-1)
    found = {"wi": wi, "wo": wo, "normal": n, "albedo": rand(3), "specular": rand(3), "exponent": rand(1, *exponent)}
    if name in ROUGH:
        rough = {"alpha": rand(ROUGH[name], 0.1, 0.6), "f0": rand(3, 0.02, 0.3)}
        found = {k: found[k] for k in ("wi", "wo", "normal", "albedo")} | rough | ({"tangent": rand(3, -1.0)} if name == "W2a" else {})
    elif name == "W1c":
        found |= {"eta": rand(3, 0.2, 3.0), "k": rand(3, 1.0, 6.0)}
    else:
        found |= {"eta": rand(3, 1.3, 2.0)} if name == "W1x" else {"f0": rand(3, 0.02, 0.3)}
    return {k: v.to(dtype) for k, v in found.items()}


class Torch:
    """The arithmetic of the textbook on interleaved tensors ``[N, 3]`` and ``[N, 1]``; benchmarks/drjit_rival.py has the other."""

    @staticmethod
    def dot(a: Tensor, b: Tensor) -> Tensor:
        return (a * b).sum(-1, keepdim=True)

    @staticmethod
    def normalize(a: Tensor) -> Tensor:
        return F.normalize(a, dim=-1)

    @staticmethod
    def cross(a: Tensor, b: Tensor) -> Tensor:
        return torch.linalg.cross(a, b)

    @staticmethod
    def pair(a: Tensor) -> tuple[Tensor, ...]:
        return a.split(1, -1)

    @staticmethod
    def sqrt(a: Tensor) -> Tensor:
        return a.clamp_min(0).sqrt()

    @staticmethod
    def power(a: Tensor, s: Tensor) -> Tensor:
        return a.clamp_min(1e-6) ** s

    @staticmethod
    def masked(mask: Tensor, a: Tensor) -> Tensor:
        return torch.where(mask, a, 0.0)


def schlick(m: Any, p: Any, c: Any) -> Any:
    x = 1 - c
    x2 = x * x
    return p["f0"] + (1 - p["f0"]) * (x2 * x2 * x)


def dielectric(m: Any, p: Any, c: Any) -> Any:
    eta = p["eta"]
    g = m.sqrt(eta * eta - 1 + c * c)
    a = (g - c) / (g + c)
    b = (c * (g + c) - 1) / (c * (g - c) + 1)
    return 0.5 * a * a * (1 + b * b)


def conductor(m: Any, p: Any, c: Any) -> Any:
    eta2, k2, c2 = p["eta"] * p["eta"], p["k"] * p["k"], c * c
    s2 = 1 - c2
    t0 = eta2 - k2 - s2
    a2_b2 = m.sqrt(t0 * t0 + 4 * eta2 * k2)
    a = m.sqrt(0.5 * (a2_b2 + t0))
    t1, t2 = a2_b2 + c2, 2 * c * a
    t3, t4 = c2 * a2_b2 + s2 * s2, t2 * s2
    r_s = (t1 - t2) / (t1 + t2)
    return 0.5 * r_s * (1 + (t3 - t4) / (t3 + t4))


TERMS: dict[str, Callable[[Any, Any, Any], Any]] = {"W1": schlick, "W1x": dielectric, "W1c": conductor}
ROUGH = {"W2": 1, "W2a": 2}  # numbers of roughness
NAMES = (*TERMS, *ROUGH)


def phong(m: Any, p: Any, cos_o: Any) -> Any:
    s = p["exponent"]
    return (s + 2) * (0.5 / math.pi) * m.power(m.dot(2 * cos_o * p["normal"] - p["wo"], p["wi"]), s)


def ggx(m: Any, p: Any, cos_i: Any, cos_o: Any, h: Any) -> Any:
    """D times the visibility, both as they are usually written."""
    a2, cos_h = p["alpha"] * p["alpha"], m.dot(p["normal"], h)
    q = cos_h * cos_h * (a2 - 1) + 1
    visible = cos_o * m.sqrt(cos_i * cos_i * (1 - a2) + a2) + cos_i * m.sqrt(cos_o * cos_o * (1 - a2) + a2)
    return a2 / (math.pi * q * q) * 0.5 / visible


def ggx_anisotropic(m: Any, p: Any, cos_i: Any, cos_o: Any, h: Any) -> Any:
    n, wi, wo = p["normal"], p["wi"], p["wo"]
    ax, ay = m.pair(p["alpha"])
    t = m.normalize(p["tangent"] - m.dot(p["tangent"], n) * n)
    b = m.cross(n, t)
    hx, hy, hz = m.dot(t, h) / ax, m.dot(b, h) / ay, m.dot(n, h)
    q = hx * hx + hy * hy + hz * hz
    ix, iy, ox, oy = ax * m.dot(t, wi), ay * m.dot(b, wi), ax * m.dot(t, wo), ay * m.dot(b, wo)
    visible = cos_o * m.sqrt(ix * ix + iy * iy + cos_i * cos_i) + cos_i * m.sqrt(ox * ox + oy * oy + cos_o * cos_o)
    return 0.5 / (math.pi * ax * ay * q * q * visible)


def textbook(name: str) -> Callable[[Any, Any], Any]:
    """What a good engineer writes, in an arithmetic ``m``: lean, on unit vectors, no care beyond clamps."""
    term = TERMS.get(name, schlick)

    def radiance(m: Any, p: Any) -> Any:
        n, wi, wo = p["normal"], p["wi"], p["wo"]
        cos_i, cos_o = m.dot(n, wi), m.dot(n, wo)
        h = m.normalize(wi + wo)
        fresnel = term(m, p, m.dot(wi, h))
        if name in ROUGH:
            lobe = fresnel * (ggx if name == "W2" else ggx_anisotropic)(m, p, cos_i, cos_o, h)
        else:
            lobe = p["specular"] * fresnel * phong(m, p, cos_o)
        return m.masked((cos_i > 0) & (cos_o > 0), (p["albedo"] * (1 / math.pi) + lobe) * cos_i)

    return radiance


def ours(name: str) -> Callable[[Points], Tensor]:
    """The same by torchbrdf: ``evaluate`` on unit vectors, times the cosine."""
    terms: dict[str, Callable[[Points], Any]] = {"W1x": lambda p: tb.Dielectric(p["eta"]), "W1c": lambda p: tb.Conductor(p["eta"], p["k"])}

    def radiance(p: Points) -> Tensor:
        fresnel = terms[name](p) if name in terms else tb.Schlick(p["f0"])
        lobe = tb.RoughConductor(p["alpha"], fresnel) if name in ROUGH else tb.Phong(p["specular"], p["exponent"], fresnel=fresnel)
        brdf = tb.Lambert(p["albedo"]) + lobe
        return brdf.evaluate(p["wi"], p["wo"], p["normal"], p.get("tangent"), assume_unit=True, cosine=True)

    return radiance
