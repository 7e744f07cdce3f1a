"""Directional lights: parallel light, as of the sun.

==========  ====================  ==============================================
parameter   unit, range           meaning
==========  ====================  ==============================================
direction   [L, 3], any length    *to* the light; normalised inside
irradiance  [L, C] >= 0, W/m^2    on a plane that faces the light
==========  ====================  ==============================================

``[B, L, 3]`` and ``[B, L, C]`` are L lights in each of B views: the leading axes go with those of the points ``[B, ..., 3]``.

A direction of length 0 is no direction: such a light gives nothing (gradient 0). Source: Lambert 1760.

>>> import torch, torchbrdf as tb
>>> light = tb.DirectionalLight([0.0, 0.0, 2.0], 3.0).sample(torch.zeros(1, 3))
>>> light.wi.tolist(), light.radiance.tolist()
([[[0.0, 0.0, 1.0]]], [[[3.0]]])
"""

import torch
from torch import Tensor

from .. import vector
from ..geometry import Layout
from ..interval import NONNEGATIVE, REAL
from ..value import COLOUR, VECTOR, param, value
from ..vector import Vec
from .base import Arrival, DeltaLight


@value
class DirectionalLight(DeltaLight):
    """L parallel lights; ``direction [L, 3]`` points to the light, ``irradiance [L, C]`` is on a plane facing it.

    ``[B, L, ...]`` are L lights in each of B views.
    """

    direction: Tensor = param(REAL, VECTOR, "to the light")
    irradiance: Tensor = param(NONNEGATIVE, COLOUR, "on a plane facing the light, W/m^2")

    def arrive(self, points: Vec, layout: Layout) -> Arrival:
        wi = vector.normalize_components(Vec(*self.axis(self.direction, points, layout)))
        return Arrival(wi, None, self.colour_axis(self.irradiance, points, layout))

    def distance(self, points: Vec, wi: Vec, layout: Layout) -> Tensor:
        return torch.full_like(wi.z, torch.inf)
