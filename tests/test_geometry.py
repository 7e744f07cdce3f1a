"""What formulas read of a viewer and a pair of directions, where no picture tells it."""

import pytest
import torch

from torchbrdf.geometry import Geometry, Viewer
from torchbrdf.testing.subject import directions, generator
from torchbrdf.vector import Vec, components, dot, stack

GRAZING = [[1.0, 0.0, 0.0], [1.0, 0.0, -0.0], [0.6, 0.0, 0.8], [0.6, 0.0, -0.8]]


def same(a, b):
    return torch.allclose(stack(a), stack(b), rtol=0, atol=1e-14)  # a few roundings


@pytest.mark.parametrize("hand", [None, 1.0, -1.0])
def test_turning_to_the_viewer_and_swapping_keep_tangent_and_bitangent(hand):
    """Also where the texture is mirrored: only the normal turns."""
    wo, wi, n, tangent = (components(directions(50, generator(k))) for k in range(4))
    viewer = Viewer(wo, n, tangent, None if hand is None else torch.full((50,), hand, dtype=torch.float64))
    g = Geometry(viewer, wi)
    along, across, up = viewer.axes
    assert viewer.facing.cos_o.min() > 0
    assert torch.allclose(g.swapped.cos_o, g.cos_i)
    for turned, towards in ((viewer.facing, wo), (g.swapped.viewer, None), (g.swapped.viewer.facing, wi)):
        assert same(turned.axes[0], along)
        assert same(turned.axes[1], across)
        side = 1.0 if towards is None else torch.sign(dot(n, towards))
        assert same(turned.axes[2], Vec(*(side * c for c in up)))


def test_the_horizon_is_on_neither_side():
    w = torch.tensor(GRAZING, dtype=torch.float64)
    wi, wo = components(w.unsqueeze(0)), components(w.unsqueeze(1))
    for n in (None, components(torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64))):
        g = Geometry(Viewer(wo, n), wi)
        proper = torch.tensor([False, False, True, True])
        sign = torch.tensor([0, 0, 1, -1])
        both = proper & proper.unsqueeze(1)
        assert torch.equal(g.same_side, both & (sign == sign.unsqueeze(1)))
        assert torch.equal(g.across, both & (sign != sign.unsqueeze(1)))
