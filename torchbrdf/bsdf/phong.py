r"""Phong's lobe about the mirror direction, in the form of the lecture.

.. math:: f = k \; N(s) \; F(\omega_i \cdot h) \; \max(0,\ \omega_i \cdot R(\omega_o))^s

=============  ====================  ===========================================================
parameter      unit, range           meaning
=============  ====================  ===========================================================
specular       [..., C], >= 0        strength k
exponent       [..., 1], >= 0        s; 0 is flat, 1e6 nearly a mirror
fresnel        a Fresnel term, None  F at the half vector, so that reciprocity stays
normalization  a name                N(s), below
=============  ====================  ===========================================================

==============  ======================  ========================================================================
normalization   N(s)                    directional albedo (F = 1)
==============  ======================  ========================================================================
``"none"``      1                       no energy bound above k = (s+2)/(2 pi): Lewis 1993
``"bound"``     (s + 1) / (2 pi)        k (s+1)/(s+2) at normal incidence; the lecture's bound for every angle
``"modified"``  (s + 2) / (2 pi)        exactly k at normal incidence, at most k elsewhere: Lafortune & Willems 1994
==============  ======================  ========================================================================

As any BRDF it is multiplied by the cosine at the surface. Phong 1975 adds the lobe to the radiance without one; Lewis 1993
("Making shaders more physically plausible") gives the lobe as a BRDF, which the cosine multiplies.

Not smooth at the edge of the lobe (wi.R = 0; for s <= 1 in the first derivative) nor, with a Fresnel term, for wi = -wo, where
there is no half vector. The cosine is taken through its complement |R - wi|^2 / 2, because near the peak, where a large exponent
lives, the cosine itself has no digits left.

>>> import torch, torchbrdf as tb
>>> up = torch.tensor([0.0, 0.0, 1.0])
>>> float(tb.Phong(1.0, 10.0, normalization="none").evaluate(up, up))
1.0
"""

import math
from typing import Any

import torch
from torch import Tensor

from .. import numerics, sampling, vector
from ..geometry import Channels, Geometry, Viewer, each
from ..interval import Interval
from ..optics.fresnel import Fresnel
from ..value import COLOUR, SCALAR, param, value
from ..vector import Vec
from .base import Bsdf, nearest
from .lobe import Draw, Lobe

STRENGTH = Interval(0.0, typical=(0.1, 0.9))  # any is legal; up to 1 no light is made
EXPONENT = Interval(0.0, typical=(1.0, 200.0), hard=(0.5, 1e7))
NORMALIZATIONS = {
    "none": lambda s: torch.ones_like(s),
    "bound": lambda s: (s + 1.0) * (0.5 / math.pi),
    "modified": lambda s: (s + 2.0) * (0.5 / math.pi),
}


@value
class Phong(Bsdf):
    """``specular N(s) F(wi.h) (wi.R(wo))^s`` with the normalisation ``"modified"``, ``"bound"`` or ``"none"``."""

    specular: Tensor = param(STRENGTH, COLOUR, "strength k")
    exponent: Tensor = param(EXPONENT, SCALAR, "s")
    fresnel: Fresnel | None = None
    normalization: str = "modified"

    lobes = (Lobe.GLOSSY_REFLECTION,)
    variants = tuple({"normalization": name} for name in ("modified", "bound", "none"))

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.normalization, str) or self.normalization not in NORMALIZATIONS:
            raise ValueError(f"Phong.normalization: found {self.normalization!r}, legal are {sorted(NORMALIZATIONS)}")

    def formula(self, g: Geometry) -> Channels:
        s = g.scalar(self.exponent)
        lobe = numerics.log1p_power(g.mirror_complement, s) * NORMALIZATIONS[self.normalization](s)
        return tinted(g, self.specular, self.fresnel, lobe)

    @staticmethod
    def textbook(m: Any, p: Any, specular: Any, exponent: Any, fresnel: Any, normalization: str) -> Any:
        n = {"none": 1, "bound": (exponent + 1) / (2 * m.pi), "modified": (exponent + 2) / (2 * m.pi)}[normalization]
        dark = m.positive(-p.cos_mirror)
        return specular * n * fresnel(p.wi_h) * m.where(dark, 0, m.power(m.where(dark, 1, p.cos_mirror), exponent))

    def density(self, g: Geometry) -> Tensor:
        s = g.scalar(self.exponent)
        return numerics.log1p_power(g.mirror_complement, s) * ((s + 1.0) / (2.0 * math.pi))

    def draw(self, viewer: Viewer, u: Vec) -> Draw:
        """Proportional to the lobe, about the mirror direction (Lafortune & Willems 1994, eq. 11)."""
        about = sampling.cosine_power(u.x, u.y, viewer.scalar(self.exponent) + 1.0)
        return Draw(vector.combine(viewer.mirror_axes, about))

    def strength(self, viewer: Viewer) -> Tensor:
        """The albedo at normal incidence, with F at the mirror direction."""
        s = viewer.scalar(self.exponent)
        return peak_reflectance(viewer, self.specular, self.fresnel) * NORMALIZATIONS[self.normalization](s) * (2.0 * math.pi) / (s + 2.0)

    def kink_distance(self, g: Geometry) -> Tensor:
        """The edge of the lobe, too, and what is not smooth about F."""
        return nearest(super().kink_distance(g), (1.0 - g.mirror_complement).abs(), fresnel_kink(self.fresnel, g))

    @property
    def energy_bound(self) -> Tensor | None:
        return None if self.normalization == "none" else self.specular


def tinted(g: Geometry, specular: Tensor, fresnel: Fresnel | None, lobe: Tensor) -> Channels:
    """``specular F(wi.h) lobe``, channel by channel."""
    if fresnel is None:
        return tuple(k * lobe for k in g.colour(specular))
    return each(lambda k, f: k * f * lobe, g.colour(specular), fresnel.terms(g.viewer.layout, g.wi_h))


def peak_reflectance(viewer: Viewer, specular: Tensor, fresnel: Fresnel | None) -> Tensor:
    """The mean of ``specular F`` where the lobe peaks: in the mirror direction wi.h is n.wo."""
    if fresnel is None:
        return viewer.layout.average(specular)
    terms = fresnel.terms(viewer.layout, numerics.unit_interval(viewer.cos_o))
    return viewer.layout.mean(each(torch.mul, viewer.colour(specular), terms))


def fresnel_kink(fresnel: Fresnel | None, g: Geometry) -> Tensor:
    """How far F(wi.h) is from where it is not smooth, as it is where there is no half vector."""
    return g.wi_h if fresnel is None else torch.minimum(g.wi_h, fresnel.kink_distance(g.viewer.layout, g.wi_h))
