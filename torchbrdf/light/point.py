r"""Point lights: radiant intensity, falling off with the square of the distance.

.. math:: E = I / r^2 \quad\text{on a plane facing the light}

=========  ===================  ================================
parameter  unit, range          meaning
=========  ===================  ================================
position   [L, 3], any          where the lights are
intensity  [L, C] >= 0, W/sr    radiant intensity, per channel
=========  ===================  ================================

``[B, L, 3]`` and ``[B, L, C]`` are L lights in each of B views: the leading axes go with those of the points ``[B, ..., 3]``.

A point that coincides with a light receives nothing from it (gradient 0). A light nearer than 1e-19 (float32), whose falloff would
overflow, counts as that near (gradient 0 by the distance). Source: Lambert 1760.

>>> import torch, torchbrdf as tb
>>> tb.PointLight([0.0, 0.0, 2.0], 8.0).sample(torch.zeros(1, 3)).radiance.tolist()
[[[2.0]]]
"""

from torch import Tensor

from .. import numerics, vector
from ..geometry import Layout
from ..interval import NONNEGATIVE, REAL
from ..value import COLOUR, VECTOR, param, value
from ..vector import Vec
from .base import Arrival, DeltaLight


@value
class PointLight(DeltaLight):
    """L point lights at ``position [L, 3]`` of radiant ``intensity [L, C]``; ``[B, L, ...]`` in each of B views."""

    position: Tensor = param(REAL, VECTOR, "where the lights are")
    intensity: Tensor = param(NONNEGATIVE, COLOUR, "radiant intensity, W/sr")

    def arrive(self, points: Vec, layout: Layout) -> Arrival:
        wi, inverse = vector.direction_and_inverse_length(self._towards(points, layout))
        near = inverse.clamp_max(1.0 / numerics.negligible(inverse.dtype))
        return Arrival(wi, near * near, self.colour_axis(self.intensity, points, layout))

    def distance(self, points: Vec, wi: Vec, layout: Layout) -> Tensor:
        return vector.dot(wi, self._towards(points, layout))

    def _towards(self, points: Vec, layout: Layout) -> Vec:
        return vector.subtract(Vec(*self.axis(self.position, points, layout)), points)
