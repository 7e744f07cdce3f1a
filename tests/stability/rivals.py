"""The same formulas as others write them: competent textbook torch, and Mitsuba. For comparison alone."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from .case import Case
from .measure import Figures, compare, run
from .truth import truth_of

# ---- textbook: what shading code in torch commonly says, with its usual clamps


def dielectric(c: Tensor, eta: Tensor) -> list[Tensor]:
    c = c.clamp(0, 1)
    sin2_t = (1 - c * c) / (eta * eta)
    cos_t = torch.sqrt((1 - sin2_t).clamp(min=0))
    r_s, r_p = (c - eta * cos_t) / (c + eta * cos_t), (eta * c - cos_t) / (eta * c + cos_t)
    return [torch.where(sin2_t >= 1, torch.ones_like(c), 0.5 * (r_s * r_s + r_p * r_p))]


def conductor(c: Tensor, eta: Tensor, k: Tensor) -> list[Tensor]:
    """Lagarde's form, as in many renderers."""
    c2 = c.clamp(0, 1) ** 2
    s2, eta2, k2 = 1 - c2, eta * eta, k * k
    t0 = eta2 - k2 - s2
    both = torch.sqrt(t0 * t0 + 4 * eta2 * k2)
    t1, a = both + c2, torch.sqrt(0.5 * (both + t0))
    t2 = 2 * c.clamp(0, 1) * a
    r_s = (t1 - t2) / (t1 + t2)
    t3, t4 = c2 * both + s2 * s2, t2 * s2
    return [0.5 * r_s * (1 + (t3 - t4) / (t3 + t4))]


def schlick(c: Tensor, f0: Tensor) -> list[Tensor]:
    return [f0 + (1 - f0) * (1 - c.clamp(0, 1)) ** 5]


def ggx_d(c: Tensor, s2: Tensor, alpha: Tensor) -> list[Tensor]:
    a2 = alpha * alpha
    below = c * c * (a2 - 1) + 1
    return [torch.where(c > 0, a2 / (math.pi * below * below), torch.zeros_like(c))]


def beckmann_d(c: Tensor, s2: Tensor, alpha: Tensor) -> list[Tensor]:
    c2, a2 = c * c, alpha * alpha
    return [torch.where(c > 0, torch.exp(-(1 - c2) / (c2 * a2)) / (math.pi * a2 * c2 * c2), torch.zeros_like(c))]


def ggx_lambda(c: Tensor, a: Tensor) -> Tensor:
    return 0.5 * (torch.sqrt(1 + (a / c) ** 2) - 1)


def ggx_g1(c: Tensor, a: Tensor) -> list[Tensor]:
    return [torch.where(c > 0, 1 / (1 + ggx_lambda(c, a)), torch.zeros_like(c))]


def ggx_g2(ci: Tensor, ai: Tensor, co: Tensor, ao: Tensor) -> list[Tensor]:
    return [torch.where((ci > 0) & (co > 0), 1 / (1 + ggx_lambda(ci, ai) + ggx_lambda(co, ao)), torch.zeros_like(ci))]


def beckmann_g1(c: Tensor, a: Tensor) -> list[Tensor]:
    nu = c / a
    value = 0.5 * (torch.erf(nu) - 1) + torch.exp(-nu * nu) / (2 * nu * math.sqrt(math.pi))
    return [torch.where(c > 0, 1 / (1 + value), torch.zeros_like(c))]


def phong_lobe(m: Tensor, s: Tensor) -> list[Tensor]:
    return [(s + 2) / (2 * math.pi) * (1 - m).clamp(min=0) ** s]


def phong(*c: Tensor) -> list[Tensor]:
    wi, wo, n = (functional.normalize(torch.stack(c[k : k + 3], -1), dim=-1) for k in (0, 3, 6))
    cos_i, cos_o = (n * wi).sum(-1), (n * wo).sum(-1)
    mirror = 2 * cos_o[:, None] * n - wo
    value = c[9] * (c[10] + 2) / (2 * math.pi) * (mirror * wi).sum(-1).clamp(min=0) ** c[10]
    return [torch.where((cos_i > 0) & (cos_o > 0), value, torch.zeros_like(value))]


