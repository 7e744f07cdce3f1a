"""The lat-long look-up of an environment map, and the falloff of a point light."""

import numpy as np
import torch

import torchbrdf as tb
from torchbrdf import numerics
from torchbrdf.light.environment import HEADROOM
from torchbrdf.vector import Vec

from ..case import Case, Draw
from ..dual import atan2, pi, plain, sqrt, where
from .vectors import added, directions, dot, names, positive, scaled, unit, unit_grid

HEIGHT, WIDTH = 4, 8
TEXELS = torch.tensor(np.random.default_rng(5).integers(0, 256, (HEIGHT, WIDTH, 1)) / 16.0)


def coordinates(x, y, z):
    """Mitsuba's orientation: right is -X, up +Y, forward +Z."""
    across2 = x * x + z * z
    off = positive(across2)
    across = where(off, sqrt(where(off, across2, 1)), 0)
    return atan2(-1 * x, z) / (2 * pi()) + 0.5, atan2(across, y) / pi()


def call_coordinates(x, y, z):
    u, v = tb.EnvironmentMap(TEXELS).coordinates(Vec(*(numerics.widen(c) for c in (x, y, z))))
    return numerics.rounded_back(u, x.dtype), numerics.rounded_back(v, x.dtype)


def radiance(x, y, z):
    u, v = coordinates(*unit((x, y, z)))
    column, row = u * WIDTH - 0.5, v * HEIGHT - 0.5
    left, top = (np.array([int(np.floor(float(t))) for t in plain(c)]) for c in (column, row))
    fx, fy = column - left, row - top
    table = TEXELS[..., 0].numpy()

    def texel(j, i):
        return table[np.clip(j, 0, HEIGHT - 1), i % WIDTH].astype(object)

    upper = texel(top, left) * (1 - fx) + texel(top, left + 1) * fx
    lower = texel(top + 1, left) * (1 - fx) + texel(top + 1, left + 1) * fx
    return (where(positive(dot((x, y, z), (x, y, z))), upper * (1 - fy) + lower * fy, 0),)


def call_radiance(x, y, z):
    return tb.EnvironmentMap(TEXELS).radiance(torch.stack((x, y, z), -1)).unbind(-1)


def direction_grid(draw: Draw) -> np.ndarray:
    """The poles, the seam and their neighbours, and anything, of unit length."""
    pole = directions(draw, 600) * draw.spread(600, draw.info.tiny * (1.0 if draw.dtype == torch.float16 else 2.0**40), 1e-2)[
        :, None
    ] + np.array([0.0, 1.0, 0.0]) * draw.rng.choice([-1, 1], (600, 1))
    seam = directions(draw, 200)
    seam[:, 2] = -np.abs(seam[:, 2])
    seam[:, 0] = draw.rng.choice([0.0, -0.0, draw.denormal, -draw.denormal, draw.info.eps], 200)
    special = np.concatenate(
        [[[0, 1, 0], [0, -1, 0], [draw.denormal, 1, 0], [0, 1, -draw.denormal], [draw.info.tiny, -1, draw.info.tiny]], pole, seam]
    )
    special = special / np.linalg.norm(special, axis=1, keepdims=True)
    return np.concatenate([draw.rounded(special), unit_grid(draw)])


def at_texel_edge(x):
    """Where the four texels change, up to rounding."""
    u, v = (
        c.astype(np.float64) for c in map(plain, coordinates(*unit(tuple(np.array(x[k], dtype=object) for k in ("d.x", "d.y", "d.z")))))
    )
    return np.minimum(*(np.abs(c - 0.5 - np.round(c - 0.5)) for c in (u * WIDTH, v * HEIGHT))) < 2e-6


LIGHT, INTENSITY = (0.5, 0.25, 1.0), 8.0


def point_light(*point):
    """Direction to a light and what arrives from it."""
    away = added(LIGHT, scaled(point, -1))
    d2 = dot(away, away)
    there = positive(d2)
    return (*unit(away), where(there, INTENSITY / where(there, d2, 1), 0))


def call_point_light(*point):
    wi, _, strength, _ = tb.PointLight(LIGHT, INTENSITY).sample(torch.stack(point, -1))
    return (*wi[0].unbind(-1), strength[0, :, 0])


def point_grid(draw: Draw) -> np.ndarray:
    """Near the light and far from it, and the light itself."""
    lengths = draw.spread(draw.points, 0.1 if draw.half else 1e-6, 1e2 if draw.half else 1e8)[:, None]
    at = np.array([LIGHT])
    return draw.rounded(
        np.concatenate([at, np.zeros((1, 3)), at + np.eye(3) * draw.info.eps, at + lengths * directions(draw, draw.points)])
    )


def at_pole(x):
    """So near that it counts as the pole."""
    return np.maximum(np.abs(x["d.x"]), np.abs(x["d.z"])) <= HEADROOM / x.working.max


CASES = (
    Case(
        "EnvironmentMap coordinates",
        names("d"),
        call_coordinates,
        coordinates,
        direction_grid,
        lambda x: np.hypot(x["d.x"], x["d.z"]) > 0.05,
        covers=("EnvironmentMap",),
        error="scale",
        vectors=True,
        outside={"pole": at_pole},
    ),
    Case(
        "EnvironmentMap radiance",
        names("d"),
        call_radiance,
        radiance,
        direction_grid,
        lambda x: np.hypot(x["d.x"], x["d.z"]) > 0.05,
        covers=("EnvironmentMap",),
        error="backward",
        vectors=True,
        outside={"pole": at_pole},
        kinks={"edge of a texel": at_texel_edge},
    ),
    Case(
        "PointLight",
        names("point"),
        call_point_light,
        point_light,
        point_grid,
        lambda x: np.abs(np.linalg.norm(np.stack([x[f"point.{k}"] for k in "xyz"], 1) - LIGHT, axis=1) - 5) < 4.9,
        covers=("PointLight",),
        error="backward",
        signed=True,
        vectors=True,
        kinks={"at the light": lambda x: np.all(np.stack([x[f"point.{k}"] for k in "xyz"], 1) == LIGHT, 1)},
    ),
)
