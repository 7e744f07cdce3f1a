"""Directions: normalise, reflect, refract, frames, and the invariants of a shading point."""

import numpy as np
import torch

from torchbrdf import numerics, vector
from torchbrdf.geometry import Geometry, Viewer
from torchbrdf.vector import Vec

from ..case import Case, Draw
from ..dual import plain, sqrt, where
from .fresnel import critical


def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def scaled(a, s):
    return tuple(x * s for x in a)


def added(a, b):
    return tuple(x + y for x, y in zip(a, b, strict=True))


def positive(x):
    return np.asarray(plain(x) > 0, dtype=bool)


def unit(v):
    """To unit length; the zero vector stays."""
    length2 = dot(v, v)
    alive = positive(length2)
    return tuple(where(alive, x / sqrt(where(alive, length2, 1)), 0) for x in v)


def normalize(x, y, z):
    return unit((x, y, z))


def reflect(*c):
    w, n = c[:3], c[3:]
    return added(scaled(n, 2 * dot(n, w)), scaled(w, -1))


def refract(*c):
    w, n, eta = c[:3], c[3:6], c[6]
    cos = dot(w, n)
    g2 = eta * eta - 1 + cos * cos
    valid = positive(g2)
    g = sqrt(where(valid, g2, 1))
    below = np.asarray(plain(cos) < 0, dtype=bool)
    along = cos - where(below, -1 * g, g)
    return tuple(where(valid, (along * b - a) / eta, 0) for a, b in zip(w, n, strict=True))


def frame(*n):
    """Duff et al. 2017."""
    sign = np.where(np.array([np.signbit(float(v)) for v in plain(n[2])]), -1, 1)
    a = -1 / (sign + n[2])
    x = (1 + sign * (n[0] * n[0]) * a, sign * (n[0] * n[1]) * a, -1 * (sign * n[0]))
    return (*x, *cross(n, x))


def invariants(*c):
    """Of unit vectors, as they are: cos_i, cos_o, wi.h, n.h, |n x h|^2, 1 - wi.R(wo)."""
    wi, wo, n = c[:3], c[3:6], c[6:]
    half = added(wi, wo)
    half2 = dot(half, half)
    there = positive(half2)
    length = sqrt(where(there, half2, 1))
    d = added(scaled(n, 2 * dot(n, wo)), scaled(half, -1))
    side = cross(n, half)
    return (
        dot(n, wi),
        dot(n, wo),
        where(there, length / 2, 0),
        where(there, dot(n, half) / length, 0),
        where(there, dot(side, side) / where(there, half2, 1), 0),
        dot(d, d) / 2,
    )


def as_vec(c):
    return Vec(*c)


def call_invariants(*c):
    wide = [numerics.widen(x) for x in c]
    g = Geometry(Viewer(as_vec(wide[3:6]), as_vec(wide[6:])), as_vec(wide[:3]))
    found = g.cos_i, g.cos_o, g.wi_h, g.cos_h, g.sin2_h, g.mirror_complement
    return tuple(numerics.rounded_back(x, c[0].dtype) for x in found)


def on_vectors(function, *sizes):
    """A function of tensors ``[..., k]`` as one of scalars."""

    def call(*c):
        parts, at = [], 0
        for size in sizes:
            parts.append(torch.stack(c[at : at + size], -1))
            at += size
        out = function(*parts)
        return out.unbind(-1)

    return call


def directions(draw: Draw, count: int) -> np.ndarray:
    v = draw.rng.normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


AXES = [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, -1, 0), (np.sqrt(0.5), 0, np.sqrt(0.5)), (0.6, 0, -0.8), (0, 0.28, 0.96)]


def special_lengths(draw: Draw) -> list[float]:
    info = draw.info
    return [draw.denormal, info.tiny, 4 * info.tiny, np.sqrt(info.tiny), info.eps, 0.5, 1.0, np.sqrt(info.max), info.max / 4, info.max]


def vector_grid(draw: Draw) -> np.ndarray:
    """Zero, denormal, huge; along axes; far from unit length."""
    axes = np.array(AXES)
    special = np.concatenate([np.zeros((1, 3)), *[axes * s for s in special_lengths(draw)]])
    uneven = draw.product(*[[0.0, -draw.denormal, 1e-3, draw.info.max / 4, 1.0]] * 3)
    bulk = directions(draw, draw.points) * draw.spread(draw.points, np.sqrt(draw.info.tiny), np.sqrt(draw.info.max))[:, None]
    return draw.rounded(np.concatenate([special, uneven, bulk]))


def unit_grid(draw: Draw) -> np.ndarray:
    """Unit vectors: the axes, their neighbours, and anything."""
    poles = np.array(AXES)[:, None] + draw.spread(40, draw.info.eps, 1e-2)[None, :, None] * directions(draw, 40)[None]
    poles = (poles / np.linalg.norm(poles, axis=-1, keepdims=True)).reshape(-1, 3)
    return draw.rounded(np.concatenate([AXES, poles, directions(draw, draw.points)]))


