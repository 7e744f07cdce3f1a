"""Whole models from directions: every registered BSDF, with each Fresnel term in its slot somewhere."""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch

import torchbrdf as tb

from ..case import Case, Columns, Draw
from ..dual import pi, plain, power, sqrt, where
from . import fresnel, lobes
from .fresnel import between
from .vectors import added, cross, directions, dot, everyday_point, names, no_half_vector, positive, scaled, stacked, unit

POINT = names("wi", "wo", "n")


class Point:
    """The exact invariants of one shading point."""

    def __init__(self, c: Any) -> None:
        wi, wo, n = (unit(v) for v in (c[:3], c[3:6], c[6:9]))
        self.cos_i, self.cos_o = dot(n, wi), dot(n, wo)
        self.lit = positive(self.cos_i) & positive(self.cos_o)
        self.same_side = positive(self.cos_i * self.cos_o)
        half = added(wi, wo)
        half2 = dot(half, half)
        self.there = positive(half2)
        length = sqrt(where(self.there, half2, 1))
        self.wi_h = where(self.there, length / 2, 0)
        side = cross(n, half)
        self.cos_h2 = where(self.there, 1 - dot(side, side) / where(self.there, half2, 1), 0)
        d = added(scaled(n, 2 * self.cos_o), scaled(half, -1))
        self.m = dot(d, d) / 2


def phong(p: Point, specular, exponent, normalization="modified"):
    return specular * lobes.lobe(p.m, exponent) * lobes.NORMALIZATION[normalization](exponent)


def blinn(p: Point, specular, exponent):
    alive = np.asarray(plain(p.cos_h2) > 0, dtype=bool)
    return specular * lobes.blinn_factor(exponent) * power(where(alive, p.cos_h2, 0), exponent / 2)


def rows_of(draw: Draw) -> int:
    return draw.points + draw.points // 50


def point_rows(draw: Draw) -> np.ndarray:
    """(wi, wo, n): anything; wi = wo, wi = -wo, the mirror direction and near it; the horizon and its neighbours, about the z axis."""
    rows = rows_of(draw)
    n = directions(draw, rows)
    n[::2] = [0.0, 0.0, 1.0]
    wi, wo = (_mostly_above(draw, directions(draw, rows), n) for _ in range(2))
    mirror = 2 * (n * wo).sum(1, keepdims=True) * n - wo
    near = mirror + draw.spread(rows, draw.info.eps, 1.0)[:, None] * directions(draw, rows)
    kind = draw.rng.integers(0, 20, rows)
    wi = np.select([(kind == 0)[:, None], (kind == 1)[:, None], (kind == 2)[:, None], (kind < 12)[:, None]], [wo, -wo, mirror, near], wi)
    special = draw.rng.choice([0.0, draw.denormal, -draw.denormal, draw.info.tiny, draw.info.eps, 1e-3], rows)
    on_axis = np.arange(rows) % 2 == 0
    wi[:, 2], wo[:, 2] = np.where(on_axis & (kind == 12), special, wi[:, 2]), np.where(on_axis & (kind == 13), special, wo[:, 2])
    most = 1e2 if draw.dtype == torch.float16 else 1e30
    lengths = np.where(draw.uniform(rows) < 0.05, 0.0, draw.spread(rows, 1 / most, most))[:, None]
    wi, wo, n = (np.where((kind == k)[:, None], w * lengths, w) for k, w in zip((14, 15, 16), (wi, wo, n), strict=True))
    return draw.rounded(np.concatenate([wi, wo, n], 1))


def _mostly_above(draw: Draw, w: np.ndarray, n: np.ndarray) -> np.ndarray:
    return w * np.where(((w * n).sum(1, keepdims=True) < 0) & (draw.uniform(len(w)) < 0.9)[:, None], -1, 1)


def with_parameters(draw: Draw, *columns: np.ndarray) -> np.ndarray:
    rows = point_rows(draw)
    return np.concatenate([rows, *[draw.rounded(c)[:, None] for c in columns]], 1)


