"""What rough surfaces are made of, masking, visibility and D, and the ways to compute them (torchbrdf/method.py)."""

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from .. import numerics, vector
from ..method import Law, Method
from ..optics import beckmann, ggx, smith
from ..optics.distribution import Facet, Rough
from .laws import GRAZING, directions, inner, turned
from .rough_conductor import RoughConductor

ALPHAS, SMOOTH, DIMMEST = (0.1, 1.0), (0.005, 0.1), 1e-3
WHERE = "where D is above 1e-3 of its peak, alpha from 0.1 on"

# Masking by Beckmann's surface, of a cosine and alpha ------------------------------------------------------------------


def g1_textbook(m: Any, cos: Any, alpha: Any) -> Any:
    """``1 / (1 + Lambda)``, Heitz 2014, eq. 66; 1 straight from above."""
    slanted = m.positive(1 - cos * cos)
    return m.where(slanted, 1 / (1 + beckmann.textbook_lambda(m, m.where(slanted, cos, 0.5), alpha)), 1 + 0 * alpha)


def g1_by_length(cos: Tensor, alpha: Tensor) -> Tensor:
    """As the models have it, ``2 c / (c + c (1 + 2 Lambda))``."""
    (cos, alpha), dtype = numerics.working(cos, alpha)
    return numerics.rounded_back(2.0 * cos / (cos + beckmann.Beckmann.smith_length(cos, _projected2(cos, alpha))), dtype)


def g1_guarded(cos: Tensor, alpha: Tensor) -> Tensor:
    """``tb.microfacet.beckmann_g1``."""
    return smith.beckmann_g1(cos, numerics.safe_sqrt(_projected2(cos, alpha)))


def g1_walter(cos: Tensor, alpha: Tensor) -> Tensor:
    """By the rational fit of Lambda."""
    (cos, alpha), dtype = numerics.working(cos, alpha)
    return numerics.rounded_back(2.0 * cos / (cos + beckmann.walter_length(cos, _projected2(cos, alpha))), dtype)


def _projected2(cos: Tensor, alpha: Tensor) -> Tensor:
    return alpha * alpha * ((1.0 - cos) * (1.0 + cos))


# Visibility of GGX, G2 / (4 cos cos), of both cosines and alpha ---------------------------------------------------------


def visibility_textbook(m: Any, cos_l: Any, cos_v: Any, alpha: Any) -> Any:
    """Heitz 2014, eq. 72 and 99."""
    return 1 / (1 + ggx.textbook_lambda(m, cos_l, alpha) + ggx.textbook_lambda(m, cos_v, alpha)) / (4 * cos_l * cos_v)


def visibility(cos_l: Tensor, cos_v: Tensor, alpha: Tensor) -> Tensor:
    """As the models have it."""
    (cos_l, cos_v, alpha), dtype = numerics.working(cos_l, cos_v, alpha)
    by = ggx.GGX.smith_length
    both = cos_v * by(cos_l, _projected2(cos_l, alpha)) + cos_l * by(cos_v, _projected2(cos_v, alpha))
    return numerics.rounded_back(0.5 / both, dtype)


def visibility_guarded(cos_l: Tensor, cos_v: Tensor, alpha: Tensor) -> Tensor:
    """``tb.microfacet.ggx_visibility``."""
    sines = (alpha * numerics.safe_sqrt((1.0 - c) * (1.0 + c)) for c in (cos_l, cos_v))
    return smith.ggx_visibility(cos_l, next(sines), cos_v, next(sines))


def visibility_separable(cos_l: Tensor, cos_v: Tensor, alpha: Tensor) -> Tensor:
    """``G1 G1 / (4 cos cos)``."""
    by = ggx.GGX.smith_length
    return 1.0 / ((cos_l + by(cos_l, _projected2(cos_l, alpha))) * (cos_v + by(cos_v, _projected2(cos_v, alpha))))


def visibility_hammon(cos_l: Tensor, cos_v: Tensor, alpha: Tensor) -> Tensor:
    """Both square roots taken out: ``0.5 / lerp(2 l v, l + v, alpha)``."""
    return 0.5 / torch.lerp(2.0 * cos_l * cos_v, cos_l + cos_v, alpha)


def visibility_karis(cos_l: Tensor, cos_v: Tensor, alpha: Tensor) -> Tensor:
    """Schlick's G1 with k = alpha / 2."""
    k = 0.5 * alpha
    return 0.25 / ((cos_l * (1.0 - k) + k) * (cos_v * (1.0 - k) + k))


# D of GGX, from directions ----------------------------------------------------------------------------------------------


def ggx_d(wi: Tensor, wo: Tensor, n: Tensor, alpha: Tensor) -> Tensor:
    """As the models have it: the sine of the half vector by a cross product."""
    g = RoughConductor(alpha.unsqueeze(-1)).geometry(wi, wo, n)
    across = vector.cross(g.n, g.half)
    flat2 = vector.dot(across, across)
    wide = numerics.widen(alpha)
    facet = Facet(vector.dot(g.n, g.half), flat2, flat2 / (wide * wide), g.half2)
    return numerics.rounded_back(ggx.GGX.density(facet, Rough(wide, wide, True)), wi.dtype)


