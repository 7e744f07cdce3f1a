r"""A rough interface between two clear media: facets that reflect and refract, their normals distributed about that of the surface.

.. math::
    f_r = \frac{F\; D(h)\; G(\omega_i, \omega_o)}{4\,|\cos\theta_i|\,|\cos\theta_o|}, \qquad
    f_t = \frac{|\omega_i \cdot m|\,|\omega_o \cdot m|}{|\cos\theta_i|\,|\cos\theta_o|}\;
    \frac{n_o^2\,(1 - F)\; D(m)\; G'(\omega_i, \omega_o)}{|n_i\,\omega_i + n_o\,\omega_o|^2}

=============  =======================  ==============================================================================================
parameter      unit, range              meaning
=============  =======================  ==============================================================================================
alpha          [..., 1 or 2], (0, 1]    roughness, a slope; two numbers are along the tangent and across
eta            [..., 1] > 0             n(inside) / n(outside); n points outside
distribution   a name                   D: ``"ggx"``, ``"beckmann"``, ``"blinn"``
shadowing      a name                   G: ``"smith_correlated"``, ``"smith_separable"``, ``"v_cavity"``
smith          a name                   Lambda of Beckmann: ``"exact"``, or ``"walter"``, the usual rational function
mode           "radiance", "flux"       whether radiance that crosses grows by (n_o/n_i)^2, or power is counted (n_i^2 for n_o^2)
part           "both", "reflection"...  both lobes, or one of them alone ("transmission")
=============  =======================  ==============================================================================================

``f_r`` on one side of the surface, either one, of h between both directions. ``f_t`` across it, of ``m`` along n_i wi + n_o wo, turned
outside: 0 unless m.n > 0 and each direction sees this facet from its own side of the surface. F is the exact law at the facet; a viewer
below sees the inverse index. As of :class:`SmoothDielectric`, ``f(wi, wo)/n_o^2 = f(wo, wi)/n_i^2``, and ``mode="flux"`` drops the factor:
it is the adjoint, f(wo, wi).

``G'`` is Smith's G1(wi) G1(wo) for both of Smith's names, as of Walter et al. and Mitsuba. Correlated heights would give
B(1 + Lambda_i, 1 + Lambda_o) (Heitz et al. 2016), for what is high is lit from above and hidden from below; that lets less through, at
80 degrees by 2 % (alpha = 0.3) or half (alpha = 1). ``"v_cavity"`` is the least of 1, 2 n.m n.wi/wi.m and 2 n.m n.wo/wo.m, all without
sign. Single scattering: light that meets a second facet is lost, from below more than from above, so that the directional albedo is
below 1: of flux at normal incidence and eta = 1.5, 0.99 from above and 0.90 from below (alpha = 0.3), 0.89 and 0.42 (alpha = 1).

At eta = 1 there is no surface: nothing is reflected, and all goes straight on, a delta that this does not give: f is 0. One index for
all channels. Not smooth at the horizon, where facets are seen edge-on, nor at the critical angle and the ridges of V-cavities.
Source: Walter et al. 2007, eq. 20 and 21; visible normals Heitz & d'Eon 2014, Heitz 2018.

>>> import torch, torchbrdf as tb
>>> frosted, up = tb.RoughDielectric(0.3, 1.5), torch.tensor([0.0, 0.0, 1.0])
>>> [round(float(frosted.evaluate(w, up)), 3) for w in (up, -up)]  # 0.04 / (4 pi alpha^2) and 0.96 / (0.5^2 pi alpha^2)
[0.035, 13.581]
"""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from .. import arguments, numerics, vector
from ..geometry import Channels, Geometry, Viewer, each
from ..optics.dielectric import dielectric, split
from ..optics.distribution import ALPHA, AXES, Distribution, Facet, need_axes
from ..optics.fresnel import ETA, Dielectric
from ..value import SCALAR, param, value
from ..vector import Vec, add, scale
from . import microfacets
from .base import Bsdf, nearest
from .lobe import Draw, Lobe
from .microfacets import DISTRIBUTIONS
from .refraction import ACROSS, TEXTBOOK_ACROSS, Refraction, Seen, v_cavity_kink
from .shadowing import SHADOWING, TEXTBOOK
from .smooth_dielectric import MODES, bent, one_index

PARTS = {
    "both": (Lobe.GLOSSY_REFLECTION, Lobe.GLOSSY_TRANSMISSION),
    "reflection": (Lobe.GLOSSY_REFLECTION,),
    "transmission": (Lobe.GLOSSY_TRANSMISSION,),
}


