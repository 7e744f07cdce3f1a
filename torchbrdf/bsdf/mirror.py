r"""Perfect mirror reflection: a delta lobe.

.. math:: f = k \; F(\cos\theta_i) \; \delta(\omega_i - R(\omega_o)) / \cos\theta_i

=========  ====================  ========================================
parameter  unit, range           meaning
=========  ====================  ========================================
tint       [..., C] in [0, 1]    colour k that multiplies F
fresnel    a Fresnel term, None  F at the angle of incidence; None: 1
=========  ====================  ========================================

``evaluate`` and ``pdf`` are 0 (a delta is no number); ``sample(...).weight`` is ``tint F`` and its ``pdf`` the discrete
probability 1. The directional albedo is ``tint F(cos)``. Smooth above the horizon wherever F is.
Source: Nicodemus et al. 1977.

>>> import torch, torchbrdf as tb
>>> up = torch.tensor([0.0, 0.0, 1.0])
>>> tb.Mirror(1.0, tb.Dielectric(1.5)).directional_albedo(up)
tensor([0.0400])
"""

import torch
from torch import Tensor

from ..geometry import Channels, Geometry, Viewer, each
from ..interval import UNIT
from ..optics.fresnel import Fresnel
from ..value import COLOUR, param, value
from ..vector import Vec
from .base import Bsdf, nearest
from .lobe import Delta, Draw, Lobe


@value
class Mirror(Bsdf):
    """A smooth mirror of reflectance ``tint F(cos)``."""

    tint: Tensor = param(UNIT, COLOUR, "colour that multiplies the Fresnel term", default=1.0)
    fresnel: Fresnel | None = None

    lobes = (Lobe.DELTA_REFLECTION,)

    def formula(self, g: Geometry) -> Channels:
        zero = torch.zeros_like(g.cos_i + g.cos_o)
        return tuple(zero * t for t in self.reflectance(g.viewer))

    def density(self, g: Geometry) -> Tensor:
        return torch.zeros_like(g.cos_i + g.cos_o)

    def draw(self, viewer: Viewer, u: Vec) -> Draw:
        return Draw(viewer.mirror)

    def deltas(self, viewer: Viewer) -> list[Delta]:
        return [Delta(viewer.mirror, viewer.cos_o, self.reflectance(viewer))]

    def reflectance(self, viewer: Viewer) -> Channels:
        """``tint F(cos)`` per channel."""
        cos = viewer.cos_o
        fresnel = self.fresnel.terms(viewer.layout, cos) if self.fresnel else (torch.ones_like(cos),)
        return each(lambda t, f: t * f, viewer.colour(self.tint), fresnel)

    def kink_distance(self, g: Geometry) -> Tensor:
        """The horizon, and what is not smooth about F."""
        horizon = super().kink_distance(g)
        return horizon if self.fresnel is None else nearest(horizon, self.fresnel.kink_distance(g.viewer.layout, g.cos_o))

    @property
    def energy_bound(self) -> Tensor:
        return self.tint
