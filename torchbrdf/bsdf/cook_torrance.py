r"""Cook and Torrance's model as published in 1982: a diffuse part, and mirror facets in V-shaped grooves.

.. math::
    f = s \, \frac{F(\omega_i \cdot h)}{\pi} \, \frac{D(h)\, G(\omega_i, \omega_o)}{\cos\theta_i \cos\theta_o}
    + (1 - s) \, \frac{\rho}{\pi}, \qquad D = \sum_j w_j \frac{e^{-\tan^2\theta_h / m_j^2}}{m_j^2 \cos^4\theta_h}

=============  ====================  ==========================================================================
parameter      unit, range           meaning
=============  ====================  ==========================================================================
diffuse        [..., C] in [0, 1]    :math:`\rho`, the albedo of the diffuse part
specular       [..., 1] in [0, 1]    s, the share of the facets; that of the diffuse part is d = 1 - s
alpha          [..., K], (0, 1]      rms slopes m of the facets (the alpha of Beckmann's distribution), one or several
fresnel        a Fresnel term, None  F; None is 1
weights        [..., K] > 0, None    w of each slope, of which the sum is taken out; None: equal
normalization  a name                the constant in front, below
=============  ====================  ==========================================================================

=============  ===================================  =============================================================
normalization  constant, with this D                directional albedo of the facets
=============  ===================================  =============================================================
``"1982"``     1 / :math:`\pi`, as printed          four times that of ``"modern"``: up to 4, no bound promised
``"modern"``   1 / :math:`4\pi`                     at most 1: ``tb.RoughConductor`` with Beckmann and V-cavities
=============  ===================================  =============================================================

The printed D is not that of today: :math:`\int D \cos\theta\, d\omega = \pi`, not 1, because it lacks Beckmann's :math:`1/\pi`. And the
4 in the denominator, from :math:`d\omega_h = d\omega_i / (4\, \omega_i \cdot h)`, is printed as :math:`\pi`. Put together f is four times
too large (it is :math:`4/\pi` of the modern one where a D that integrates to 1 is put in), so that light is made wherever s F > 1/4.
Metals of 1982 were rendered so; to measure, take ``"modern"``.

G = min(1, 2 n.h n.wi / wo.h, 2 n.h n.wo / wo.h). Not smooth at the horizon, at the ridges of G, and where F is not. Source: Cook &
Torrance 1982, *A reflectance model for computer graphics*, ACM TOG 1(1).

>>> import torch, torchbrdf as tb
>>> up, copper = torch.tensor([0.0, 0.0, 1.0]), tb.Conductor.named("Cu")
>>> printed, modern = (tb.CookTorrance(0.3, 0.5, 0.2, copper, normalization=n) for n in ("1982", "modern"))
>>> [[round(x, 3) for x in m.directional_albedo(up).tolist()] for m in (printed, modern)]
[[2.02, 1.397, 1.226], [0.618, 0.462, 0.419]]
"""

from typing import Any

import torch
from torch import Tensor

from .. import arguments, numerics, parameters
from ..geometry import Channels, Geometry, Viewer
from ..interval import UNIT, Interval
from ..optics.distribution import ALPHA
from ..optics.fresnel import Fresnel
from ..value import COLOUR, SCALAR, param, value
from ..vector import Vec
from .base import Bsdf
from .combine import Scaled, Sum
from .lambert import Lambert
from .lobe import Draw, Lobe
from .rough_conductor import RoughConductor
from .shadowing import TEXTBOOK

NORMALIZATIONS = {"1982": 4.0, "modern": 1.0}  # over the modern one


