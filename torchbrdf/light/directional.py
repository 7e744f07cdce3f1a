r"""Directional lights: parallel light, as of the sun.

==========  ====================  ==============================================
parameter   unit, range           meaning
==========  ====================  ==============================================
direction   [L, 3], any length    *to* the light; normalised inside
irradiance  [L, C] >= 0, W/m^2    on a plane that faces the light
==========  ====================  ==============================================
"""

import torch
from torch import Tensor

from .. import vector
from ..value import NONNEGATIVE, REAL, param, value
from ..vector import Vec
from .base import Arrival, LocalLight, channels


@value
class DirectionalLight(LocalLight):
    """L parallel lights; ``direction [L, 3]`` points to the light, ``irradiance [L, C]`` is on a plane facing it."""

    direction: Tensor = param(REAL, 3, "to the light")
    irradiance: Tensor = param(NONNEGATIVE, None, "on a plane facing the light, W/m^2")

    def arrivals(self, points: Vec, wide: bool) -> list[Arrival]:
        return [Arrival(vector.normalize_components(Vec(*d.unbind(-1))), None, channels(e, wide)) for d, e in self.rows(points.x)]

    def shadow_targets(self, points: Tensor) -> tuple[Tensor, Tensor]:
        lead = (len(self),) + (1,) * (points.dim() - 1)
        wi = vector.normalize(self.direction.to(points)).expand(len(self), 3).reshape(*lead, 3).expand(len(self), *points.shape)
        return wi, torch.full((*wi.shape[:-1], 1), torch.inf, dtype=points.dtype, device=points.device)
