"""The n-linear look-up behind textures, environment maps and tables."""

import itertools

import pytest
import torch
from scipy.interpolate import RegularGridInterpolator
from torch.autograd import gradcheck

import torchbrdf as tb
from torchbrdf.lookup import lookup


@pytest.mark.parametrize("sizes", [(5,), (4, 6), (3, 5, 4), (2, 3, 4, 5)], ids=str)
def test_it_is_linear_along_each_axis(sizes):
    gen = torch.Generator().manual_seed(0)
    table = torch.rand(*sizes, 3, generator=gen, dtype=torch.float64)
    at = [(n - 1) * torch.rand(50, generator=gen, dtype=torch.float64) for n in sizes]
    expected = RegularGridInterpolator([torch.arange(n).numpy() for n in sizes], table.numpy())(torch.stack(at, -1).numpy())
    found = lookup(table, at, ["clamp"] * len(sizes))
    torch.testing.assert_close(torch.stack(found, -1), torch.from_numpy(expected))


def test_ends_are_held_or_begin_again():
    table = torch.tensor([[1.0], [2.0], [4.0]])
    x = torch.tensor([-5.0, -0.5, 0.0, 2.0, 2.5, 9.0])
    assert lookup(table, [x], ["clamp"])[0].tolist() == [1.0, 1.0, 1.0, 4.0, 4.0, 4.0]
    assert lookup(table, [x], ["repeat"])[0].tolist() == [2.0, 2.5, 1.0, 4.0, 2.5, 1.0]


@pytest.mark.parametrize("wrap", ["clamp", "repeat"])
def test_gradients_to_entries_and_coordinates(wrap):
    gen = torch.Generator().manual_seed(0)
    table = torch.rand(3, 4, 2, generator=gen, dtype=torch.float64).requires_grad_()
    at = [(0.1 + 0.8 * torch.rand(6, generator=gen, dtype=torch.float64) + k).requires_grad_() for k in (1, 2)]
    assert gradcheck(lambda t, x, y: torch.stack(lookup(t, [x, y], [wrap, wrap])), (table, *at))


def test_it_never_leaves_the_range_of_the_entries():
    table = torch.tensor([[0.1], [0.1], [0.3]])
    x = torch.rand(10_000, generator=torch.Generator().manual_seed(0)) * 2
    found = lookup(table, [x], ["clamp"])[0]
    assert found.min() >= table.min()
    assert found.max() <= table.max()


def test_a_coordinate_that_is_none_reads_an_entry():
    for x in (float("nan"), float("inf"), -float("inf")):
        at = torch.tensor([x], requires_grad=True)
        (found,) = lookup(torch.tensor([[7.0], [8.0]]), [at], ["clamp"])
        assert found.item() == 7.0
        assert torch.autograd.grad(found.sum(), at)[0].item() == 0.0


def test_coordinates_broadcast():
    table = torch.rand(4, 6, 2)
    x, y = torch.rand(5, 1) * 3, torch.rand(7) * 5
    found = lookup(table, [x, y], ["clamp", "repeat"])[1]
    for i, j in itertools.product(range(5), range(7)):
        torch.testing.assert_close(found[i, j], lookup(table, [x[i, 0], y[j]], ["clamp", "repeat"])[1])


def test_a_leaf_texture_gets_its_gradient():
    """What a material is made of without modules: texels that are plain leaves, looked up at g.uv."""
    texels = torch.rand(6, 4, 3, requires_grad=True)  # taller than wide
    uv = torch.rand(5, 8, 2)
    albedo = tb.bilinear(texels, uv)
    torch.testing.assert_close(albedo, tb.nn.Texture(texels.detach())(tb.GBuffer(torch.zeros(5, 8, 3), torch.ones(5, 8, 3), uv=uv)))
    albedo.sum().backward()
    torch.testing.assert_close(texels.grad.sum(), torch.tensor(5.0 * 8 * 3))
    assert tb.is_planar(albedo)
    corners = torch.tensor([[0.125, 1 - 0.5 / 6], [0.875, 0.5 / 6]])  # the first texel is the top left one, the last the bottom right
    torch.testing.assert_close(tb.bilinear(texels, corners), torch.stack([texels[0, 0], texels[5, 3]]))
