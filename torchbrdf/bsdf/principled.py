r"""One material of everyday parameters, under the names of glTF and OpenPBR: a metal or a glossy diffuse base, a clear coat, a sheen.

.. math::
    f = T_s(\theta_i)\,T_s(\theta_o) \Big\{ T_c(\theta_i)\,T_c(\theta_o) \Big[ F(\omega_i \cdot h)\,
    \frac{D\,G}{4 \cos\theta_i \cos\theta_o} + (1 - m)\, \frac{\rho}{\pi} \frac{T(\theta_i)\, T(\theta_o)}{1 - \bar F} \Big]
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
smooth at the horizon, for wi = -wo, nor, with a sheen, in the mirror direction.

**What is zero costs nothing.** ``metallic``, ``specular``, ``anisotropy``, ``coat`` or ``sheen`` given as the number 0 take what they
make zero out of the model, its lobes and its sampler; so does ``metallic`` of 1, and ``specular`` of 1 saves its factor. ``off`` names
them: ``"metal"``, ``"specular"``, ``"anisotropy"``, ``"coat"``, ``"sheen"``, ``"dielectric"`` (metallic is 1), ``"partial"`` (specular is
1). A tensor of one number is a number if it can be looked at (on the CPU, not in graphs and transforms) and requires no gradient; what is
learned stays. ``tb.nn.Material`` decides when it is made.

======================  ====================================  ==========================================================================
beside                  the same                              otherwise
======================  ====================================  ==========================================================================
glTF 2.0                names, alpha, f0, metal, the          the base is weighted by 1 - F(wi.h), by which energy is made (to 1.9 at
                        specular lobe                         grazing); the coat by F(n.wo) alone; anisotropy is another formula
OpenPBR 1.1             coat and base as layers, alpha        prefixes of names; exact Fresnel; Oren-Nayar; layers weighted by their
                                                              albedos; specular changes f0; anisotropy is another formula
Mitsuba's principled    alpha, anisotropy (Burley 2012); a    exact Fresnel; a base with retro-reflection that the interface does not
                        metal with                            weaken, nor the coat, which is GTR1 at a quarter of its strength;
                        ``shadowing="smith_separable"`` is    spec_tint, flatness, spec_trans are not here; sheen is (1 - wi.h)^5
                        theirs to rounding
======================  ====================================  ==========================================================================

Sources: Burley 2012; glTF 2.0, appendix B; Shirley, Hu, Smits & Lafortune 1997, *A practitioners' assessment of light reflection models*.

>>> import torch, torchbrdf as tb
>>> tb.Principled([0.8, 0.2, 0.1]).lobes == (tb.Lobe.DIFFUSE_REFLECTION, tb.Lobe.GLOSSY_REFLECTION)
True
>>> tb.Principled([0.8, 0.2, 0.1], metallic=1, coat=0.5).off
('dielectric', 'partial', 'anisotropy', 'sheen')
"""

from typing import Any, Self

import torch
from torch import Tensor

from .. import arguments, numerics, sampling
from ..geometry import Channels, Geometry, Viewer
from ..interval import UNIT, Interval
from ..value import COLOUR, SCALAR, param, value
from ..vector import Vec
from .base import Bsdf, nearest
from .combine import either
from .lobe import Draw, Lobe
from .principled_layers import Layers, total
from .principled_textbook import principled
from .sheen import ROUGHNESS
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
        return self._layers(g.viewer).formula(g)

    @staticmethod
    def textbook(m: Any, p: Any, **fields: Any) -> Any:
        return NotImplemented if fields["parts"] or "anisotropy" not in (fields["off"] or ()) else principled(m, p, fields)

    def density(self, g: Geometry) -> Tensor:
        layers, density = self._layers(g.viewer), torch.zeros_like(g.cos_i + g.cos_o)
        for share, name in zip(layers.shares, self.names, strict=True):
            density = density + share * layers.alone(name).density(g)
        return density

    def draw(self, viewer: Viewer, u: Vec) -> Draw:
        """Choose a lobe with ``u.z``, and draw from it."""
        layers = self._layers(viewer)
        chosen, rest = sampling.choose(u.z, layers.shares)
        numbers, found = Vec(u.x, u.y, rest), None
        for k, (mask, name) in enumerate(zip(chosen, self.names, strict=True)):
            drawn = layers.alone(name).draw(viewer, numbers)._replace(lobe=k)
            found = drawn if found is None else either(mask, drawn, found)
        assert found is not None
        return found

    def strength(self, viewer: Viewer) -> Tensor:
        return sum(self._layers(viewer).strengths, torch.zeros_like(viewer.cos_o))

    def albedo_at(self, viewer: Viewer, order: int) -> Channels:
        """The sum of the lobes' albedos, each by quadrature of its own sampler."""
        if len(self.names) == 1:
            return super().albedo_at(viewer, order)
        return total([self.replace(parts=(name,)).albedo_at(viewer, order) for name in self.names])

    def kink_distance(self, g: Geometry) -> Tensor:
        """The horizon, for glossy lobes where there is no half vector, and for the sheen where it is the normal."""
        found = super().kink_distance(g)
        if "sheen" in self.names:
            return nearest(found, g.wi_h, numerics.safe_sqrt(g.sin2_h))
        return found if self.names == ("diffuse",) else nearest(found, g.wi_h)

    def _layers(self, viewer: Viewer) -> Layers:
        made: Layers = viewer.once(self, lambda: Layers(self.map(numerics.widen), viewer))  # slopes of half types are added up in float32
        return made
