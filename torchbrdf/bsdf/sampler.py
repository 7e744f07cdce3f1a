"""Sampling, written once for all models: choose among lobes, draw one direction, then one density and one formula for it."""

from __future__ import annotations  # of functions made inside graphs, which older compilers could not make

from typing import NamedTuple

import torch
from torch import Tensor

from .. import numerics
from ..geometry import Channels, Geometry, Viewer, each
from ..sampling import choose
from ..vector import Vec
from .base import Bsdf
from .lobe import Delta


class Sampled(NamedTuple):
    """A sample inside the formulas: components, channels and numbers ``[...]``."""

    wi: Vec
    weight: Channels
    pdf: Tensor
    lobe: Tensor
    eta: Tensor


def normalised(strengths: list[Tensor]) -> list[Tensor]:
    """Shares in proportion to detached strengths >= 0; equal ones where all are 0."""
    weights = [s.detach() for s in strengths]
    total = sum(weights[1:], weights[0])
    some = total > 0
    inverse = 1.0 / torch.where(some, total, 1.0)
    return [torch.where(some, w * inverse, 1.0 / len(weights)) for w in weights]


def has_spread(bsdf: Bsdf) -> bool:
    """Whether some lobe is no delta."""
    return any(not lobe.is_delta for lobe in bsdf.lobes)


def shares(bsdf: Bsdf, viewer: Viewer) -> tuple[list[Delta], list[Tensor] | None]:
    """The delta lobes, and the probabilities with which they (in order), then the other lobes together, are sampled.

    None where there are no delta lobes; no last share where there is nothing else. Computed once for a viewer.
    """

    def compute() -> tuple[list[Delta], list[Tensor] | None]:
        deltas = bsdf.deltas(viewer)
        if not deltas:
            return deltas, None
        strengths = [viewer.layout.mean(d.weight) for d in deltas]
        return deltas, normalised(strengths + [bsdf.strength(viewer)] * has_spread(bsdf))

    return viewer.once(bsdf, compute, "shares")


def mixture_density(bsdf: Bsdf, g: Geometry) -> Tensor:
    """pdf ``[...]`` of ``wi`` over all lobes, 0 for deltas; unmasked."""
    _, parts = shares(bsdf, g.viewer)
    if not has_spread(bsdf):
        return torch.zeros_like(g.cos_i + g.cos_o)
    density = bsdf.density(g)
    return density if parts is None else density * parts[-1]


def sample(bsdf: Bsdf, viewer: Viewer, u: Vec) -> Sampled:
    """Draw ``wi`` for a viewer, in its space."""
    local = viewer.local
    deltas, parts = shares(bsdf, local)
    if parts is None:
        found = _spread(bsdf, local, u, None)
    else:
        chosen, rest = choose(u.z, parts)
        samples = [_delta(bsdf, local, d, share, u) for d, share in zip(deltas, parts, strict=False)]
        if has_spread(bsdf):
            samples.append(_spread(bsdf, local, Vec(u.x, u.y, rest), parts[-1]))
        found = samples[0]
        for mask, other in zip(chosen[1:], samples[1:], strict=True):
            found = _where(mask, other, found)
    return found._replace(wi=viewer.to_world(found.wi))


def _spread(bsdf: Bsdf, viewer: Viewer, u: Vec, share: Tensor | None) -> Sampled:
    """weight = f |cos| / pdf from the model's own formula and density."""
    drawn = bsdf.draw(viewer, u)
    g = Geometry(viewer, drawn.wi)
    inside = bsdf.domain(g)
    density = bsdf.density(g)
    pdf = density if share is None else density * share
    factor = torch.where(inside, g.cos_i.abs() * inverse_density(pdf), 0.0)
    weight = tuple(f * factor for f in bsdf.formula(g))
    return _filled(g, weight, torch.where(inside, pdf, 0.0), drawn.lobe, drawn.eta, u)


def _delta(bsdf: Bsdf, viewer: Viewer, d: Delta, share: Tensor, u: Vec) -> Sampled:
    """A delta lobe competes with nothing: its weight over the probability of choosing it."""
    g = d.geometry(viewer)
    inside = bsdf.domain(g).to(g.cos_i.dtype)
    factor = inside * numerics.reciprocal_or_zero(share)
    return _filled(g, tuple(w * factor for w in d.weight), share * inside, d.lobe, d.eta, u)


def _filled(g: Geometry, weight: Channels, pdf: Tensor, lobe: Tensor | int, eta: Tensor | float, u: Vec) -> Sampled:
    """Everything in the shape of the directions and the random numbers together."""
    zero = torch.zeros_like(g.cos_i + g.cos_o + u.x + pdf)
    index = torch.zeros_like(zero, dtype=torch.int64) + lobe
    whole = tuple(w.expand(torch.broadcast_shapes(w.shape, zero.shape)) for w in weight)
    return Sampled(Vec(*(c.expand_as(zero) for c in g.wi)), whole, pdf.expand_as(zero), index, zero + eta)


def _where(mask: Tensor, a: Sampled, b: Sampled) -> Sampled:
    wi = Vec(*(torch.where(mask, x, y) for x, y in zip(a.wi, b.wi, strict=True)))
    weight = each(lambda x, y: torch.where(mask, x, y), a.weight, b.weight)
    pdf, lobe, eta = (torch.where(mask, x, y) for x, y in ((a.pdf, b.pdf), (a.lobe, b.lobe), (a.eta, b.eta)))
    return Sampled(wi, weight, pdf, lobe, eta)


def inverse_density(pdf: Tensor) -> Tensor:
    """1 / pdf; 0 for a direction of negligible density, which a sampler gives by rounding alone."""
    return numerics.reciprocal_or_zero(pdf, numerics.negligible(pdf.dtype))
