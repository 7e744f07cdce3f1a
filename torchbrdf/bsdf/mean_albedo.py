"""The albedo of a model under diffuse light, by a fixed rule that graphs hold as a constant."""

import math

import torch
from torch import Tensor

from .. import quadrature
from ..geometry import Channels, Geometry, Layout, Viewer
from ..vector import Vec
from .base import Bsdf

SIDE = 8  # nodes of either cosine, and of the azimuth between


def _pairs() -> Tensor:
    """``[SIDE^3, 7]``: wi and wo, evenly spread over the azimuths, and the weights of ``f`` in its albedo under diffuse light."""
    mu, weight = quadrature.gauss_legendre(SIDE)
    i, o, k = (index.flatten() for index in torch.meshgrid(*[torch.arange(SIDE)] * 3, indexing="ij"))
    turn = 2.0 * math.pi * quadrature.midpoints(SIDE)[k]
    around = math.pi * (3.0 - 5.0**0.5) * torch.arange(len(i))  # of both, for bases that are not isotropic
    ends = [
        torch.stack([torch.sqrt(1.0 - c * c) * torch.cos(a), torch.sqrt(1.0 - c * c) * torch.sin(a), c], -1)
        for c, a in ((mu[i], around), (mu[o], around + turn))
    ]
    return torch.cat([*ends, (4.0 * math.pi / SIDE * mu[i] * weight[i] * mu[o] * weight[o]).unsqueeze(-1)], -1)


PAIRS = _pairs()


def mean_albedo(base: Bsdf, layout: Layout) -> Channels:
    """The albedo of ``base`` under diffuse light, ``f cos_i cos_o / pi`` over both hemispheres; to about 1e-3 where f has kinks."""
    axes = len(base.batch_shape) + int(layout.wide)
    table = PAIRS.to(layout.device, layout.dtype).unflatten(0, (-1, *(1,) * axes))
    x = table.unbind(-1)
    g = Geometry(Viewer(Vec(*x[3:6]), layout=layout), Vec(*x[:3]))
    weight = x[6] * base.domain(g).to(layout.dtype)
    return tuple((f * weight).sum(0) for f in base.formula(g))
