r"""A rough conductor: facets that are mirrors, their normals distributed about the normal of the surface.

.. math:: f = \frac{F(\omega_i \cdot h)\; D(h)\; G(\omega_i, \omega_o)}{4\,|\cos\theta_i|\,|\cos\theta_o|}

=============  =======================  ==================================================================================
parameter      unit, range              meaning
=============  =======================  ==================================================================================
alpha          [..., 1 or 2], (0, 1]    roughness, a slope; two numbers are along the tangent and across
fresnel        a Fresnel term, None     F of the facets; None is 1, a white mirror
distribution   a name                   D: ``"ggx"``, ``"beckmann"``, ``"blinn"``
shadowing      a name                   G: ``"smith_correlated"``, ``"smith_separable"``, ``"v_cavity"``
smith          a name                   Lambda of Beckmann: ``"exact"``, or ``"walter"``, the usual rational function
energy         a name                   ``"single"``: what meets a second facet is lost; ``"conserving"``: it leaves, too
=============  =======================  ==================================================================================

``energy="single"``: light that meets a second facet is lost, up to 0.7 of it at alpha = 1, so that the directional albedo falls with
alpha. ``"conserving"`` adds a broad lobe that returns it, coloured by each further reflection (:mod:`~torchbrdf.bsdf.lost_energy`: Kulla
& Conty 2017): a white surface then returns everything, within 3.5e-4 at every angle and alpha in [0.02, 1] (1.2e-4 for GGX with Smith's
shadowing). Along two axes it is approximate: within 0.08 at (0.3, 0.6) or (0.4, 0.1), where single scattering loses 0.31 and 0.19, and
0.25 at ratios of 10; ``energy_bound`` is then None. There is none for Walter's Lambda, nor for Blinn's distribution but with V-cavities.

Not smooth at the horizon, where f jumps (before, it grows as 1 / cos, its slopes as the square of that), nor at the ridge of
V-cavities. Roughness along two axes needs a tangent; without one the frame is that of ``tb.Frame.from_normal``, which jumps.
Perceptual roughness, as of glTF, is the square root of alpha: ``tb.alpha_from_roughness``. Smith's shadowing of Blinn's distribution
is that of Beckmann's, which suits it up to alpha = 0.2; beyond, energy is made at grazing (albedo 1.11 at alpha = 0.5, 1.75 at 1),
so take ``"v_cavity"``, whose albedo is at most 1.
The directional albedo is that of the law to 1e-5, but for V-cavities and a critical angle in F, whose kinks cost up to 1e-4 and 1e-2.
Sources: Torrance & Sparrow 1967; Walter et al. 2007, eq. 20; visible normals Heitz 2018.

>>> import torch, torchbrdf as tb
>>> gold = tb.RoughConductor(0.2, tb.Conductor.named("Au"))
>>> [round(x, 2) for x in gold.directional_albedo(torch.tensor([[0.6, 0.0, 0.8]]))[0].tolist()]
[0.89, 0.74, 0.39]
>>> [round(x, 2) for x in gold.replace(energy="conserving").directional_albedo(torch.tensor([[0.6, 0.0, 0.8]]))[0].tolist()]
[0.95, 0.78, 0.4]
"""

import math
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from .. import arguments, numerics, sampling, vector
from ..geometry import Channels, Geometry, Viewer, each
from ..optics.beckmann import Beckmann, walter_length
from ..optics.blinn import Blinn
from ..optics.distribution import ALPHA, AXES, Distribution, Facet, Rough, need_axes
from ..optics.fresnel import Fresnel
from ..optics.ggx import GGX
from ..value import param, value
from ..vector import Vec
from .base import Bsdf, nearest
from .facet_albedo import facet_albedo
from .lobe import Draw, Lobe
from .lost_energy import FITS, Lost
from .phong import fresnel_kink
from .sampler import normalised
from .shadowing import SHADOWING, TEXTBOOK

Length = Callable[[Tensor, Tensor], Tensor]  # the Smith length, of a cosine and the square of the projected roughness
DISTRIBUTIONS: dict[str, type[Distribution]] = {"ggx": GGX, "beckmann": Beckmann, "blinn": Blinn}


