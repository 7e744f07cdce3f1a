"""Directions by bins: what rays put into them, and what a law does."""

import math

import torch
from torch import Tensor

import torchbrdf as tb

STEP, SECTOR = 5, 30  # degrees: bins of theta_o, and of the azimuth from the light, whose first is about the plane of incidence
ROWS, COLUMNS, COARSE = 90 // STEP, 180 // SECTOR + 1, 3  # rows of bins; for the comparison three are one, of 15 degrees


def histogram(wo: Tensor, wi: Tensor, weight: Tensor) -> Tensor:
    """Sums ``[ROWS, COLUMNS]`` of ``weight [N]`` by theta_o and by azimuth from the light, either way."""
    along = wo[..., 0] * wi[..., 0] + wo[..., 1] * wi[..., 1]
    across = wo[..., 1] * wi[..., 0] - wo[..., 0] * wi[..., 1]
    row = (torch.rad2deg(torch.acos(wo[..., 2].clamp(-1.0, 1.0))) / STEP).long()
    column = (torch.rad2deg(torch.atan2(across.abs(), along)) / SECTOR).round().long()
    above = row < ROWS
    index = (row * COLUMNS + column)[above]
    return torch.zeros(ROWS * COLUMNS, dtype=torch.float64).index_add(0, index, weight[above].double()).reshape(ROWS, COLUMNS)


def directions() -> tuple[Tensor, Tensor]:
    """Midpoints ``[N, 3]`` of small cells that fill the bins, and their solid angles ``[N]``, of both halves of the sphere."""
    theta, phi = ((torch.arange(n, dtype=torch.float64) + 0.5) * math.radians(a / n) for n, a in ((360, 90.0), (360, 180.0)))
    t, p = (x.reshape(-1) for x in torch.meshgrid(theta, phi, indexing="ij"))
    wo = torch.stack([torch.sin(t) * torch.cos(p), torch.sin(t) * torch.sin(p), torch.cos(t)], -1)
    return wo, 2.0 * torch.sin(t) * math.radians(0.25) * math.radians(0.5)


def predicted(law: tb.Bsdf, theta: float) -> Tensor:
    """What the law sends into the bins: the integral of f cos."""
    wo, solid = directions()
    wi = torch.tensor([math.sin(theta), 0.0, math.cos(theta)], dtype=torch.float64)
    f = law.evaluate(wi, wo).squeeze(-1)
    return histogram(wo, torch.eye(3, dtype=wo.dtype)[0], f * wo[:, 2] * solid)


def from_light(theta: float) -> Tensor:
    """Least angle to the light ``[ROWS / COARSE, COLUMNS]`` within the bins of the comparison, in degrees."""
    row, column = torch.meshgrid(torch.arange(0.5, 90.0), torch.arange(0.5, 180.0), indexing="ij")
    t, p = torch.deg2rad(row), torch.deg2rad(column)
    cos = math.cos(theta) * torch.cos(t) + math.sin(theta) * torch.sin(t) * torch.cos(p)
    angle = torch.rad2deg(torch.acos(cos.clamp(-1.0, 1.0))).reshape(-1)
    index = ((row / (COARSE * STEP)).long() * COLUMNS + (column / SECTOR).round().long()).reshape(-1)
    least = torch.full((ROWS // COARSE * COLUMNS,), 180.0).scatter_reduce(0, index, angle, "amin")
    return least.reshape(-1, COLUMNS)


def coarse(bins: Tensor) -> Tensor:
    """Three rows as one."""
    return bins.unflatten(-2, (-1, COARSE)).sum(-2)


def compared(theta: float) -> Tensor:
    """The bins ``[ROWS / COARSE, COLUMNS]`` in which Smith's law is held to the measurement."""
    below = torch.arange(ROWS // COARSE).unsqueeze(-1) * COARSE * STEP < 60
    return below & (from_light(theta) > 30.0)
