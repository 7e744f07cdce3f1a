r"""Beckmann's distribution of normals: heights that are Gaussian, so that slopes are, too.

.. math:: D = \frac{e^{-(x^2/\alpha_x^2 + y^2/\alpha_y^2)/z^2}}{\pi\alpha_x\alpha_y z^4}, \qquad
   \Lambda = \frac{\mathrm{erf}\,\nu - 1}{2} + \frac{e^{-\nu^2}}{2\nu\sqrt\pi}, \quad \nu = z / \sqrt{\alpha_x^2 x^2 + \alpha_y^2 y^2}

=========  =====================  ====================================================
parameter  unit, range            meaning
=========  =====================  ====================================================
alpha      [..., 1 or 2], (0, 1]  sqrt(2) times the rms slope, along tangent and bitangent
=========  =====================  ====================================================

D below the smallest normal number is 0, with gradient 0. Sources: Beckmann & Spizzichino 1963; Cook & Torrance 1982; Smith 1967,
Heitz 2014 for Lambda. Walter et al. 2007 replace Lambda by a rational function, ``smith="walter"`` of the models: within 0.32 % in G1.
Visible normals by their slopes (Heitz & d'Eon 2014): the one across the viewer is Gaussian, the one along is found by Newton's method.

>>> import torch, torchbrdf as tb
>>> up = torch.tensor([0.0, 0.0, 1.0])
>>> round(float(tb.Beckmann(0.5).d(up)) * torch.pi, 6), float(tb.Beckmann(0.5).g1(up))
(4.0, 1.0)
"""

import math
from typing import Any

import torch
from torch import Tensor

from .. import numerics
from ..value import param, value
from ..vector import Vec
from .distribution import ALPHA, AXES, Distribution, Facet, Rough, local_direction
from .smith import beckmann_tail, walter_share


def textbook_d(m: Any, cos2: Any, alpha: Any) -> Any:
    """Cook & Torrance 1982, of the squared cosine of the half vector."""
    return m.exp(-1 * (1 - cos2) / (cos2 * (alpha * alpha))) / (m.pi * (alpha * alpha) * (cos2 * cos2))


def textbook_lambda(m: Any, cos: Any, alpha: Any) -> Any:
    """Heitz 2014, eq. 66."""
    nu = cos / (alpha * m.sqrt(1 - cos * cos))
    return (m.erf(nu) - 1) / 2 + m.exp(-1 * (nu * nu)) / (2 * m.sqrt(m.pi) * nu)


@value
class Beckmann(Distribution):
    """Beckmann's distribution of normals."""

    alpha: Tensor = param(ALPHA, AXES, "roughness, a slope")

    textbook = (textbook_d, textbook_lambda)

    @staticmethod
    def density(facet: Facet, rough: Rough) -> Tensor:
        z2 = facet.z * facet.z
        least = -math.log(numerics.tiny(z2.dtype))  # exp(-least) is the smallest normal number
        alive = numerics.step(least * z2 - facet.stretched2)
        z2 = z2 * alive + (1.0 - alive)
        ratio = facet.length2 / z2
        return torch.exp(-(facet.stretched2 * alive) / z2) * alive * (ratio * ratio / (math.pi * rough.area))

    @staticmethod
    def smith_length(cos: Tensor, projected2: Tensor) -> Tensor:
        a = numerics.safe_sqrt(projected2)
        _, a, w = beckmann_tail(cos, a)
        return cos + a * w

    @staticmethod
    def visible_normal(w: Vec, rough: Rough, u: Vec) -> Vec:
        """Slopes of the surface of roughness 1 along the viewer and across, and stretched back.

        They are made of a Gaussian pair of the frame's own axes, so that the sample does not turn with the azimuth of a viewer above.
        """
        seen = local_direction(w, rough)
        sin = numerics.safe_sqrt(seen.x * seen.x + seen.y * seen.y)
        inverse = numerics.reciprocal_or_zero(sin)
        cos_phi, sin_phi = seen.x * inverse + (1.0 - numerics.step(sin)), seen.y * inverse
        p, q = _gaussian(u.x), _gaussian(u.y)
        turned, across = cos_phi * p + sin_phi * q, cos_phi * q - sin_phi * p
        along = _slope_along(0.5 * torch.special.erfc(-turned), seen.z, sin)
        return local_direction(Vec(sin_phi * across - cos_phi * along, -sin_phi * along - cos_phi * across, torch.ones_like(along)), rough)


def _gaussian(u: Tensor) -> Tensor:
    """The number that a Gaussian of variance 1/2 stays below with probability u."""
    eps = torch.finfo(u.dtype).eps
    return torch.erfinv(2.0 * u.clamp(eps, 1.0 - eps) - 1.0)


def walter_length(cos: Tensor, projected2: Tensor) -> Tensor:
    """The Smith length by the rational Lambda of Walter et al. 2007, eq. 27; 0 from nu = 1.548 on."""
    a = numerics.safe_sqrt(projected2)
    share, _ = walter_share(cos, a)
    return cos + 2.0 * a * share


STEPS = {torch.float32: 16, torch.float64: 28}  # of Newton's method, a bisection where it would leave the bracket


def _slope_along(u: Tensor, cos: Tensor, sin: Tensor) -> Tensor:
    """The slope x against the viewer whose share of what is visible, from -inf to x, is u; density (cos - x sin) exp(-x^2).

    Its derivatives are those of the equation that it solves: one more step of Newton's, which gradients pass through.
    """
    with torch.no_grad():
        end = 6.0 if u.dtype == torch.float64 else 4.0  # beyond, less than rounding is left
        low = torch.full_like(u + cos, -end)
        high = torch.clamp(cos / sin.clamp_min(numerics.tiny(sin.dtype)), -end, end).expand_as(low)
        wanted = u * _visible(high, cos, sin)
        x = _between(u, cos, sin).clamp(-end, end).minimum(high)
        for _ in range(STEPS[u.dtype]):
            excess = _visible(x, cos, sin) - wanted
            low, high = torch.where(excess > 0, low, x), torch.where(excess > 0, x, high)
            slope = _seen(x, cos, sin)
            step = x - excess * numerics.reciprocal_or_zero(slope)
            inside = (step >= low) & (step <= high) & (slope > 0)  # at the root itself it stands still
            x = torch.where(inside, step, 0.5 * (low + high))
    end_x = torch.clamp(cos / sin.clamp_min(numerics.tiny(sin.dtype)), max=end)
    residue = _visible(x, cos, sin) - u * _visible(end_x, cos, sin)
    slope = numerics.reciprocal_or_zero(_seen(x, cos, sin).detach(), numerics.negligible(x.dtype))
    return x - (residue - residue.detach()) * slope


def _between(u: Tensor, cos: Tensor, sin: Tensor) -> Tensor:
    """A start: between the solutions for a viewer above and for one in the horizon."""
    return cos * cos * _gaussian(u) - sin * sin * torch.sqrt(-torch.log(u.clamp_min(torch.finfo(u.dtype).eps)))


def _visible(x: Tensor, cos: Tensor, sin: Tensor) -> Tensor:
    """The integral of ``(cos - x sin) exp(-x^2) / sqrt(pi)`` from -inf to x."""
    return 0.5 * (cos * torch.special.erfc(-x) + sin * torch.exp(-x * x) * (1.0 / math.sqrt(math.pi)))


def _seen(x: Tensor, cos: Tensor, sin: Tensor) -> Tensor:
    return (cos - x * sin) * torch.exp(-x * x) * (1.0 / math.sqrt(math.pi))