def normalize(*v: Tensor) -> Sequence[Tensor]:
    return functional.normalize(torch.stack(v, -1), dim=-1).unbind(-1)


def refract(*c: Tensor) -> Sequence[Tensor]:
    """As in GLSL."""
    w, n, ratio = torch.stack(c[:3], -1), torch.stack(c[3:6], -1), 1 / c[6]
    cos = (w * n).sum(-1)
    n = torch.where(cos[:, None] < 0, -n, n)
    cos = cos.abs()
    k = 1 - ratio * ratio * (1 - cos * cos)
    bent = -ratio[:, None] * w + (ratio * cos - torch.sqrt(k.clamp(min=0)))[:, None] * n
    return torch.where(k[:, None] < 0, torch.zeros_like(bent), bent).unbind(-1)


def lat_long(x: Tensor, y: Tensor, z: Tensor) -> list[Tensor]:
    return [torch.atan2(-x, z) / (2 * math.pi) + 0.5, torch.acos(y.clamp(-1, 1)) / math.pi]


TEXTBOOK: dict[str, Callable[..., Sequence[Tensor]]] = {
    "fresnel.dielectric": dielectric,
    "fresnel.conductor": conductor,
    "fresnel.schlick": schlick,
    "microfacet.ggx_d": ggx_d,
    "microfacet.beckmann_d": beckmann_d,
    "microfacet.ggx_g1": ggx_g1,
    "microfacet.ggx_g2": ggx_g2,
    "microfacet.beckmann_g1": beckmann_g1,
    "Phong lobe (modified)": phong_lobe,
    "Phong": phong,
    "normalize": normalize,
    "refract": refract,
    "EnvironmentMap coordinates": lat_long,
}

# rivals that take other arguments, so that their slopes are others: they know the angle from the cosine alone, or from a vector
OTHER_ARGUMENTS = ("microfacet.ggx_d", "microfacet.beckmann_d", "EnvironmentMap coordinates")

# ---- Mitsuba in float32, values and derivatives, where its LLVM back end can be loaded


def _mitsuba_formulas(mi: Any, dr: Any) -> dict[str, Callable[..., list[Any]]]:
    def distribution(kind: Any) -> Callable[..., list[Any]]:
        return lambda c, s2, alpha: [mi.MicrofacetDistribution(kind, alpha, alpha, False).eval(mi.Vector3f(dr.sqrt(s2), 0, c))]

    kinds = mi.MicrofacetType
    return {
        "fresnel.dielectric": lambda c, eta: [mi.fresnel(c, eta)[0]],
        "fresnel.refraction_cosine": lambda c, eta: [abs(mi.fresnel(c, eta)[1])],
        "fresnel.conductor": lambda c, eta, k: [mi.fresnel_conductor(c, dr.llvm.ad.Complex2f(eta, k))],
        "microfacet.ggx_d": distribution(kinds.GGX),
        "microfacet.beckmann_d": distribution(kinds.Beckmann),
    }


def textbook(case: Case, dtype: torch.dtype) -> Figures:
    """Figures of the textbook's form on the case's grid."""

    return run(case, dtype, TEXTBOOK[case.name], second=False)


def mitsuba() -> dict[str, Callable[..., list[Any]]]:
    """Mitsuba's formulas by the names of cases; none where its LLVM back end cannot be loaded."""
    try:
        import drjit as dr
        import mitsuba as mi

        mi.set_variant("llvm_ad_rgb")
        mi.Float([0.0])
    except ImportError:
        return {}
    return _mitsuba_formulas(mi, dr)


def mitsuba_figures(case: Case, formula: Callable[..., list[Any]]) -> Figures:
    """Figures of Mitsuba's float32 values and first derivatives on the case's grid."""
    import drjit as dr
    import mitsuba as mi

    columns = [mi.Float(np.ascontiguousarray(c, dtype=np.float32)) for c in truth_of(case, torch.float32).points.T]
    for c in columns:
        dr.enable_grad(c)
    outs = formula(*columns)
    dr.backward(dr.sum(outs[0]))
    return compare(
        case, torch.float32, [np.array(o, dtype=np.float64) for o in outs], [np.array(c.grad, dtype=np.float64) for c in columns], None
    )
