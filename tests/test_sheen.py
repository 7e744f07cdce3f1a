"""Sheen: the published fibres at a constant of our own, and the bound of their albedo."""

import math

import pytest
import torch

import torchbrdf as tb
from torchbrdf.testing.subject import above, generator

COSINES = torch.cat([torch.tensor([1e-6, 1e-3], dtype=torch.float64), torch.linspace(0.02, 1.0, 30, dtype=torch.float64)])
VIEWS = torch.stack([torch.sqrt(1 - COSINES**2), 0 * COSINES, COSINES], -1)


@pytest.mark.parametrize("r", [0.1, 0.2, 0.32, 0.45, 0.7, 1.0])
def test_the_bound_holds_and_is_reached_at_grazing(r):
    sheen = tb.Sheen(1.0, r)
    albedo = sheen.directional_albedo(VIEWS, order=160).squeeze(-1)
    (bound,) = sheen.bound(sheen.viewer(VIEWS), COSINES)
    assert bool((albedo <= bound + 2e-4).all()), (albedo - bound).max()
    assert albedo[0].item() == pytest.approx(1.0, abs=1e-3)
    assert bool((albedo[1:].diff() < 0).all()), "brightest at grazing"


def test_beside_the_published_constant():
    wi, wo = above(50, generator(0)), above(50, generator(1))
    for r in (0.3, 1.0):
        exponent, h = 1 / r**2, tb.normalize(wi + wo)
        charlie = (2 + exponent) / (2 * math.pi) * (1 - h[:, 2:] ** 2) ** (exponent / 2)
        published = charlie / (4 * (wi[:, 2:] + wo[:, 2:] - wi[:, 2:] * wo[:, 2:]))
        x = (3 + exponent) / 2
        exact = math.exp(math.lgamma(x + 0.5) - math.lgamma(x)) / math.sqrt(math.pi) * 2 * math.pi / (2 + exponent)
        torch.testing.assert_close(tb.Sheen(0.8, r).evaluate(wi, wo), 0.8 * exact * published, rtol=5e-4, atol=1e-12)
