"""Energy: no light is made, and the directional albedo is what an independent, adaptive integral of ``evaluate`` says."""

import math
from typing import Any

import torch
from torch import Tensor

from ..bsdf.base import Bsdf
from ..bsdf.lambert import Lambert
from .brightest import brightest
from .sphere import TOLERANCE, integral, pilots
from .subject import DELTA, Outcome, above, generator, spread, views
from .words import degrees

ANGLES = (0.0, 45.0, 80.0, 89.0)
ORDER = 128  # nodes along a side of directional_albedo's quadrature: what is judged is the model, not the default number of nodes
QUADRATURE = 2e-3  # what they keep, critical angles and grazing included, where half of a sampler's half vectors face away


def energy_bound(subject: Any, rng: torch.Generator, thorough: bool = False) -> Outcome:
    """The largest directional albedo, sought over all directions, must exceed neither 1 nor ``energy_bound``, unless that is None."""
    name = "energy_bound"
    if not isinstance(subject, Bsdf):
        return Outcome.absent(name, "not a BSDF")
    bound = subject.energy_bound
    promise = torch.full((1,), torch.inf, dtype=torch.float64) if bound is None else bound.to(torch.float64).clamp_max(1.0)
    where = brightest(subject, torch.where(promise < torch.inf, promise, 0.0), thorough)
    found = subject.directional_albedo(where, order=ORDER).reshape(-1)
    excess = torch.where(torch.isfinite(found), found - promise, torch.inf)
    k = int((found if bound is None or bool((excess <= QUADRATURE).all()) else excess).argmax())
    at = f"largest directional albedo, at {degrees(where[0])}"
    if bound is None:
        return Outcome(name, None, float(found[k]), f"{at}; the model promises nothing")
    ok, most = bool((excess <= QUADRATURE).all()), float(promise.expand_as(found)[k])
    return Outcome(name, ok, float(found[k]), at if ok else f"{at}: above {most:.3g}{', its energy_bound' if most < 1.0 else ''}")


def albedo(subject: Any, rng: torch.Generator, thorough: bool = False) -> Outcome:
    """``directional_albedo`` must equal the integral of ``evaluate`` times the cosine, delta lobes added."""
    if not isinstance(subject, Bsdf):
        return Outcome.absent("albedo", "not a BSDF")
    w = views(subject, ANGLES)
    expected, doubt = leaving(subject, w, rng)
    delta = subject.select(DELTA)
    expected = expected if delta is None else expected + delta.directional_albedo(w)
    error = (subject.directional_albedo(w, order=ORDER) - expected).abs().nan_to_num(nan=torch.inf)
    error, k = (error / expected.clamp_min(1.0)).amax(-1).max(0)
    detail = f"largest |directional_albedo - integral of evaluate|, at {degrees(w[k])}"
    wide = float(doubt[k]) > QUADRATURE
    return Outcome("albedo", float(error) <= QUADRATURE, float(error), detail + f", known to {float(doubt[k]):.1g}" * wide)


def leaving(bsdf: Bsdf, w: Tensor, rng: torch.Generator, tolerance: float = TOLERANCE) -> tuple[Tensor, Tensor]:
    """The part ``[V, C]`` of light arriving along ``w [V, 3]`` that leaves again, delta lobes apart, and a bound ``[V]`` of its error."""
    if spread(bsdf) is None:
        return torch.zeros(len(w), bsdf.channels, dtype=w.dtype), torch.zeros(len(w), dtype=w.dtype)

    def sent(out: Tensor, w: Tensor) -> Tensor:
        return (bsdf.evaluate(out, w) if bsdf.is_adjoint else bsdf.evaluate(w, out)) * out[:, 2:].abs()

    cells = integral(sent, w, *pilots(bsdf, w, rng), tolerance)
    return cells.total(cells.value), cells.error


def hemisphere(bsdf: Bsdf, w: Tensor) -> tuple[Tensor, float]:
    """As :func:`leaving`, of ``w [1, 3]``."""
    found, error = leaving(bsdf, w, generator(0), tolerance=1e-4)
    return found, float(error)


def lambert(subject: Any, rng: torch.Generator, thorough: bool = False) -> Outcome:
    """Of Lambert's surface alone: albedo = pi f at every pair of directions, and radiosity M = pi L."""
    if not isinstance(subject, Lambert):
        return Outcome.absent("lambert", "not Lambert's surface")
    f = subject.evaluate(above(64, rng), above(64, rng))
    radiance = f[0]  # under unit irradiance
    # Midpoints in the square of the sine, in which the cosine-weighted hemisphere is even.
    sin2, turn = ((torch.arange(32, dtype=f.dtype) + 0.5) / 32 for _ in range(2))
    s, a = torch.meshgrid(torch.sqrt(sin2), 2.0 * math.pi * turn, indexing="ij")
    wo = torch.stack([s * torch.cos(a), s * torch.sin(a), torch.sqrt(1.0 - s * s)], -1).reshape(-1, 3)
    radiosity = math.pi * subject.evaluate(above(1, rng), wo).mean(0)
    worst = max(float((math.pi * f - subject.albedo).abs().max()), float((radiosity - math.pi * radiance).abs().max()))
    return Outcome("lambert", worst <= 64 * torch.finfo(f.dtype).eps, worst, "largest |albedo - pi f|, |M - pi L|")
