r"""Blinn's distribution of normals, a power of the cosine; anisotropic as that of Ashikhmin and Shirley.

.. math:: D = \frac{1}{\pi\alpha_x\alpha_y}\, z^{\,(s_x x^2 + s_y y^2)/(x^2 + y^2)}, \qquad s = 2/\alpha^2 - 2

=========  =====================  ====================================================
parameter  unit, range            meaning
=========  =====================  ====================================================
alpha      [..., 1 or 2], (0, 1]  roughness, a slope; 1 is the exponent 0
=========  =====================  ====================================================

``tb.alpha_from_exponent`` converts. Its Lambda has no closed form; as Walter et al. 2007 do, that of Beckmann's distribution of the same
alpha stands in for it, which suits small alpha alone (Torrance-Sparrow's V-cavities need none). Normals are drawn as those of GGX.
Sources: Blinn 1977; Ashikhmin & Shirley 2000, eq. 4; Walter et al. 2007, eq. 30.

>>> import torch, torchbrdf as tb
>>> up = torch.tensor([0.0, 0.0, 1.0])
>>> round(float(tb.Blinn(0.5).d(up)) * torch.pi, 6), round(float(tb.exponent_from_alpha(torch.tensor(0.5))), 6)
(4.0, 6.0)
"""

import math
from typing import Any

import torch
from torch import Tensor

from .. import numerics
from ..value import param, value
from ..vector import Vec
from . import beckmann
from .distribution import ALPHA, AXES, Distribution, Facet, Rough
from .ggx import GGX


def textbook_d(m: Any, cos2: Any, alpha: Any) -> Any:
    """Walter et al. 2007, eq. 30, of the squared cosine of the half vector."""
    return m.power(cos2, 1 / (alpha * alpha) - 1) / (m.pi * (alpha * alpha))


@value
class Blinn(Distribution):
    """Blinn's distribution of normals, ``(s + 2) / (2 pi) (n.h)^s``; of two exponents where ``alpha`` is two numbers."""

    alpha: Tensor = param(ALPHA, AXES, "roughness, a slope")

    textbook = (textbook_d, beckmann.textbook_lambda)

    @staticmethod
    def density(facet: Facet, rough: Rough) -> Tensor:
        # The exponent times log z is (stretched^2 - flat^2) log(1 - s) / s, with s = flat^2 the squared sine.
        per_length = numerics.reciprocal_or_zero(facet.length2)
        sin2, cos2 = facet.flat2 * per_length, facet.z * facet.z * per_length
        power = (facet.stretched2 - facet.flat2) * per_length * _log_cos2_by_sin2(sin2, cos2)
        return numerics.flushed_exp(power) / (math.pi * rough.area)

    @staticmethod
    def smith_length(cos: Tensor, projected2: Tensor) -> Tensor:
        return beckmann.Beckmann.smith_length(cos, projected2)

    @staticmethod
    def visible_normal(w: Vec, rough: Rough, u: Vec) -> Vec:
        return GGX.visible_normal(w, rough, u)

    @classmethod
    def drawn_as(cls) -> type[Distribution]:
        """GGX of the same alpha, of which it is at most 1.5 times, and whose tail is longer."""
        return GGX


def _log_cos2_by_sin2(sin2: Tensor, cos2: Tensor) -> Tensor:
    """``log(1 - s) / s`` of the squared sine s, -1 at the pole; near the horizon by the cosine."""
    far = numerics.step(0.25 - cos2)
    off = numerics.step(sin2)
    near = torch.log1p(-sin2.clamp_max(0.875))
    log = near * (1.0 - far) + torch.log(cos2.clamp_min(numerics.tiny(cos2.dtype))) * far
    return log / (sin2 + (1.0 - off)) - (1.0 - off)
