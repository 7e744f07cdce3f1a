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
=============  =======================  ==================================================================================

Single scattering: light that meets a second facet is lost, up to half of it at alpha = 1, so that the directional albedo falls with
alpha. Not smooth at the horizon, where f jumps (before, it grows as 1 / cos, its slopes as the square of that), nor at the ridge of
V-cavities. Roughness along two axes needs a tangent; without one the frame is that of ``tb.Frame.from_normal``, which jumps.
Perceptual roughness, as of glTF, is the square root of alpha: ``tb.alpha_from_roughness``. Smith's shadowing of Blinn's distribution
is that of Beckmann's, which suits it up to alpha = 0.2; beyond, energy is made at grazing (albedo 1.11 at alpha = 0.5, 1.75 at 1),
so take ``"v_cavity"``, whose albedo is at most 1.
The directional albedo is that of the law to 1e-5, but for V-cavities and a critical angle in F, whose kinks cost up to 1e-4 and 1e-2.
Sources: Torrance & Sparrow 1967; Walter et al. 2007, eq. 20; visible normals Heitz 2018.

>>> import torch, torchbrdf as tb
>>> gold = tb.RoughConductor(0.2, tb.Conductor.named("Au"))
>>> [round(x, 2) for x in gold.directional_albedo(torch.tensor([[0.6, 0.0, 0.8]]))[0].tolist()]
[0.89, 0.74, 0.38]
"""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from .. import arguments, numerics, vector
from ..geometry import Channels, Geometry, Viewer
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
from .phong import fresnel_kink
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

    lobes = (Lobe.GLOSSY_REFLECTION,)
    variants = (
        {"distribution": "ggx", "shadowing": "smith_correlated"},
        {"distribution": "ggx", "shadowing": "v_cavity"},
        {"distribution": "beckmann", "shadowing": "smith_correlated"},
        {"distribution": "blinn", "shadowing": "v_cavity"},
        {"distribution": "ggx", "shadowing": "smith_separable", "alpha": (0.4, 0.15)},
        {"distribution": "beckmann", "shadowing": "smith_separable", "smith": "walter", "alpha": (0.15, 0.4)},
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

    def check_shapes(self) -> None:
        """As every model; and one or two numbers of roughness."""
        super().check_shapes()
        need_axes(self.alpha, "RoughConductor.alpha")

    def formula(self, g: Geometry) -> Channels:
        lobe = self.normals.density(self._facet(g), self._rough(g.viewer)) * self._shadowed(g)
        if self.fresnel is None:
            return (lobe,)
        return tuple(f * lobe for f in self.fresnel.terms(g.viewer.layout, g.wi_h))

    @staticmethod
    def textbook(m: Any, p: Any, alpha: Any, fresnel: Any, distribution: str, shadowing: str, smith: str) -> Any:
        if isinstance(alpha, tuple) or smith == "walter":
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
        return 0.5 * d * numerics.reciprocal_or_zero(g.cos_o + length, numerics.negligible(d.dtype))

    def draw(self, viewer: Viewer, u: Vec) -> Draw:
        """A normal that the viewer sees, and the mirror direction about it."""
        return Draw(vector.reflect_components(viewer.wo, self.normals.visible_normal(viewer.wo, self._rough(viewer), u)))

    def albedo_at(self, viewer: Viewer, order: int) -> Channels:
        """By quadrature over the normals; V-cavities have ridges, which need more nodes."""
        order = order + order // 2 if self.shadowing == "v_cavity" else order
        rough = self._rough(viewer.local)
        return facet_albedo(self, viewer.local, rough, lambda facet: self.normals.density(facet, rough), order)

    def strength(self, viewer: Viewer) -> Tensor:
        """F in the mirror direction."""
        if self.fresnel is None:
            return torch.ones_like(viewer.cos_o)
        return viewer.layout.mean(self.fresnel.terms(viewer.layout, numerics.unit_interval(viewer.cos_o)))

    def kink_distance(self, g: Geometry) -> Tensor:
        """Beside the horizon: what is not smooth about F, and the ridges of V-cavities."""
        found = nearest(super().kink_distance(g), fresnel_kink(self.fresnel, g))
        if self.shadowing != "v_cavity":
            return found
        larger, smaller = torch.maximum(g.cos_i, g.cos_o), torch.minimum(g.cos_i, g.cos_o)
        lit = 4.0 * (larger + smaller) * smaller - g.half2  # > 0 where nothing is hidden
        return nearest(found, torch.maximum(lit.abs(), torch.zeros_like(lit)), torch.where(lit < 0, larger - smaller, 1.0))

    @property
    def energy_bound(self) -> Tensor | None:
        """1; none for Blinn's distribution with Smith's shadowing, which is that of another distribution."""
        return None if self.distribution == "blinn" and self.shadowing != "v_cavity" else super().energy_bound

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
