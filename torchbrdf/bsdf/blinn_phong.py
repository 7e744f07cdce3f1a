r"""Blinn's lobe about the half vector, normalised to reflect exactly its strength at normal view.

.. math:: f = k \; \frac{(s+2)(s+4)}{8\pi\,(2^{-s/2}+s)} \; F(\omega_i \cdot h) \; (n \cdot h)^s

=========  ====================  ========================================
parameter  unit, range           meaning
=========  ====================  ========================================
specular   [..., C] in [0, 1]    strength k
exponent   [..., 1], >= 0        s
fresnel    a Fresnel term, None  F at the half vector
=========  ====================  ========================================

Directional albedo with F = 1: exactly k at normal view, at most k elsewhere. The factor is that of the *reflected light*
(Sloan & Hoffman, in Akenine-Moeller et al. 2008, sec. 7.6), not that of a microfacet distribution, (s+2)/(2 pi). Smooth above the
horizon, but for wi = -wo, where there is no half vector. Source: Blinn 1977.

>>> import torch, torchbrdf as tb
>>> up = torch.tensor([0.0, 0.0, 1.0])
>>> round(float(tb.BlinnPhong(1.0, 0.0).evaluate(up, up)) * torch.pi, 6)
1.0
"""

import math
from typing import Any

import torch
from torch import Tensor

from .. import numerics, sampling, vector
from ..geometry import Channels, Geometry, Viewer
from ..interval import UNIT
from ..optics.fresnel import Fresnel
from ..value import COLOUR, SCALAR, param, value
from ..vector import Vec
from .base import Bsdf, nearest
from .lobe import Draw, Lobe
from .phong import EXPONENT, fresnel_kink, peak_reflectance, tinted


def normal_view_factor(s: Tensor) -> Tensor:
    """The factor that makes the directional albedo at normal view exactly 1."""
    return (s + 2.0) * (s + 4.0) / (8.0 * math.pi * (torch.exp2(-0.5 * s) + s))


@value
class BlinnPhong(Bsdf):
    """``specular N(s) F(wi.h) (n.h)^s``, of directional albedo ``specular`` at normal view."""

    specular: Tensor = param(UNIT, COLOUR, "strength k")
    exponent: Tensor = param(EXPONENT, SCALAR, "s")
    fresnel: Fresnel | None = None

    lobes = (Lobe.GLOSSY_REFLECTION,)

    def formula(self, g: Geometry) -> Channels:
        s = g.scalar(self.exponent)
        return tinted(g, self.specular, self.fresnel, half_vector_power(g, s) * normal_view_factor(s))

    @staticmethod
    def textbook(m: Any, p: Any, specular: Any, exponent: Any, fresnel: Any) -> Any:
        n = (exponent + 2) * (exponent + 4) / (8 * m.pi * (m.exp(-exponent * m.log(2) / 2) + exponent))
        return specular * n * fresnel(p.wi_h) * m.power(p.cos2_h, exponent / 2)

    def density(self, g: Geometry) -> Tensor:
        """Of the half vector, (s+2)/(2 pi) cos^(s+1), over the Jacobian 4 wi.h of the reflection."""
        s = g.scalar(self.exponent)
        return half_vector_power(g, s + 1.0) * (s + 2.0) / (4.0 * math.pi) * g.inverse_half

    def draw(self, viewer: Viewer, u: Vec) -> Draw:
        """The half vector in proportion to cos^(s+1), and the mirror direction about it."""
        half = sampling.cosine_power(u.x, u.y, viewer.scalar(self.exponent) + 2.0)
        return Draw(vector.reflect_components(viewer.wo, half))

    def strength(self, viewer: Viewer) -> Tensor:
        """The albedo at normal view, with F at the mirror direction."""
        return peak_reflectance(viewer, self.specular, self.fresnel)

    def kink_distance(self, g: Geometry) -> Tensor:
        """The missing half vector of wi = -wo, too, and what is not smooth about F."""
        return nearest(super().kink_distance(g), g.wi_h, fresnel_kink(self.fresnel, g))

    @property
    def energy_bound(self) -> Tensor:
        return self.specular


def half_vector_power(g: Geometry, s: Tensor) -> Tensor:
    """``|n.h|^s``."""
    return numerics.cosine_power(g.cos_h.abs(), g.sin2_h, s)
