"""The sphere as a unit square about -wo, integrals over it, and the samples that fall on it.

The polar angle and azimuth about -wo are those of the half vector about wo, at half the angle: whatever a sampler of half vectors
does is as smooth here as the density of its half vectors, though 1 / (4 wi.h) has a pole at wi = -wo. The same holds for the
generalised half vector of refraction, whose densities end at a circle about -wo. Lobes about any other direction are found by
halving cells (cubature.py).
"""

import math
from collections.abc import Callable

import torch
from torch import Tensor

from ..bsdf.base import Bsdf
from ..bsdf.sampler import mixture_density
from ..vector import Frame, normalize
from .cubature import Cells, integrate
from .subject import uniform

PILOTS = 4096  # samples that show where a sampler goes
LATTICE = 1024  # directions at which peaks are looked for, sampled or not: wider than 4 degrees are seen
TOLERANCE = 5e-4  # of integrals; what is reached is ten times better, a hundred times where all is smooth


def integral(f: Callable[[Tensor, Tensor], Tensor], wo: Tensor, wi: Tensor, of: Tensor, tolerance: float = TOLERANCE) -> Cells:
    """``f(wi, wo)`` (``[N, 3]`` each ``-> [N, C]``) over the sphere of ``wi``, for each of ``wo [V, 3]``.

    ``wi [P, 3]``, of ``wo[of]``, are directions near which something is to be expected.
    """
    hints, hinted = _hints(wo)
    wi, of = torch.cat([wi, hints]), torch.cat([of, hinted])

    def integrand(x: Tensor, index: Tensor) -> Tensor:
        directions, area = from_square(x, wo, index)
        there = wo[index].unsqueeze(1).expand_as(directions)
        return f(directions.flatten(0, 1), there.flatten(0, 1)).unflatten(0, x.shape[:2]) * area

    return integrate(integrand, to_square(wi, wo, of), of, tolerance)


def from_square(x: Tensor, wo: Tensor, of: Tensor) -> tuple[Tensor, Tensor]:
    """Directions ``[K, N, 3]`` of points ``[K, N, 2]`` about ``-wo[of [K]]``, and steradians per unit of area ``[K, N, 1]``."""
    polar, azimuth = math.pi * x[..., :1], 2.0 * math.pi * x[..., 1:]
    sin = torch.sin(polar)
    tangent, bitangent, normal = (axis[of].unsqueeze(1) for axis in Frame.from_normal(-wo))
    side = tangent * torch.cos(azimuth) + bitangent * torch.sin(azimuth)
    return side * sin + normal * torch.cos(polar), 2.0 * math.pi**2 * sin


def to_square(wi: Tensor, wo: Tensor, of: Tensor) -> Tensor:
    """Points ``[N, 2]`` of directions ``[N, 3]`` about ``-wo[of [N]]``."""
    x, y, z = ((axis[of] * wi).sum(-1) for axis in Frame.from_normal(-wo))
    return torch.stack([torch.atan2(torch.hypot(x, y), z) / math.pi, torch.atan2(y, x) / (2.0 * math.pi) % 1.0], -1)


def _hints(wo: Tensor) -> tuple[Tensor, Tensor]:
    """The mirror direction and wo itself, where a narrow peak may hide that no sample finds, and an even lattice."""
    i = torch.arange(LATTICE, dtype=wo.dtype) + 0.5
    z, turn = 1.0 - 2.0 * i / LATTICE, i * (math.pi * (3.0 - 5.0**0.5))
    r = torch.sqrt(1.0 - z * z)
    lattice = torch.stack([r * torch.cos(turn), r * torch.sin(turn), z], -1)
    mirror = wo * torch.tensor([-1.0, -1.0, 1.0], dtype=wo.dtype)
    own = torch.stack([mirror, wo], 1)
    hints = torch.cat([own, lattice.expand(len(wo), -1, -1)], 1)
    return hints.reshape(-1, 3), torch.arange(len(wo)).repeat_interleave(hints.shape[1])


def sampling_density(bsdf: Bsdf, wi: Tensor, wo: Tensor) -> Tensor:
    """The density ``[N, 1]`` of all samples, outside the model's domain, too (where ``pdf`` is 0)."""
    return mixture_density(bsdf, bsdf.geometry(wi, wo)).reshape(-1, 1).expand(len(wi), 1)


def spread_samples(bsdf: Bsdf, wo: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
    """Samples ``wi [N, 3]`` for each of ``wo [V, 3]`` and ``u [P, 3]`` that have a density, and of which wo ``[N]`` they are.

    Those of delta lobes have none, nor have those that are lost: for which the sampler has no direction to give, and gives (0, 0, 0).
    """
    s = bsdf.sample(wo.unsqueeze(1), u.unsqueeze(0))
    found = ~(is_delta(bsdf, s.lobe) | (s.wi == 0).all(-1))
    return s.wi[found], torch.arange(len(wo)).unsqueeze(1).expand_as(found)[found]


def pilots(bsdf: Bsdf, wo: Tensor, rng: torch.Generator) -> tuple[Tensor, Tensor]:
    """As :func:`spread_samples`: where the sampler goes; without those of no usable direction."""
    wi, of = spread_samples(bsdf, wo, uniform(PILOTS, rng))
    usable = torch.isfinite(wi).all(-1)
    return normalize(wi[usable]), of[usable]


def is_delta(bsdf: Bsdf, lobe: Tensor) -> Tensor:
    """Which samples ``[...]`` are of a delta lobe, by their lobe ``[..., 1]``."""
    return torch.tensor([kind.is_delta for kind in bsdf.lobes])[lobe.squeeze(-1)]
