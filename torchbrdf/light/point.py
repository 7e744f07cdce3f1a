r"""Point lights: radiant intensity, falling off with the square of the distance.

.. math:: E = I / r^2 \quad\text{on a plane facing the light}

=========  ===================  ================================
parameter  unit, range          meaning
=========  ===================  ================================
position   [L, 3], any          where the lights are
intensity  [L, C] >= 0, W/sr    radiant intensity, per channel
=========  ===================  ================================

A point that coincides with a light receives nothing from it (gradient 0). A light nearer than 1e-19 (float32), whose falloff would
overflow, counts as that near (gradient 0 by the distance). Source: Lambert 1760.

>>> import torch, torchbrdf as tb
>>> tb.PointLight([0.0, 0.0, 2.0], 8.0).incident(torch.zeros(1, 3))[1].tolist()
[[[2.0]]]
"""

from torch import Tensor

from .. import numerics, vector
from ..interval import NONNEGATIVE, REAL
from ..value import COLOUR, VECTOR, param, value
from ..vector import Vec
from .base import Arrival, LocalLight, colour_parts


@value
class PointLight(LocalLight):
    """L point lights at ``position [L, 3]`` of radiant ``intensity [L, C]``."""

    position: Tensor = param(REAL, VECTOR, "where the lights are")
    intensity: Tensor = param(NONNEGATIVE, COLOUR, "radiant intensity, W/sr")

    def arrivals(self, points: Vec, wide: bool) -> list[Arrival]:
        found = []
        for position, intensity in self.rows(points.x):
            towards = vector.subtract(Vec(*position.unbind(-1)), points)
            wi, inverse = vector.direction_and_inverse_length(towards)
            inverse = inverse.clamp_max(1.0 / numerics.negligible(inverse.dtype))
            found.append(Arrival(wi, inverse * inverse, colour_parts(intensity, wide)))
        return found

    def shadow_targets(self, points: Tensor) -> tuple[Tensor, Tensor]:
        at = numerics.widen(points)
        position = self.position.to(at).expand(len(self), 3).reshape(len(self), *(1,) * (at.dim() - 1), 3)
        wi, distance = vector.direction_and_length(vector.components(position - at))
        return vector.stack(wi), distance.unsqueeze(-1)
