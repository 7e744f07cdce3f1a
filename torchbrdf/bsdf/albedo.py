"""Directional albedo by quadrature: the light that arrives along w, followed to wherever it leaves."""

from __future__ import annotations  # of functions made inside graphs, which older compilers could not make

from collections.abc import Callable

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from .. import quadrature
from ..geometry import Channels, Geometry, Viewer, each
from ..vector import Vec
from .base import Bsdf
from .lobe import Delta
from .sampler import has_spread, inverse_density

CHUNK = 1 << 20  # directions computed at a time: tens of megabytes for each figure of a formula


def quadrature_albedo(bsdf: Bsdf, viewer: Viewer, order: int) -> Channels:
    """Power fraction per channel of light arriving along ``viewer.wo`` that leaves again."""
    parts = [_of_delta(bsdf, viewer, delta) for delta in bsdf.deltas(viewer)]
    if has_spread(bsdf):
        parts.append(_of_spread(bsdf, viewer.local, order))
    total = parts[0]
    for part in parts[1:]:
        total = each(torch.add, total, part)
    return total


def _of_delta(bsdf: Bsdf, viewer: Viewer, delta: Delta) -> Channels:
    """Radiance grows by the square of the index across an interface, power does not."""
    g = delta.geometry(viewer)
    factor = bsdf.domain(g).to(g.cos_o.dtype) * delta.eta * delta.eta
    return tuple(w * factor for w in delta.weight)


def _of_spread(bsdf: Bsdf, viewer: Viewer, order: int) -> Channels:
    r"""``integral f(w -> d) |cos_d| dd`` over directions d that the sampler gives for w."""
    several = sum(not lobe.is_delta for lobe in bsdf.lobes) > 1
    u, weights = quadrature.unit_cube(order * order) if several else quadrature.unit_square(order)
    nodes = torch.cat([u, weights.unsqueeze(-1)], -1)
    return summed(bsdf, viewer, nodes, lambda chunk: _leaving(bsdf, viewer, Vec(*chunk[..., :3].unbind(-1)), chunk[..., 3]))


def summed(bsdf: Bsdf, viewer: Viewer, nodes: Tensor, part: Callable[[Tensor], Channels]) -> Channels:
    """The sum of ``part`` over chunks of ``nodes [N, K]``, which it gets as ``[N, ..., K]`` beside the batch axes."""
    like = viewer.cos_o
    batch = torch.broadcast_shapes(like.shape, (*bsdf.batch_shape, 1) if viewer.layout.wide else bsdf.batch_shape)
    beside = nodes.to(like).unflatten(0, (-1, *(1,) * len(batch)))
    chunks = beside.split(max(1, CHUNK // max(1, batch.numel())))
    total = _run(part, chunks[0], len(chunks))
    for chunk in chunks[1:]:
        total = each(torch.add, total, _run(part, chunk, len(chunks)))
    return total


def _leaving(bsdf: Bsdf, viewer: Viewer, u: Vec, weights: Tensor) -> Channels:
    there = Geometry(viewer, bsdf.draw(viewer, u).wi)
    back = bsdf.reciprocal and not any(lobe.transmits for lobe in bsdf.lobes)  # what is received along w is what is sent there
    g = there if back or bsdf.is_adjoint else there.swapped
    inside = bsdf.domain(g)
    factor = torch.where(inside, there.cos_i.abs() * inverse_density(bsdf.density(there)), 0.0) * weights
    return tuple((f * factor).sum(0) for f in bsdf.formula(g))


def _run(part: Callable[[Tensor], Channels], chunk: Tensor, count: int) -> Channels:
    """Where there are several chunks, what backward needs is computed again: memory stays that of one."""
    if count == 1 or not torch.is_grad_enabled():
        return part(chunk)
    return checkpoint(part, chunk, use_reentrant=False)
