"""The direction from which a model reflects most."""

import math

import torch
from torch import Tensor

from ..bsdf.base import Bsdf
from .subject import sees_below

ORDER = 16  # nodes along a side of the albedo's quadrature
NEAR, GRAZING = 7, 10  # even steps to cosine 1/10; decades of the cosine, of which the first is that
TURNS, ZOOMS = 4, 4  # azimuths over half a turn; times the surroundings of the largest value are looked at, at half the distance


def brightest(bsdf: Bsdf, promise: Tensor, thorough: bool = False) -> Tensor:
    """The local direction ``[1, 3]`` whose albedo exceeds ``promise [C]`` most: on a grid logarithmic towards grazing, then nearer."""
    finer, order = (4, 2 * ORDER) if thorough else (1, ORDER)
    t = torch.cat([torch.linspace(0, 1, NEAR * finer + 1), torch.linspace(1, GRAZING, 2 * (GRAZING - 1) * finer + 1)[1:]]).double()
    grid = torch.cartesian_prod(t, torch.arange(0, math.pi, math.pi / (TURNS * finer), dtype=t.dtype))
    found = [_climb(bsdf, promise, grid, side, order) for side in ((1.0, -1.0) if sees_below(bsdf) else (1.0,))]
    return max(found, key=lambda one: one[0])[1]


def _climb(bsdf: Bsdf, promise: Tensor, grid: Tensor, side: float, order: int) -> tuple[float, Tensor]:
    """The largest excess on one side, and its direction."""
    around = torch.cartesian_prod(*[torch.linspace(-1.0, 1.0, 5, dtype=grid.dtype)] * 2)
    best, value = grid[0], -math.inf
    for zoom in range(1 + ZOOMS):
        excess = (bsdf.directional_albedo(_directions(grid, side), order=order) - promise).nan_to_num(nan=math.inf).amax(-1)
        k = int(excess.argmax())
        best, value = (grid[k], float(excess[k])) if float(excess[k]) > value else (best, value)
        reach = 0.5**zoom * torch.tensor([1.0 / NEAR if best[0] < 1.0 else 0.5, math.pi / TURNS], dtype=grid.dtype)
        grid = best + reach * around
        grid[:, 0].clamp_(0.0, GRAZING)
    return value, _directions(best.unsqueeze(0), side)


def _directions(grid: Tensor, side: float) -> Tensor:
    """Directions ``[N, 3]`` of ``(t, azimuth) [N, 2]``: even in angle up to t = 1, where the cosine is 1/10; from there it is 10^-t."""
    t, turn = grid.unbind(1)
    cos = torch.where(t < 1.0, torch.cos(t * math.acos(0.1)), 10.0**-t)
    sin = torch.sqrt(1.0 - cos * cos)
    return torch.stack([sin * torch.cos(turn), sin * torch.sin(turn), side * cos], -1)