@value
class RoughConductor(Bsdf):
    """Microfacets that are mirrors of Fresnel reflectance ``fresnel``, of roughness ``alpha``."""

    alpha: Tensor = param(ALPHA, AXES, "roughness, a slope")
    fresnel: Fresnel | None = None
    distribution: str = "ggx"
    shadowing: str = "smith_correlated"
    smith: str = "exact"
    energy: str = "single"

    lobes = (Lobe.GLOSSY_REFLECTION,)
    variants = (
        {"distribution": "ggx", "shadowing": "smith_correlated"},
        {"distribution": "ggx", "shadowing": "v_cavity"},
        {"distribution": "beckmann", "shadowing": "smith_correlated"},
        {"distribution": "blinn", "shadowing": "v_cavity"},
        {"distribution": "ggx", "shadowing": "smith_separable", "alpha": (0.4, 0.15)},
        {"distribution": "beckmann", "shadowing": "smith_separable", "smith": "walter"},
        {"distribution": "ggx", "energy": "conserving"},
        {"distribution": "beckmann", "shadowing": "smith_separable", "alpha": (0.3, 0.8), "energy": "conserving"},
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        arguments.one_of(self.distribution, "RoughConductor.distribution", DISTRIBUTIONS)
        arguments.one_of(self.shadowing, "RoughConductor.shadowing", SHADOWING)
        arguments.one_of(self.smith, "RoughConductor.smith", ("exact", "walter"))
        if self.smith == "walter" and self.distribution != "beckmann":
            raise ValueError(
                f"RoughConductor.smith: found 'walter' beside {self.distribution!r}; it is an approximation of 'beckmann' alone"
            )

        arguments.one_of(self.energy, "RoughConductor.energy", ("single", "conserving"))
        if self.energy == "conserving" and ((self.distribution, self.shadowing) not in FITS or self.smith == "walter"):
            raise ValueError(
                f"RoughConductor.energy: found 'conserving' beside {self.distribution!r}, {self.shadowing!r}, {self.smith!r}; legal are "
                "'exact' Lambda, and for 'blinn' the shadowing 'v_cavity'; else energy='single'"
            )

    def check_shapes(self) -> None:
        """As every model; and one or two numbers of roughness."""
        super().check_shapes()
        need_axes(self.alpha, "RoughConductor.alpha")

    def formula(self, g: Geometry) -> Channels:
        lobe = self.normals.density(self._facet(g), self._rough(g.viewer)) * self._shadowed(g)
        if self.energy == "conserving":
            return self._with_lost(lobe, g)
        if self.fresnel is None:
            return (lobe,)
        return tuple(f * lobe for f in self.fresnel.terms(g.viewer.layout, g.wi_h))

    @staticmethod
    def textbook(m: Any, p: Any, alpha: Any, fresnel: Any, distribution: str, shadowing: str, smith: str, energy: str) -> Any:
        if isinstance(alpha, tuple) or smith == "walter" or energy == "conserving":
            return NotImplemented
        d, lam = DISTRIBUTIONS[distribution].textbook
        ci, co = m.where(p.above, p.cos_i, 1), m.where(p.above, p.cos_o, 1)
        g = TEXTBOOK[shadowing](m, p, lambda c: lam(m, m.where(p.above, c, 1), alpha))
        return fresnel(p.wi_h) * d(m, m.where(p.above, p.cos2_h, 1), alpha) * g / (4 * ci * co)

    def density(self, g: Geometry) -> Tensor:
        """That of the normals that the viewer sees, over the Jacobian of the mirror direction about them, 4 wo.h."""
        by = self.normals.drawn_as()
        d = by.density(self._facet(g), self._rough(g.viewer)) * numerics.step(vector.dot(g.n, g.half))
        length = self._length_o(by.smith_length, g.viewer)
        once = 0.5 * d * numerics.reciprocal_or_zero(g.cos_o + length, numerics.negligible(d.dtype))
        if self.energy == "single":
            return once
        first, rest = self._shares(g.viewer)
        return first * once + rest * self._lost(g.viewer).density(g.cos_i)

    def draw(self, viewer: Viewer, u: Vec) -> Draw:
        """A normal that the viewer sees, and the mirror direction about it; or, chosen by u.x, what further facets send out."""
        if self.energy == "single":
            return Draw(vector.reflect_components(viewer.wo, self.normals.visible_normal(viewer.wo, self._rough(viewer), u)))
        (first, _), x = sampling.choose(u.x, self._shares(viewer))
        once = vector.reflect_components(viewer.wo, self.normals.visible_normal(viewer.wo, self._rough(viewer), Vec(x, u.y, u.z)))
        again = self._lost(viewer).draw(x, u.y)
        return Draw(Vec(*(torch.where(first, a, b) for a, b in zip(once, again, strict=True))))

    def albedo_at(self, viewer: Viewer, order: int) -> Channels:
        """By quadrature over the normals; V-cavities have ridges, which need more nodes. And what further facets return."""
        if self.energy == "conserving":
            once = self.replace(energy="single").albedo_at(viewer, order)
            lost = self._lost_o(viewer)
            return each(lambda f, k: f + lost * k, once, self._gain(viewer))
        order = order + order // 2 if self.shadowing == "v_cavity" else order
        rough = self._rough(viewer.local)
        return facet_albedo(self, viewer.local, rough, lambda facet: self.normals.density(facet, rough), order)

    def strength(self, viewer: Viewer) -> Tensor:
        """F in the mirror direction; of what is lost, all that comes back."""
        once, again = self._strengths(viewer)
        return once if again is None else once + again

    def kink_distance(self, g: Geometry) -> Tensor:
        """Beside the horizon: what is not smooth about F, and the ridges of V-cavities."""
        found = nearest(super().kink_distance(g), fresnel_kink(self.fresnel, g))
        if self.shadowing != "v_cavity":
            return found
        ci, co = g.cos_i.abs(), g.cos_o.abs()
        larger, smaller = torch.maximum(ci, co), torch.minimum(ci, co)
        lit = 4.0 * smaller - g.half2 * numerics.reciprocal_or_zero(larger + smaller)  # > 0 where nothing is hidden
        return nearest(found, lit.abs(), torch.where(lit < 0, larger - smaller, 1.0))

    @property
    def energy_bound(self) -> Tensor | None:
        """1; none for Blinn's distribution with Smith's shadowing, that of another distribution, nor where what is lost is approximate."""
        makes = self.distribution == "blinn" and self.shadowing != "v_cavity"
        return None if makes or (self.energy == "conserving" and self.alpha.shape[-1] == 2) else super().energy_bound

    # What single scattering loses ----------------------------------------------------------------------------------------

    def _with_lost(self, lobe: Tensor, g: Geometry) -> Channels:
        """The single-scattering lobe, and what it loses."""
        v, lost = g.viewer, self._lost(g.viewer)
        local = None if lost.rough.isotropic else g.wi_local
        per_mean = v.once(self, lambda: self._lost_o(v) / (math.pi * lost.mean), "lost per mean")
        again = lost.at(g.cos_i.abs(), local) * per_mean
        if self.fresnel is None:
            return (lobe + again,)
        return each(lambda f, k: f * lobe + k * again, self.fresnel.terms(v.layout, g.wi_h), self._gain(v))

    def _lost(self, viewer: Viewer) -> Lost:
        fit = FITS[self.distribution, self.shadowing]
        return viewer.once(self, lambda: Lost.of(fit, self._rough(viewer)), "lost")

    def _lost_o(self, viewer: Viewer) -> Tensor:
        """The share of light along wo that single scattering loses."""

        def compute() -> Tensor:
            lost = self._lost(viewer)
            return lost.at(viewer.cos_o.abs(), None if lost.rough.isotropic else viewer.local.wo)

        return viewer.once(self, compute, "lost of wo")

    def _gain(self, viewer: Viewer) -> Channels:
        """How much of what is lost comes back, per channel."""
        if self.fresnel is None:
            return (torch.ones_like(viewer.cos_o),)
        term = self.fresnel
        return viewer.once(self, lambda: self._lost(viewer).gain(term, viewer), "gain")

    def _strengths(self, viewer: Viewer) -> tuple[Tensor, Tensor | None]:
        """How much the first reflection sends out, and further ones, about."""
        mean, term, ones = viewer.layout.mean, self.fresnel, torch.ones_like(viewer.cos_o)
        first = ones if term is None else mean(term.terms(viewer.layout, numerics.unit_interval(viewer.cos_o)))
        if self.energy == "single":
            return first, None
        lost = self._lost_o(viewer)
        gain = ones if term is None else mean(self._gain(viewer))
        return first * (1.0 - lost), gain * lost

    def _shares(self, viewer: Viewer) -> list[Tensor]:
        """How often the first reflection is sampled, and further ones."""
        return viewer.once(self, lambda: normalised([s for s in self._strengths(viewer) if s is not None]), "shares of lobes")

    # What stands once for each surface, viewer, geometry -----------------------------------------------------------------

    @property
    def normals(self) -> type[Distribution]:
        """The formulas of the distribution."""
        return DISTRIBUTIONS[self.distribution]

    def _rough(self, viewer: Viewer) -> Rough:
        return viewer.once(self.alpha, lambda: Rough.of(self.alpha, viewer.layout), "rough")

    def _facet(self, g: Geometry) -> Facet:
        rough = self._rough(g.viewer)
        if not rough.isotropic:
            return Facet.local(vector.add(g.wi_local, g.viewer.local.wo), rough, g.half2)
        across = vector.cross(g.n, g.half)
        flat2 = vector.dot(across, across)
        return Facet(vector.dot(g.n, g.half), flat2, flat2 / (rough.x * rough.x), g.half2)

    def _shadowed(self, g: Geometry) -> Tensor:
        by = walter_length if self.smith == "walter" else self.normals.smith_length
        return SHADOWING[self.shadowing](g, lambda: self._length_i(by, g), lambda: self._length_o(by, g.viewer))

    def _length_i(self, by: Length, g: Geometry) -> Tensor:
        """The Smith length of wi; below the horizon that of its image above."""
        rough = self._rough(g.viewer)
        return by(g.cos_i.abs(), rough.projected2(g.cos_i, None if rough.isotropic else g.wi_local))

    def _length_o(self, by: Length, viewer: Viewer) -> Tensor:
        """Of wo, once for a viewer."""

        def compute() -> Tensor:
            rough = self._rough(viewer)
            return by(viewer.cos_o.abs(), rough.projected2(viewer.cos_o, None if rough.isotropic else viewer.local.wo))

        return viewer.once(self.alpha, compute, by.__qualname__)
