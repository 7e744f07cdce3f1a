"""Directions from uniform numbers, in the local frame (z = axis)."""

import math

import torch
from torch import Tensor

from . import numerics
from .vector import Vec


def cosine_hemisphere(x: Tensor, y: Tensor) -> Vec:
    """Density cos / pi: a uniform point of the disk, lifted to the hemisphere (Malley 1988)."""
    r, phi = torch.sqrt(x), 2.0 * math.pi * y
    return Vec(r * torch.cos(phi), r * torch.sin(phi), torch.sqrt(1.0 - x))


def cosine_power(x: Tensor, y: Tensor, power: Tensor) -> Vec:
    """Density of the cosine ``power cos^(power-1)``; the sine by expm1, accurate at any power (Lafortune & Willems 1994, eq. 11)."""
    log_cos = torch.log(1.0 - x) / power
    cos, sin = torch.exp(log_cos), numerics.safe_sqrt(-torch.expm1(2.0 * log_cos))
    phi = 2.0 * math.pi * y
    return Vec(sin * torch.cos(phi), sin * torch.sin(phi), cos)


def uniform_sphere(x: Tensor, y: Tensor) -> Vec:
    """Density 1 / (4 pi)."""
    z = 1.0 - 2.0 * x
    r, phi = 2.0 * torch.sqrt(x * (1.0 - x)), 2.0 * math.pi * y
    return Vec(r * torch.cos(phi), r * torch.sin(phi), z)


def uniform_hemisphere(x: Tensor, y: Tensor) -> Vec:
    """Density 1 / (2 pi)."""
    z = 1.0 - x
    r, phi = torch.sqrt(x * (2.0 - x)), 2.0 * math.pi * y
    return Vec(r * torch.cos(phi), r * torch.sin(phi), z)


def choose(u: Tensor, shares: list[Tensor]) -> tuple[list[Tensor], Tensor]:
    """Which of some alternatives uniform ``u [...]`` in [0, 1) chooses, as masks, and ``u`` stretched back to [0, 1) for the next choice.

    ``shares`` are probabilities that sum to 1 up to rounding; an alternative of share 0 is never chosen.
    """
    below = torch.zeros_like(shares[0])
    chosen: list[Tensor] = []
    rest = torch.zeros_like(u)
    for share in shares:
        mine = (u >= below) & (share > 0)
        chosen = [m & mine.logical_not() for m in chosen] + [mine]  # rounding leaves what is above the last share to it
        rest = torch.where(mine, (u - below) / torch.where(share > 0, share, 1.0), rest)
        below = below + share
    return chosen, numerics.unit_interval(rest).clamp_max(1.0 - torch.finfo(rest.dtype).eps)
