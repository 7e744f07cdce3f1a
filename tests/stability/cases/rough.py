"""Anisotropic microfacets from directions in the local frame: what the derived cases, of one number of roughness, do not hold."""

import inspect
from typing import Any

import numpy as np
import torch

import torchbrdf as tb
from torchbrdf.testing.textbook import Point

from ..case import Case, Columns, Draw
from ..dual import pi, sqrt, where
from . import points
from .derived import FEW, M, column
from .vectors import added, everyday_point, names, no_half_vector, stacked, unit

ALPHA = tb.RoughConductor._params["alpha"]
INPUTS = (*names("wi", "wo"), "alpha_x", "alpha_y")
UP = (0.0, 0.0, 1.0)


def ggx(*c: Any) -> tuple[Any]:
    """Heitz 2014, eq. 85 to 87 and 99: D of the unit half vector, Lambda of both directions, height-correlated."""
    wi, wo, (ax, ay) = unit(c[:3]), unit(c[3:6]), c[6:]
    p = Point(M, wi, wo, tuple(0 * x + z for x, z in zip(wi, UP, strict=True)))
    x, y, z = unit(added(wi, wo))
    there = p.above
    q = where(there, x * x / (ax * ax) + y * y / (ay * ay) + z * z, 1)

    def smith(w: Any) -> Any:
        cos = where(there, w[2], 1)
        return (sqrt(1 + ((ax * w[0]) * (ax * w[0]) + (ay * w[1]) * (ay * w[1])) / (cos * cos)) - 1) / 2

    ci, co = where(there, wi[2], 1), where(there, wo[2], 1)
    f = 1 / (pi() * ax * ay * q * q) / (1 + smith(wi) + smith(wo)) / (4 * ci * co)
    return (where(there, f, 0),)


def call(*c: torch.Tensor) -> Any:
    wi, wo, alpha = (torch.stack(c[a:b], -1) for a, b in ((0, 3), (3, 6), (6, 8)))
    return tb.RoughConductor(alpha).evaluate(wi, wo).unbind(-1)


def grid(draw: Draw) -> np.ndarray:
    """The points of every model, those whose normal is the z axis."""
    twice = Draw(draw.dtype, 2 * draw.points)
    rows = points.with_parameters(twice, column(ALPHA, twice), column(ALPHA, twice))[::2]
    return np.delete(rows, [6, 7, 8], 1)


def upright(x: Columns) -> Columns:
    """The same points with their normal."""
    found = Columns({**x, **{f"n.{k}": np.full(len(x["wi.x"]), v) for k, v in zip("xyz", UP, strict=True)}})
    found.dtype = x.dtype
    return found


def everyday(x: Columns) -> Any:
    """Both roughnesses typical, directions off the horizon, and a value bright enough to be seen beside that of the mirror direction."""
    wi, wo = (points.unit_rows(stacked(x, k)) for k in ("wi", "wo"))
    alpha = torch.from_numpy(np.stack([x["alpha_x"], x["alpha_y"]], 1))
    f, peak = (tb.RoughConductor(alpha).evaluate(torch.from_numpy(w), torch.from_numpy(wo))[:, 0].numpy() for w in (wi, wo * [-1, -1, 1]))
    low, high = ALPHA.constraint.typical
    typical = [(x[k] >= low) & (x[k] <= high) for k in ("alpha_x", "alpha_y")]
    return np.logical_and.reduce([*typical, everyday_point(upright(x)), ~no_half_vector(x), f > FEW * peak])


CASES = (
    Case(
        "RoughConductor, ggx, anisotropic",
        INPUTS,
        call,
        ggx,
        grid,
        everyday,
        covers=("RoughConductor",),
        error="backward",
        vectors=True,
        kinks={"no half vector": lambda x: points.lost_half_vector(upright(x))},
        outside={"at the horizon, up to rounding": lambda x: points.near_horizon(upright(x))},
        source=inspect.getsource(ggx),
    ),
)
