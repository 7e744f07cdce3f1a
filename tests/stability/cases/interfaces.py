"""Smooth interfaces: the delta pair of a dielectric, its reflectance of diffuse light, and a coat."""

import inspect
from typing import Any

import numpy as np
import torch

import torchbrdf as tb
from torchbrdf.optics import dielectric_average

from ..case import Case, Columns, Draw
from ..dual import inverse, pi, plain, sqrt, where
from . import fresnel, points
from .derived import M, case, column
from .vectors import dot, stacked, unit

ETA = tb.SmoothDielectric._params["eta"]


def interface(*c: Any) -> tuple[Any, ...]:
    """(F, index ahead, refracted direction times not in the horizon) of wo, n, eta; everything 0 in the horizon."""
    wo, n, eta = unit(c[:3]), unit(c[3:6]), c[6]
    cos = dot(n, wo)
    below, off = (np.asarray(mask, dtype=bool) for mask in (plain(cos) < 0, plain(cos) != 0))
    ahead = where(below, inverse(eta), eta)
    cos = where(below, -1 * cos, cos)
    g2 = ahead * ahead - 1 + cos * cos
    through = off & np.asarray(plain(g2) > 0, dtype=bool)
    along = cos - sqrt(where(through, g2, 1))
    along = where(below, -1 * along, along)
    bent = tuple(where(through, (along * b - a) / ahead, 0) for a, b in zip(wo, n, strict=True))
    return off, fresnel.dielectric(where(off, cos, 1), ahead)[0], ahead, bent


def radiance(*c: Any) -> tuple[Any, ...]:
    off, f, ahead, bent = interface(*c)
    return (where(off, f, 0), where(off, (1 - f) / (ahead * ahead), 0), *bent)


def flux(*c: Any) -> tuple[Any, ...]:
    off, f, _, _ = interface(*c)
    return where(off, f, 0), where(off, 1 - f, 0)


def deltas(c: tuple[torch.Tensor, ...], mode: str) -> tuple[torch.Tensor, ...]:
    wo, n = torch.stack(c[:3], -1), torch.stack(c[3:6], -1)
    model = tb.SmoothDielectric(c[6].unsqueeze(-1), mode)
    viewer = model.viewer(wo, n)
    off = (viewer.cos_o != 0).to(viewer.cos_o.dtype)
    mirror, bent = model.deltas(viewer)
    return tuple((x * off).to(wo.dtype) for x in (*mirror.weight, *bent.weight, *(bent.wi if mode == "radiance" else ())))


def grid(draw: Draw) -> np.ndarray:
    """Viewers on both sides; a part of them about the critical angle, to a few ulp."""
    rows, eta = points.point_rows(draw)[:, 3:], column(ETA, draw)
    edge = np.arange(len(rows)) % 16 == 3
    inside = np.minimum(eta, 1 / eta)
    turn = draw.uniform(len(rows), 0, 2 * np.pi)
    cos = np.sqrt((1 - inside) * (1 + inside)) * (1 + draw.rng.choice([-1, 1], len(rows)) * draw.spread(len(rows), draw.info.eps, 0.1))
    cos = np.minimum(cos, 1.0) * np.where(eta > 1, -1, 1)
    sin = np.sqrt((1 - cos) * (1 + cos))
    on_axis = np.stack([sin * np.cos(turn), sin * np.sin(turn), cos, 0 * cos, 0 * cos, 1 + 0 * cos], 1)
    rows = np.where(edge[:, None], on_axis, rows)
    rows[1::2, :3] *= np.where(edge[1::2, None], 1, -1)
    return np.concatenate([draw.rounded(rows), draw.rounded(eta)[:, None]], 1)


def everyday(x: Columns) -> Any:
    """An index that is typical, from either side; off the horizon and the critical angle."""
    wo, n = stacked(x, "wo"), stacked(x, "n")
    cos = (points.unit_rows(wo) * points.unit_rows(n)).sum(1)
    near_one = np.logical_and.reduce([np.abs(np.log(np.maximum(np.linalg.norm(w, axis=1), 1e-300))) < 3 for w in (wo, n)])
    ahead = np.where(cos < 0, 1 / x["eta"], x["eta"])
    typical = (x["eta"] > 1.2) & (x["eta"] < 2.5)
    return near_one & typical & (np.abs(cos) > 0.05) & (np.abs(ahead**2 - 1 + cos**2) > 0.05)


def near_own_horizon(x: Columns) -> Any:
    """As near the horizon as the rounding of the two directions."""
    wo, n = stacked(x, "wo"), stacked(x, "n")
    with np.errstate(all="ignore"):
        cos = np.abs((wo * n).sum(1)) / np.linalg.norm(wo, axis=1) / np.linalg.norm(n, axis=1)
    return ~(np.abs(n) == 1).any(1) & (cos < 4e-7)


def pair(mode: str, truth: Any, **claims: Any) -> Case:
    return Case(
        f"SmoothDielectric, {mode}",
        (*points.NAMES[3:], "eta"),
        lambda *c: deltas(c, mode),
        truth,
        grid,
        everyday,
        covers=("SmoothDielectric",),
        error="backward",
        vectors=True,
        outside={"at the horizon, up to rounding": near_own_horizon},
        outside_twice={
            "matched media and a tiny normal": lambda x: (
                (x["eta"] == 1) & (np.linalg.norm(stacked(x, "n"), axis=1) < x.working.smallest_normal**0.5)
            )
        },
        **claims,
    )


def coated(p: Any, albedo: Any, eta: Any) -> Any:
    """Over Lambert's surface."""
    within = 1 - (1 - dielectric_average.textbook(M, eta)) / (eta * eta)
    enter = [1 - fresnel.dielectric(where(p.above, c, 1), eta)[0] for c in (p.cos_i, p.cos_o)]
    return where(p.above, enter[0] * enter[1] * albedo / (pi() * eta * eta * (1 - albedo * within)), 0)


def average_grid(draw: Draw) -> np.ndarray:
    """Beside 1 to the ulp, and as far as the dtype goes."""
    most = draw.info.max**0.25
    special = np.array([*fresnel.etas(draw), 1 / most, most, draw.info.eps, 3.0, *draw.near(3.0), *draw.near(1 / 3)])
    beside = 1 + draw.spread(draw.points // 2, max(1e-7, draw.info.eps), 0.3) * draw.rng.choice([-1, 1], draw.points // 2)
    return draw.rounded(np.concatenate([special, beside, draw.spread(draw.points, 0.1, 10.0)]))[:, None]


CASES = (
    pair("radiance", radiance, signed=True),
    pair("flux", flux, at_most_one=True),
    Case(
        "fresnel.dielectric_average",
        ("eta",),
        lambda eta: (tb.fresnel.dielectric_average(eta),),
        lambda eta: (dielectric_average.textbook(M, eta),),
        average_grid,
        lambda x: (x["eta"] > 1.2) & (x["eta"] < 2.5),
        covers=("fresnel.dielectric_average",),
        at_most_one=True,
        source=inspect.getsource(dielectric_average.textbook),
    ),
    case(
        "Coated, Lambert",
        {"albedo": tb.Lambert._params["albedo"], "eta": ETA},
        lambda a, eta: tb.Coated(tb.Lambert(a), eta),
        coated,
        covers=("Coated",),
        source=inspect.getsource(dielectric_average.textbook),
    ),
)
