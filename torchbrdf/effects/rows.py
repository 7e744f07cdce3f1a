"""Rows of lights: which light has which, and how their radiance becomes an image."""

from collections.abc import Sequence

import torch
from torch import Tensor

from ..geometry import Channels, Layout, each
from ..light.base import Light, LightKind
from .base import Contribution, Surface


def rows_of(lights: Sequence[Light], kinds: tuple[LightKind, ...]) -> list[tuple[int, Light]]:
    """(first row, light) of each light of some kinds; a light takes ``len(light)`` rows, in the order of the list."""
    row, found = 0, []
    for light in lights:
        if light.kind in kinds:
            found.append((row, light))
        row += len(light)
    return found


def summed(parts: Sequence[Contribution], surface: Surface, count: int) -> Tensor:
    """The image ``[..., C]`` in planar memory: all rows added up, as they come."""
    total: Channels | None = None
    for part in parts:
        several = part.rows.stop - part.rows.start > 1
        one = tuple(c.sum(0) for c in part.radiance) if several else part.radiance
        total = one if total is None else each(torch.add, total, one)
    return _planes(total, surface, count).movedim(0, -1)


def apart(parts: Sequence[Contribution], surface: Surface, count: int, rows: int) -> Tensor:
    """The image of each row ``[L, ..., C]``, each in planar memory; rows that no effect serves are dark."""
    found: list[Channels | None] = [None] * rows
    for part in parts:
        several = part.rows.stop - part.rows.start > 1
        for k, row in enumerate(range(part.rows.start, part.rows.stop)):
            one = tuple(c[k] if len(c) > 1 else c[0] for c in part.radiance) if several else part.radiance
            before = found[row]
            found[row] = one if before is None else each(torch.add, before, one)
    return torch.stack([_planes(f, surface, count) for f in found]).movedim(1, -1)


def _planes(colour: Channels | None, surface: Surface, count: int) -> Tensor:
    """``[C, ...]`` in contiguous memory, of a colour that may have given one channel for all."""
    layout: Layout = surface.viewer.layout
    if colour is None:
        return torch.zeros(count, *surface.shape, dtype=layout.dtype, device=layout.device)
    if layout.wide:
        return colour[0].expand(*surface.shape, count).movedim(-1, 0).contiguous()
    return torch.stack([c.expand(surface.shape) for c in (colour if len(colour) == count else colour * count)])
