"""A reflecting layer by Schlick's law, f0 + rise (1 - cos)^5: what it lets through to what is below, and its own glossy lobe."""

from typing import NamedTuple

import torch
from torch import Tensor

from .. import numerics, parameters, vector
from ..geometry import Channels, Geometry, Viewer, each
from .rough_conductor import RoughConductor

MEAN = 1.0 / 23.0  # of (1 - cos)^5 under diffuse light, 1/21, less what rough facets reflect beyond a smooth interface


def grazing(cos: Tensor) -> Tensor:
    """Schlick's (1 - cos)^5."""
    m = numerics.positive(1.0 - cos)
    m2 = m * m
    return m2 * m2 * m


class Cover(NamedTuple):
    """A smooth interface above a base: reflectance f0 + rise p, as numbers."""

    f0: Tensor
    rise: Tensor
    rest: Tensor | None  # 1 - f0; None: the same as rise, of an interface of full strength

    @staticmethod
    def of(index: Tensor, strength: Tensor | None) -> "Cover":
        """Of an index of refraction, and a strength of which None is 1."""
        root = (index - 1.0) / (index + 1.0)
        f0 = root * root
        if strength is None:
            return Cover(f0, 1.0 - f0, None)
        return Cover(strength * f0, strength * (1.0 - f0), 1.0 - strength * f0)

    def through(self, cos: Tensor) -> Tensor:
        """What is not reflected; of full strength over 1 - f0. (Below the horizon any number.)"""
        return 1.0 - grazing(cos) if self.rest is None else self.rest - self.rise * grazing(cos)

    @property
    def gain(self) -> Tensor:
        """Over :meth:`through` of both directions, so that diffuse light is let through as often as it should."""
        return self.rise * (1.0 / (1.0 - MEAN)) if self.rest is None else 1.0 / (self.rest - self.rise * MEAN)


class Gloss(NamedTuple):
    """The lobe of a rough interface: mirror facets times f0 + rise p at the half vector."""

    facets: RoughConductor
    f0: Channels
    rise: Channels

    def formula(self, g: Geometry) -> Channels:
        """f in 1/sr per channel."""
        (lobe,), p = self.facets.formula(g), grazing(g.wi_h)
        return each(lambda f0, rise: (rise * p + f0) * lobe, self.f0, self.rise)

    def strength(self, viewer: Viewer) -> Tensor:
        """The reflectance in the mirror direction, averaged over channels."""
        p = grazing(viewer.cos_o)
        return viewer.layout.mean(each(lambda f0, rise: rise * p + f0, self.f0, self.rise))


def alpha_of(roughness: Tensor, anisotropy: Tensor | None = None) -> Tensor:
    """Slopes ``[..., 1]``, or ``[..., 2]`` along the tangent and across: roughness^2 over and times the aspect (Burley 2012)."""
    if anisotropy is None:
        r = numerics.widen(roughness)
        return r * r
    r, strength = parameters.alike(numerics.widen(roughness), numerics.widen(anisotropy))
    aspect = torch.sqrt(1.0 - 0.9 * strength)
    x, y = torch.broadcast_tensors(r * r / aspect, r * r * aspect)
    return vector.stack((x.squeeze(-1), y.squeeze(-1)))


def mixed(cover: Cover | None, colour: Channels, metallic: Tensor) -> tuple[Channels, Channels]:
    """f0 and rise of metal of a colour, and of a dielectric or none for the rest."""
    metal = tuple(metallic * c for c in colour)
    if cover is None:
        return metal, tuple(metallic - c for c in metal)
    f0, rise = (1.0 - metallic) * cover.f0, (1.0 - metallic) * cover.rise
    return tuple(c + f0 for c in metal), tuple((metallic - c) + rise for c in metal)