@value
class CookTorrance(Bsdf):
    """``specular`` parts of Beckmann facets in V-cavities, and ``1 - specular`` parts of Lambert's surface."""

    diffuse: Tensor = param(UNIT, COLOUR, "albedo of the diffuse part")
    specular: Tensor = param(UNIT, SCALAR, "share s of the facets; that of the diffuse part is 1 - s")
    alpha: Tensor = param(ALPHA, ("K",), "rms slope m of the facets, one or several")
    fresnel: Fresnel | None = None
    weights: Tensor | None = param(
        Interval(0.0, open_low=True, typical=(0.1, 1.0)), ("K",), "weight of each slope, up to a factor", default=None
    )
    normalization: str = "1982"

    lobes = (Lobe.GLOSSY_REFLECTION, Lobe.DIFFUSE_REFLECTION)
    variants = ({"normalization": "1982"}, {"normalization": "modern"})

    def __post_init__(self) -> None:
        super().__post_init__()
        arguments.one_of(self.normalization, "CookTorrance.normalization", NORMALIZATIONS)

    def formula(self, g: Geometry) -> Channels:
        return self._parts(g.viewer).formula(g)

    @staticmethod
    def textbook(m: Any, p: Any, diffuse: Any, specular: Any, alpha: Any, fresnel: Any, weights: Any, normalization: str) -> Any:
        slopes = alpha if isinstance(alpha, tuple) else (alpha,)
        shares = weights if isinstance(weights, tuple) else (1,) * len(slopes)  # of one slope, and equal ones
        c2 = m.where(p.above, p.cos2_h, 1)
        d = sum(w * m.exp(-1 * (1 - c2) / (c2 * (a * a))) / (a * a * (c2 * c2)) for w, a in zip(shares, slopes, strict=True)) / sum(shares)
        ci, co = m.where(p.above, p.cos_i, 1), m.where(p.above, p.cos_o, 1)
        r_s = fresnel(p.wi_h) / m.pi * d * TEXTBOOK["v_cavity"](m, p, None) / (ci * co) * (NORMALIZATIONS[normalization] / 4)
        return specular * r_s + (1 - specular) * diffuse / m.pi

    def density(self, g: Geometry) -> Tensor:
        return self._parts(g.viewer).density(g)

    def draw(self, viewer: Viewer, u: Vec) -> Draw:
        """From one of the parts, chosen by what each reflects."""
        drawn = self._parts(viewer).draw(viewer, u)
        last = self.alpha.shape[-1]  # the diffuse part; the slopes before it are one lobe
        return drawn._replace(lobe=(torch.as_tensor(drawn.lobe) == last).to(torch.int64))

    def albedo_at(self, viewer: Viewer, order: int) -> Channels:
        """The sum of the parts' albedos."""
        return self._parts(viewer).albedo_at(viewer, order)

    def strength(self, viewer: Viewer) -> Tensor:
        return self._parts(viewer).strength(viewer)

    def select(self, wanted: Lobe) -> Bsdf | None:
        kept = [lobe.serves(wanted) for lobe in self.lobes]
        return self if all(kept) else self._sum(self).select(wanted) if any(kept) else None

    def kink_distance(self, g: Geometry) -> Tensor:
        return self._parts(g.viewer).kink_distance(g)

    @property
    def energy_bound(self) -> Tensor | None:
        """Of the modern constant ``s + (1 - s) diffuse``."""
        if self.normalization == "1982":
            return None
        s, diffuse = parameters.alike(self.specular, self.diffuse)
        return s + (1.0 - s) * diffuse

    def _parts(self, viewer: Viewer) -> Sum:
        """The models that this one is the sum of, once for a viewer."""
        made: Sum = viewer.once(self, lambda: self._sum(self.map(numerics.widen)))  # a half type rounds once, at the end
        return made

    @staticmethod
    def _sum(of: "CookTorrance") -> Sum:
        weights = torch.ones_like(of.alpha) if of.weights is None else of.weights
        s, w = parameters.alike(of.specular, weights / weights.sum(-1, keepdim=True))
        shares, slopes = (NORMALIZATIONS[of.normalization] * s * w).split(1, -1), of.alpha.split(1, -1)
        facets = [Scaled(RoughConductor(a, of.fresnel, "beckmann", "v_cavity"), k) for a, k in zip(slopes, shares, strict=True)]
        return Sum((*facets, Scaled(Lambert(of.diffuse), 1.0 - s)))
