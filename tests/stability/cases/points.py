"""Shading points: what a grid of directions holds, and where nothing or no slope is claimed."""

from typing import Any

import numpy as np
import torch

from ..case import Columns, Draw
from .vectors import directions, names, no_half_vector, stacked

NAMES = names("wi", "wo", "n")
# Of a grid. What a model may not be smooth at takes less than what bounds.EXCLUDED allows, half of it at most.
SHARES = {"wi = wo": 0.004, "wi = -wo": 0.004, "mirror": 0.004, "near mirror": 0.5, "anything": 0.238}
SHARES |= {f"{w} in the horizon": 0.05 for w in ("wi", "wo")} | {f"length of {w}": 0.05 for w in ("wi", "wo", "n")}


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
    kind = draw.rng.choice(list(SHARES), rows, p=list(SHARES.values()))
    of = {name: (kind == name)[:, None] for name in SHARES}
    wi = np.select([of["wi = wo"], of["wi = -wo"], of["mirror"], of["near mirror"]], [wo, -wo, mirror, near], wi)
    special = draw.rng.choice([0.0, draw.denormal, -draw.denormal, draw.info.tiny, draw.info.eps, 1e-3], rows)
    on_axis = np.arange(rows) % 2 == 0
    for w, name in ((wi, "wi in the horizon"), (wo, "wo in the horizon")):
        w[:, 2] = np.where(on_axis & (kind == name), special, w[:, 2])
    most = 1e2 if draw.dtype == torch.float16 else 1e30
    lengths = np.where(draw.uniform(rows) < 0.05, 0.0, draw.spread(rows, 1 / most, most))[:, None]
    wi, wo, n = (np.where(of[f"length of {k}"], w * lengths, w) for k, w in zip(("wi", "wo", "n"), (wi, wo, n), strict=True))
    return draw.rounded(np.concatenate([wi, wo, n], 1))


def _mostly_above(draw: Draw, w: np.ndarray, n: np.ndarray) -> np.ndarray:
    return w * np.where(((w * n).sum(1, keepdims=True) < 0) & (draw.uniform(len(w)) < 0.9)[:, None], -1, 1)


def with_parameters(draw: Draw, *columns: np.ndarray) -> np.ndarray:
    rows = point_rows(draw)
    return np.concatenate([rows, *[draw.rounded(c)[:, None] for c in columns]], 1)


def near_horizon(x: Columns) -> Any:
    """Closer to the horizon, where every model jumps, than the rounding of the directions."""
    wi, wo, n = (stacked(x, k) for k in ("wi", "wo", "n"))
    with np.errstate(all="ignore"):
        cosines = [np.abs((w * n).sum(1)) / np.linalg.norm(w, axis=1) / np.linalg.norm(n, axis=1) for w in (wi, wo)]
    exact = (np.abs(n) == 1).any(1)
    return ~exact & (np.minimum(*cosines) < 4e-7)


def lost_half_vector(x: Columns) -> Any:
    """Opposite directions, both in the horizon up to rounding: elsewhere one of them is below it and nothing is reflected."""
    wi, n = (unit_rows(stacked(x, k)) for k in ("wi", "n"))
    return no_half_vector(x) & (np.abs((wi * n).sum(1)) < 1e-3)


def unit_rows(v: np.ndarray) -> np.ndarray:
    """The rows to unit length; zero ones stay."""
    length = np.linalg.norm(v, axis=1, keepdims=True)
    return v / np.where(length > 0, length, 1.0)
