"""The layers of ``tb.Principled`` for one viewer: each figure computed once, when a lobe that is there asks for it."""

import math
from typing import Any

import torch
from torch import Tensor

from .. import numerics
from ..geometry import Channels, Geometry, Viewer, each, memo
from .base import Bsdf
from .lambert import Lambert
from .rough_conductor import RoughConductor
from .sampler import normalised
from .schlick_layer import Cover, Gloss, alpha_of, mixed
from .sheen import Sheen


class Layers:
    """From below: diffuse base, interface and metal as one gloss, coat, sheen. ``m`` is the material."""

    def __init__(self, m: Any, viewer: Viewer) -> None:
        self.m, self.viewer = m, viewer
        self._memo: dict[str, Any] = {}

    # Of both directions -------------------------------------------------------------------------------------------------

    def formula(self, g: Geometry) -> Channels:
        """f in 1/sr of the lobes that are asked for."""
        found = [self._base(name, g) for name in self.m.names if name in ("diffuse", "specular")]
        if self.m.has("coat") and found:
            through = self.over * self.coat_cover.through(g.cos_i)
            found = [tuple(f * through for f in total(found))]
        if "coat" in self.m.names:
            found.append(self.coat.formula(g))
        if self.m.has("sheen") and found:
            found = [each(_below_sheen, total(found), self.sheen.bound(self.viewer, g.cos_i), self.taken)]
        return total([*found, self.sheen.formula(g)] if "sheen" in self.m.names else found)

    def _base(self, name: str, g: Geometry) -> Channels:
        """A lobe below the coat."""
        if name == "specular":
            return self.gloss.formula(g)
        if self.cover is None:
            return self.albedo
        through = self.cover.through(g.cos_i)
        return tuple(a * through for a in self.albedo)

    # Sampling -----------------------------------------------------------------------------------------------------------

    def alone(self, name: str) -> Bsdf:
        """The model that a lobe is drawn from."""
        return {"diffuse": lambda: Lambert(self.m.base_color), "specular": lambda: self.facets, "coat": lambda: self.coat.facets}.get(
            name, lambda: self.sheen
        )()

    @memo
    def shares(self) -> list[Tensor]:
        """The probability of each lobe."""
        return normalised(self.strengths)

    @memo
    def strengths(self) -> list[Tensor]:
        """Of each lobe, about what it reflects; seen from below 0."""
        return [numerics.positive(self._strength(name)) for name in self.m.names]

    def _strength(self, name: str) -> Tensor:
        if name == "sheen":
            return self.sheen.strength(self.viewer)
        free = 1.0 - self.sheen.strength(self.viewer) if self.m.has("sheen") else 1.0
        if name == "coat":
            return self.coat.strength(self.viewer) * free
        over = self.over if self.m.has("coat") else 1.0
        if name == "specular":
            return self.gloss.strength(self.viewer) * (over * over * free)
        return self.viewer.layout.mean(self.albedo) * (math.pi * over * free)

    # The layers ---------------------------------------------------------------------------------------------------------

    @memo
    def cover(self) -> Cover | None:
        """The dielectric over the base."""
        if not (self.m.has("specular") and self.m.has("dielectric")):
            return None
        return Cover.of(self.viewer.scalar(self.m.ior), self.viewer.scalar(self.m.specular) if self.m.has("partial") else None)

    @memo
    def albedo(self) -> Channels:
        """f of the diffuse base, but for what the interface takes of the light."""
        share = (1.0 / math.pi) * (1.0 - self.viewer.scalar(self.m.metallic)) if self.m.has("metal") else 1.0 / math.pi
        if self.cover is not None:
            share = self.cover.through(self.viewer.cos_o) * (self.cover.gain * share)
        return tuple(a * share for a in self.viewer.colour(self.m.base_color))

    @memo
    def facets(self) -> RoughConductor:
        """Mirrors with the roughness of what is below the coat."""
        alpha = alpha_of(self.m.roughness, self.m.anisotropy if self.m.has("anisotropy") else None)
        return RoughConductor(alpha, shadowing=self.m.shadowing)

    @memo
    def gloss(self) -> Gloss:
        """The lobe of metal and dielectric together."""
        return Gloss(self.facets, *self._reflectance())

    def _reflectance(self) -> tuple[Channels, Channels]:
        """f0 and rise of Schlick's law."""
        colour = self.viewer.colour(self.m.base_color)
        if not self.m.has("metal") and self.cover is not None:
            return (self.cover.f0,), (self.cover.rise,)
        if not self.m.has("dielectric"):
            return colour, tuple(1.0 - c for c in colour)
        return mixed(self.cover, colour, self.viewer.scalar(self.m.metallic))

    @memo
    def coat_cover(self) -> Cover:
        """What the coat reflects, and lets through."""
        return Cover.of(self.viewer.scalar(self.m.coat_ior), self.viewer.scalar(self.m.coat))

    @memo
    def over(self) -> Tensor:
        """What leaves through the coat."""
        return self.coat_cover.through(self.viewer.cos_o)

    @memo
    def coat(self) -> Gloss:
        """The lobe of the coat."""
        facets = RoughConductor(alpha_of(self.m.coat_roughness), shadowing=self.m.shadowing)
        return Gloss(facets, (self.coat_cover.f0,), (self.coat_cover.rise,))

    @memo
    def sheen(self) -> Sheen:
        """The fibres above all."""
        return Sheen(self.m.sheen, self.m.sheen_roughness)

    @memo
    def taken(self) -> Channels:
        """What the sheen takes of what leaves."""
        return self.sheen.bound(self.viewer, self.viewer.cos_o)


def _below_sheen(f: Tensor, taken_i: Tensor, taken_o: Tensor) -> Tensor:
    return f * ((1.0 - taken_i) * (1.0 - taken_o))


def total(found: list[Channels]) -> Channels:
    """The sum of several lobes."""
    all_of_them = found[0]
    for other in found[1:]:
        all_of_them = each(torch.add, all_of_them, other)
    return all_of_them
