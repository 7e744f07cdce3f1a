"""How colours lie beside numbers, and how parameters become both."""

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from . import numerics, parameters, vector
from .vector import Vec

Channels = tuple[Tensor, ...]


def each(formula: Callable[..., Tensor], *colours: Sequence[Tensor]) -> Channels:
    """Map a formula over channels; a colour with a single channel serves them all."""
    count = max([len(c) for c in colours])
    if any(len(c) not in (1, count) for c in colours):
        raise ValueError(f"colours have different numbers of channels: {[len(c) for c in colours]}; use one C, or 1")
    return tuple(formula(*(c[k] if len(c) > 1 else c[0] for c in colours)) for k in range(count))


class Layout(NamedTuple):
    """How colours lie beside numbers ``[...]`` of one dtype and device.

    ``wide=False`` takes a colour apart into single channels ``[...]`` (fastest for a few); ``wide=True`` keeps it as one
    ``[..., C]`` tensor, beside which numbers carry a trailing 1. With a ``rank``, the most axes that a number has, it is one tensor
    ``[C, ...]`` of 1 + rank axes: one operation serves all channels, which is fastest where points are few and dispatching is dear.
    """

    wide: bool
    dtype: torch.dtype
    device: torch.device
    rank: int | None = None

    @staticmethod
    def beside(points: Tensor, wide: bool = False, rank: int | None = None) -> "Layout":
        """The layout of formulas at ``points``, in their working dtype."""
        return Layout(wide, numerics.working_dtype(points.dtype), points.device, rank)

    def colour(self, parameter: Tensor) -> Channels:
        """A parameter ``[..., C]`` as the channels that a formula maps over."""
        if self.rank is not None:
            return (_channels_first(self.follow(parameter), self.rank),)
        p = self.follow(parameter, apart=not self.wide)
        # Not unbind(-1), whose derivative is interleaved memory.
        return (p,) if self.wide else p.movedim(-1, 0).unbind(0) if p.dim() > 1 else p.unbind(0)

    def rows(self, parameter: Tensor, event: int) -> tuple[Tensor, ...]:
        """A parameter whose last ``event`` axes are one parameter, ``[..., K, *rest]``, as K parameters ``[..., *rest]``."""
        return parameter.movedim(-event, 0).unbind(0)

    def scalar(self, parameter: Tensor) -> Tensor:
        """A parameter ``[..., 1]`` as a number."""
        p = self.follow(parameter, apart=not self.wide)
        return p if self.wide else p.squeeze(-1)

    def average(self, parameter: Tensor) -> Tensor:
        """The mean of a colour ``[..., C]`` as a number."""
        p = self.follow(parameter, apart=not self.wide).mean(-1, keepdim=True)
        return p if self.wide else p.squeeze(-1)

    def mean(self, channels: Channels) -> Tensor:
        """The mean of channels as a number."""
        if self.rank is not None:
            return channels[0].mean(0)
        return channels[0].mean(-1, keepdim=True) if self.wide else sum(channels[1:], channels[0]) / len(channels)

    def vector(self, v: Tensor) -> Vec:
        """``[..., 3]`` as three numbers."""
        return Vec(*map(self.lift, vector.components(self.follow(v))))

    def lift(self, x: Tensor) -> Tensor:
        """A tensor ``[...]`` as a number."""
        return x.unsqueeze(-1) if self.wide else x

    def join(self, channels: Iterable[Tensor]) -> Tensor:
        """Channels of a formula -> ``[..., C]``, planar unless wide."""
        parts = tuple(channels)
        if self.rank is not None:
            return parts[0].movedim(0, -1)
        return parts[0] if self.wide else vector.stack(parts)

    def join_vector(self, v: Vec) -> Tensor:
        """Three numbers -> ``[..., 3]``, planar."""
        return vector.stack([c.squeeze(-1) for c in v] if self.wide else v)

    def join_number(self, x: Tensor) -> Tensor:
        """A number -> ``[..., 1]``."""
        return x if self.wide else x.unsqueeze(-1)

    def follow(self, parameter: Tensor, axes: int = 1, apart: bool = False) -> Tensor:
        """A parameter by the rule of :mod:`~torchbrdf.parameters`."""
        return parameters.follow(parameter, self.dtype, self.device, axes, apart)


def _channels_first(colour: Tensor, rank: int) -> Tensor:
    """``[..., C]`` as ``[C, ...]`` of 1 + rank axes."""
    missing = rank + 1 - colour.dim()
    if colour.dim() == 1:
        return colour.reshape(-1, *(1,) * rank)
    return (colour.reshape(*(1,) * missing, *colour.shape) if missing else colour).movedim(-1, 0)
