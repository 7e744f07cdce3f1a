"""Constraints: what is legal, what is drawn, and that no step of an optimiser leaves it; intervals of every kind, directions, rotations."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor
from torch.autograd import gradcheck

import torchbrdf as tb
from torchbrdf.constraint import ROTATION, UNIT_DIRECTION
from torchbrdf.interval import UNIT
from torchbrdf.testing.instances import of_class
from torchbrdf.value import COLOUR, param, value

LARGEST = torch.finfo(torch.float32).max
ROUGHNESS = tb.Interval(0.0, 1.0, open_low=True)
KINDS = [
    ROUGHNESS,
    tb.Interval(0.0, 1.0, open_high=True),
    tb.Interval(0.0, 1.0, open_low=True, open_high=True),
    tb.Interval(-3.0, 5.0, open_low=True),
    tb.Interval(1.0, 1.5, open_high=True),
    tb.Interval(10.0, 11.0, open_low=True, open_high=True),
    tb.Interval(high=2.0),
    tb.Interval(high=-1.0, open_high=True),
    tb.Interval(-1.0, open_low=True),
]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("interval", KINDS, ids=str)
def test_an_open_end_is_never_reached(interval, dtype):
    u = torch.tensor([0.0, 1e-30, 1.0, 17.0, 40.0, 90.0, 200.0, 1e4, 1e30, LARGEST, math.inf], dtype=dtype)
    x = interval.from_unconstrained(torch.cat([u, -u]))
    assert bool(interval.contains(x).all())
    for end, is_open in ((interval.low, interval.open_low), (interval.high, interval.open_high)):
        if math.isfinite(end):
            assert bool((x == end).any()) is not is_open, "a closed end is reached, an open one is not"


@pytest.mark.parametrize("interval", KINDS, ids=str)
def test_the_way_there_and_back(interval):
    x = interval.draw((500,), torch.Generator().manual_seed(0))
    assert bool(interval.contains(x).all())
    torch.testing.assert_close(interval.from_unconstrained(interval.to_unconstrained(x)), x)
    for end in interval.extremes():
        at = torch.tensor([end], dtype=torch.float64)
        beside = interval.from_unconstrained(interval.to_unconstrained(at))
        assert bool(interval.contains(at).all())
        assert 0 < float((beside - at).abs()) < 1e-6, "a start on a closed end begins beside it, where there is a slope"
    u = interval.to_unconstrained(x[:5]).requires_grad_()
    assert gradcheck(interval.from_unconstrained, u)


@settings(deadline=None, max_examples=200)
@given(
    st.floats(-1e6, 1e6),
    st.floats(1e-3, 1e6),
    st.booleans(),
    st.booleans(),
    st.lists(st.floats(width=32, allow_nan=False), min_size=1, max_size=20),
)
def test_any_interval_holds_any_step(low, span, open_low, open_high, u):
    interval = tb.Interval(low, low + span, open_low=open_low, open_high=open_high)
    for dtype in (torch.float32, torch.float64):
        if span < 64 * torch.finfo(dtype).eps * max(abs(low), abs(low + span)):
            continue  # hardly a number of the dtype lies between the ends
        x = interval.from_unconstrained(torch.tensor(u, dtype=dtype))
        assert bool(interval.contains(x).all()), (interval, x)


def test_a_learned_roughness_comes_back_from_both_ends():
    """The slope near the open end is the value itself: a step there is a factor."""
    for start in (1.0, 0.5, 1e-4):
        field = tb.nn.Learned(start)
        field.bind(ROUGHNESS, "roughness")
        optimiser = torch.optim.Adam(field.parameters(), lr=0.2)
        for _ in range(400):
            optimiser.zero_grad()
            loss = (torch.log(field(None)) - math.log(0.03)).square().sum()
            loss.backward()
            optimiser.step()
        assert field(None).item() == pytest.approx(0.03, rel=0.02), start


def test_unit_directions():
    gen = torch.Generator().manual_seed(0)
    d = UNIT_DIRECTION.draw((50, 3), gen)
    assert bool(UNIT_DIRECTION.contains(d).all())
    torch.testing.assert_close(UNIT_DIRECTION.from_unconstrained(7.0 * d), d)
    assert UNIT_DIRECTION.complaint(torch.cat([d, 2 * d[:3]])) == "expected unit vectors, found 3 of another length"
    assert gradcheck(UNIT_DIRECTION.from_unconstrained, (3.0 * d[:4]).requires_grad_())
    for bad in (0.0, math.nan, math.inf):
        u = torch.full((1, 3), bad, requires_grad=True)
        made = UNIT_DIRECTION.from_unconstrained(u)
        assert made.tolist() == [[0.0, 0.0, 1.0]]
        assert not torch.autograd.grad(made.sum(), u)[0].any()


def test_rotations():
    gen = torch.Generator().manual_seed(0)
    turns = ROTATION.draw((40, 3, 3), gen)
    assert bool(ROTATION.contains(turns).all())
    torch.testing.assert_close(torch.linalg.det(turns), torch.ones(40, dtype=torch.float64))
    torch.testing.assert_close(ROTATION.from_unconstrained(turns), turns)
    assert not ROTATION.contains(-turns).any(), "mirrored"
    assert not ROTATION.contains(1.01 * turns).any(), "stretched"
    assert ROTATION.complaint(2 * turns) == "not a rotation"
    for dtype in (torch.float32, torch.bfloat16, torch.float16):
        assert bool(ROTATION.contains(turns.to(dtype)).all()), "rounded"
        assert bool(UNIT_DIRECTION.contains(turns[:, 0].to(dtype)).all())
        assert not ROTATION.contains(1.1 * turns.to(dtype)).any()
    loose = torch.randn(6, 3, 3, generator=gen, dtype=torch.float64)
    assert bool(ROTATION.contains(ROTATION.from_unconstrained(loose)).all())
    assert gradcheck(ROTATION.from_unconstrained, loose.requires_grad_())


@pytest.mark.parametrize("bad", [0.0, math.nan, math.inf, 1.0])
def test_what_is_no_rotation_becomes_one(bad):
    """Zero, not finite, or all rows parallel."""
    u = torch.full((3, 3), bad, requires_grad=True)
    made = ROTATION.from_unconstrained(u)
    assert bool(ROTATION.contains(made))
    assert bool(torch.isfinite(torch.autograd.grad(made.sum(), u)[0]).all())


def test_a_learned_pose_of_a_camera_stays_one():
    """A camera looks for the target that it has lost: no step makes its axes anything but a rotation."""
    target = torch.tensor([[0.5, -1.0, 3.0]])
    start = torch.eye(3)
    camera = tb.nn.Material(
        tb.Camera, origin=torch.zeros(3), rotation=tb.nn.Learned(start), focal=[100.0, 90.0], principal=[32.0, 24.0], size=(48, 64)
    )
    optimiser = torch.optim.Adam(camera.parameters(), lr=0.05)
    for _ in range(200):
        optimiser.zero_grad()
        pixel, _ = camera(None).project(target)
        (pixel - torch.tensor([[10.0, 40.0]])).square().mean().backward()
        optimiser.step()
        assert bool(ROTATION.contains(camera(None).rotation.detach()))
    assert (pixel - torch.tensor([[10.0, 40.0]])).abs().max() < 0.05
    with pytest.raises(ValueError, match=r"Camera.rotation: the field starts outside: not a rotation; start it inside"):
        tb.nn.Material(
            tb.Camera, origin=torch.zeros(3), rotation=tb.nn.Learned(2 * start), focal=[1.0, 1.0], principal=[0.0, 0.0], size=(4, 4)
        )
    with pytest.raises(ValueError, match=r"Camera.rotation \[3, 3\]: not a rotation; take the scale, or the mirroring, out of it"):
        tb.validate(camera(None).replace(rotation=2 * start))


@value
class Lobes(tb.Bsdf):
    """Lafortune's generalised cosine lobes, as an example of a parameter of three axes: K lobes, 3 factors, C colours."""

    factors: Tensor = param(tb.Interval(0.0, 1.0, typical=(0.2, 0.9)), ("K", 3, "C"), "of each lobe")
    exponent: Tensor = param(tb.Interval(1.0, typical=(1.0, 8.0)), ("K", 1), "of each lobe")
    albedo: Tensor = param(UNIT, COLOUR, "of the base")

    lobes = (tb.Lobe.DIFFUSE_REFLECTION,)

    def formula(self, g):
        layout, total = g.viewer.layout, g.colour(self.albedo)
        for lobe, s in zip(layout.rows(self.factors, 3), layout.rows(self.exponent, 2), strict=True):
            x, y, z = (layout.colour(row) for row in layout.rows(lobe, 2))
            wi, wo = g.wi_local, g.viewer.local.wo
            cosines = [torch.relu(a * wi.x * wo.x + b * wi.y * wo.y + c * wi.z * wo.z) for a, b, c in zip(x, y, z, strict=True)]
            total = tuple(t + c ** layout.scalar(s) for t, c in zip(total, cosines, strict=True))
        return tuple(t / math.pi for t in total)

    def density(self, g):
        return torch.relu(g.cos_i) / math.pi

    def draw(self, viewer, u):
        from torchbrdf import sampling
        from torchbrdf.bsdf.lobe import Draw

        return Draw(sampling.cosine_hemisphere(u.x, u.y))

    def kink_distance(self, g):
        return torch.zeros_like(g.cos_i)  # derivatives are not under test here


