r"""Microfacet theory: distributions of normals D, and Smith's Lambda, G1, G2 that follow from them; GGX and Beckmann.

With :math:`c = \cos\theta`, :math:`s = \sin\theta`, the roughness :math:`\alpha` as a slope (not its square root), and the
*projected roughness* of a direction :math:`a = \sqrt{(\alpha_x x)^2 + (\alpha_y y)^2}`, which is :math:`\alpha s` where isotropic:

======================  =====================================================================  ==========================
GGX D                   :math:`1/(\pi q^2),\ q = s_h^2/\alpha + \alpha c_h^2`                  Trowbridge & Reitz 1975;
                                                                                               Walter et al. 2007, eq. 33
GGX D, anisotropic      :math:`1/(\pi\alpha_x\alpha_y(x^2/\alpha_x^2+y^2/\alpha_y^2+z^2)^2)`   Burley 2012; Heitz 2014
Beckmann D              :math:`e^{-\tan^2\theta_h/\alpha^2}/(\pi\alpha^2c_h^4)`                Beckmann & Spizzichino 1963;
                                                                                               Cook & Torrance 1982
GGX Lambda              :math:`(r/c - 1)/2,\ r = \sqrt{c^2 + a^2}`                             Heitz 2014
Beckmann Lambda         :math:`(\mathrm{erf}\,\nu - 1)/2 + e^{-\nu^2}/(2\nu\sqrt\pi)`          Smith 1967; Heitz 2014
                        with :math:`\nu = c/a`
G1                      :math:`1/(1+\Lambda)`; of GGX :math:`2c/(c+r)`                         Smith 1967
G2, height-correlated   :math:`1/(1+\Lambda_i+\Lambda_o)`                                      Ross et al. 2005; Heitz 2014
visibility              :math:`G_2/(4c_ic_o)`; of GGX :math:`1/(2(c_or_i+c_ir_o))`             Lagarde & de Rousiers 2014
Walter's Lambda         :math:`(1-1.259\nu+0.396\nu^2)/(3.535\nu+2.181\nu^2)`, 0 from 1.6 on   Walter et al. 2007, eq. 27
======================  =====================================================================  ==========================

Walter's fit, the usual stand-in for Beckmann's law, is within 0.32 % of it in G1 (worst at nu = 1.34) and 0.63 % in G2; in Lambda
within 5 % for nu < 1. It has no tail: Lambda is 0 from nu = 1.548 on.

The functions are elementwise and broadcast. Cosines are those to the macroscopic normal; beyond 1 by rounding they need no care,
for every formula is smooth there. Roughness is in (0, 1], and accuracy is claimed from 1e-4 on; ratios alpha_x / alpha_y up to
1e4. Half types compute in float32 and round once. Not smooth at: the horizon, cos = 0, where D of Beckmann is flat, and D of
GGX, visibility and the derivatives of G1 and G2 jump to 0; and at a = 0 in :func:`projected_roughness`, a cone.
"""

import math

import torch
from torch import Tensor
from torch.nn import functional

from .. import numerics
from ..numerics import step, working
from .smith import (
    beckmann_g1,
    beckmann_g2,
    beckmann_lambda,
    beckmann_lambda_walter,
    ggx_g1,
    ggx_g2,
    ggx_lambda,
    ggx_visibility,
    power_of_two_below,
    projected_roughness,
)

__all__ = [
    "beckmann_d",
    "beckmann_d_anisotropic",
    "beckmann_g1",
    "beckmann_g2",
    "beckmann_lambda",
    "beckmann_lambda_walter",
    "ggx_d",
    "ggx_d_anisotropic",
    "ggx_g1",
    "ggx_g2",
    "ggx_lambda",
    "ggx_visibility",
    "projected_roughness",
]