def unit_interval(draw: Draw) -> np.ndarray:
    return draw.rng.choice([0.0, 1.0, -1.0], rows_of(draw), p=[0.05, 0.05, 0.9]) ** 2 * draw.uniform(rows_of(draw))


def exponent(draw: Draw) -> np.ndarray:
    drawn = draw.spread(rows_of(draw), 0.1, 30.0 if draw.half else 300.0)
    return np.where(draw.uniform(rows_of(draw)) < 0.05, draw.rng.choice(lobes.exponents(draw), rows_of(draw)), drawn)


def near_horizon(x: Columns) -> Any:
    """Closer to the horizon, where every model jumps, than the rounding of the directions."""
    wi, wo, n = (stacked(x, k) for k in ("wi", "wo", "n"))
    with np.errstate(all="ignore"):
        cosines = [np.abs((w * n).sum(1)) / np.linalg.norm(w, axis=1) / np.linalg.norm(n, axis=1) for w in (wi, wo)]
    exact = (np.abs(n) == 1).any(1)
    return ~exact & (np.minimum(*cosines) < 4e-7)


def lost_half_vector(x: Columns) -> Any:
    """Opposite directions, both in the horizon up to rounding: elsewhere one of them is below it and nothing is reflected."""
    wi, n = (stacked(x, k) / np.linalg.norm(stacked(x, k), axis=1, keepdims=True) for k in ("wi", "n"))
    return no_half_vector(x) & (np.abs((wi * n).sum(1)) < 1e-3)


def lobe_edge(x: Columns) -> Any:
    """Where Phong's lobe ends, or no half vector is left, up to rounding."""
    wi, wo, n = (stacked(x, k) / np.linalg.norm(stacked(x, k), axis=1, keepdims=True) for k in ("wi", "wo", "n"))
    mirror = 2 * (n * wo).sum(1, keepdims=True) * n - wo
    return np.abs((mirror * wi).sum(1)) < 1e-6


def model(
    name: str,
    parameters: dict[str, Callable[[Draw], np.ndarray]],
    make: Callable[..., Any],
    truth: Callable[..., Any],
    domain: str = "lit",
    **more: Any,
) -> Case:
    """A case of ``make(*parameters).evaluate(wi, wo, n)``, which is 0 outside a domain of :class:`Point`."""

    def call(*c):
        wi, wo, n = (torch.stack(c[k : k + 3], -1) for k in (0, 3, 6))
        return make(*(p.unsqueeze(-1) for p in c[9:])).evaluate(wi, wo, n).unbind(-1)

    def exact(*c):
        p = Point(c)
        return (where(getattr(p, domain), truth(p, *c[9:]), 0),)

    return Case(
        name,
        (*POINT, *parameters),
        call,
        exact,
        lambda draw: with_parameters(draw, *(column(draw) for column in parameters.values())),
        lambda x: everyday_point(x) & ~no_half_vector(x) & everyday_lobe(x),
        error="backward",
        vectors=True,
        outside={"at the horizon, up to rounding": near_horizon},
        **more,
    )


def everyday_lobe(x: Columns) -> Any:
    """Exponents of every day, and bright enough to be seen: above a thousandth of the peak."""
    coloured = np.min([x[k] for k in ("albedo", "specular") if k in x], 0) > 0.01
    if "exponent" not in x:
        return coloured
    wi, wo, n = (stacked(x, k) / np.linalg.norm(stacked(x, k), axis=1, keepdims=True) for k in ("wi", "wo", "n"))
    mirror = 2 * (n * wo).sum(1, keepdims=True) * n - wo
    cos = np.maximum((mirror * wi).sum(1), 1e-9)
    return between("exponent", 1.0, 200.0)(x) & (x["exponent"] * np.log(cos) > np.log(1e-3)) & coloured


def eta(draw: Draw) -> np.ndarray:
    return np.where(draw.uniform(rows_of(draw)) < 0.1, 1.0, draw.uniform(rows_of(draw), 1.2, 2.5))


