r"""One material of everyday parameters, under the names of glTF and OpenPBR: a metal or a glossy diffuse base, a clear coat, a sheen.

.. math::
    f = T_s(\theta_i)\,T_s(\theta_o) \Big\{ T_c(\theta_i)\,T_c(\theta_o) \Big[ F(\omega_i \cdot h)\, \frac{D\,G}{4 \cos\theta_i \cos\theta_o}
    + (1 - m)\, \frac{\rho}{\pi} \frac{T(\theta_i)\, T(\theta_o)}{1 - \bar F} \Big]
    + F_c(\omega_i \cdot h)\, \frac{D_c\, G_c}{4 \cos\theta_i \cos\theta_o} \Big\} + f_{sheen}

===============  ====================  ==================================================================================
parameter        unit, range           meaning
===============  ====================  ==================================================================================
base_color       [..., C] in [0, 1]    :math:`\rho`, albedo of the base, and reflectance of the metal at normal incidence
metallic         [..., 1] in [0, 1]    m, the share of metal
roughness        [..., 1] in (0, 1]    of metal and base: GGX of alpha = roughness^2
ior              [..., 1] >= 1         index of refraction of the dielectric
specular         [..., 1] in [0, 1]    s, the strength of the dielectric's reflection
anisotropy       [..., 1] in [0, 1]    alpha over the aspect along the tangent, times it across; aspect^2 = 1 - 0.9 anisotropy
coat             [..., 1] in [0, 1]    c, the share that has a clear coat
coat_roughness   [..., 1] in (0, 1]    of the coat: GGX of alpha = coat_roughness^2
coat_ior         [..., 1] >= 1         index of refraction of the coat
sheen            [..., C] in [0, 1]    color of ``tb.Sheen``, its albedo at grazing
sheen_roughness  [..., 1] in (0, 1]    r of ``tb.Sheen``
shadowing        a name                G: ``"smith_correlated"`` or ``"smith_separable"``
off              names, None           what is known to have no effect and is not computed; None: what the numbers say
parts            names, None           the lobes that are evaluated: "diffuse", "specular", "coat", "sheen"; None: all there are
===============  ====================  ==================================================================================

Reflectances are Schlick's, with :math:`p(\theta) = (1 - \cos\theta)^5` and :math:`f_0 = ((ior-1)/(ior+1))^2`. Metal and dielectric are
one lobe, of :math:`F = m\,(\rho + (1-\rho)\,p) + (1-m)\,s\,(f_0 + (1-f_0)\,p)`; the coat has :math:`F_c = c\,(f_c + (1-f_c)\,p)`. What the
interface reflects the base does not get: :math:`T=1 - s\,(f_0 + (1-f_0)\,p)`, and :math:`\bar F = s\,(f_0 + (1-f_0)/23)`. With 21 in place
of 23 that were the mean of F, and the diffuse albedo exactly :math:`\rho\,T(\theta)` (Shirley et al. 1997); rough facets reflect up to
0.0025 more than a smooth interface, so that the base is made up to 0.45 % darker, and no energy is made. :math:`T_c = 1 - F_c(\theta)`,
on the way in and on the way out; what the coat throws back down is left out. :math:`T_s`, channel by channel, is what ``tb.Sheen.bound``
leaves.

Reciprocal; the directional albedo is at most 1, and less where facets hide one another: light that meets a second facet is lost. Not
smooth at the horizon, nor for wi = -wo.

**What is zero costs nothing.** ``metallic``, ``specular``, ``anisotropy``, ``coat`` or ``sheen`` given as the number 0 take what they make zero
out of the model, its lobes and its sampler; so does ``metallic`` of 1, and ``specular`` of 1 saves its factor. ``off`` names them: ``"metal"``,
``"specular"``, ``"anisotropy"``, ``"coat"``, ``"sheen"``, ``"dielectric"`` (metallic is 1), ``"partial"`` (specular is 1). A tensor of one number is a
number if it can be looked at (on the CPU, not in graphs and transforms) and requires no gradient; what is learned stays.
``tb.nn.Material`` decides when it is made.

======================  ====================================  ==========================================================================
beside                  the same                              otherwise
======================  ====================================  ==========================================================================
glTF 2.0                names, alpha, f0, metal, the          the base is weighted by 1 - F(wi.h), by which energy is made (to 1.9 at
                        specular lobe                         grazing); the coat by F(n.wo) alone; anisotropy is another formula
OpenPBR 1.1             coat and base as layers, alpha        prefixes of names; exact Fresnel; Oren-Nayar; layers weighted by their
                                                              albedos; specular changes f0; anisotropy is another formula
Mitsuba's principled    alpha, anisotropy (Burley 2012); a    exact Fresnel; a base with retro-reflection that the interface does not
                        metal with                            weaken, nor the coat, which is GTR1 at a quarter of its strength;
                        ``shadowing="smith_separable"`` is    spec_tint, flatness, spec_trans are not here; sheen is 1 - cos to the fifth
                        theirs to rounding
======================  ====================================  ==========================================================================

Sources: Burley 2012; glTF 2.0, appendix B; Shirley, Hu, Smits & Lafortune 1997, *A practitioners' assessment of light reflection models*.

>>> import torch, torchbrdf as tb
>>> tb.Principled([0.8, 0.2, 0.1]).lobes == (tb.Lobe.DIFFUSE_REFLECTION, tb.Lobe.GLOSSY_REFLECTION)
True
>>> tb.Principled([0.8, 0.2, 0.1], metallic=1, coat=0.5).off
('dielectric', 'partial', 'anisotropy', 'sheen')
"""