def ggx_d(cos_h: Tensor, sin2_h: Tensor | float, alpha: Tensor | float) -> Tensor:
    """GGX distribution of normals, in 1/sr: ``[...]`` from the half vector's cosine, its squared sine, and the roughness.

    ``sin2_h`` >= 0 must be known without cancellation (``|n x h|^2``, not ``1 - cos_h^2``); below 0 it acts as 0. 0 with
    gradient 0 for ``cos_h`` <= 0; at most ``1 / (pi alpha^2)``.
    """
    (c, s2, alpha), dtype = working(cos_h, sin2_h, alpha)
    above = step(c)
    q = numerics.positive(s2) / alpha + alpha * (c * c)
    root = 1.0 / (q + (1.0 - above))
    return numerics.rounded_back(root * root * (above * (1.0 / math.pi)), dtype)


def ggx_d_anisotropic(x: Tensor, y: Tensor, z: Tensor, alpha_x: Tensor | float, alpha_y: Tensor | float) -> Tensor:
    """GGX distribution of normals, in 1/sr: ``[...]`` from the components of the half vector along tangent, bitangent, normal.

    The vector may have any length, tiny and huge included (derivatives by it grow as 1 / length, the second as its square, and
    overflow with that). 0 with gradient 0 for ``z`` <= 0, the zero vector included.
    """
    (x, y, z, alpha_x, alpha_y), dtype = working(x, y, z, alpha_x, alpha_y)
    x2, y2, z2, above = _squares(x, y, z)
    ratio = (x2 + y2 + z2) / (x2 / (alpha_x * alpha_x) + y2 / (alpha_y * alpha_y) + z2)
    return numerics.rounded_back(ratio * ratio / (math.pi * (alpha_x * alpha_y)) * above, dtype)


def beckmann_d(cos_h: Tensor, sin2_h: Tensor | float, alpha: Tensor | float) -> Tensor:
    """Beckmann distribution of normals, in 1/sr; arguments as :func:`ggx_d`.

    0 with gradient 0 for ``cos_h`` <= 0 and where it is below the smallest normal number. Relative error about |ln D| roundings.
    """
    (c, s2, alpha), dtype = working(cos_h, sin2_h, alpha)
    c2 = c * c
    return numerics.rounded_back(_gaussian(numerics.positive(s2) / (alpha * alpha), c2, alpha * c2, step(c)), dtype)


def beckmann_d_anisotropic(x: Tensor, y: Tensor, z: Tensor, alpha_x: Tensor | float, alpha_y: Tensor | float) -> Tensor:
    """Beckmann distribution of normals, in 1/sr; arguments as :func:`ggx_d_anisotropic`, edges as :func:`beckmann_d`."""
    (x, y, z, alpha_x, alpha_y), dtype = working(x, y, z, alpha_x, alpha_y)
    x2, y2, z2, above = _squares(x, y, z)
    cos2 = z2 / (x2 + y2 + z2)
    slope2 = x2 / (alpha_x * alpha_x) + y2 / (alpha_y * alpha_y)
    return numerics.rounded_back(_gaussian(slope2, z2, torch.sqrt(alpha_x * alpha_y) * cos2, above), dtype)


def _gaussian(numerator: Tensor, denominator: Tensor, root: Tensor, above: Tensor) -> Tensor:
    """``(exp(-numerator / (2 denominator)) / root)^2 / pi``, flushed to 0 below the smallest normal number, and 0 unless ``above``."""
    tiny = numerics.tiny(root.dtype)
    alive = above * step(-2.0 * math.log(tiny) * denominator - numerator)
    dead = 1.0 - alive
    exponent = -0.5 * (numerator * alive) / (denominator * alive + dead)
    root_of_d = torch.exp(exponent) * alive / (root * alive + dead)
    root_of_d = functional.threshold(root_of_d, math.sqrt(math.pi * tiny), 0.0)
    return root_of_d * root_of_d * (1.0 / math.pi)


def _squares(x: Tensor, y: Tensor, z: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Squares of the components, and 1.0; where z <= 0 instead those of the normal, and 0.0.

    The largest component is brought to [1, 2), without rounding: fourth powers, and 1e4 times more, are in range then.
    """
    above = step(z)
    x, y, z = x * above, y * above, z * above + (1.0 - above)
    scale = power_of_two_below(torch.maximum(torch.maximum(x.abs(), y.abs()), z))
    x, y, z = x / scale, y / scale, z / scale
    return x * x, y * y, z * z, above