def ggx_d_bare(wi: Tensor, wo: Tensor, n: Tensor, alpha: Tensor) -> Tensor:
    """As pasted: of the squared cosine alone, which near the peak has lost the angle."""
    h = functional.normalize(functional.normalize(wi, dim=-1) + functional.normalize(wo, dim=-1), dim=-1)
    cos = (functional.normalize(n, dim=-1) * h).sum(-1)
    a2 = alpha * alpha
    q = cos * cos * (a2 - 1.0) + 1.0
    return a2 / (np.pi * q * q)


def draw(rng: Any, count: int, alphas: tuple[float, float] = ALPHAS) -> dict[str, Any]:
    """Directions whose half vectors are spread as the normals of the surface."""
    found: list[Any] = []
    while sum(map(len, found)) < count:
        found.append(_candidates(rng, 4 * count, alphas))
    rows = np.concatenate(found)[:count]
    return {"wi": rows[:, :3], "wo": rows[:, 3:6], "n": rows[:, 6:9], "alpha": rows[:, 9]}


def _candidates(rng: Any, count: int, alphas: tuple[float, float]) -> Any:
    alpha = np.exp(rng.uniform(*np.log(alphas), count))
    below = rng.uniform(0.0, 1.0 - np.sqrt(DIMMEST), count)
    wo, n = (directions(rng.normal(size=(count, 3))) for _ in range(2))
    wo *= np.sign(inner(wo, n))
    half = turned(rng, n, 1.0 / np.sqrt(1.0 + alpha * alpha * below / (1.0 - below)))
    wi = 2.0 * inner(half, wo) * half - wo
    keep = (inner(wi, n) > GRAZING) & (inner(wo, n) > GRAZING)
    return np.concatenate([wi, wo, n, alpha[:, None]], 1)[keep[:, 0]]


LAWS = (
    Law(
        "beckmann_g1",
        {"cos": (0.05, 1.0), "alpha": (0.05, 1.0)},
        g1_textbook,
        (
            Method(
                "standard", g1_by_length, 'tb.RoughConductor(alpha, f, "beckmann")', "Smith 1967; Heitz 2014, eq. 66", "16 ulp everywhere"
            ),
            Method(
                "guarded",
                g1_guarded,
                "tb.microfacet.beckmann_g1(cos, alpha_sin)",
                "the same; quotients of the smaller by the larger",
                "16 ulp everywhere",
            ),
            Method(
                "Walter",
                g1_walter,
                'tb.RoughConductor(alpha, f, "beckmann", smith="walter")',
                "Walter et al. 2007, eq. 27",
                "0.0033 everywhere",
                exact=False,
            ),
        ),
    ),
    Law(
        "ggx_visibility",
        {"cos_l": (0.05, 1.0), "cos_v": (0.05, 1.0), "alpha": (0.05, 1.0)},
        visibility_textbook,
        (
            Method(
                "standard",
                visibility,
                "tb.RoughConductor(alpha, f)",
                "Heitz 2014, eq. 72 and 99; Lagarde & de Rousiers 2014",
                "16 ulp everywhere",
            ),
            Method(
                "guarded",
                visibility_guarded,
                "tb.microfacet.ggx_visibility(cos_i, alpha_sin_i, cos_o, alpha_sin_o)",
                "the same; scaled against overflow",
                "16 ulp everywhere",
            ),
            Method(
                "separable",
                visibility_separable,
                'tb.RoughConductor(alpha, f, shadowing="smith_separable")',
                "Smith 1967; Walter et al. 2007, eq. 34",
                "0.75 of the value everywhere",
                exact=False,
            ),
            Method(
                "Hammon",
                visibility_hammon,
                "0.5 / torch.lerp(2 * cos_l * cos_v, cos_l + cos_v, alpha)",
                "Hammon 2017",
                "0.3 of the value everywhere",
                exact=False,
            ),
            Method(
                "Karis",
                visibility_karis,
                "Schlick's G1 of both, k = alpha / 2, over 4 cos_l cos_v",
                "Karis 2013, of Schlick 1994",
                "0.75 of the value everywhere",
                exact=False,
            ),
        ),
    ),
    Law(
        "ggx_d",
        {"alpha": ALPHAS},
        lambda m, p, alpha: ggx.textbook_d(m, p.cos2_h, alpha),
        (
            Method(
                "standard",
                ggx_d,
                "tb.RoughConductor(alpha, f)",
                "Walter et al. 2007, eq. 33; |n x h| by a cross product",
                f"1e-5 of the value {WHERE}",
            ),
            Method(
                "squared cosine",
                ggx_d_bare,
                "alpha**2 / (pi * (cos_h**2 * (alpha**2 - 1) + 1) ** 2)",
                "as pasted",
                f"1e-4 of the value {WHERE}",
            ),
        ),
        ("wi", "wo", "n"),
        draw,
        hard=lambda rng, count: draw(rng, count, SMOOTH),
        hard_where="alpha from 0.005 to 0.1",
    ),
)
