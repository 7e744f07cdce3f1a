"""Directional lights: parallel light, as of the sun.

==========  ====================  ==============================================
parameter   unit, range           meaning
==========  ====================  ==============================================
direction   [L, 3], any length    *to* the light; normalised inside
irradiance  [L, C] >= 0, W/m^2    on a plane that faces the light
==========  ====================  ==============================================

A direction of length 0 is no direction: such a light gives nothing (gradient 0). Source: Lambert 1760.

>>> import torch, torchbrdf as tb
>>> wi, irradiance = tb.DirectionalLight([0.0, 0.0, 2.0], 3.0).incident(torch.zeros(1, 3))
>>> wi.tolist(), irradiance.tolist()
([[[0.0, 0.0, 1.0]]], [[[3.0]]])
"""

import torch
from torch import Tensor

from .. import numerics, vector
from ..interval import NONNEGATIVE, REAL
from ..value import COLOUR, VECTOR, param, value
from ..vector import Vec
from .base import Arrival, LocalLight, colour_parts


@value
class DirectionalLight(LocalLight):
    """L parallel lights; ``direction [L, 3]`` points to the light, ``irradiance [L, C]`` is on a plane facing it."""

    direction: Tensor = param(REAL, VECTOR, "to the light")
    irradiance: Tensor = param(NONNEGATIVE, COLOUR, "on a plane facing the light, W/m^2")

    def arrivals(self, points: Vec, wide: bool) -> list[Arrival]:
        return [Arrival(vector.normalize_components(Vec(*d.unbind(-1))), None, colour_parts(e, wide)) for d, e in self.rows(points.x)]

    def shadow_targets(self, points: Tensor) -> tuple[Tensor, Tensor]:
        at = numerics.widen(points)
        wi = vector.normalize(self.direction.to(at)).expand(len(self), 3).reshape(len(self), *(1,) * (at.dim() - 1), 3)
        return wi.expand(len(self), *at.shape), at.new_full((len(self), *at.shape[:-1], 1), torch.inf)
