"""Rows of lights: which light has which, and how their radiance becomes an image."""

from collections.abc import Sequence

import torch
from torch import Tensor

from .. import numerics
from ..bsdf.base import Bsdf
from ..geometry import Channels, Layout, each
from ..light.base import Light, LightKind
from ..scene.gbuffer import GBuffer
from .base import Contribution, Surface


def rows_of(lights: Sequence[Light], kinds: tuple[LightKind, ...]) -> list[tuple[int, Light]]:
    """(first row, light) of each light of some kinds; a light takes ``len(light)`` rows, in the order of the list."""
    row, found = 0, []
    for light in lights:
        if light.kind in kinds:
            found.append((row, light))
        row += len(light)
    return found


def rank(g: GBuffer, bsdf: Bsdf, lights: Sequence[Light]) -> int | None:
    """How many axes numbers have at most where colours lie as one tensor ``[C, ...]``: for few points, eagerly (see :class:`Layout`)."""
    if torch.compiler.is_compiling() or bsdf.is_wide or g.batch_shape.numel() > numerics.FEW:
        return None
    device = g.position.device
    if device.type != "cpu" and any(t.device != device for _, t in bsdf.named_tensors()):
        return None  # numbers reach kernels from the CPU without a copy, one by one
    return len(g.batch_shape) + any(len(light) > 1 for light in lights)


def summed(parts: Sequence[Contribution], surface: Surface, count: int) -> Tensor:
    """The image ``[..., C]`` in planar memory: all rows added up, as they come."""
    total: Channels | None = None
    for part in parts:
        axis, radiance = _light_axis(part, surface)
        one = radiance if axis is None else tuple(c.sum(axis) for c in radiance)
        total = one if total is None else each(torch.add, total, one)
    return _planes(total, surface, count).movedim(0, -1)


def apart(parts: Sequence[Contribution], surface: Surface, count: int, rows: int) -> Tensor:
    """The image of each row ``[L, ..., C]``, each in planar memory; rows that no effect serves are dark."""
    found: list[Channels | None] = [None] * rows
    for part in parts:
        axis, radiance = _light_axis(part, surface)
        for k, row in enumerate(range(part.rows.start, part.rows.stop)):
            one = radiance if axis is None else tuple(_row(c, k, axis) for c in radiance)
            before = found[row]
            found[row] = one if before is None else each(torch.add, before, one)
    return torch.stack([_planes(f, surface, count) for f in found]).movedim(1, -1)


def _light_axis(part: Contribution, surface: Surface) -> tuple[int | None, Channels]:
    """The axis of the lights, if there is one, and the channels: where colours lie as ``[C, ...]``, whatever the effect gave, as one."""
    rank = surface.viewer.layout.rank
    if rank is None:
        return 0 if part.rows.stop - part.rows.start > 1 else None, part.radiance
    first = part.radiance[0]
    whole = first if len(part.radiance) == 1 and first.dim() > rank else _stacked(part.radiance, rank)
    return 1 if rank > len(surface.shape) else None, (whole,)


def _stacked(radiance: Channels, rank: int) -> Tensor:
    return torch.stack(torch.broadcast_tensors(*(c.reshape(*(1,) * (rank - c.dim()), *c.shape) for c in radiance)))


def _row(colour: Tensor, k: int, axis: int) -> Tensor:
    return colour.select(axis, k if colour.shape[axis] > 1 else 0)


def _planes(colour: Channels | None, surface: Surface, count: int) -> Tensor:
    """``[C, ...]`` in contiguous memory, of a colour that may have given one channel for all."""
    layout: Layout = surface.viewer.layout
    if colour is None:
        return torch.zeros(count, *surface.shape, dtype=layout.dtype, device=layout.device)
    if layout.wide:
        return colour[0].expand(*surface.shape, count).movedim(-1, 0).contiguous()
    if layout.rank is not None:
        whole = (count, *surface.shape)
        return (colour[0] if colour[0].shape == whole else colour[0].expand(whole)).contiguous()  # parameters may lie interleaved
    return torch.stack([c.expand(surface.shape) for c in (colour if len(colour) == count else colour * count)])
