"""Energy: the directional albedo against its promised bound and against an independent quadrature of ``evaluate``."""

import math
from typing import Any

import torch
from torch import Tensor

from ..bsdf.base import Bsdf
from ..bsdf.lambert import Lambert
from ..quadrature import gauss_legendre
from .subject import DELTA, Outcome, above, at_angles, spread, transmits

ANGLES = (0.0, 45.0, 80.0, 89.0)
QUADRATURE = 2e-3  # directional_albedo keeps 1e-3 where F has no critical angle, as typical draws have none; twice that
FINEST = 512


def energy_bound(subject: Any, rng: torch.Generator, thorough: bool = False) -> Outcome:
    """The directional albedo at normal, 45 degrees and grazing must not exceed ``energy_bound``."""
    if not isinstance(subject, Bsdf):
        return Outcome.absent("energy_bound", "not a BSDF")
    if subject.energy_bound is None:
        return Outcome.absent("energy_bound", "the model promises none")
    angles = tuple(range(0, 90, 3)) if thorough else ANGLES
    excess = subject.directional_albedo(at_angles(*angles)) - subject.energy_bound
    worst = float(excess.max())
    return Outcome("energy_bound", worst <= QUADRATURE * max(1.0, float(subject.energy_bound.max())), worst, "largest albedo - bound")


def albedo(subject: Any, rng: torch.Generator, thorough: bool = False) -> Outcome:
    """``directional_albedo`` must equal the integral of ``evaluate`` times the cosine, delta lobes added."""
    if not isinstance(subject, Bsdf):
        return Outcome.absent("albedo", "not a BSDF")
    worst, allowed = 0.0, QUADRATURE
    for wo in at_angles(*ANGLES).split(1):
        integral, uncertainty = hemisphere(subject, wo)
        if uncertainty > 0.05:
            return Outcome.absent("albedo", f"too narrow for a product quadrature of {FINEST} nodes")
        delta = subject.select(DELTA)
        expected = integral if delta is None else integral + delta.directional_albedo(wo)
        error = float((subject.directional_albedo(wo) - expected).abs().max())
        if error - uncertainty > worst:
            worst, allowed = error - uncertainty, QUADRATURE * max(1.0, float(expected.max()))
    return Outcome("albedo", worst <= allowed, worst, "largest |directional_albedo - integral of evaluate|")


def hemisphere(bsdf: Bsdf, w: Tensor) -> tuple[Tensor, float]:
    """The part of the light arriving along ``w [1, 3]`` that leaves again, delta lobes apart: the integral of ``evaluate`` times the
    cosine of where it goes; and how far it moved at the last refinement."""
    if spread(bsdf) is None:
        return torch.zeros(1, bsdf.channels, dtype=w.dtype), 0.0
    order, coarse = 32, torch.zeros(())
    while True:
        out, weight = _nodes(order, transmits(bsdf))
        fine = (bsdf.evaluate(w, out) * weight).sum(0, keepdim=True)
        moved = float((fine - coarse).abs().max())
        if order > 32 and (moved < 0.1 * QUADRATURE or order == FINEST):
            return fine, moved
        order, coarse = 2 * order, fine


def _nodes(order: int, both_sides: bool = False) -> tuple[Tensor, Tensor]:
    """Directions ``[2 order^2, 3]`` and weights ``[2 order^2, 1]``, the cosine included: Gauss in it, midpoints in azimuth."""
    if both_sides:
        up, w = _nodes(order)
        return torch.cat([up, up * torch.tensor([1.0, 1.0, -1.0], dtype=up.dtype)]), torch.cat([w, w])
    z, w = (t.reshape(-1, 1) for t in gauss_legendre(order))
    phi = (torch.arange(2 * order, dtype=z.dtype) + 0.5) * (math.pi / order)
    r = torch.sqrt(1.0 - z * z)
    wi = torch.stack(torch.broadcast_tensors(r * torch.cos(phi), r * torch.sin(phi), z), -1)
    return wi.reshape(-1, 3), (z * w * (math.pi / order)).expand(-1, 2 * order).reshape(-1, 1)


def lambert(subject: Any, rng: torch.Generator, thorough: bool = False) -> Outcome:
    """Of Lambert's surface alone: albedo = pi f at every pair of directions, and radiosity M = pi L."""
    if not isinstance(subject, Lambert):
        return Outcome.absent("lambert", "not Lambert's surface")
    f = subject.evaluate(above(64, rng), above(64, rng))
    radiance = f[0]  # under unit irradiance
    wo, cosine = _nodes(32)
    radiosity = (subject.evaluate(above(1, rng), wo) * cosine).sum(0)
    worst = max(float((math.pi * f - subject.albedo).abs().max()), float((radiosity - math.pi * radiance).abs().max()))
    return Outcome("lambert", worst <= 64 * torch.finfo(f.dtype).eps, worst, "largest |albedo - pi f|, |M - pi L|")
