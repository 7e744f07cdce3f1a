"""Where a law is measured: everyday points, hard ones, and the angles of a real G-buffer; numbers of one dtype, as float64 arrays."""

import zlib
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .. import vector
from ..method import Law, Ranges
from . import spot

Points = dict[str, np.ndarray]  # by input: numbers [N], directions [N, 3]


def everyday(law: Law, dtype: torch.dtype, count: int) -> Points:
    """``count`` points of the law's everyday domain."""
    rng = _generator(law)
    return rounded(law.draw(rng, count) if law.draw else spread(rng, law.inputs, count), dtype)


def hard(law: Law, dtype: torch.dtype, count: int) -> Points | None:
    """Points where methods lose digits, if the law says where."""
    return None if law.hard is None else rounded(law.hard(_generator(law), count), dtype)


def pixels(law: Law, dtype: torch.dtype) -> dict[str, Points]:
    """The pixels of Spot, by the angle that is meant; other inputs spread over their everyday ranges."""
    rng = _generator(law)
    rest = spread(rng, law.inputs, len(spot.cosines()))
    if law.vectors:
        return {"wi, wo, n": rounded(spot.directions(rng) | rest, dtype)}
    return {angle: rounded(rest | {"cos_i": cos}, dtype) for angle, cos in spot.angles().items()} if "cos_i" in rest else {}


def spread(rng: Any, ranges: Ranges, count: int) -> Points:
    """Evenly; over more than a factor of 100, evenly in the logarithm."""
    found = {}
    for name, (low, high) in ranges.items():
        by_logarithm = low > 0 and high >= 100 * low
        found[name] = np.exp(rng.uniform(np.log(low), np.log(high), count)) if by_logarithm else rng.uniform(low, high, count)
    return found


def rounded(points: Points, dtype: torch.dtype) -> Points:
    """To numbers of the dtype."""
    return {name: torch.from_numpy(np.ascontiguousarray(x)).to(dtype).double().numpy() for name, x in points.items()}


def tensors(points: Points, dtype: torch.dtype, count: int | None = None) -> list[Tensor]:
    """Leaves, directions planar; repeated from the first on until there are ``count``."""
    found = [torch.from_numpy(x).to(dtype) for x in points.values()]
    if count is not None:
        found = [x[torch.arange(count) % len(x)] for x in found]
    return [(vector.planar(x) if x.dim() > 1 else x).requires_grad_() for x in found]


def _generator(law: Law) -> Any:
    return np.random.default_rng(zlib.crc32(law.name.encode()))
