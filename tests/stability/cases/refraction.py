"""The rough dielectric across its surface: near the refracted direction, from both sides, at facets close to their critical angle."""

import dataclasses
import inspect
from typing import Any

import numpy as np
import torch

import torchbrdf as tb
from torchbrdf.bsdf.refraction import Refraction
from torchbrdf.testing.textbook import Point

from ..case import Columns, Draw
from . import points
from .derived import FEW, NEAR, M, case, column
from .vectors import directions, stacked

SPECS = {name: tb.RoughDielectric._params[name] for name in ("alpha", "eta")}
CHOICES = {"distribution": "ggx", "shadowing": "smith_correlated", "smith": "exact", "mode": "radiance", "part": "both"}


def refracted(wo: np.ndarray, n: np.ndarray, eta: np.ndarray) -> np.ndarray:
    """Where unit wo goes, (0, 0, 0) under total reflection."""
    cos = (n * wo).sum(1)
    ahead = np.where(cos < 0, 1 / eta, eta)
    g2 = (ahead - 1) * (ahead + 1) + cos * cos
    along = cos - np.copysign(np.sqrt(np.maximum(g2, 0.0)), cos)
    return np.where(g2 > 0, (along * n.T - wo.T) / ahead, 0.0).T


def grid(draw: Draw) -> np.ndarray:
    """As of every model; of five rows three across: two near the refracted direction, one where facets are near their critical angle.

    Where the indices match both are -wo, where no slope is claimed: a quarter of those rows is enough, the others are as of every model.
    """
    rows = points.point_rows(draw).reshape(-1, 3, 3)
    alpha, eta = (draw.rounded(column(spec, draw)) for spec in SPECS.values())
    kind = np.arange(len(rows)) % 10 // 2  # n is along z in even rows
    plain = (kind < 3) & (np.abs(np.linalg.norm(rows, axis=2) - 1) < 1e-3).all(1)
    plain &= (np.abs(eta - 1) > NEAR) | (draw.uniform(len(rows)) < 0.25)
    wo, n = rows[:, 1], rows[:, 2]
    wo[plain & (np.arange(len(rows)) % 4 < 2)] *= -1
    straight = refracted(wo, n, eta)
    near = straight + draw.spread(len(rows), draw.info.eps, 1.0)[:, None] * directions(draw, len(rows))
    facet = n + draw.spread(len(rows), 1e-2, 3.0)[:, None] * directions(draw, len(rows))
    facet /= np.linalg.norm(facet, axis=1, keepdims=True)
    edge = refracted(wo, facet * np.copysign(1.0, (facet * n).sum(1))[:, None], eta)
    wi = np.where((kind == 2)[:, None], edge, near)
    length = np.linalg.norm(wi, axis=1, keepdims=True)
    rows[plain, 0] = np.where(length > 0.1, wi / np.maximum(length, 0.1), rows[:, 0])[plain]
    return np.concatenate([draw.rounded(rows.reshape(-1, 9)), alpha[:, None], eta[:, None]], 1)


def everyday(x: Columns) -> Any:
    """Both directions off the horizon, on different sides; the facet off its own, 1 - F above a tenth; bright beside what goes straight."""
    wi, wo, n = (points.unit_rows(stacked(x, k)) for k in ("wi", "wo", "n"))
    model = tb.RoughDielectric(*(torch.from_numpy(x[name]).unsqueeze(-1) for name in SPECS))
    g = model.geometry(*map(torch.from_numpy, (wi, wo, n)))
    at = Refraction.of(g, model.eta.squeeze(-1))
    straight = model.evaluate(*map(torch.from_numpy, (refracted(wo, n, x["eta"]), wo, n))).squeeze(-1).numpy()
    f = model.evaluate(*map(torch.from_numpy, (wi, wo, n))).squeeze(-1).numpy()
    cosines = np.minimum(np.abs((wi * n).sum(1)), np.abs((wo * n).sum(1)))
    seen = ((at.there > 0) & (at.transmitted > 0.1) & (at.cos_n > 0.1)).numpy()
    near_one = np.logical_and.reduce([np.abs(np.linalg.norm(stacked(x, k), axis=1) - 1) < 0.5 for k in ("wi", "wo", "n")])
    typical = near_one & (x["alpha"] >= 0.1) & (x["eta"] >= 1.2) & (x["eta"] <= 2.5)
    return typical & seen & (cosines > 0.05) & (f > FEW * straight)


def truth(p: Point, alpha: Any, eta: Any) -> Any:
    return tb.RoughDielectric.textbook(M, p, alpha, eta, **CHOICES)


CASES = (
    dataclasses.replace(
        case(
            "RoughDielectric, refraction",
            SPECS,
            tb.RoughDielectric,
            truth,
            ("RoughDielectric",),
            inspect.getsource(tb.RoughDielectric.textbook),
        ),
        grid=grid,
        everyday=everyday,
    ),
)
