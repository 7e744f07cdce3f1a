"""Models of smooth interfaces: the delta pair of a dielectric."""

from typing import Any

import numpy as np
import torch

import torchbrdf as tb

from ..case import Case, Columns, Draw
from ..dual import inverse, plain, sqrt, where
from . import fresnel, points
from .derived import column
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
        **claims,
    )


CASES = (pair("radiance", radiance, signed=True), pair("flux", flux, at_most_one=True))
