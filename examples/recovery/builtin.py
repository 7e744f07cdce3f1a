"""A scene made from nothing: a lumpy ring under eight lights from frontal to grazing, photographed with noise."""

import math

import torch
from torch import Tensor

import torchbrdf as tb

from .problem import Lights, Problem, View, make_material

TEXELS = 24
# Angles between each light and the camera's axis. With light and viewer 120 degrees and more apart the half angle passes 60
# degrees: only there does k F(eta) stop being one number, because F rises by an amount that depends on eta.
ANGLES = (5.0, 30.0, 55.0, 80.0, 105.0, 125.0, 140.0, 150.0)


def lumpy_ring(segments: int = 160, sides: int = 80) -> tb.Mesh:
    """A closed ring whose tube swells and twists; uv runs along and around it."""
    u, v = torch.meshgrid(torch.arange(segments + 1) / segments, torch.arange(sides + 1) / sides, indexing="ij")
    a, b = 2 * math.pi * u, 2 * math.pi * v
    tube = 0.42 * (1 + 0.16 * torch.cos(3 * a + 2 * b) + 0.08 * torch.sin(5 * b - a))
    radius = 1.0 + tube * torch.cos(b)
    vertices = torch.stack([radius * torch.cos(a), radius * torch.sin(a), tube * torch.sin(b)], -1).reshape(-1, 3)
    i, j = torch.meshgrid(torch.arange(segments), torch.arange(sides), indexing="ij")
    p = (i * (sides + 1) + j).reshape(-1)
    q = p + sides + 1
    faces = torch.cat([torch.stack([p, q, q + 1], -1), torch.stack([p, q + 1, p + 1], -1)])
    return tb.Mesh(vertices, faces, normals=_seamless_normals(vertices, faces, segments, sides), uv=torch.stack([u, v], -1).reshape(-1, 2))


def _seamless_normals(vertices: Tensor, faces: Tensor, segments: int, sides: int) -> Tensor:
    """Area-weighted normals, the two rims of the uv seam joined."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    total = torch.zeros_like(vertices).index_add_(0, faces.reshape(-1), torch.cross(b - a, c - a, dim=-1).repeat_interleave(3, 0))
    grid = total.reshape(segments + 1, sides + 1, 3)
    grid[0], grid[-1] = grid[0] + grid[-1], grid[0] + grid[-1]
    grid[:, 0], grid[:, -1] = grid[:, 0] + grid[:, -1], grid[:, 0] + grid[:, -1]
    return torch.nn.functional.normalize(grid.reshape(-1, 3), dim=-1)


def true_albedo(gen: torch.Generator) -> Tensor:
    """A smooth random pattern of texels between 0.15 and 0.85."""
    coarse = torch.rand(1, 3, 6, 6, generator=gen, dtype=torch.float64)
    wrapped = torch.nn.functional.pad(coarse, (1, 1, 1, 1), mode="circular")
    fine = torch.nn.functional.interpolate(wrapped, scale_factor=TEXELS / 6, mode="bilinear", align_corners=False)
    cut = TEXELS // 6
    return 0.15 + 0.7 * fine[0, :, cut:-cut, cut:-cut].movedim(0, -1)


def build(seed: int, size: int = 112, noise: float = 0.01) -> Problem:
    """The scene of one seed: its truth, a start far from it, and noisy images (``noise`` times the mean radiance)."""
    gen = torch.Generator().manual_seed(seed)
    mesh = lumpy_ring().to(torch.float64)
    camera = tb.Camera.look_at([0.9, -2.6, 3.4], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0], fov_y=40.0, size=(size, size)).to(torch.float64)
    g = tb.GBuffer.from_mesh(mesh, camera)
    lights = tb.PointLight(_ring_of_lights(), torch.full((1, 3), 60.0, dtype=torch.float64))
    draw = torch.rand(4, generator=gen, dtype=torch.float64).tolist()
    truth = {"specular": 0.6 + 0.4 * draw[0], "exponent": 25.0 + 35.0 * draw[1], "eta": 1.4 + 0.25 * draw[2]}
    far = 5.0 if draw[3] < 0.5 else 0.2
    start = {"albedo": 0.5, "specular": 0.4, "exponent": truth["exponent"] * far, "eta": truth["eta"] + (0.32 if draw[3] < 0.5 else -0.3)}
    material = make_material("glossy", TEXELS, {"albedo": 0.5, **truth}).double()
    albedo = true_albedo(gen)
    brdf = tb.Lambert(tb.nn.Texture(albedo).at(g.uv).detach()) + material.terms[1](g)
    shadows = tb.visibility(g, lights, mesh)
    images = tb.shade(g, brdf, lights, visibility=shadows, per_light=True).detach()
    sigma = noise * float(images[:, g.valid.squeeze(-1)].mean())
    noisy = images + sigma * torch.randn(images.shape, generator=gen, dtype=images.dtype)
    view = View(g, noisy, g.valid.expand(len(lights), -1, -1, -1), shadows)
    return Problem([view], Lights(lights), {"albedo": albedo, **{k: torch.tensor([v]) for k, v in truth.items()}}, start, sigma)


def _ring_of_lights() -> Tensor:
    """Lights 6 units away, at ANGLES from the direction to the camera, each turned on by the golden angle."""
    axis = torch.nn.functional.normalize(torch.tensor([0.9, -2.6, 3.4], dtype=torch.float64), dim=0)
    frame = tb.Frame.from_normal(axis)
    polar = torch.deg2rad(torch.tensor(ANGLES, dtype=torch.float64))
    turn = torch.arange(len(ANGLES), dtype=torch.float64) * math.pi * (3 - math.sqrt(5))
    local = torch.stack([torch.sin(polar) * torch.cos(turn), torch.sin(polar) * torch.sin(turn), torch.cos(polar)], -1)
    return 6.0 * frame.to_world(local)


def largest_half_angle(problem: Problem) -> float:
    """The largest angle(wi, h), in degrees, on pixels that a light reaches."""
    view = problem.views[0]
    wi = problem.lights(view.g)[0].sample(view.g.position).wi
    reached = ((wi * view.g.normal).sum(-1) > 0) & (view.visibility.squeeze(-1) > 0) & view.g.valid.squeeze(-1)
    cosine = (wi * view.g.require_view()).sum(-1)[reached]
    return float(torch.rad2deg(torch.acos(cosine.clamp(-1, 1)) / 2).max())
