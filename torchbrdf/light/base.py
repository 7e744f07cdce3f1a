"""What every light answers. Local lights (points, directions) are lists ``[L, 3]`` that a shading point looks up one by one."""

from abc import abstractmethod
from typing import NamedTuple

import torch
from torch import Tensor

from .. import arguments, numerics, vector
from ..value import Value
from ..vector import Vec


class Arrival(NamedTuple):
    """Light of one source at the shading points, in components."""

    wi: Vec  # unit, to the light; without batch axes where it is the same at every point
    falloff: Tensor | None  # [...] factor of the colour; None where it is 1
    colour: tuple[Tensor, ...]  # channels


class Light(Value):
    """Interface of the lights. ``len(light)`` is L, the number of sources it stands for."""

    def __len__(self) -> int:
        return 1

    @property
    def channels(self) -> int:
        """C, the number of colour channels."""
        return max((t.shape[-1] for _, t, spec in self.own_tensors() if spec.size is None), default=1)


class LocalLight(Light):
    """Interface of lights that reach each point from one direction: each answers with irradiance on a plane facing it.

    Parameters are ``[L, k]``; ``[k]`` stands for one light.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, t, _ in list(self.own_tensors()):
            object.__setattr__(self, name, t.unsqueeze(0) if t.dim() == 1 else t)

    def check_shapes(self) -> None:
        """As every value, with one batch axis at most, of one light at least."""
        for name, t, _ in self.own_tensors():
            if t.dim() > 2 or not t.numel():
                remedy = "flatten the lights into one axis" if t.dim() > 2 else "leave out lights that there are none of"
                raise ValueError(f"{type(self).__name__}.{name}: expected shape [L, {t.shape[-1]}], found {list(t.shape)}; {remedy}")
        super().check_shapes()

    def __len__(self) -> int:
        batch = self.batch_shape  # empty for what indexing and vmap make: one light
        return int(batch[0]) if batch else 1

    @abstractmethod
    def arrivals(self, points: Vec, wide: bool) -> list[Arrival]:
        """One :class:`Arrival` per light at ``points`` (components ``[...]``)."""

    @abstractmethod
    def shadow_targets(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Unit direction ``[L, ..., 3]`` and distance ``[L, ..., 1]`` of what a shadow ray from ``points [..., 3]`` must reach."""

    def incident(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """``wi [L, ..., 3]``, unit, and the irradiance ``[L, ..., C]`` on a plane facing the light, at ``points [..., 3]``."""
        at = vector.components(numerics.widen(arguments.floats(points, "points", 3)))
        found = self.arrivals(at, wide=False)
        wi = torch.stack([_planes(a.wi, at.x) for a in found], 1)
        strength = torch.stack([_planes([c if a.falloff is None else c * a.falloff for c in a.colour], at.x) for a in found], 1)
        return wi.movedim(0, -1).to(points.dtype), strength.movedim(0, -1).to(points.dtype)

    def rows(self, like: Tensor) -> list[tuple[Tensor, ...]]:
        """The parameters of one light after the other, in the dtype and on the device of ``like``."""
        tensors = [numerics.widen(t).to(like).expand(len(self), t.shape[-1]) for _, t, _ in self.own_tensors()]
        return list(zip(*[t.unbind(0) for t in tensors], strict=True))


def _planes(parts: tuple[Tensor, ...] | list[Tensor], like: Tensor) -> Tensor:
    """``[k, ...]`` of k parts that broadcast to the shape of ``like``."""
    return torch.stack([p.expand_as(like) for p in parts])


def colour_parts(colour: Tensor, wide: bool) -> tuple[Tensor, ...]:
    """One light's colour ``[C]`` as the channels that a formula maps over."""
    return (colour,) if wide else colour.unbind(-1)