def mirror(*c):
    """tint F(cos) above the horizon."""
    wo, n = unit(c[:3]), unit(c[3:6])
    cos = dot(n, wo)
    return (where(positive(cos), c[6] * fresnel.dielectric(where(positive(cos), cos, 1), c[7])[0], 0),)


def call_mirror(*c):
    wo, n = torch.stack(c[:3], -1), torch.stack(c[3:6], -1)
    return tb.Mirror(c[6].unsqueeze(-1), tb.Dielectric(c[7].unsqueeze(-1))).directional_albedo(wo, n).unbind(-1)


def mirror_grid(draw: Draw) -> np.ndarray:
    columns = (unit_interval(draw), eta(draw))
    return np.concatenate([point_rows(draw)[:, 3:], *[draw.rounded(c)[:, None] for c in columns]], 1)


def near_own_horizon(x: Columns) -> Any:
    """As near the horizon as the rounding of the two directions."""
    wo, n = stacked(x, "wo"), stacked(x, "n")
    with np.errstate(all="ignore"):
        cos = np.abs((wo * n).sum(1)) / np.linalg.norm(wo, axis=1) / np.linalg.norm(n, axis=1)
    return ~(np.abs(n) == 1).any(1) & (cos < 4e-7)


MIRROR = Case(
    "Mirror, dielectric",
    (*POINT[3:], "tint", "eta"),
    call_mirror,
    mirror,
    mirror_grid,
    lambda x: ((stacked(x, "wo") * stacked(x, "n")).sum(1) > 0.05) & (x["tint"] > 0.01) & (x["eta"] > 1),
    covers=("Mirror",),
    error="backward",
    vectors=True,
    at_most_one=True,
    outside={"at the horizon, up to rounding": near_own_horizon},
)

CASES = (
    model("Lambert", {"albedo": unit_interval}, tb.Lambert, lambda p, a: a / pi(), covers=("Lambert",)),
    model(
        "Phong",
        {"specular": unit_interval, "exponent": exponent},
        tb.Phong,
        phong,
        covers=("Phong",),
        kinks={"edge of the lobe": lobe_edge},
    ),
    model(
        "Phong, Schlick",
        {"specular": unit_interval, "exponent": exponent, "f0": unit_interval},
        lambda k, s, f0: tb.Phong(k, s, tb.Schlick(f0)),
        lambda p, k, s, f0: phong(p, k, s) * fresnel.schlick(p.wi_h, f0)[0],
        covers=("Phong",),
        kinks={"edge of the lobe": lobe_edge, "no half vector": lost_half_vector},
    ),
    model(
        "Blinn-Phong",
        {"specular": unit_interval, "exponent": exponent},
        tb.BlinnPhong,
        blinn,
        covers=("BlinnPhong",),
        kinks={"no half vector": lost_half_vector},
    ),
    model(
        "Blinn-Phong, dielectric",
        {"specular": unit_interval, "exponent": exponent, "eta": eta},
        lambda k, s, n: tb.BlinnPhong(k, s, tb.Dielectric(n)),
        lambda p, k, s, n: blinn(p, k, s) * fresnel.dielectric(p.wi_h, n)[0],
        covers=("BlinnPhong", "Dielectric"),
        kinks={"no half vector": lost_half_vector},
    ),
    model(
        "2^20 (2^-40 (Lambert + Phong))",  # 1e6 times 1e-12
        {"albedo": unit_interval, "exponent": exponent},
        lambda a, s: 2.0**20 * (2.0**-40 * (tb.Lambert(a) + tb.Phong(a, s, normalization="bound"))),
        lambda p, a, s: (a / pi() + phong(p, a, s, "bound")) * 2.0**-20,
        covers=("Sum", "Scaled"),
        kinks={"edge of the lobe": lobe_edge},
    ),
    model(
        "TwoSided, Phong",
        {"specular": unit_interval, "exponent": exponent},
        lambda k, s: tb.TwoSided(tb.Phong(k, s)),
        phong,
        domain="same_side",
        covers=("TwoSided",),
        kinks={"edge of the lobe": lobe_edge},
    ),
    MIRROR,
)
