"""Rules for integrals: nodes and weights in float64, on the CPU."""

import torch
from torch import Tensor


def gauss_legendre(order: int) -> tuple[Tensor, Tensor]:
    """``order`` nodes and weights on [0, 1]."""
    import numpy as np

    x, w = np.polynomial.legendre.leggauss(order)
    return torch.from_numpy(0.5 * (x + 1.0)), torch.from_numpy(0.5 * w)


def midpoints(count: int) -> Tensor:
    """``count`` nodes of equal weight on [0, 1], for periodic integrands."""
    return (torch.arange(count, dtype=torch.float64) + 0.5) / count


def unit_square(order: int) -> tuple[Tensor, Tensor]:
    """``order^2`` nodes ``[order^2, 3]`` and weights: Gauss in x, midpoints in y, which is an azimuth; z = 1/2 chooses nothing."""
    x, weight = gauss_legendre(order)
    u = torch.stack(torch.meshgrid(x, midpoints(order), indexing="ij"), -1).reshape(-1, 2)
    return torch.cat([u, torch.full_like(u[:, :1], 0.5)], -1), weight.repeat_interleave(order) / order


def unit_cube(count: int) -> tuple[Tensor, Tensor]:
    """``count`` points of Sobol' ``[count, 3]`` of equal weight, for integrands that jump along z."""
    u = torch.quasirandom.SobolEngine(3, scramble=True, seed=0).draw(count, dtype=torch.float64)
    return u, torch.full((count,), 1.0 / count, dtype=torch.float64)
