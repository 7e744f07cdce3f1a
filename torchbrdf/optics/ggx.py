r"""GGX, the distribution of normals of an ellipsoid.

.. math:: D = \frac{1}{\pi\alpha_x\alpha_y\,(x^2/\alpha_x^2 + y^2/\alpha_y^2 + z^2)^2}, \qquad
   \Lambda = \tfrac12\Big(\sqrt{1 + (\alpha_x^2 x^2 + \alpha_y^2 y^2)/z^2} - 1\Big)

=========  =====================  ====================================================
parameter  unit, range            meaning
=========  =====================  ====================================================
alpha      [..., 1 or 2], (0, 1]  roughness, a slope; along tangent and bitangent
=========  =====================  ====================================================

Sources: Trowbridge & Reitz 1975; Walter et al. 2007; Heitz 2014 for Lambda. Visible normals by spherical caps: Dupuy & Benyoub 2023.

>>> import torch, torchbrdf as tb
>>> up = torch.tensor([0.0, 0.0, 1.0])
>>> round(float(tb.GGX(0.5).d(up)) * torch.pi, 6), float(tb.GGX(0.5).g1(up))
(4.0, 1.0)
"""

import math
from typing import Any

import torch
from torch import Tensor

from .. import numerics, vector
from ..value import param, value
from ..vector import Vec
from .distribution import ALPHA, AXES, Distribution, Facet, Rough, local_direction


def textbook_d(m: Any, cos2: Any, alpha: Any) -> Any:
    """Walter et al. 2007, eq. 33, of the squared cosine of the half vector."""
    q = cos2 * (alpha * alpha) + (1 - cos2)
    return alpha * alpha / (m.pi * (q * q))


def textbook_lambda(m: Any, cos: Any, alpha: Any) -> Any:
    """Heitz 2014, eq. 72."""
    return (m.sqrt(1 + alpha * alpha * (1 - cos * cos) / (cos * cos)) - 1) / 2


@value
class GGX(Distribution):
    """The GGX (Trowbridge-Reitz) distribution of normals."""

    alpha: Tensor = param(ALPHA, AXES, "roughness, a slope")

    textbook = (textbook_d, textbook_lambda)

    @staticmethod
    def density(facet: Facet, rough: Rough) -> Tensor:
        ratio = facet.length2 * numerics.reciprocal_or_zero(facet.stretched2 + facet.z * facet.z)
        return ratio * ratio / (math.pi * rough.area)

    @staticmethod
    def smith_length(cos: Tensor, projected2: Tensor) -> Tensor:
        return numerics.safe_sqrt(cos * cos + projected2)

    @staticmethod
    def visible_normal(w: Vec, rough: Rough, u: Vec) -> Vec:
        """A point of the cap of the unit sphere that w sees, plus w: the half vector of a mirror sphere, unstretched."""
        seen = local_direction(w, rough)  # the stretched viewer
        z = (1.0 - u.y) * (1.0 + seen.z) - seen.z
        sin, phi = numerics.safe_sqrt((1.0 - z) * (1.0 + z)), 2.0 * math.pi * u.x
        cap = Vec(sin * torch.cos(phi), sin * torch.sin(phi), z)
        return local_direction(vector.add(cap, seen), rough)
