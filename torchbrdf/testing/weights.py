"""Sample weights against ``evaluate``, and their mean against the directional albedo."""

from typing import Any

import torch
from torch import Tensor

from ..bsdf.base import Bsdf
from ..vector import Frame
from .sphere import is_delta
from .subject import Outcome, directions, spread, uniform, viewers, views
from .words import degrees, pair

ANGLES = (0.0, 45.0, 80.0)
STANDARD_ERRORS = 5.0


def weights_match(subject: Any, rng: torch.Generator, thorough: bool = False) -> Outcome:
    """``weight * pdf`` must be ``evaluate`` times the cosine, and the sample's pdf that of ``pdf``, in world space too."""
    name = "weights_match"
    if spread(subject) is None:
        return Outcome.absent(name, "no lobe that has a density")
    frame = Frame.from_normal(directions(1024, rng))
    wo = frame.to_world(viewers(subject, 1024, rng))
    s = subject.sample(wo, uniform(1024, rng), frame.normal)
    f, pdf = subject.evaluate(s.wi, wo, frame.normal), subject.pdf(s.wi, wo, frame.normal)
    cos = frame.to_local(s.wi)[:, 2:].abs()
    spreads = ~is_delta(subject, s.lobe).unsqueeze(-1)
    errors = torch.cat([_relative(s.weight * s.pdf, f * cos, spreads), _relative(s.pdf, pdf, spreads)], -1)
    worst, k = errors.max(-1).values.max(0)
    where = "weight pdf against f cos, pdf against its own, over the largest; " + pair(s.wi[k], wo[k], frame.normal[k])
    # the two routes differ by rounding alone, which an exponent of 1e4 magnifies ten-thousandfold
    return Outcome(name, float(worst) <= 2.0**20 * torch.finfo(f.dtype).eps, float(worst), where)


def _relative(a: Tensor, b: Tensor, counts: Tensor) -> Tensor:
    """Differences over the largest, infinite where they are NaN, 0 where a sample does not count."""
    scale = torch.where(counts, b.abs(), 0.0).max().clamp_min(torch.finfo(b.dtype).tiny)
    return torch.where(counts, ((a - b).abs() / scale).nan_to_num(nan=torch.inf), 0.0)


def mean_weight(subject: Any, rng: torch.Generator, thorough: bool = False) -> Outcome:
    """The mean of ``sample(...).weight``, as power, must be the directional albedo, delta lobes included; of reciprocal models."""
    name = "mean_weight"
    if not isinstance(subject, Bsdf):
        return Outcome.absent(name, "not a BSDF")
    if not subject.reciprocal:
        return Outcome.absent(name, "the model is not reciprocal: samples follow the light that arrives, the albedo that which leaves")
    count, worst, where = 100_000 if thorough else 8192, -1.0, ""
    for wo in views(subject, ANGLES).split(1):
        error = _standard_errors(subject, wo, uniform(count, rng))
        worst, where = max((worst, where), (error, degrees(wo[0])))
    return Outcome(name, worst <= STANDARD_ERRORS, worst, f"standard errors between mean weight and albedo, for wo at {where}")


def _standard_errors(bsdf: Bsdf, wo: Tensor, u: Tensor) -> float:
    s = bsdf.sample(wo, u)
    # Of power: radiance grows by the square of the index across an interface, unless the model counts flux.
    weight = s.weight if bsdf.is_adjoint else s.weight * s.eta * s.eta
    # 2e-3: twice the stated error of directional_albedo's quadrature, relative to the brightest channel
    floor = 2e-3 * max(1.0, float(weight.mean(0).max())) / STANDARD_ERRORS
    error = (weight.mean(0) - bsdf.directional_albedo(wo)).abs()
    worst = float((error / (weight.std(0) / len(u) ** 0.5 + floor)).max())
    return worst if worst == worst else float("inf")
