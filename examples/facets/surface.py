"""A Gaussian height field as a mesh, and light that goes from facet to facet."""

import math

import torch
from torch import Tensor

import torchbrdf as tb

TRACED = 32  # facets that a ray meets at most


def heights(side: int, steps: int, generator: torch.Generator) -> Tensor:
    """A periodic Gaussian field ``[side * steps, side * steps]``, ``steps`` to the correlation length, of any scale."""
    k = 2.0 * math.pi * torch.fft.fftfreq(side * steps, 1.0 / steps, dtype=torch.float64)
    spectrum = torch.exp(-(k[:, None] ** 2 + k**2) / 8.0)  # the square root of that of the correlation exp(-r^2)
    noise = torch.randn(spectrum.shape, generator=generator, dtype=torch.float64)
    return torch.fft.ifft2(torch.fft.fft2(noise) * spectrum).real


def surface(field: Tensor, steps: int, alpha: float) -> tb.Mesh:
    """Two triangles to each square of the periodic ``field``, and a margin, which rays may run over; alpha is that of the facets."""
    rise = [(field.roll(-1, axis) - field).square().mean() for axis in (0, 1)]  # each facet has one edge along x and one along y
    field = field * (alpha / (steps * torch.sqrt(rise[0] + rise[1])))
    margin = math.ceil(steps * max(8.0 * alpha, 2.0))
    index = torch.arange(-margin, field.shape[0] + margin)
    z = field[index % field.shape[0]][:, index % field.shape[0]]
    x, y = torch.meshgrid(index.double() / steps, index.double() / steps, indexing="ij")
    at = torch.arange(z.numel()).reshape(z.shape)
    a, b, c, d = (t.reshape(-1) for t in (at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]))
    up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).expand(z.numel(), 3)  # not read: facets are flat
    faces = torch.cat([torch.stack([a, b, d], -1), torch.stack([c, d, b], -1)])
    return tb.Mesh(torch.stack([x, y, z], -1).reshape(-1, 3), faces, normals=up)


def arriving(mesh: tb.Mesh, side: float, theta: float, rays: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Origins above the mesh and directions to the light ``[rays, 3]``: uniform on the mean plane of one period, of any azimuth."""
    x, y, turn = torch.rand(3, rays, generator=generator, dtype=torch.float64)
    phi, sin, cos = 2.0 * math.pi * turn, math.sin(theta), math.cos(theta)
    wi = torch.stack([sin * torch.cos(phi), sin * torch.sin(phi), torch.full_like(phi, cos)], -1)
    point = torch.stack([side * x, side * y, torch.zeros_like(x)], -1)
    return point + (1.01 * float(mesh.vertices[:, 2].max()) / cos) * wi, wi


def trace(mesh: tb.Mesh, origin: Tensor, wi: Tensor) -> tuple[Tensor, Tensor]:
    """Where light leaves ``[rays, 3]``, and after how many bounces ``[rays]``; 0 for rays that meet nothing or do not find out."""
    wo, bounces = torch.zeros_like(wi), torch.zeros(wi.shape[:-1], dtype=torch.int64)
    inside = torch.arange(wi.shape[0])
    g = tb.GBuffer.from_rays(mesh, origin, -wi)
    for k in range(1, TRACED + 1):
        met = g.mask.squeeze(-1)
        g, inside = g.map(lambda t, met=met: t[met]), inside[met]
        if not inside.numel():
            return wo, bounces
        wo[inside], bounces[inside] = tb.reflect(g.view, g.geometric_normal), k
        g = tb.GBuffer.from_rays(mesh, g, wo[inside])
    bounces[inside[g.mask.squeeze(-1)]] = 0
    return wo, bounces
