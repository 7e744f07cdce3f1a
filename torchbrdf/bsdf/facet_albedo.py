r"""The directional albedo of mirror facets by quadrature over their normals, of which none is lost below the horizon.

On a surface of roughness 1 let a normal have the polar angle psi and the azimuth t. On this surface it is
:math:`h \propto (\alpha_x \cos t \sin\psi,\; \alpha_y \sin t \sin\psi,\; \cos\psi)`. It mirrors wo to above the horizon for psi up to

.. math:: \tan\psi = \frac{k + \sqrt{k^2 + m^2\cos^2\theta_o}}{m^2 \cos\theta_o}, \qquad
   k = \alpha_x\cos t\;\omega_{o,x} + \alpha_y\sin t\;\omega_{o,y}, \quad m^2 = \alpha_x^2\cos^2 t + \alpha_y^2\sin^2 t

and up to there psi is integrated. At grazing that angle falls steeply where k changes its sign; there the integral over t is cut.
"""

import math
from collections.abc import Callable

import torch
from torch import Tensor

from .. import numerics, quadrature, vector
from ..geometry import Channels, Geometry, Viewer
from ..optics.distribution import Facet, Rough
from ..vector import Vec
from .albedo import summed
from .base import Bsdf
from .sampler import inverse_density


def facet_albedo(bsdf: Bsdf, viewer: Viewer, rough: Rough, d: Callable[[Facet], Tensor], order: int) -> Channels:
    """Of a model that mirrors at facets of density ``d``, for a viewer in the local frame."""
    seen = _turned(viewer) if rough.isotropic else viewer

    def part(chunk: Tensor) -> Channels:
        half, solid_angle = _normals(seen.wo, rough, chunk)
        g = Geometry(seen, vector.reflect_components(seen.wo, half))
        # f is a product with D of the half vector that rounding leaves of wi and wo: its error cancels against itself alone.
        exact = d(Facet.local(half, rough)) * inverse_density(d(Facet.local(g.half, rough)))
        factor = torch.where(bsdf.domain(g), 4.0 * g.cos_i.abs() * g.wi_h * exact, 0.0) * solid_angle
        return tuple((f * factor).sum(0) for f in bsdf.formula(g))

    return summed(bsdf, viewer, _nodes(order, rough.isotropic), part)


def _turned(viewer: Viewer) -> Viewer:
    """The viewer at azimuth 0: all are the same, in their derivatives too."""
    sin = numerics.safe_sqrt(viewer.wo.x * viewer.wo.x + viewer.wo.y * viewer.wo.y)
    return Viewer(Vec(sin, torch.zeros_like(sin), viewer.wo.z), layout=viewer.layout)


def _nodes(order: int, isotropic: bool) -> Tensor:
    """``[N, 5]``: cosine and sine of the azimuth from the viewer, whether it faces the viewer, share of the polar angle, weight."""
    share, of_share = _dense_at_one(order)
    side, of_side = _dense_at_one((order + 1) // 2)
    quarter = torch.stack([0.5 * math.pi * side, of_side], -1)  # from the viewer's azimuth to where the facets turn away
    angles = torch.cat([quarter[:, 0], math.pi - quarter[:, 0]])
    if not isotropic:  # else the same on both sides of the viewer
        angles = torch.cat([angles, -angles])
    faces = (torch.cos(angles) > 0).to(angles)
    weight = 2.0 * math.pi * (of_side.repeat(len(angles) // len(side)) / (len(angles) // len(side)))
    around = torch.stack([torch.cos(angles), torch.sin(angles), faces], -1)
    a, p = (index.flatten() for index in torch.meshgrid(torch.arange(len(angles)), torch.arange(order), indexing="ij"))
    return torch.cat([around[a], share[p].unsqueeze(-1), (weight[a] * of_share[p]).unsqueeze(-1)], -1)


def _dense_at_one(order: int) -> tuple[Tensor, Tensor]:
    """Gauss' nodes, denser towards 1, where at grazing and for small roughness everything happens."""
    x, weight = quadrature.gauss_legendre(order)
    return x * (2.0 - x), weight * (2.0 - 2.0 * x)


def _normals(wo: Vec, rough: Rough, chunk: Tensor) -> tuple[Vec, Tensor]:
    """Unit normals that mirror wo to above the horizon, and the solid angles for which they stand."""
    cos_t, sin_t, faces, share, weight = chunk.unbind(-1)
    c = torch.where(wo.z > 0, wo.z, 1.0)
    x, y = wo.x * rough.x, wo.y * rough.y
    k = numerics.safe_sqrt(x * x + y * y)
    # Within rounding of the normal every azimuth is as good; taken as it comes, it would turn the nodes.
    off = numerics.step(k - 16.0 * torch.finfo(k.dtype).eps)
    inverse = numerics.reciprocal_or_zero(k) * off
    along_x, along_y = x * inverse + (1.0 - off), y * inverse
    slope_x, slope_y = rough.x * (along_x * cos_t - along_y * sin_t), rough.y * (along_y * cos_t + along_x * sin_t)
    m2 = slope_x * slope_x + slope_y * slope_y
    towards = k * cos_t
    root = torch.sqrt(towards * towards + m2 * (c * c)) + towards.abs()
    last = torch.where(faces > 0, torch.atan2(root, c * m2), torch.atan2(c.expand_as(root), root))
    cos, sin = torch.cos(share * last), torch.sin(share * last)
    per = torch.rsqrt(cos * cos + m2 * (sin * sin))
    solid_angle = rough.area * sin * (per * per * per) * (last * weight)
    return Vec(slope_x * sin * per, slope_y * sin * per, cos * per), solid_angle
