"""What every light answers. Local lights (points, directions) are lists ``[L, 3]`` that a shading point looks up one by one."""

from abc import abstractmethod
from typing import NamedTuple

import torch
from torch import Tensor

from .. import numerics, vector
from ..value import Value
from ..vector import Vec


class Arrival(NamedTuple):
    """Light of one source at the shading points, in components."""

    wi: Vec  # unit, to the light
    falloff: Tensor | None  # [...] factor of the colour; None where it is 1
    colour: tuple[Tensor, ...]  # channels


class Light(Value):
    """Interface of the lights. ``len(light)`` is L, the number of sources it stands for."""

    def __len__(self) -> int:
        return 1


class LocalLight(Light):
    """Interface of lights that reach each point from one direction: each answers with irradiance on a plane facing it."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, t, _ in list(self.own_tensors()):
            if t.dim() > 2:
                raise ValueError(f"{type(self).__name__}.{name}: expected shape [L, {t.shape[-1]}], found {list(t.shape)}; flatten the lights into one axis")
            object.__setattr__(self, name, t.unsqueeze(0) if t.dim() == 1 else t)

    def __len__(self) -> int:
        return int(self.batch_shape[0])

    @abstractmethod
    def arrivals(self, points: Vec, wide: bool) -> list[Arrival]:
        """One :class:`Arrival` per light at ``points`` (components ``[...]``)."""

    @abstractmethod
    def shadow_targets(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Unit direction ``[L, ..., 3]`` and distance ``[L, ..., 1]`` of what a shadow ray from ``points [..., 3]`` must reach."""

    def incident(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """``wi [L, ..., 3]``, unit, and the irradiance ``[L, ..., C]`` on a plane facing the light, at ``points [..., 3]``."""
        wi, strength = [], []
        for a in self.arrivals(vector.components(numerics.widen(points)), wide=False):
            wi.append(vector.stack(a.wi))
            one = torch.ones_like(a.wi.x)
            strength.append(vector.stack([c * (one if a.falloff is None else a.falloff) for c in a.colour]))
        return torch.stack(wi).to(points.dtype), torch.stack(strength).to(points.dtype)

    def rows(self, like: Tensor) -> list[tuple[Tensor, ...]]:
        """The parameters of one light after the other, in the dtype and on the device of ``like``."""
        tensors = [numerics.widen(t).to(like).expand(len(self), t.shape[-1]) for _, t, _ in self.own_tensors()]
        return list(zip(*[t.unbind(0) for t in tensors], strict=True))


def channels(colour: Tensor, wide: bool) -> tuple[Tensor, ...]:
    """One light's colour ``[C]`` as the channels that a formula maps over."""
    return (colour,) if wide else colour.unbind(-1)