import math
from typing import Any, Self

import torch
from torch import Tensor

from .. import arguments, numerics, sampling
from ..geometry import Channels, Geometry, Viewer, each
from ..interval import UNIT, Interval
from ..value import COLOUR, SCALAR, param, value
from ..vector import Vec
from .base import Bsdf, nearest
from .combine import either
from .lambert import Lambert
from .lobe import Draw, Lobe
from .principled_textbook import principled
from .rough_conductor import RoughConductor
from .sampler import normalised
from .schlick_layer import Cover, Gloss, alpha_of, mixed
from .sheen import ROUGHNESS, Sheen
from .switches import SWITCHES, is_known, known_off

INDEX = Interval(1.0, typical=(1.2, 2.5), hard=(10.0,), flat=(1.0,))
LOBES = {
    "diffuse": Lobe.DIFFUSE_REFLECTION,
    "specular": Lobe.GLOSSY_REFLECTION,
    "coat": Lobe.GLOSSY_REFLECTION,
    "sheen": Lobe.GLOSSY_REFLECTION,
}


@value
class Principled(Bsdf):
    """A metal or a glossy diffuse base with a clear coat, of which what is zero costs nothing."""

    base_color: Tensor = param(UNIT, COLOUR, "albedo of the base, and reflectance of the metal at normal incidence")
    metallic: Tensor = param(UNIT, SCALAR, "share of metal", default=0.0)
    roughness: Tensor = param(ROUGHNESS, SCALAR, "of metal and base; alpha is its square", default=0.5)
    ior: Tensor = param(INDEX, SCALAR, "index of refraction of the dielectric", default=1.5)
    specular: Tensor = param(UNIT, SCALAR, "strength of the dielectric's reflection", default=1.0)
    anisotropy: Tensor = param(UNIT, SCALAR, "0: none; 1: alpha along the tangent is ten times that across", default=0.0)
    coat: Tensor = param(UNIT, SCALAR, "share that has a clear coat", default=0.0)
    coat_roughness: Tensor = param(ROUGHNESS, SCALAR, "of the coat; alpha is its square", default=0.03)
    coat_ior: Tensor = param(INDEX, SCALAR, "index of refraction of the coat", default=1.5)
    sheen: Tensor = param(UNIT, COLOUR, "of fibres above all: their albedo at grazing", default=0.0)
    sheen_roughness: Tensor = param(ROUGHNESS, SCALAR, "how far from grazing they are bright", default=0.5)
    shadowing: str = "smith_correlated"
    off: tuple[str, ...] | None = None
    parts: tuple[str, ...] | None = None

    variants = (
        {"shadowing": "smith_correlated"},
        {"metallic": 0.0, "anisotropy": 0.0, "coat": 0.0, "sheen": 0.0},
        {"metallic": 1.0, "anisotropy": 0.0, "sheen": 0.0},
        {"specular": 0.0, "anisotropy": 0.0, "coat": 0.0, "shadowing": "smith_separable"},
    )

    def __post_init__(self) -> None:
        off = known_off({name: getattr(self, name) for name in self._fields}) if self.off is None else tuple(self.off)
        for name in off:
            arguments.one_of(name, "Principled.off", SWITCHES)
        object.__setattr__(self, "off", off)
        super().__post_init__()
        arguments.one_of(self.shadowing, "Principled.shadowing", ("smith_correlated", "smith_separable"))
        if self.parts is not None:
            object.__setattr__(self, "parts", tuple(self.parts))
            if not self.names or len(self.names) < len(self.parts):
                there = tuple(self.replace(parts=None).names)
                raise ValueError(f"Principled.parts: found {self.parts}, of this material there are {there}")

    @classmethod
    def decides(cls, name: str, given: Any) -> bool:
        return any(name == field and is_known(given, x) for field, x in SWITCHES.values())

    def replace(self, **changes: Any) -> Self:
        """A copy with some fields changed; what that takes out or brings in is found again."""
        kept = tuple(x for x in self.off or () if SWITCHES[x][0] not in changes)
        return super().replace(**{"off": kept + known_off(changes), **changes})

    # What there is ------------------------------------------------------------------------------------------------------

    def has(self, name: str) -> bool:
        """Whether something is not known to be off."""
        return name not in (self.off or ())

    @property
    def names(self) -> tuple[str, ...]:
        """Of the lobes."""
        dielectric = self.has("dielectric")
        gloss = self.has("metal") or (dielectric and self.has("specular"))
        there = (("diffuse", dielectric), ("specular", gloss), ("coat", self.has("coat")), ("sheen", self.has("sheen")))
        return tuple([n for n, is_there in there if is_there and (self.parts is None or n in self.parts)])

    @property
    def lobes(self) -> tuple[Lobe, ...]:  # type: ignore[override]
        return tuple([LOBES[n] for n in self.names])

    def select(self, wanted: Lobe) -> Bsdf | None:
        kept = tuple([n for n in self.names if LOBES[n].serves(wanted)])
        return self if kept == self.names else self.replace(parts=kept) if kept else None

    # What is computed ---------------------------------------------------------------------------------------------------

    def formula(self, g: Geometry) -> Channels:
        found = [self._base(name, g) for name in self.names if name not in ("coat", "sheen")]
        if self.has("coat") and found:
            through = self._over(g.viewer) * self._coat_cover(g.viewer).through(g.cos_i)
            found = [tuple(f * through for f in _total(found))]
        if "coat" in self.names:
            found.append(self._coat(g.viewer).formula(g))
        if self.has("sheen") and found:
            found = [
                each(
                    lambda f, i, o: f * ((1.0 - i) * (1.0 - o)),
                    _total(found),
                    self._sheen(g.viewer).bound(g.viewer, g.cos_i),
                    self._taken(g.viewer),
                )
            ]
        return _total([*found, self._sheen(g.viewer).formula(g)] if "sheen" in self.names else found)

    @staticmethod
    def textbook(m: Any, p: Any, **fields: Any) -> Any:
        return NotImplemented if fields["parts"] or "anisotropy" not in (fields["off"] or ()) else principled(m, p, fields)

    def _base(self, name: str, g: Geometry) -> Channels:
        """A lobe below the coat."""
        if name == "specular":
            return self._gloss(g.viewer).formula(g)
        cover = self._cover(g.viewer)
        return self._albedo(g.viewer) if cover is None else tuple(a * cover.through(g.cos_i) for a in self._albedo(g.viewer))

    def density(self, g: Geometry) -> Tensor:
        total = torch.zeros_like(g.cos_i + g.cos_o)
        for share, name in zip(self._shares(g.viewer), self.names, strict=True):
            total = total + share * self._alone(name, g.viewer).density(g)
        return total

    def draw(self, viewer: Viewer, u: Vec) -> Draw:
        """Choose a lobe with ``u.z``, and draw from it."""
        chosen, rest = sampling.choose(u.z, self._shares(viewer))
        numbers, found = Vec(u.x, u.y, rest), None
        for k, (mask, name) in enumerate(zip(chosen, self.names, strict=True)):
            drawn = self._alone(name, viewer).draw(viewer, numbers)._replace(lobe=k)
            found = drawn if found is None else either(mask, drawn, found)
        assert found is not None
        return found

    def _alone(self, name: str, viewer: Viewer) -> Bsdf:
        """The model that a lobe is drawn from."""
        if name == "diffuse":
            return Lambert(self.base_color)
        return self._sheen(viewer) if name == "sheen" else self._facets(name, viewer)

    def strength(self, viewer: Viewer) -> Tensor:
        return sum(self._strengths(viewer), torch.zeros_like(viewer.cos_o))

    def albedo_at(self, viewer: Viewer, order: int) -> Channels:
        """The sum of the lobes' albedos, each by quadrature of its own sampler."""
        if len(self.names) == 1:
            return super().albedo_at(viewer, order)
        return _total([self.replace(parts=(name,)).albedo_at(viewer, order) for name in self.names])

    def kink_distance(self, g: Geometry) -> Tensor:
        """The horizon, and for glossy lobes where there is no half vector."""
        found = super().kink_distance(g)
        if "sheen" in self.names:
            return nearest(found, self._sheen(g.viewer).kink_distance(g))
        return found if self.names == ("diffuse",) else nearest(found, g.wi_h)

    # What stands once for each viewer -----------------------------------------------------------------------------------

    def _shares(self, viewer: Viewer) -> list[Tensor]:
        made: list[Tensor] = viewer.once(self, lambda: normalised(self._strengths(viewer)), "lobes")
        return made

    def _strengths(self, viewer: Viewer) -> list[Tensor]:
        """Of each lobe, about what it reflects."""
        over = self._over(viewer) if self.has("coat") else 1.0
        free = 1.0 - self._sheen(viewer).strength(viewer) if self.has("sheen") else 1.0
        of = {
            "diffuse": lambda: viewer.layout.mean(self._albedo(viewer)) * (math.pi * over * free),
            "specular": lambda: self._gloss(viewer).strength(viewer) * (over * over * free),
            "coat": lambda: self._coat(viewer).strength(viewer) * free,
            "sheen": lambda: self._sheen(viewer).strength(viewer),
        }
        return [numerics.positive(of[name]()) for name in self.names]  # seen from below some are negative

    def _cover(self, viewer: Viewer) -> Cover | None:
        """The dielectric over the base."""
        if not (self.has("specular") and self.has("dielectric")):
            return None
        strength = self.specular if self.has("partial") else None
        made: Cover = viewer.once(self, lambda: _cover(viewer, self.ior, strength), "cover")
        return made

    def _albedo(self, viewer: Viewer) -> Channels:
        """f of the diffuse base, but for what the interface takes of the light."""

        def compute() -> Channels:
            cover = self._cover(viewer)
            share = (1.0 / math.pi) * (1.0 - viewer.scalar(self.metallic)) if self.has("metal") else 1.0 / math.pi
            share = share if cover is None else cover.through(viewer.cos_o) * (cover.gain * share)
            return tuple(a * share for a in viewer.colour(self.base_color))

        made: Channels = viewer.once(self, compute, "albedo")
        return made

    def _gloss(self, viewer: Viewer) -> Gloss:
        """The lobe of metal and dielectric together."""
        made: Gloss = viewer.once(self, lambda: Gloss(self._facets("specular", viewer), *self._reflectance(viewer)), "gloss")
        return made

    def _reflectance(self, viewer: Viewer) -> tuple[Channels, Channels]:
        """f0 and rise of Schlick's law."""
        cover, colour = self._cover(viewer), viewer.colour(self.base_color)
        if not self.has("metal") and cover is not None:
            return (cover.f0,), (cover.rise,)
        if not self.has("dielectric"):
            return colour, tuple(1.0 - c for c in colour)
        return mixed(cover, colour, viewer.scalar(self.metallic))

    def _facets(self, name: str, viewer: Viewer) -> RoughConductor:
        """Mirrors with the roughness of the coat, or of what is below."""

        def compute() -> RoughConductor:
            anisotropy = self.anisotropy if name == "specular" and self.has("anisotropy") else None
            roughness = self.coat_roughness if name == "coat" else self.roughness
            return RoughConductor(alpha_of(roughness, anisotropy), shadowing=self.shadowing)

        made: RoughConductor = viewer.once(self, compute, f"{name} facets")
        return made

    def _coat_cover(self, viewer: Viewer) -> Cover:
        made: Cover = viewer.once(self, lambda: _cover(viewer, self.coat_ior, self.coat), "coat cover")
        return made

    def _over(self, viewer: Viewer) -> Tensor:
        """What leaves through the coat."""
        made: Tensor = viewer.once(self, lambda: self._coat_cover(viewer).through(viewer.cos_o), "over")
        return made

    def _coat(self, viewer: Viewer) -> Gloss:
        cover = self._coat_cover(viewer)
        return Gloss(self._facets("coat", viewer), (cover.f0,), (cover.rise,))

    def _sheen(self, viewer: Viewer) -> Sheen:
        made: Sheen = viewer.once(self, lambda: Sheen(self.sheen, self.sheen_roughness), "sheen")
        return made

    def _taken(self, viewer: Viewer) -> Channels:
        """What the sheen takes of what leaves."""
        made: Channels = viewer.once(self, lambda: self._sheen(viewer).bound(viewer, viewer.cos_o), "taken")
        return made


def _cover(viewer: Viewer, index: Tensor, strength: Tensor | None) -> Cover:
    return Cover.of(viewer.scalar(index), None if strength is None else viewer.scalar(strength))


def _total(found: list[Channels]) -> Channels:
    total = found[0]
    for other in found[1:]:
        total = each(torch.add, total, other)
    return total
