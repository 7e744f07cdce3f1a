"""Adaptive integrals over unit squares: cells are halved where the integrand varies, and where known points say that it must.

Several integrals are refined at once. A cell has a Gauss rule of 5 x 5 nodes. Its *roughness* along a side is what the two highest
Legendre polynomials that the nodes can see amount to: it bounds the error of a smooth integrand by far, and is of the size of the
error at kinks and jumps. Sums of null rules as error estimates: Berntsen & Espelid 1991, *Error estimation in automatic quadrature*.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import one_hot

from ..quadrature import gauss_legendre

ORDER, HIGHEST = 5, 2  # nodes along a side; polynomials whose share counts as error
ROOTS = (2, 4)  # cells to begin with
CROWD = 64  # a cell with more of the known points than this is halved whatever the rule says
PEAK = 8.0  # so is one whose integral is less than an eighth of what one of its points promises
SMALLEST = 2.0**-45  # area; half-way between the resolution of float64 and of any lobe
MOST = 20_000  # cells of one integral

Integrand = Callable[[Tensor, Tensor], Tensor]  # (points [K, N, 2], which integral [K]) -> values [K, N, C]


class Cells(NamedTuple):
    """A forest of halved rectangles; ``M`` cells, inner ones included, of which the leaves cover the square of each integral."""

    low: Tensor  # [M, 2] lower corner
    size: Tensor  # [M, 2]
    of: Tensor  # [M] which integral
    rank: Tensor  # [M] in [0, 1): where the cell's leaves come in a walk through the tree, neighbours together
    value: Tensor  # [M, C] the integral
    rough: Tensor  # [M, 2] along either side
    child: Tensor  # [M] the first of two halves, which lie one behind the other; -1 for a leaf
    axis: Tensor  # [M] the side that is halved

    @property
    def leaf(self) -> Tensor:
        """Which cells are leaves, ``[M]``."""
        return self.child < 0

    def total(self, what: Tensor) -> Tensor:
        """The sum of ``what [M, ...]`` over the leaves of each integral."""
        count, leaf = int(self.of.max()) + 1, self.leaf
        return what.new_zeros(count, *what.shape[1:]).index_add_(0, self.of[leaf], what[leaf])

    @property
    def error(self) -> Tensor:
        """A bound (see above) of the error of each integral."""
        return self.total(self.rough.sum(-1))

    def locate(self, points: Tensor, of: Tensor) -> Tensor:
        """The leaf in which each of ``points [P, 2]`` lies."""
        at = _root(points, of)
        inner = (~self.leaf[at]).nonzero().squeeze(1)
        while len(inner):
            at[inner] = self.descend(points[inner], at[inner])
            inner = inner[~self.leaf[at[inner]]]
        return at

    def descend(self, points: Tensor, at: Tensor) -> Tensor:
        """From cells to their halves, one step."""
        middle = self.low[at] + 0.5 * self.size[at]
        upper = (points >= middle).gather(1, self.axis[at].unsqueeze(1)).squeeze(1)
        return torch.where(self.leaf[at], at, self.child[at] + upper)


def integrate(integrand: Integrand, points: Tensor, of: Tensor, tolerance: float) -> Cells:
    """Integrals over [0, 1]^2, each to an error of about ``tolerance`` times its share of the roughness.

    ``points [P, 2]`` of integral ``of [P]`` are places where something is to be expected: no peak that holds one is overlooked.
    """
    cells, at = _roots(integrand, int(of.max()) + 1), _root(points, of)
    heights = integrand(points.unsqueeze(1), of).amax((1, 2))
    while bool(torch.isfinite(cells.value).all()):
        chosen = _unfinished(cells, at, heights, tolerance)
        if not bool(chosen.any()) or len(cells.of) > 2 * MOST * (int(of.max()) + 1):
            break
        cells = _halved(cells, chosen.nonzero().squeeze(1), integrand)
        at = cells.descend(points, at)
    return cells


def _unfinished(cells: Cells, at: Tensor, heights: Tensor, tolerance: float) -> Tensor:
    """Which leaves to halve: the crowded ones, those that miss a peak, and the roughest, until what is left is within tolerance."""
    crowded = torch.bincount(at, minlength=len(cells.of)) > CROWD
    promised = heights.new_zeros(len(cells.of)).scatter_reduce_(0, at, heights, "amax") * cells.size.prod(-1)
    peaked = (promised > PEAK * cells.value.amax(-1)) & (promised > 1e-2 * tolerance)
    rough, order = torch.where(cells.leaf, cells.rough.sum(-1), 0.0).sort()
    uncertain = torch.zeros_like(crowded)
    uncertain[order[rough.cumsum(0) > tolerance * (int(cells.of.max()) + 1)]] = True
    return cells.leaf & (crowded | peaked | uncertain) & (cells.size.prod(-1) > SMALLEST)


def _root(points: Tensor, of: Tensor) -> Tensor:
    nx, ny = ROOTS
    x, y = (points * torch.tensor(ROOTS, dtype=points.dtype)).long().unbind(1)
    return of * nx * ny + x.clamp(0, nx - 1) * ny + y.clamp(0, ny - 1)


def _roots(integrand: Integrand, count: int) -> Cells:
    nx, ny = ROOTS
    corners = torch.cartesian_prod(torch.arange(nx, dtype=torch.float64) / nx, torch.arange(ny, dtype=torch.float64) / ny)
    low, of = corners.repeat(count, 1), torch.arange(count).repeat_interleave(nx * ny)
    rank = (torch.arange(nx * ny, dtype=torch.float64) / (nx * ny)).repeat(count)
    return _measured(integrand, low, torch.tensor([1 / nx, 1 / ny], dtype=torch.float64).expand_as(low), of, rank)


def _halved(cells: Cells, chosen: Tensor, integrand: Integrand) -> Cells:
    """The cells, ``chosen [K]`` of them halved across their rougher side; where nothing is seen, across the longer one."""
    rough, size = cells.rough[chosen], cells.size[chosen]
    side = torch.where(rough.sum(-1, keepdim=True) > 0, rough, size).argmax(-1)
    cells.axis[chosen] = side
    cells.child[chosen] = len(cells.of) + 2 * torch.arange(len(chosen))
    along = one_hot(side, 2).to(size.dtype)
    size = size * (1.0 - 0.5 * along)
    low = torch.stack([cells.low[chosen], cells.low[chosen] + along * size], 1).flatten(0, 1)
    # A root's share of the ranks is its area: all ranks stay exact.
    rank = torch.stack([cells.rank[chosen], cells.rank[chosen] + size.prod(-1)], 1).flatten()
    new = _measured(integrand, low, size.repeat_interleave(2, 0), cells.of[chosen].repeat_interleave(2), rank)
    return Cells(*(torch.cat(pair) for pair in zip(cells, new, strict=True)))


def _measured(integrand: Integrand, low: Tensor, size: Tensor, of: Tensor, rank: Tensor) -> Cells:
    """Cells without halves, with their integrals and roughness."""
    x, weight, null = _rule()
    nodes = torch.cartesian_prod(x, x)
    f = integrand(low.unsqueeze(1) + size.unsqueeze(1) * nodes, of) * size.prod(-1).reshape(-1, 1, 1)
    grid = f.unflatten(1, (ORDER, ORDER))
    value = torch.einsum("kijc,i,j->kc", grid, weight, weight)
    along_x = torch.einsum("knjc,j->kc", torch.einsum("kijc,ni->knjc", grid, null).abs(), weight)
    along_y = torch.einsum("knic,i->kc", torch.einsum("kijc,nj->knic", grid, null).abs(), weight)
    rough = torch.stack([along_x.amax(-1), along_y.amax(-1)], -1)
    none = torch.full_like(of, -1)
    return Cells(low, size, of, rank, value, rough, none, torch.zeros_like(of))


@functools.cache
def _rule() -> tuple[Tensor, Tensor, Tensor]:
    """Nodes and weights on [0, 1], and rows that give the highest Legendre coefficients."""
    x, weight = gauss_legendre(ORDER)
    legendre = [torch.ones_like(x), 2.0 * x - 1.0]
    for k in range(1, ORDER - 1):
        legendre.append(((2 * k + 1) * legendre[1] * legendre[k] - k * legendre[k - 1]) / (k + 1))
    return x, weight, torch.stack(legendre[-HIGHEST:]) * weight
