"""Directions, frames, planar memory."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.autograd import gradcheck, gradgradcheck

import torchbrdf as tb
from torchbrdf import geometry, vector
from torchbrdf.geometry import Geometry, Viewer
from torchbrdf.vector import Vec, components

EPS = torch.finfo(torch.float32).eps


def unit(*shape, dtype=torch.float64):
    return tb.normalize(torch.randn(*shape, 3, dtype=dtype))


number = st.floats(-1.0, 1.0, width=32)


@settings(max_examples=200, deadline=None)
@given(st.tuples(number, number, number), st.integers(-120, 120))
def test_normalize_any_scale(v, power):
    """From near the smallest float32 to near the largest: no overflow, no underflow."""
    x = torch.tensor(v, dtype=torch.float64)
    scaled = (x * 2.0**power).float()
    length = float(scaled.double().norm())
    n = tb.normalize(scaled)
    if length == 0:
        assert n.tolist() == [0.0, 0.0, 0.0]
    elif scaled.abs().max() > torch.finfo(torch.float32).tiny:
        assert float((n.double() - scaled.double() / length).abs().max()) <= 3 * EPS


@pytest.mark.parametrize("bad", [(0.0, 0.0, 0.0), (float("nan"), 1.0, 0.0), (float("inf"), 1.0, 0.0), (1.0, -float("inf"), float("nan"))])
def test_normalize_unusable(bad):
    v = torch.tensor(bad, requires_grad=True)
    n = tb.normalize(v)
    n.sum().backward()
    assert n.tolist() == [0.0, 0.0, 0.0]
    assert v.grad.tolist() == [0.0, 0.0, 0.0]


def test_normalize_derivatives():
    v = torch.randn(4, 3, dtype=torch.float64, requires_grad=True)
    assert gradcheck(tb.normalize, v)
    assert gradgradcheck(tb.normalize, v)
    axis = torch.tensor([[0.0, 0.0, 2.0]], dtype=torch.float64, requires_grad=True)
    assert gradcheck(tb.normalize, axis)


def test_direction_and_length():
    v = torch.tensor([[3.0, 4.0, 0.0], [0.0, 0.0, 0.0]])
    direction, length = vector.direction_and_length(components(v))
    torch.testing.assert_close(length, torch.tensor([5.0, 0.0]))
    torch.testing.assert_close(torch.stack(direction, -1), torch.tensor([[0.6, 0.8, 0.0], [0.0, 0.0, 0.0]]))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_frame_is_orthonormal(dtype):
    n = torch.cat([unit(20000, dtype=dtype), torch.eye(3, dtype=dtype), -torch.eye(3, dtype=dtype)])
    n = torch.cat([n, tb.normalize(torch.tensor([[1e-20, 0, -1], [0, 1e-8, -1], [1, 0, -0.0], [1e-4, 1e-4, -1]], dtype=dtype))])
    for tangent in (None, unit(len(n), dtype=dtype)):
        frame = tb.Frame.from_normal(n, tangent)
        axes = torch.stack(frame, -2).double()
        residual = (axes @ axes.mT - torch.eye(3, dtype=torch.float64)).abs().max()
        assert residual <= 8 * torch.finfo(dtype).eps
        assert bool((torch.linalg.det(axes) > 0).all()), "right-handed"


def test_frame_follows_the_tangent():
    n = torch.tensor([0.0, 0.0, 1.0])
    frame = tb.Frame.from_normal(n, torch.tensor([0.0, 2.0, 5.0]))
    torch.testing.assert_close(frame.tangent, torch.tensor([0.0, 1.0, 0.0]))
    torch.testing.assert_close(frame.bitangent, torch.tensor([-1.0, 0.0, 0.0]))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_frame_with_a_tangent_along_the_normal(dtype):
    n = unit(5000, dtype=dtype)
    for tangent in (n, -3 * n, torch.zeros_like(n), n + 1e-5 * unit(5000, dtype=dtype)):
        axes = torch.stack(tb.Frame.from_normal(n, tangent), -2).double()
        assert (axes @ axes.mT - torch.eye(3, dtype=torch.float64)).abs().max() <= 16 * torch.finfo(dtype).eps


def test_frame_there_and_back():
    frame, w = tb.Frame.from_normal(unit(100)), unit(100)
    torch.testing.assert_close(frame.to_world(frame.to_local(w)), w)
    torch.testing.assert_close(frame.to_local(frame.normal), torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).expand(100, 3))


def test_reflect():
    w, n = unit(100), unit(100)
    r = tb.reflect(w, n)
    torch.testing.assert_close((r * n).sum(-1), (w * n).sum(-1))
    torch.testing.assert_close(tb.reflect(r, n), w)


@pytest.mark.parametrize("eta", [0.5, 1 / 1.5, 1.0, 1.5, 2.4])
def test_refract_obeys_snell(eta):
    w, n = unit(1000), unit(1000)
    wt, valid = tb.refract(w, n, eta)
    v = valid.squeeze(-1)
    sin_i, sin_t = torch.linalg.cross(w, n).norm(dim=-1), torch.linalg.cross(wt, n).norm(dim=-1)
    torch.testing.assert_close(eta * sin_t[v], sin_i[v])
    torch.testing.assert_close(wt[v].norm(dim=-1), torch.ones(int(v.sum()), dtype=torch.float64))
    assert bool(((wt * n).sum(-1) * (w * n).sum(-1) <= 0).all()), "on the far side"
    assert bool((torch.linalg.det(torch.stack([w, n, wt], -1)).abs() < 1e-12).all()), "in the plane of incidence"
    assert torch.equal(v, sin_i < eta)
    assert bool((wt[~v] == 0).all())


def test_refract_there_and_back():
    w, n = unit(100), unit(100)
    back, valid = tb.refract(tb.refract(w, n, 1.5)[0], n, 1 / 1.5)
    assert bool(valid.all())
    torch.testing.assert_close(back, w)


def test_refract_batched_eta_and_gradient():
    w, n = torch.tensor([[0.3, 0.1, 0.9]], dtype=torch.float64), torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64)
    eta = torch.tensor([[1.3], [1.5]], dtype=torch.float64, requires_grad=True)
    assert tb.refract(tb.normalize(w), n, eta)[0].shape == (2, 3)
    assert gradcheck(lambda w, eta: tb.refract(tb.normalize(w), n, eta)[0], (w.requires_grad_(), eta))


def test_refract_knows_the_side_to_the_last_digit():
    """n.w of 4e-9, which float32 sums to -4e-9: the ray must not leave on the wrong side of the surface."""
    rng = torch.Generator().manual_seed(0)
    n = tb.normalize(torch.randn(20_000, 3, generator=rng))
    w = tb.normalize(torch.linalg.cross(n, torch.randn(20_000, 3, generator=rng)))
    exact = (w.double() * n.double()).sum(-1)
    plain = (w * n).sum(-1)
    assert bool(((plain < 0) != (exact < 0)).any()), "float32 alone gets some wrong"
    bent, valid = tb.refract(w, n, 1.5)
    assert bool(valid.all())
    assert bool((((bent.double() * n.double()).sum(-1) < 0) == (exact >= 0)).all())


def test_planar_memory():
    v = torch.randn(4, 5, 3)
    p = tb.planar(v)
    assert torch.equal(p, v)
    assert tb.is_planar(p)
    assert not tb.is_planar(v)
    assert p.stride() == (5, 1, 20)
    assert tb.planar(p).data_ptr() == p.data_ptr(), "no copy of what is planar"
    for made in (tb.normalize(v), tb.reflect(v, v), tb.Frame.from_normal(v).tangent):
        assert tb.is_planar(made)


@pytest.mark.parametrize("half", [torch.float16, torch.bfloat16])
def test_half_types_round_once(half):
    w, n = unit(200).to(half), unit(200).to(half)
    exact = tb.reflect(w.double(), n.double())
    found = tb.reflect(w, n)
    assert found.dtype == half
    # half an ulp, and what float32 adds before it
    assert bool(((found.double() - exact).abs() <= 0.51 * torch.finfo(half).eps * exact.abs().clamp_min(2.0**-8)).all())
    assert tb.normalize(w).dtype == half
    assert tb.refract(w, n, 1.5)[0].dtype == half
    assert tb.Frame.from_normal(n).to_world(w).dtype == half


def test_geometry_invariants():
    wi, wo, n = (unit(500) for _ in range(3))
    g = Geometry(Viewer(components(wo), components(n)), components(wi))
    h = tb.normalize(wi + wo)
    expected = {
        "cos_i": (wi * n).sum(-1),
        "cos_o": (wo * n).sum(-1),
        "wi_h": (wi * h).sum(-1),
        "cos_h": (n * h).sum(-1),
        "sin2_h": torch.linalg.cross(n, h).square().sum(-1),
        "half2": (wi + wo).square().sum(-1),
        "mirror_complement": 1.0 - (wi * tb.reflect(wo, n)).sum(-1),
    }
    for name, value in expected.items():
        torch.testing.assert_close(getattr(g, name), value, msg=name)
    assert g.cos_i is g.cos_i, "computed once"


def test_invariants_keep_their_digits_at_the_mirror_direction():
    """In float32, an angle of 1e-4 off the mirror direction: 1 - cos is 5e-9, far below eps."""
    off = torch.tensor(1e-4, dtype=torch.float64)
    wi = torch.stack([torch.sin(off), torch.zeros_like(off), torch.cos(off)]).float()
    up = torch.tensor([0.0, 0.0, 1.0])
    g = Geometry(Viewer(components(up), components(up)), components(wi))
    assert float(g.mirror_complement) == pytest.approx(float(1 - torch.cos(off)), rel=1e-3)
    assert float(g.sin2_h) == pytest.approx(float(torch.sin(off / 2) ** 2), rel=1e-3)


def test_each_refuses_mixed_channels():
    with pytest.raises(ValueError, match="different numbers of channels"):
        geometry.each(lambda a, b: a + b, (torch.ones(1),) * 3, (torch.ones(1),) * 2)


def test_components_are_views():
    v = torch.randn(7, 3)
    c = components(v)
    assert isinstance(c, Vec)
    assert c.x.data_ptr() == v.data_ptr()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: tb.normalize([0.0, 0.0, 1.0]), "v: expected a tensor of floats, found list"),
        (lambda: tb.normalize(torch.tensor([0, 0, 1])), "v: expected a tensor of floats, found torch.int64"),
        (lambda: tb.normalize(torch.ones(4)), r"v: expected shape \[..., 3\], found \[4\]"),
        (lambda: tb.reflect(torch.ones(3), torch.ones(2)), r"n: expected shape \[..., 3\], found \[2\]"),
        (
            lambda: tb.refract(torch.ones(3, dtype=torch.complex64), torch.ones(3), 1.5),
            "w: expected a tensor of floats, found torch.complex64",
        ),
        (lambda: tb.Frame.from_normal(torch.ones(4)), r"n: expected shape \[..., 3\], found \[4\]"),
    ],
)
def test_directions_that_are_none(call, message):
    with pytest.raises((TypeError, ValueError), match=message):
        call()
