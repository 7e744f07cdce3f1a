"""Helmholtz reciprocity, f(wi, wo)/n_o^2 = f(wo, wi)/n_i^2, by differences: a ratio would hide what is near 0."""

from typing import Any

import torch

from .subject import Outcome, smooth_points, spread
from .words import pair

ROUNDINGS = 2.0**20  # times eps: exponents of 1e4 magnify the rounding of a cosine ten-thousandfold


def reciprocity(subject: Any, rng: torch.Generator, thorough: bool = False) -> Outcome:
    """Largest difference of f under exchange of the directions, over the largest f; across an interface as radiance or flux has it."""
    if spread(subject) is None:
        return Outcome.absent("reciprocity", "no lobe to evaluate")
    if not subject.reciprocal:
        return Outcome.absent("reciprocity", "the model claims none")
    w = smooth_points(subject, rng, 4096 if thorough else 256)
    there, back = subject.evaluate(w["wi"], w["wo"], w["n"]), subject.evaluate(w["wo"], w["wi"], w["n"])
    back = back * subject.exchange(subject.geometry(w["wi"], w["wo"], w["n"])).reshape(-1, 1)
    worst, k = (there - back).abs().nan_to_num(nan=torch.inf).amax(-1).max(0)
    allowed = ROUNDINGS * torch.finfo(there.dtype).eps * float(there.abs().max())
    where = pair(w["wi"][k], w["wo"][k], w["n"][k])
    return Outcome("reciprocity", float(worst) <= allowed, float(worst), f"largest |f(wi, wo) - f(wo, wi)|, 1/sr; {where}")
