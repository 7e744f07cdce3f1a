"""The directional albedo of rough mirrors against an independent rule: half vectors in spherical coordinates, float64, no torch."""

import itertools

import numpy as np
import pytest
import torch

import torchbrdf as tb

ANGLES = (0.0, 30.0, 60.0, 80.0, 85.0, 89.0, 89.9)


def rule(order):
    """Nodes and weights on [0, 1], dense at both ends."""
    x, w = np.polynomial.legendre.leggauss(order)
    return np.sin(0.25 * np.pi * (x + 1)) ** 2, 0.25 * np.pi * w * np.sin(0.5 * np.pi * (x + 1))


def white_albedo(alpha, degrees, order=40):
    """Of GGX, correlated. The polar angle of h runs in pieces, its azimuth up to where the mirror direction meets the horizon."""
    theta = np.radians(degrees)
    co, so = np.cos(theta), np.sin(theta)
    ends = (np.pi / 2 - theta) / 2, (np.pi / 2 + theta) / 2  # all azimuths up to the first, none from the second on
    edges = [0.0, *np.geomspace(1e-3 * alpha, ends[0], 30), *np.geomspace(*ends, 12)[1:]]
    share, of_share = rule(60)
    turn, of_turn = rule(order)
    total = 0.0
    for low, high in itertools.pairwise(edges):
        polar = (low + (high - low) * share)[:, None]
        ch, sh = np.cos(polar), np.sin(polar)
        last = np.arccos(np.clip((co / (2 * ch) - co * ch) / (max(so, 1e-9) * sh), -1, 1))
        for a, b in itertools.pairwise(np.sin(np.linspace(0, np.pi / 2, 9))):
            wo_h = so * sh * np.cos(last * (a + (b - a) * turn)) + co * ch
            ci = np.maximum(2 * wo_h * ch - co, 1e-300)
            d = 1 / (np.pi * alpha**2 * (sh**2 / alpha**2 + ch**2) ** 2)
            lengths = [np.sqrt(1 + alpha**2 * (1 - np.minimum(c * c, 1)) / c**2) for c in (ci, co)]
            g = 2 / (lengths[0] + lengths[1])
            total += 2 * np.sum((high - low) * of_share[:, None] * last * (b - a) * of_turn * d * sh * g * wo_h / co)
    return total


@pytest.mark.parametrize("alpha", [0.01, 0.03, 0.1, 0.3, 0.6, 1.0])
def test_white_ggx_mirror(alpha):
    theta = torch.deg2rad(torch.tensor(ANGLES, dtype=torch.float64))
    wo = torch.stack([torch.sin(theta), torch.zeros_like(theta), torch.cos(theta)], -1)
    exact = torch.tensor([white_albedo(alpha, a) for a in ANGLES])
    assert white_albedo(alpha, 89.0, 64) == pytest.approx(white_albedo(alpha, 89.0), abs=1e-10)
    found = tb.RoughConductor(alpha).directional_albedo(wo)[:, 0]
    assert (found - exact).abs().max() < 2e-6
    single = tb.RoughConductor(alpha).directional_albedo(wo.float())[:, 0]
    assert (single.double() - exact)[:-1].abs().max() < 1e-5


SOME = [
    {"alpha": [0.4, 0.1]},
    {"alpha": [0.02, 0.7], "shadowing": "smith_separable"},
    {"alpha": 0.1, "distribution": "beckmann"},
    {"alpha": [0.5, 0.2], "distribution": "beckmann", "smith": "walter"},
    {"alpha": [0.1, 0.3], "distribution": "blinn"},
    {"alpha": 0.3, "fresnel": tb.Conductor.named("Cu")},
]


@pytest.mark.parametrize("given", SOME, ids=[f"{g.get('distribution', 'ggx')}-{g['alpha']}" for g in SOME])
def test_the_sampler_agrees(given):
    """The mean weight of the samples, from every azimuth: nothing of the rule over the normals is used."""
    mirror = tb.RoughConductor(**given)
    theta, phi = (x.flatten() for x in torch.meshgrid(torch.tensor([0.2, 1.0, 1.45]), torch.tensor([0.3, 1.9, 4.0]), indexing="ij"))
    wo = torch.stack([torch.sin(theta) * torch.cos(phi), torch.sin(theta) * torch.sin(phi), torch.cos(theta)], -1).double()
    u = torch.quasirandom.SobolEngine(2, scramble=True, seed=0).draw(1 << 14, dtype=torch.float64)
    mean = mirror.sample(wo, u.unsqueeze(1)).weight.mean(0)
    assert (mirror.directional_albedo(wo) - mean).abs().max() < 1e-3


@pytest.mark.parametrize("alpha", [[0.3], [0.4, 0.1]])
def test_gradients(alpha):
    """By alpha and direction, straight up too, where the azimuth has no beginning."""
    wo = torch.tensor([[0.3, -0.5, 0.6], [0.1, 0.2, 0.05], [0.0, 0.0, 1.0]], dtype=torch.float64, requires_grad=True)
    a = torch.tensor(alpha, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda a, wo: tb.RoughConductor(a).directional_albedo(wo, order=12), (a, wo))


def test_below_the_horizon_nothing_is_reflected():
    wo = torch.tensor([[0.6, 0.0, -0.8], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]], requires_grad=True)
    found = tb.RoughConductor([0.4, 0.1]).directional_albedo(wo)
    found.sum().backward()
    assert (found == 0).all()
    assert torch.isfinite(wo.grad).all()