def test_a_parameter_of_several_axes():
    gen = torch.Generator().manual_seed(0)
    ((_, one),) = of_class(Lobes)
    assert one.factors.shape == (2, 3, 3)
    assert one.batch_shape == ()
    assert one.channels == 3
    many = Lobes(torch.rand(5, 2, 3, 3, generator=gen), torch.rand(5, 2, 1, generator=gen) + 1, torch.rand(3, generator=gen))
    assert many.batch_shape == (5,)
    assert many[2].factors.shape == (2, 3, 3)
    assert many[1:4].batch_shape == (3,)
    wi, wo = (tb.normalize(torch.randn(7, 1, 3, generator=gen) + torch.tensor([0.0, 0.0, 3.0])) for _ in range(2))
    together = many.evaluate(wi, wo)
    assert together.shape == (7, 5, 3)
    for k in range(5):
        torch.testing.assert_close(together[:, k], many[k].evaluate(wi[:, 0], wo[:, 0]))
    torch.testing.assert_close(
        torch.func.vmap(lambda m: m.evaluate(wi[:, 0], wo[:, 0]))(many.replace(albedo=torch.rand(5, 3))).shape, torch.Size([5, 7, 3])
    )
    assert one.evaluate(wi.half(), wo.half()).dtype == torch.float16, "without batch axes it follows the points"
    with pytest.raises(ValueError, match=r"Lobes.exponent: expected shape \[..., K, 1\] with K = 2 as in factors, found \[3, 1\]"):
        Lobes(torch.rand(2, 3, 3), torch.rand(3, 1), 0.5)
    with pytest.raises(ValueError, match=r"Lobes.factors: expected shape \[..., K, 3, C\], found \[3, 3\]"):
        Lobes(torch.rand(3, 3), torch.rand(3, 1), 0.5)
    with pytest.raises(ValueError, match="colour parameters have different numbers of channels"):
        Lobes(torch.rand(2, 3, 3), torch.rand(2, 1), torch.rand(4))
