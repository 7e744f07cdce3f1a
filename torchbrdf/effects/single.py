"""Lights one by one: a compiled graph of one light serves any number of them, called again and again, its images added up outside.

So compiling takes as long for many lights as for one, another number compiles nothing anew, and what one light needs in backward is
free again before the next one's turn: beside the gradients of the material, memory does not grow with the number of lights.
"""

from collections.abc import Callable, Iterator, Sequence

import torch
from torch import Tensor

from .. import numerics
from ..light.base import DeltaLight, Light
from .base import Prepared
from .shadow import Visibility

Render = Callable[[list[Light], Prepared], Tensor]  # the image of some lights, or that of each of their rows


def parts(lights: Sequence[Light], prepared: Prepared) -> Iterator[tuple[list[Light], Prepared]]:
    """Each point and directional light with what was prepared for it, each other light by itself; in the order of their rows."""
    shadow, row = prepared.of("shadow"), 0
    for light in lights:
        if not isinstance(light, DeltaLight):
            yield [light], Prepared()
            continue
        for _, one in light.groups(1):
            seen = None if shadow is None else Visibility(shadow.share[row : row + 1])
            # In memory of its own, or the strides of lights by view would tell their number, and torch would compile again.
            yield [one.map(Tensor.contiguous)], Prepared() if seen is None else Prepared(("shadow",), (seen,))
            row += 1


def one_by_one(render: Render, lights: Sequence[Light], prepared: Prepared, per_light: bool) -> Tensor:
    """The image of all lights, or with ``per_light`` that of each row, ``[L, ..., C]``; planar."""
    images = (render(*part) for part in parts(lights, prepared))  # made when it is their turn
    if per_light:
        planes = [rows.movedim(-1, 1) for rows in images]
        count = max(p.shape[1] for p in planes)  # a light of one channel under a material of one gives one
        return torch.cat([p.expand(-1, count, *p.shape[2:]) for p in planes]).movedim(1, -1)
    total = next(images)
    dtype, working = total.dtype, numerics.working_dtype(total.dtype)
    for image in images:
        total = total.to(working) + image
    return total.to(dtype)
