"""Where a model must be dark, and what its delta lobes do, which have nothing else to show."""

from typing import Any

import torch
from torch import Tensor

from ..bsdf.base import Bsdf
from ..bsdf.lobe import Lobe
from ..vector import Frame, reflect
from .sphere import is_delta
from .subject import DELTA, Outcome, above, at_angles, directions, mirrored, spread, transmits, uniform, viewers
from .words import degrees, pair


def dark_outside_domain(subject: Any, rng: torch.Generator, thorough: bool = False) -> Outcome:
    """Outside ``domain`` everything is 0: ``evaluate``, ``pdf``, the weights of samples. Nothing crosses without a transmission lobe."""
    name = "dark_outside_domain"
    if not isinstance(subject, Bsdf):
        return Outcome.absent(name, "not a BSDF")
    up = torch.cat([above(1024, rng), at_angles(*[89.0] * 1024)])
    wo = torch.cat([up, mirrored(up)])
    s = subject.sample(wo, uniform(4096, rng))
    wi, wo = torch.cat([s.wi, directions(4096, rng), mirrored(wo)]), wo.repeat(3, 1)
    dark = _must_be_dark(subject, wi, wo)
    light = subject.evaluate(wi, wo).abs().sum(-1) + subject.pdf(wi, wo).abs().sum(-1)
    light[:4096] += torch.where(is_delta(subject, s.lobe), 0.0, s.weight.abs().sum(-1) + s.pdf.abs().sum(-1))
    light = torch.where(dark, light.nan_to_num(nan=torch.inf), 0.0)
    total, k = float(light.sum()), int(light.argmax())
    where = f", most at {pair(wi[k], wo[k])}" if total else ""
    return Outcome(name, total == 0.0, total, f"sum of what should be 0{where}")


def _must_be_dark(subject: Bsdf, wi: Tensor, wo: Tensor) -> Tensor:
    dark = ~subject.domain(subject.geometry(wi, wo)).reshape(-1)
    if not transmits(subject):
        dark = dark | (wi[:, 2] * wo[:, 2] <= 0)
    if type(subject).domain is Bsdf.domain:
        dark = dark | (wi[:, 2] <= 0) | (wo[:, 2] <= 0)
    return dark


def delta_lobes(subject: Any, rng: torch.Generator, thorough: bool = False) -> Outcome:
    """``sample`` and ``deltas`` agree on direction and weight; a mirror lobe mirrors; a model of deltas alone evaluates to 0."""
    if not isinstance(subject, Bsdf) or subject.select(DELTA) is None:
        return Outcome.absent("delta_lobes", "no delta lobe")
    frame = Frame.from_normal(directions(512, rng))
    n, local = frame.normal, viewers(subject, 512, rng)
    wo = frame.to_world(local)
    s, viewer = subject.sample(wo, uniform(512, rng), n), subject.viewer(wo, n)
    errors = torch.zeros(512, dtype=wo.dtype)
    for d in subject.deltas(viewer):
        taken = (s.lobe == d.lobe) & (s.pdf > 0)
        wi, weight = (x.expand(512, x.shape[-1]) for x in (viewer.layout.join_vector(d.wi), viewer.layout.join(d.weight)))
        errors = torch.maximum(errors, torch.maximum(_size((s.wi - wi) * taken), _size((s.weight * s.pdf - weight) * taken)))
        if subject.lobes[d.lobe] == Lobe.DELTA_REFLECTION:
            errors = torch.maximum(errors, _size(wi - reflect(wo, n)))
        if spread(subject) is None:
            errors = torch.maximum(errors, torch.maximum(_size(subject.evaluate(wi, wo, n)), _size(subject.pdf(wi, wo, n))))
    worst, k = errors.max(0)
    detail = f"largest error of direction, weight, evaluate; for wo at {degrees(local[k])}"
    return Outcome("delta_lobes", float(worst) <= 64 * torch.finfo(wo.dtype).eps, float(worst), detail)


def _size(x: Tensor) -> Tensor:
    return x.abs().nan_to_num(nan=torch.inf).amax(-1)
