"""Bins for a chi-square test: the cells of the very integral of the density, neighbours together until a bin holds its share."""

from typing import NamedTuple

import torch
from torch import Tensor

from ..bsdf.base import Bsdf
from .cubature import Cells
from .sphere import from_square, integral, pilots, sampling_density, to_square
from .words import angles

BINS = 128
DARK = 1e-7  # a cell of less probability than this belongs to the dark


class Partition(NamedTuple):
    """The bins of each of ``wo [V, 3]``: ``BINS`` of about equal probability, and behind them one of all that is dark."""

    wo: Tensor
    cells: Cells
    bin: Tensor  # [M] of each leaf

    @staticmethod
    def of(bsdf: Bsdf, wo: Tensor, rng: torch.Generator) -> "Partition":
        """Adapted to the density of ``bsdf``, and to where its sampler goes."""
        cells = integral(lambda wi, v: sampling_density(bsdf, wi, v), wo, *pilots(bsdf, wo, rng))
        return Partition(wo, cells, _bins(cells))

    @property
    def integrals(self) -> Tensor:
        """The integral of the density over each bin, ``[V, BINS + 1]``."""
        return self.sums(self.cells.value[:, 0])

    def counts(self, wi: Tensor, of: Tensor) -> Tensor:
        """How many of ``wi [N, 3]``, samples for ``wo[of]``, fall into each cell, ``[M]``."""
        return torch.bincount(self.cells.locate(to_square(wi, self.wo, of), of), minlength=len(self.bin)).to(wi.dtype)

    def sums(self, cells: Tensor) -> Tensor:
        """Of numbers ``[M]`` of cells, ``[V, BINS + 1]``."""
        leaf, index = self.cells.leaf, self.cells.of * (BINS + 1) + self.bin
        zero = cells.new_zeros(len(self.wo) * (BINS + 1))
        return zero.index_add_(0, index[leaf], cells[leaf]).reshape(-1, BINS + 1)

    def place(self, view: int, bin: int, surplus: Tensor) -> str:
        """The middle of that cell of a bin where ``surplus [M]`` is largest in size, in words."""
        mine = (self.cells.leaf & (self.cells.of == view) & (self.bin == bin)).nonzero().squeeze(1)
        k = mine[surplus[mine].abs().argmax()]
        middle = self.cells.low[k] + 0.5 * self.cells.size[k]
        return angles(from_square(middle.reshape(1, 1, 2), self.wo, torch.tensor([view]))[0].flatten())


def _bins(cells: Cells) -> Tensor:
    """By the probability of all leaves that come before in a walk through the tree."""
    leaf, mass = cells.leaf, cells.value[:, 0].clamp_min(0.0)
    bins = torch.full_like(cells.of, BINS)
    for view in range(int(cells.of.max()) + 1):
        mine = (leaf & (cells.of == view) & (mass >= DARK)).nonzero().squeeze(1)
        mine = mine[cells.rank[mine].argsort()]
        before = mass[mine].cumsum(0) - 0.5 * mass[mine]
        bins[mine] = (before / mass[mine].sum() * BINS).long().clamp(0, BINS - 1)
    return bins