@value
class RoughDielectric(Bsdf):
    """Microfacets that reflect F and refract the rest, of roughness ``alpha``. ``eta``: n(inside) / n(outside)."""

    alpha: Tensor = param(ALPHA, AXES, "roughness, a slope")
    eta: Tensor = param(ETA, SCALAR, "index of refraction, inside over outside")
    distribution: str = "ggx"
    shadowing: str = "smith_correlated"
    smith: str = "exact"
    mode: str = "radiance"
    part: str = "both"

    variants = (
        {"distribution": "ggx"},
        {"distribution": "beckmann", "shadowing": "v_cavity", "mode": "flux"},
        {"distribution": "beckmann", "shadowing": "smith_separable", "smith": "walter", "alpha": (0.4, 0.15)},
        {"distribution": "blinn", "alpha": (0.3, 0.6), "part": "reflection"},
        {"part": "transmission"},
    )

    def __post_init__(self) -> None:
        one_index("RoughDielectric.eta", self.eta)
        super().__post_init__()
        microfacets.check_choices(self)
        arguments.one_of(self.mode, "RoughDielectric.mode", MODES)
        arguments.one_of(self.part, "RoughDielectric.part", PARTS)

    def check_shapes(self) -> None:
        """As every model; and one or two numbers of roughness."""
        super().check_shapes()
        need_axes(self.alpha, "RoughDielectric.alpha")

    @property
    def lobes(self) -> tuple[Lobe, ...]:  # type: ignore[override]
        return PARTS[self.part]

    def select(self, wanted: Lobe) -> Bsdf | None:
        kept = tuple(lobe for lobe in self.lobes if lobe.serves(wanted))
        if kept == self.lobes:
            return self
        return self.replace(part=next(name for name, lobes in PARTS.items() if lobes == kept)) if kept else None

    def domain(self, g: Geometry) -> Tensor:
        """The lobes' sides of the surface, above and below it."""
        return g.same_side | g.across if self.part == "both" else g.across if self.part == "transmission" else g.same_side

    def formula(self, g: Geometry) -> Channels:
        return (self._sum(lambda: self._reflected(g), lambda: self._refracted(g)),)

    def density(self, g: Geometry) -> Tensor:
        """That of the normals that the viewer sees, by the Jacobians of reflection and refraction, with F and 1 - F of each."""
        by = microfacets.normals(self).drawn_as()
        length = microfacets.length_o(self, by.smith_length, g.viewer)
        seen = 0.5 * numerics.reciprocal_or_zero(g.cos_o.abs() + length, numerics.negligible(length.dtype))
        return seen * self._sum(lambda: self._drawn_back(g, by), lambda: self._drawn_through(g, by))

    def draw(self, viewer: Viewer, u: Vec) -> Draw:
        """A normal that the viewer sees, and the mirror direction about it or the refracted one; lost where that is on the wrong side."""
        w = Vec(viewer.wo.x, viewer.wo.y, viewer.wo.z * viewer.side)
        m = microfacets.normals(self).visible_normal(w, microfacets.rough(self, viewer), u)
        cos, eta = numerics.unit_interval(vector.dot(w, m)), self._eta_of(viewer)
        at = split(cos, eta)
        mirror, through = vector.reflect_components(w, m), scale(bent(w, m, at.g - cos, at, eta), -1.0)
        passes = (u.z >= at.reflected) if self.part == "both" else torch.full_like(at.reflected, self.part == "transmission").bool()
        kept = torch.where(passes, through.z < 0, mirror.z > 0).to(cos.dtype)
        wi = Vec(*(torch.where(passes, t, r) * kept for t, r in zip(through, mirror, strict=True)))
        lobe = passes.to(torch.int64) if self.part == "both" else 0
        return Draw(Vec(wi.x, wi.y, wi.z * viewer.side), lobe, torch.where(passes, eta, 1.0))

    def albedo_at(self, viewer: Viewer, order: int) -> Channels:
        """By quadrature, of power: each lobe by its own sampler; V-cavities have ridges, which need more nodes."""
        nodes = order + order // 2 if self.shadowing == "v_cavity" else order
        parts = ("reflection", "transmission") if self.part == "both" else (self.part,)
        found = [Bsdf.albedo_at(self.replace(mode="flux", part=part), viewer, nodes) for part in parts]
        return found[0] if len(found) == 1 else each(torch.add, *found)

    def strength(self, viewer: Viewer) -> Tensor:
        """1; of one lobe its share at the viewer's angle."""
        at = split(viewer.cos_o.abs(), self._eta_of(viewer))
        return {"both": torch.ones_like(at.reflected), "reflection": at.reflected, "transmission": at.transmitted}[self.part]

    @property
    def energy_bound(self) -> Tensor | None:
        """1; none for Blinn's distribution with Smith's shadowing, which is that of another distribution."""
        return None if microfacets.smith_only(self) else super().energy_bound

    def kink_distance(self, g: Geometry) -> Tensor:
        """Beside the horizon: facets seen edge-on, the critical angle, and the ridges of V-cavities."""
        at, eta = self._facet(g), self._eta_of(g.viewer)
        critical = (g.wi_h * g.wi_h - (1.0 - eta) * (1.0 + eta)).abs()
        edges = [torch.where(g.across, torch.minimum(at.thin.abs(), at.cos_n.abs()), critical)]
        if self.shadowing == "v_cavity":
            edges.append(v_cavity_kink(g, at))
        return nearest(super().kink_distance(g), *edges)

    def exchange(self, g: Geometry) -> Tensor:
        """(n_o/n_i)^2 across the surface, of flux its inverse."""
        eta = self._eta_of(g.viewer)
        return torch.where(g.across, eta * eta if self.mode == "flux" else 1.0 / (eta * eta), 1.0)

    @staticmethod
    def textbook(m: Any, p: Any, alpha: Any, eta: Any, distribution: str, shadowing: str, smith: str, mode: str, part: str) -> Any:
        if isinstance(alpha, tuple) or smith == "walter" or part != "both":
            return NotImplemented
        d, lam = DISTRIBUTIONS[distribution].textbook
        n_i, n_o = (m.where(m.positive(-1 * c), eta, 1) for c in (p.cos_i, p.cos_o))
        ahead = m.where(m.positive(-1 * p.cos_o), 1 / eta, eta)
        t, same = p.facet_across(n_i, n_o), p.same_side
        ci, co, cos_h = (m.where(m.positive(c), c, -1 * c) for c in (p.cos_i, p.cos_o, p.cos_h))
        ci, co = (m.where(same | t.there, c, 1) for c in (ci, co))

        def lobe(law: Any, cos2_h: Any, *seen: Any) -> Any:
            g = law[shadowing](m, Seen(ci, co, *seen), lambda c: lam(m, c, alpha))
            return d(m, m.where(same | t.there, cos2_h, 1), alpha) * g / (4 * ci * co)

        f, f_across = (Dielectric.textbook(m, c, ahead) for c in (p.wi_h, t.wo_h))
        back = f * lobe(TEXTBOOK, p.cos2_h, cos_h, p.wi_h, p.wi_h)
        n = n_i if mode == "flux" else n_o
        jacobian = 4 * t.wi_h * t.wo_h * n * n / m.where(t.there, t.length2, 1)
        through = (1 - f_across) * jacobian * lobe(TEXTBOOK_ACROSS, t.cos2_h, t.cos_h, t.wi_h, t.wo_h)
        return m.where(same, back, m.where(t.there, through, 0))

    # One side of the surface, and across it ------------------------------------------------------------------------------

    def _sum(self, reflected: Callable[[], Tensor], refracted: Callable[[], Tensor]) -> Tensor:
        """Of the lobes at hand; each is 0 on the other's side."""
        return refracted() if self.part == "transmission" else reflected() if self.part == "reflection" else reflected() + refracted()

    def _reflected(self, g: Geometry) -> Tensor:
        lengths = self._lengths(g)
        return self._mirrored(g, microfacets.normals(self)) * self._reflectance(g) * SHADOWING[self.shadowing](g, *lengths)

    def _refracted(self, g: Geometry) -> Tensor:
        """n_o^2 of radiance, n_i^2 of flux; 4, because shadowing is over 4 cos_i cos_o."""
        at = self._facet(g)
        n = at.n_i if self.mode == "flux" else at.n_o
        lobe = 4.0 * self._bent(g, at, microfacets.normals(self)) * at.transmitted * (n * n)
        return lobe * ACROSS[self.shadowing](g, at, *self._lengths(g))

    def _mirrored(self, g: Geometry, by: type[Distribution]) -> Tensor:
        """D of the half vector, on one side."""
        facet = microfacets.facet(self, g, g.half, lambda: add(g.wi_local, g.viewer.local.wo), g.half2)
        return self._masked(g, by, facet, g.same_side.to(g.half2.dtype))

    def _bent(self, g: Geometry, at: Refraction, by: type[Distribution]) -> Tensor:
        """D of the facet that refracts, times its Jacobian, across."""
        facet = microfacets.facet(self, g, at.half, lambda: at.local(g), at.length2)
        return self._masked(g, by, facet, at.there) * at.jacobian

    def _masked(self, g: Geometry, by: type[Distribution], facet: Facet, there: Tensor) -> Tensor:
        """D; a facet that is not there is none, for it may be so short that slopes of D overflow."""
        return by.density(Facet(*(x * there for x in facet)), microfacets.rough(self, g.viewer)) * there

    def _drawn_back(self, g: Geometry, by: type[Distribution]) -> Tensor:
        d = self._mirrored(g, by)
        return d * self._reflectance(g) if self.part == "both" else d

    def _drawn_through(self, g: Geometry, by: type[Distribution]) -> Tensor:
        at = self._facet(g)
        d = 4.0 * self._bent(g, at, by) * (at.n_i * at.n_i)
        return d * at.transmitted if self.part == "both" else d

    def _facet(self, g: Geometry) -> Refraction:
        return Refraction.of(g, g.scalar(self.eta))

    def _reflectance(self, g: Geometry) -> Tensor:
        return dielectric(g.wi_h, self._eta_of(g.viewer))

    def _lengths(self, g: Geometry) -> tuple[Callable[[], Tensor], Callable[[], Tensor]]:
        by = microfacets.smith_length(self)
        return lambda: microfacets.length_i(self, by, g), lambda: microfacets.length_o(self, by, g.viewer)

    def _eta_of(self, viewer: Viewer) -> Tensor:
        """n(other side) / n(side of the viewer)."""
        eta = viewer.scalar(self.eta)
        return torch.where(viewer.side < 0, 1.0 / eta, eta)
