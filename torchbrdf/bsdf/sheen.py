r"""The sheen of cloth: fibres that stand up from the surface, bright at grazing angles.

.. math::
    f = s \, \sqrt{\frac{x - \tfrac14 + \tfrac1{32x}}{\pi}} \; \frac{\sin^{1/\alpha}\theta_h}{4\,(\cos\theta_i + \cos\theta_o -
    \cos\theta_i \cos\theta_o)}, \qquad x = \tfrac12(3 + \tfrac1\alpha), \quad \alpha = r^2

=========  ====================  ====================================================
parameter  unit, range           meaning
=========  ====================  ====================================================
color      [..., C] in [0, 1]    s, the directional albedo at grazing
roughness  [..., 1] in (0, 1]    r: how far from grazing the fibres are still bright
=========  ====================  ====================================================

The distribution of Estevez & Kulla 2017 ("Charlie") with the visibility of Ashikhmin & Premoze 2007, as in glTF, but for the constant:
theirs, :math:`(2 + 1/\alpha)/2\pi`, reflects up to four times what arrives where r is 0.1. Here the albedo at grazing is s at every
roughness (to 5e-4, by which the root is less than the quotient :math:`\Gamma(x + \tfrac12)/\Gamma(x)\sqrt\pi` that it stands for), and
at most :math:`s\, e^{-1.39 \cos\theta / r}` elsewhere: :meth:`Sheen.bound`, by which a base below may be weakened.

Not smooth at the horizon, nor for wi = -wo. Where the half vector is the normal f is 0 and flat, but for r = 1, where its slope jumps and
is taken as 0; its curvature is infinite there from r = 0.71 on. Sources: Estevez & Kulla 2017, *Production friendly microfacet
sheen BRDF*; Ashikhmin & Premoze 2007.

>>> import torch, torchbrdf as tb
>>> grazing, up = torch.tensor([[1.0, 0.0, 1e-4], [0.0, 0.0, 1.0]])
>>> [round(float(tb.Sheen(0.5, 0.6).directional_albedo(w)), 2) for w in (grazing, up)]
[0.5, 0.03]
"""

import math
from typing import Any

import torch
from torch import Tensor

from .. import numerics, sampling
from ..geometry import Channels, Geometry, Viewer
from ..interval import UNIT, Interval
from ..value import COLOUR, SCALAR, param, value
from ..vector import Vec
from .base import Bsdf, nearest
from .lobe import Draw, Lobe

ROUGHNESS = Interval(0.0, 1.0, open_low=True, typical=(0.3, 1.0), hard=(0.01,))
DECAY = 1.39  # of the albedo over its value at grazing, -ln of which was found to be 1.399 cos / r or more at every r


@value
class Sheen(Bsdf):
    """Fibres of albedo ``color`` at grazing."""

    color: Tensor = param(UNIT, COLOUR, "directional albedo at grazing")
    roughness: Tensor = param(ROUGHNESS, SCALAR, "how far from grazing it is still bright")

    lobes = (Lobe.GLOSSY_REFLECTION,)

    def formula(self, g: Geometry) -> Channels:
        r = g.scalar(self.roughness)
        exponent = 1.0 / (r * r)
        x = 0.5 * (3.0 + exponent)
        fibres = numerics.cosine_power(numerics.safe_sqrt(g.sin2_h), g.cos_h * g.cos_h, exponent)
        seen = 4.0 * (g.cos_i + g.cos_o * (1.0 - g.cos_i))
        lobe = torch.sqrt((x - 0.25 + 1.0 / (32.0 * x)) * (1.0 / math.pi)) * fibres
        lobe = lobe * numerics.reciprocal_or_zero(seen, numerics.negligible(seen.dtype))
        return tuple(c * lobe for c in g.colour(self.color))

    @staticmethod
    def textbook(m: Any, p: Any, color: Any, roughness: Any) -> Any:
        exponent = 1 / (roughness * roughness)
        x = (3 + exponent) / 2
        seen = 4 * m.where(p.above, p.cos_i + p.cos_o - p.cos_i * p.cos_o, 1)
        return color * m.sqrt((x - 0.25 + 1 / (32 * x)) / m.pi) * m.power(m.where(p.above, 1 - p.cos2_h, 1), exponent / 2) / seen

    def density(self, g: Geometry) -> Tensor:
        return numerics.step(g.cos_i) * (0.5 / math.pi)

    def draw(self, viewer: Viewer, u: Vec) -> Draw:
        """Evenly over the hemisphere."""
        return Draw(sampling.uniform_hemisphere(u.x, u.y))

    def bound(self, viewer: Viewer, cos: Tensor) -> Channels:
        """What the directional albedo at this cosine is at most."""
        decay = torch.exp(numerics.positive(cos) * (-DECAY / viewer.scalar(self.roughness)))
        return tuple(c * decay for c in viewer.colour(self.color))

    def strength(self, viewer: Viewer) -> Tensor:
        return viewer.layout.mean(self.bound(viewer, viewer.cos_o))

    def kink_distance(self, g: Geometry) -> Tensor:
        """The horizon, and where there is no half vector."""
        return nearest(super().kink_distance(g), g.wi_h)

    @property
    def energy_bound(self) -> Tensor:
        return self.color
