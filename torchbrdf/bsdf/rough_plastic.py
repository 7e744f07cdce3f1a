r"""A rough clear coat over a diffuse base: plastic, satin varnish.

.. math::
    f = \frac{F(\omega_i \cdot h)\; D(h)\; G(\omega_i, \omega_o)}{4\,|\cos\theta_i|\,|\cos\theta_o|} +
    \frac{\rho}{\pi}\,\frac{T(\theta_i)\,T(\theta_o)}{\eta^2\,(1 - \rho F_{di})}, \qquad T(\theta) = 1 - E(\theta, \alpha, \eta)

=============  =======================  ==================================================================================
parameter      unit, range              meaning
=============  =======================  ==================================================================================
albedo         [..., C] in [0, 1]       :math:`\rho`, of the base
alpha          [..., 1] in (0, 1]       roughness of the coat, a slope
eta            [..., 1] in [1.125, 3]   n(coat) / n(outside)
distribution   a name                   D: ``"ggx"``, ``"beckmann"``, ``"blinn"``
shadowing      a name                   G: ``"smith_correlated"``, ``"smith_separable"``, ``"v_cavity"``
coupling       a name                   F_di: ``"conserving"``, or ``"mitsuba"``
nonlinear      True, False              of "mitsuba": whether :math:`\rho` stands before F_di, or 1
gloss          True, False              whether the coat's own reflection is part of the model
=============  =======================  ==================================================================================

The coat reflects as :class:`RoughConductor` with the exact F of ``tb.Dielectric``, once: E is the directional albedo of that lobe
(:mod:`~torchbrdf.bsdf.boundary_albedo`, a fit; the smoother the coat, the nearer to F). The base gets
T, the rest, with what meets a second facet; scatters :math:`\rho` of it evenly; and of diffuse light from below F_di comes back to it,
again and again, so that :math:`\rho\,(1 - F_{di})/(1 - \rho F_{di})` of it leaves.

``"conserving"``: the share that leaves, 1 - F_di, and its spread over the angles follow from reciprocity. Light in leaves along
theta in proportion to T(theta) cos(theta), as it is taken from there; from below the same boundary lets through :math:`1/\eta^2` of what
it lets in from above (radiance grows by :math:`\eta^2`, solid angle falls by it), hence with :math:`\bar T = 2\int T(\mu)\,\mu\,d\mu`

.. math:: 1 - F_{di} = \bar T / \eta^2, \qquad
   \text{albedo} = E + T\, \frac{\rho\,\bar T/\eta^2}{1 - \rho\,(1 - \bar T/\eta^2)}

which is 1 for :math:`\rho = 1` at every angle: within 1e-3 for alpha in [0.02, 1], 4e-3 below (Kelemen & Szirmay-Kalos 2001 with the
base below a boundary as of Saunderson 1942; with alpha towards 0 it is ``Coated`` over ``Lambert``).

``"mitsuba"``: T and F_di as the plugin ``roughplastic`` of Mitsuba 3 has them: what refraction at one facet lets in, and what reflection
at one facet throws back from below (its mean over 64 angles), for ``"smith_separable"`` shadowing of GGX and Beckmann alone. A white base
then loses what facets lose (GGX, eta = 1.5: 4 to 12 % at alpha 0.05, 30 to 40 % at 0.3). The two are fits, at the fitted points within
4e-3 and 2e-3 (Beckmann 7e-3 and 2e-3); its Beckmann has Walter's Lambda, ours the exact one; its T is interpolated between 64 cosines.

Reciprocal. One index for all channels. Not smooth at the horizon, for wi = -wo, and at the ridges of V-cavities.

>>> import torch, torchbrdf as tb
>>> w = torch.tensor([0.6, 0.0, 0.8])
>>> [round(x, 2) for x in tb.RoughPlastic([1.0, 0.5, 0.0], 0.3, 1.5).directional_albedo(w).tolist()]
[1.0, 0.32, 0.04]
"""

import math
from typing import Any, NamedTuple

import torch
from torch import Tensor