def pair_grid(draw: Draw) -> np.ndarray:
    """(w, n): anything, along, opposite, in the horizon."""
    n = unit_grid(draw)
    w = directions(draw, len(n))
    kind = draw.rng.integers(0, 8, len(n))
    across = np.cross(n, w)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    w = np.select([(kind == k)[:, None] for k in range(3)], [n, -n, across], w)
    return draw.rounded(np.concatenate([w, n], 1))


def refract_grid(draw: Draw) -> np.ndarray:
    """Every pair with an index; and about the critical angle to the ulp, n along z."""
    pairs = pair_grid(draw)
    etas = draw.rounded(np.where(draw.uniform(len(pairs)) < 0.1, 1.0, draw.spread(len(pairs), 0.3, 3.0)))
    edge = critical(draw, np.linspace(0.3, 0.99, 20))
    sin = np.sqrt((1 - edge[:, 0]) * (1 + edge[:, 0]))
    w = np.column_stack([sin * 0.6, sin * 0.8, edge[:, 0], np.zeros((len(edge), 2)), np.ones(len(edge)), edge[:, 1]])
    return np.concatenate([np.column_stack([pairs, etas]), draw.rounded(w)])


def point_grid(draw: Draw) -> np.ndarray:
    """(wi, wo, n): wi = wo, wi = -wo, the mirror direction and near it, the horizon, anything."""
    wo_n = pair_grid(draw)
    wo, n = wo_n[:, :3], wo_n[:, 3:]
    count = len(n)
    wi = directions(draw, count)
    mirror = 2 * (n * wo).sum(1, keepdims=True) * n - wo
    near = mirror + draw.spread(count, draw.info.eps, 0.3)[:, None] * wi
    across = np.cross(n, wi)
    kind = draw.rng.integers(0, 10, count)
    wi = np.select([(kind == k)[:, None] for k in (0, 1, 2, 3, 4, 5, 6)], [wo, -wo, mirror, across, near, near, near], wi)
    return draw.rounded(np.concatenate([wi / np.linalg.norm(wi, axis=1, keepdims=True), wo, n], 1))


def names(*vectors: str) -> tuple[str, ...]:
    return tuple(f"{v}.{k}" for v in vectors for k in "xyz")


def stacked(x, name):
    return np.stack([x[f"{name}.{k}"] for k in "xyz"], 1)


def no_half_vector(x):
    """Opposite directions, up to rounding."""
    return np.linalg.norm(stacked(x, "wi") + stacked(x, "wo"), axis=1) < 1e-3


def everyday_point(x):
    wi, wo, n = (stacked(x, k) for k in ("wi", "wo", "n"))
    return ((wi * n).sum(1) > 0.05) & ((wo * n).sum(1) > 0.05)


def beyond_critical(x, margin=0.05):
    cos = (stacked(x, "w") * stacked(x, "n")).sum(1)
    return x["eta"] ** 2 - 1 + cos**2 > margin


def shorter_than_usable(x):
    """So short that 1/length, the slope, is not a number of the dtype: documented to count as zero."""
    return np.abs(stacked(x, "v")).max(1) <= 2 / x.working.max


def call_frame(*n):
    found = vector.Frame.from_normal(torch.stack(n, -1))
    return (*found.tangent.unbind(-1), *found.bitangent.unbind(-1))


CASES = (
    Case(
        "normalize",
        names("v"),
        on_vectors(vector.normalize, 3),
        normalize,
        vector_grid,
        lambda x: np.abs(np.log(np.maximum(np.linalg.norm(stacked(x, "v"), axis=1), 1e-300))) < 3,
        covers=("normalize", "DirectionalLight"),  # which is its direction, normalised
        outside={"shorter than 2/max": shorter_than_usable},
        signed=True,
        vectors=True,
    ),
    Case(
        "reflect",
        names("w", "n"),
        on_vectors(vector.reflect, 3, 3),
        reflect,
        pair_grid,
        lambda x: np.ones(len(x["w.x"]), dtype=bool),
        covers=("reflect",),
        error="length",
        signed=True,
        vectors=True,
    ),
    Case(
        "refract",
        (*names("w", "n"), "eta"),
        lambda *c: vector.refract(torch.stack(c[:3], -1), torch.stack(c[3:6], -1), c[6].unsqueeze(-1))[0].unbind(-1),
        refract,
        refract_grid,
        beyond_critical,
        covers=("refract",),
        error="length",
        signed=True,
        vectors=True,
    ),
    Case(
        "Frame",
        names("n"),
        call_frame,
        frame,
        unit_grid,
        lambda x: np.abs(x["n.z"]) > 0.01,
        covers=("Frame",),
        error="scale",
        signed=True,
        vectors=True,
    ),
    Case(
        "Geometry",
        names("wi", "wo", "n"),
        call_invariants,
        invariants,
        point_grid,
        lambda x: everyday_point(x) & ~no_half_vector(x),
        covers=("Geometry",),
        error="scale",
        signed=True,
        vectors=True,
    ),
)
