"""Models that are hard on a test of samplers: half vectors, visible normals, refraction with lost samples, an albedo without a bound."""

import math

import torch
from torch import Tensor

import torchbrdf as tb
from torchbrdf import microfacet, vector
from torchbrdf.bsdf.lobe import Draw
from torchbrdf.geometry import each
from torchbrdf.interval import UNIT, Interval
from torchbrdf.value import COLOUR, SCALAR, param, value
from torchbrdf.vector import Vec

ALPHA = Interval(0.0, 1.0, open_low=True, typical=(0.1, 0.8), hard=(1e-3,))


def tangent_slope(u, alpha):
    """A half vector of GGX in proportion to D cos (Walter et al. 2007, eq. 35)."""
    r, phi = alpha * torch.sqrt(u.x / (1 - u.x)), 2 * math.pi * u.y
    return vector.normalize_components(Vec(r * torch.cos(phi), r * torch.sin(phi), torch.ones_like(r)))


@value
class Ggx(tb.Bsdf):
    """GGX sampled by D cos: many samples below the horizon, and a density with a pole at wi = -wo."""

    tint: Tensor = param(UNIT, COLOUR, "in place of F")
    alpha: Tensor = param(ALPHA, SCALAR, "roughness")

    lobes = (tb.Lobe.GLOSSY_REFLECTION,)

    def _d(self, g):
        return microfacet.ggx_d(g.cos_h.abs(), g.sin2_h, g.scalar(self.alpha))

    def formula(self, g):
        alpha = g.scalar(self.alpha)
        sin = [alpha * torch.sqrt(torch.relu(1 - c * c)) for c in (g.cos_i, g.cos_o)]
        visibility = torch.where(g.above, microfacet.ggx_visibility(g.cos_i, g.cos_o, *sin), 0.0)
        return tuple(k * self._d(g) * visibility for k in g.colour(self.tint))

    def density(self, g):
        return self._d(g) * g.cos_h.abs() * 0.5 * g.inverse_half

    def draw(self, viewer, u):
        return Draw(vector.reflect_components(viewer.wo, tangent_slope(u, viewer.scalar(self.alpha))))


@value
class VisibleNormals(tb.Bsdf):
    """Anisotropic GGX sampled by visible normals (Heitz 2018, by the caps of Dupuy & Benyoub 2023)."""

    x: Tensor = param(ALPHA, SCALAR, "roughness along the tangent")
    y: Tensor = param(ALPHA, SCALAR, "roughness across it")

    lobes = (tb.Lobe.GLOSSY_REFLECTION,)

    def formula(self, g):
        return (self.density(g) / torch.where(g.above, g.cos_i, 1.0),)

    def density(self, g):
        h, x, y = vector.scale(g.viewer.to_local(g.half), g.inverse_half), g.scalar(self.x), g.scalar(self.y)
        wo = g.viewer.local.wo
        g1 = microfacet.ggx_g1(wo.z, microfacet.projected_roughness(wo.x, wo.y, x, y))
        seen = g1 * microfacet.ggx_d_anisotropic(h.x, h.y, h.z, x, y)
        return torch.where(wo.z > 0, seen / (4 * torch.where(wo.z > 0, wo.z, 1.0)), 0.0)

    def draw(self, viewer, u):
        x, y, wo = viewer.scalar(self.x), viewer.scalar(self.y), viewer.wo
        v = vector.normalize_components(Vec(wo.x * x, wo.y * y, wo.z))
        z, phi = (1 - u.x) * (1 + v.z) - v.z, 2 * math.pi * u.y
        sin = torch.sqrt(torch.relu(1 - z * z))
        c = Vec((sin * torch.cos(phi) + v.x) * x, (sin * torch.sin(phi) + v.y) * y, z + v.z)
        return Draw(vector.reflect_components(wo, vector.normalize_components(c)))


@value
class RoughGlass(tb.Bsdf):
    """Half of the samples reflected, half refracted by Walter's half vectors, those of no direction lost; it sends no light itself."""

    alpha: Tensor = param(ALPHA, SCALAR, "roughness")
    eta: Tensor = param(Interval(0.0, open_low=True, typical=(1.2, 2.0)), SCALAR, "inside over outside")

    lobes = (tb.Lobe.GLOSSY_REFLECTION, tb.Lobe.GLOSSY_TRANSMISSION)

    def domain(self, g):
        return g.same_side | g.across

    def formula(self, g):
        return (torch.zeros_like(g.cos_i + g.cos_o) * g.scalar(self.eta),)

    def _eta(self, viewer):
        inside = viewer.scalar(self.eta)
        return torch.where(viewer.side > 0, inside, 1 / inside)  # far side over the viewer's

    def density(self, g):
        alpha, eta = g.scalar(self.alpha), self._eta(g.viewer)
        reflected = microfacet.ggx_d(g.cos_h.abs(), g.sin2_h, alpha) * g.cos_h.abs() * 0.5 * g.inverse_half
        half = vector.add(vector.scale(g.wi, eta), g.wo)
        length2 = vector.dot(half, half)
        h = vector.scale(half, torch.rsqrt(length2))
        h = vector.scale(h, torch.sign(vector.dot(h, g.n)) * g.viewer.side)
        cos, across, i_h = vector.dot(h, g.n), vector.cross(g.n, h), vector.dot(h, g.wi)
        d = microfacet.ggx_d(cos.abs(), vector.dot(across, across), alpha) * cos.abs()
        bent = (vector.dot(h, g.wo) > 0) & (i_h < 0)
        return 0.5 * reflected + torch.where(bent, 0.5 * d * eta * eta * i_h.abs() / length2, 0.0)

    def draw(self, viewer, u):
        h, eta = tangent_slope(u, viewer.scalar(self.alpha)), self._eta(viewer)
        h = Vec(h.x, h.y, h.z * viewer.side)
        cos = vector.dot(viewer.wo, h)
        cos2 = 1 - (1 - cos * cos) / (eta * eta)
        lost, along = (cos <= 0) | (cos2 <= 0), cos / eta - torch.sqrt(torch.relu(cos2))
        bent = (torch.where(lost, 0.0, along * a - b / eta) for a, b in zip(h, viewer.wo, strict=True))
        passes = u.z >= 0.5
        wi = each(lambda p, q: torch.where(passes, p, q), tuple(bent), tuple(vector.reflect_components(viewer.wo, h)))
        return Draw(Vec(*wi), passes.to(torch.int64))


@value
class Ward(tb.Bsdf):
    """Ward 1992, of strength k: its albedo grows without bound towards grazing."""

    specular: Tensor = param(UNIT, COLOUR, "k")
    alpha: Tensor = param(ALPHA, SCALAR, "roughness")

    lobes = (tb.Lobe.GLOSSY_REFLECTION,)

    def _d(self, g):
        return microfacet.beckmann_d(g.cos_h.abs(), g.sin2_h, g.scalar(self.alpha))

    def formula(self, g):
        product = torch.where(g.above, g.cos_i * g.cos_o, 1.0)
        lobe = self._d(g) * g.cos_h**4 / (4 * torch.sqrt(product))
        return tuple(k * lobe for k in g.colour(self.specular))

    def density(self, g):
        return self._d(g) * g.cos_h.abs() * 0.5 * g.inverse_half

    def draw(self, viewer, u):
        slope, phi = viewer.scalar(self.alpha) * torch.sqrt(-torch.log1p(-u.x)), 2 * math.pi * u.y
        h = vector.normalize_components(Vec(slope * torch.cos(phi), slope * torch.sin(phi), torch.ones_like(slope)))
        return Draw(vector.reflect_components(viewer.wo, h))
