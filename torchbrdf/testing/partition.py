"""The sphere in bins that follow a lobe: rings about its peak at the quantiles of pilot samples, cut into sectors."""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from ..bsdf.base import Bsdf
from ..bsdf.sampler import mixture_density
from ..quadrature import gauss_legendre
from ..vector import Frame, normalize
from .subject import uniform

RINGS, SECTORS = 16, 8
PILOTS = 4096
RADIAL, ANGULAR = 32, 16  # nodes within a bin


class Partition(NamedTuple):
    """Bins for one ``wo [1, 3]``; ``edges [RINGS + 1]`` are of 1 - cosine to the peak, which keeps its digits near 0."""

    frame: Frame
    edges: Tensor

    @staticmethod
    def of(bsdf: Bsdf, wo: Tensor, rng: torch.Generator) -> "Partition":
        """Adapted to where the sampler of ``bsdf`` goes."""
        wi = spread_samples(bsdf, wo, uniform(PILOTS, rng))
        peak = normalize(wi[sampling_density(bsdf, wi, wo).argmax()])
        rings = torch.quantile(complement(wi, peak), torch.linspace(0, 1, RINGS + 1, dtype=wi.dtype))
        edges = torch.cat([torch.zeros(1, dtype=wi.dtype), rings[1:-1], torch.full((1,), 2.0, dtype=wi.dtype)])
        return Partition(Frame.from_normal(peak), edges)

    def counts(self, wi: Tensor) -> Tensor:
        """How many of ``wi [N, 3]`` fall into each bin, ``[RINGS, SECTORS]``."""
        local = self.frame.to_local(wi)
        ring = torch.bucketize(complement(wi, self.frame.normal), self.edges[1:-1].contiguous())
        turn = torch.atan2(local[:, 1], local[:, 0]) / (2.0 * math.pi) % 1.0
        sector = (turn * SECTORS).long().clamp_max(SECTORS - 1)
        return torch.bincount(ring * SECTORS + sector, minlength=RINGS * SECTORS).reshape(RINGS, SECTORS)

    def integrals(self, bsdf: Bsdf, wo: Tensor) -> Tensor:
        """The integral of the pdf over each bin, ``[RINGS, SECTORS]``, by Gauss-Legendre in every bin."""
        (t, wt), (p, wp) = gauss_legendre(RADIAL), gauss_legendre(ANGULAR)
        low, high = self.edges[:-1, None], self.edges[1:, None]
        # Logarithmic away from the peak: an outer ring may span many widths of the lobe.
        ratio = torch.log(high / torch.where(low > 0, low, high))
        x = torch.where(low > 0, low * torch.exp(ratio * t), high * t)
        dx = torch.where(low > 0, x * ratio, high) * wt
        phi = (torch.arange(SECTORS)[:, None] + p) * (2.0 * math.pi / SECTORS)
        wi = self.frame.to_world(_around(x.reshape(RINGS, 1, RADIAL, 1), phi.reshape(1, SECTORS, 1, ANGULAR)))
        pdf = sampling_density(bsdf, wi.reshape(-1, 3), wo).reshape(RINGS, SECTORS, RADIAL, ANGULAR)
        return torch.einsum("rspa,rp,a->rs", pdf, dx, wp * (2.0 * math.pi / SECTORS))


def sampling_density(bsdf: Bsdf, wi: Tensor, wo: Tensor) -> Tensor:
    """The density ``[N]`` of all samples, outside the model's domain, too (where ``pdf`` is 0), at ``wi [N, 3]`` for ``wo [1, 3]``."""
    return mixture_density(bsdf, bsdf.geometry(wi, wo)).reshape(len(wi))


def complement(wi: Tensor, peak: Tensor) -> Tensor:
    """1 - wi.peak as half the squared distance."""
    return 0.5 * ((wi - peak) ** 2).sum(-1)


def _around(x: Tensor, phi: Tensor) -> Tensor:
    sin = torch.sqrt(x * (2.0 - x))
    return torch.stack(torch.broadcast_tensors(sin * torch.cos(phi), sin * torch.sin(phi), 1.0 - x), -1)


def spread_samples(bsdf: Bsdf, wo: Tensor, u: Tensor) -> Tensor:
    """The samples ``wi [M, 3]`` that are of no delta lobe."""
    s = bsdf.sample(wo, u)
    return s.wi[~is_delta(bsdf, s.lobe)]


def is_delta(bsdf: Bsdf, lobe: Tensor) -> Tensor:
    """Which samples ``[N]`` are of a delta lobe, by their lobe ``[N, 1]``."""
    return torch.tensor([kind.is_delta for kind in bsdf.lobes])[lobe.squeeze(-1)]