from .. import arguments, numerics, sampling
from ..geometry import Channels, Geometry, Viewer, each
from ..interval import UNIT
from ..optics.distribution import ALPHA
from ..optics.fresnel import Dielectric
from ..value import COLOUR, SCALAR, param, value
from ..vector import Vec
from . import microfacets
from .base import Bsdf, nearest
from .boundary_albedo import BOUNDARY_FITS, COAT, Boundary, inside_reflectance, textbook
from .combine import either
from .lambert import Lambert
from .lobe import Draw, Lobe
from .rough_conductor import RoughConductor
from .sampler import normalised
from .shadowing import SHADOWING
from .smooth_dielectric import one_index


class Below(NamedTuple):
    """What the coat and the base do for one viewer."""

    boundary: Boundary
    let_in: Tensor  # T along wo
    mean: Tensor  # T under diffuse light
    body: Channels  # rho / (eta^2 (1 - rho F_di))


@value
class RoughPlastic(Bsdf):
    """A rough coat of index ``eta`` over a diffuse base of albedo ``albedo``."""

    albedo: Tensor = param(UNIT, COLOUR, "albedo of the base")
    alpha: Tensor = param(ALPHA, SCALAR, "roughness of the coat, a slope")
    eta: Tensor = param(COAT, SCALAR, "index of refraction, coat over outside")
    distribution: str = "ggx"
    shadowing: str = "smith_correlated"
    coupling: str = "conserving"
    nonlinear: bool = True
    gloss: bool = True

    variants = (
        {"distribution": "ggx"},
        {"distribution": "beckmann", "shadowing": "smith_separable", "coupling": "mitsuba"},
        {"distribution": "blinn", "shadowing": "v_cavity", "gloss": False},
    )

    def __post_init__(self) -> None:
        one_index("RoughPlastic.eta", self.eta)
        super().__post_init__()
        arguments.one_of(self.distribution, "RoughPlastic.distribution", microfacets.DISTRIBUTIONS)
        arguments.one_of(self.shadowing, "RoughPlastic.shadowing", SHADOWING)
        arguments.one_of(self.coupling, "RoughPlastic.coupling", ("conserving", "mitsuba"))
        if (self.distribution, self.shadowing) not in BOUNDARY_FITS:
            raise ValueError(f"RoughPlastic.shadowing: found {self.shadowing!r} beside {self.distribution!r}, legal there is 'v_cavity'")
        if self.coupling == "mitsuba" and self.shadowing != "smith_separable":
            raise ValueError(f"RoughPlastic.coupling: found 'mitsuba' beside {self.shadowing!r}; it goes with shadowing='smith_separable'")
        for name in ("nonlinear", "gloss"):
            if not isinstance(getattr(self, name), bool):
                raise TypeError(f"RoughPlastic.{name}: found {getattr(self, name)!r}, legal are True and False")

    @property
    def lobes(self) -> tuple[Lobe, ...]:  # type: ignore[override]
        return (Lobe.GLOSSY_REFLECTION,) * self.gloss + (Lobe.DIFFUSE_REFLECTION,)

    @property
    def energy_bound(self) -> Tensor | None:
        """1; none for Mitsuba's coupling."""
        return None if self.coupling == "mitsuba" else super().energy_bound

    def select(self, wanted: Lobe) -> Bsdf | None:
        glossy, diffuse = self.gloss and Lobe.GLOSSY_REFLECTION.serves(wanted), Lobe.DIFFUSE_REFLECTION.serves(wanted)
        if diffuse:
            return self if glossy == self.gloss else self.replace(gloss=glossy)
        return self._made() if glossy else None

    def formula(self, g: Geometry) -> Channels:
        below = self._below(g.viewer)
        through = self._let_in(below.boundary, g.cos_i.abs()) * below.let_in * (1.0 / math.pi)
        base = tuple(b * through for b in below.body)
        return each(torch.add, base, self._coat(g.viewer).formula(g)) if self.gloss else base

    def density(self, g: Geometry) -> Tensor:
        diffuse = numerics.positive(g.cos_i) * (1.0 / math.pi)
        if not self.gloss:
            return diffuse
        first, rest = self._shares(g.viewer)
        return first * self._coat(g.viewer).density(g) + rest * diffuse

    def draw(self, viewer: Viewer, u: Vec) -> Draw:
        """As the coat, or evenly as the base, chosen by u.z."""
        base = Lambert(self.albedo)
        if not self.gloss:
            return base.draw(viewer, u)
        (first, _), rest = sampling.choose(u.z, self._shares(viewer))
        numbers = Vec(u.x, u.y, rest)
        return either(first, self._coat(viewer).draw(viewer, numbers)._replace(lobe=0), base.draw(viewer, numbers)._replace(lobe=1))

    def albedo_at(self, viewer: Viewer, order: int) -> Channels:
        """By quadrature over the normals of the coat; that of the base in closed form."""
        base = self._diffuse_albedo(viewer)
        above = (viewer.cos_o > 0).to(viewer.cos_o.dtype)
        base = tuple(b * above for b in base)
        return each(torch.add, base, self._coat(viewer).albedo_at(viewer, order)) if self.gloss else base

    def strength(self, viewer: Viewer) -> Tensor:
        return sum(self._strengths(viewer), torch.zeros_like(viewer.cos_o))

    def kink_distance(self, g: Geometry) -> Tensor:
        return nearest(super().kink_distance(g), self._coat(g.viewer).kink_distance(g)) if self.gloss else super().kink_distance(g)

    @staticmethod
    def textbook(m: Any, p: Any, albedo: Any, alpha: Any, eta: Any, **names: Any) -> Any:
        if names["coupling"] == "mitsuba" or not names["gloss"]:
            return NotImplemented
        by = {"distribution": names["distribution"], "shadowing": names["shadowing"]}
        reflected, mean = textbook(m, alpha, eta, **by)
        t_i, t_o = (1 - reflected(m.where(p.above, c, 1)) for c in (p.cos_i, p.cos_o))
        body = albedo * t_i * t_o / (m.pi * eta * eta * (1 - albedo * (1 - mean / (eta * eta))))
        return body + RoughConductor.textbook(
            m, p, alpha, lambda cos: Dielectric.textbook(m, cos, eta), smith="exact", energy="single", **by
        )

    # Once for a viewer ---------------------------------------------------------------------------------------------------

    def _made(self) -> RoughConductor:
        return RoughConductor(self.alpha, Dielectric(self.eta), self.distribution, self.shadowing)

    def _coat(self, viewer: Viewer) -> RoughConductor:
        """The coat's own reflection."""
        made: RoughConductor = viewer.once(self, lambda: self._wide(viewer)._made(), "coat")
        return made

    def _wide(self, viewer: Viewer) -> "RoughPlastic":
        """Slopes of half types, of which coat and base each have a large part, are added up in float32."""
        made: RoughPlastic = viewer.once(self, lambda: self.map(numerics.widen), "widened")
        return made

    def _below(self, viewer: Viewer) -> Below:
        made: Below = viewer.once(self, lambda: self._computed(viewer), "below")
        return made

    def _computed(self, viewer: Viewer) -> Below:
        eta = viewer.scalar(self._wide(viewer).eta)
        conserving, rough = self.coupling == "conserving", self._coat(viewer)._rough(viewer)
        boundary = Boundary.of(self.distribution, self.shadowing, rough, eta, through=not conserving)
        let_in = self._let_in(boundary, viewer.cos_o.abs())
        mean, inverse = boundary.mean_let_in(through=not conserving), 1.0 / (eta * eta)
        leaves = mean * inverse if conserving else 1.0 - inside_reflectance(self.distribution, boundary.alpha, eta)
        rho = viewer.colour(self.albedo)
        # 1 - rho F_di without the difference of what may be equal
        if conserving or self.nonlinear:
            body = tuple(r * inverse / ((1.0 - r) + r * leaves) for r in rho)
        else:
            body = tuple(r * inverse / leaves for r in rho)
        return Below(boundary, let_in, mean, body)

    def _let_in(self, boundary: Boundary, cos: Tensor) -> Tensor:
        """T at a cosine."""
        return boundary.let_through(cos) if self.coupling == "mitsuba" else 1.0 - boundary.at(cos)

    def _diffuse_albedo(self, viewer: Viewer) -> Channels:
        below = self._below(viewer)
        return tuple(b * below.let_in * below.mean for b in below.body)

    def _strengths(self, viewer: Viewer) -> list[Tensor]:
        """About what each lobe reflects."""
        diffuse = viewer.layout.mean(self._diffuse_albedo(viewer))
        return [numerics.positive(1.0 - self._below(viewer).let_in), diffuse] if self.gloss else [diffuse]

    def _shares(self, viewer: Viewer) -> list[Tensor]:
        """How often each lobe is sampled."""
        made: list[Tensor] = viewer.once(self, lambda: normalised(self._strengths(viewer)), "shares of lobes")
        return made
