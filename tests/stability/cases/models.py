"""Models that derive no case of their own: sums, two sides, the mirror."""

import inspect
from typing import Any

import numpy as np
import torch

import torchbrdf as tb
from torchbrdf.bsdf import principled_textbook
from torchbrdf.testing.textbook import Point

from ..case import Case, Columns, Draw
from ..dual import pi, where
from . import fresnel, points
from .derived import M, case, column
from .vectors import dot, positive, stacked, unit

PHONG = {name: tb.Phong._params[name] for name in ("specular", "exponent")}
ALBEDO, TINT, ETA = tb.Lambert._params["albedo"], tb.Mirror._params["tint"], tb.Dielectric._params["eta"]


def phong(p: Point, specular, exponent, normalization="modified"):
    return tb.Phong.textbook(M, p, specular, exponent, lambda cos: 1, normalization)


def mirror(*c):
    """tint F(cos) above the horizon."""
    wo, n = unit(c[:3]), unit(c[3:6])
    cos = dot(n, wo)
    return (where(positive(cos), c[6] * fresnel.dielectric(where(positive(cos), cos, 1), c[7])[0], 0),)


def call_mirror(*c):
    wo, n = torch.stack(c[:3], -1), torch.stack(c[3:6], -1)
    return tb.Mirror(c[6].unsqueeze(-1), tb.Dielectric(c[7].unsqueeze(-1))).directional_albedo(wo, n).unbind(-1)


def mirror_grid(draw: Draw) -> np.ndarray:
    columns = (column(TINT, draw), column(ETA, draw))
    return np.concatenate([points.point_rows(draw)[:, 3:], *[draw.rounded(c)[:, None] for c in columns]], 1)


def near_own_horizon(x: Columns) -> Any:
    """As near the horizon as the rounding of the two directions."""
    wo, n = stacked(x, "wo"), stacked(x, "n")
    with np.errstate(all="ignore"):
        cos = np.abs((wo * n).sum(1)) / np.linalg.norm(wo, axis=1) / np.linalg.norm(n, axis=1)
    return ~(np.abs(n) == 1).any(1) & (cos < 4e-7)


MIRROR = Case(
    "Mirror, dielectric",
    (*points.NAMES[3:], "tint", "eta"),
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

APART = ("anisotropy", "sheen", "sheen_roughness")  # the sheen has a case of its own
PRINCIPLED = {name: spec for name, spec in tb.Principled._params.items() if name not in APART}
PLAIN = {"anisotropy": 0, "sheen": 0, "sheen_roughness": 1, "shadowing": "smith_correlated", "off": ("anisotropy",), "parts": None}

CASES = (
    case(
        "Principled",
        PRINCIPLED,
        lambda *values: tb.Principled(**dict(zip(PRINCIPLED, values, strict=True))),
        lambda p, *values: where(p.above, tb.Principled.textbook(M, p, **dict(zip(PRINCIPLED, values, strict=True)), **PLAIN), 0),
        covers=("Principled",),
        source=inspect.getsource(principled_textbook),
    ),
    case(
        "2^20 (2^-40 (Lambert + Phong))",  # 1e6 times 1e-12
        {"albedo": ALBEDO, "exponent": PHONG["exponent"]},
        lambda a, s: 2.0**20 * (2.0**-40 * (tb.Lambert(a) + tb.Phong(a, s, normalization="bound"))),
        lambda p, a, s: where(p.above, (a / pi() + phong(p, a, s, "bound")) * 2.0**-20, 0),
        covers=("Sum", "Scaled"),
    ),
    case(
        "TwoSided, Phong",
        PHONG,
        lambda k, s: tb.TwoSided(tb.Phong(k, s)),
        lambda p, k, s: where(p.same_side, phong(p, k, s), 0),
        covers=("TwoSided",),
    ),
    MIRROR,
)
