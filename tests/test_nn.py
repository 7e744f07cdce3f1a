"""Fields: what they start at, what they stay within, where a texture's texels lie, and where gradients go."""

import math

import pytest
import torch
from torch.autograd import gradcheck

import torchbrdf as tb
from torchbrdf.interval import NONNEGATIVE, REAL, UNIT
from torchbrdf.value import COLOUR, value

ETA = tb.Dielectric.params()["eta"].constraint


@value
class Pair(tb.Value):
    """Two parameters of one range."""

    first: torch.Tensor = tb.param(UNIT, COLOUR)
    second: torch.Tensor = tb.param(UNIT, COLOUR)


def points(*pixels, **fields):
    up = torch.tensor([0.0, 0.0, 1.0]).expand(*pixels, 3)
    return tb.GBuffer(torch.rand(*pixels, 3), up, up, **fields)


def with_uv(uv):
    return points(*uv.shape[:-1], uv=uv).to(uv.dtype)


def test_constant_is_fixed_and_learned_is_a_parameter():
    g = points(2, 3)
    for given in (0.25, [0.25, 0.5], torch.tensor([0.25, 0.5]), torch.tensor([0.25, 0.5]).double().numpy(), 2, [1, 2]):
        fixed, learned = tb.nn.Constant(given), tb.nn.Learned(given)
        expected = torch.as_tensor(given).reshape(-1).float()
        assert torch.equal(fixed(g), expected)
        assert torch.equal(learned(g).detach(), expected)
        assert not list(fixed.parameters())
        assert [n for n, _ in learned.named_parameters()] == ["raw"]
        assert set(fixed.state_dict()) == {"raw"}
    assert tb.nn.Learned(torch.ones(2).double()).raw.dtype == torch.float64
    start = torch.ones(2)
    field = tb.nn.Learned(start)
    start += 1
    assert torch.equal(field(g), torch.ones(2)), "a field owns its numbers"


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(("constraint", "starts"), [(UNIT, [1e-12, 1e-5, 0.1, 0.5, 0.9, 0.99999]), (NONNEGATIVE, [1e-9, 1e-3, 1.0, 20.0, 1e7]), (ETA, [1e-3, 1.1, 1.5, 30.0]), (REAL, [-4.0, 0.0, 9.0])], ids=str)  # fmt: skip
def test_learned_starts_at_its_init(constraint, starts, dtype):
    """To rounding: the logarithm's half ulp, multiplied by its own size, which is below 32 here."""
    init = torch.tensor(starts, dtype=dtype)
    field = tb.nn.Learned(init)
    field.bind(constraint, "here")
    torch.testing.assert_close(field(None).detach(), init, rtol=32 * torch.finfo(dtype).eps, atol=0)


def test_a_start_on_the_bound_begins_just_inside_and_can_leave():
    for constraint, bound in ((UNIT, 0.0), (UNIT, 1.0), (NONNEGATIVE, 0.0)):
        field = tb.nn.Learned([bound])
        field.bind(constraint, "here")
        assert 0 < abs(field(None).item() - bound) < 1e-3
        target = abs(bound - 0.3)
        optimiser = torch.optim.Adam(field.parameters(), lr=0.3)
        for _ in range(200):
            optimiser.zero_grad()
            (field(None) - target).square().sum().backward()
            optimiser.step()
        assert field(None).item() == pytest.approx(target, abs=1e-3)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(("owner", "name", "flat"), [(tb.Dielectric, "eta", 1.0), (tb.Conductor, "k", 0.0)])
def test_a_start_where_no_slope_is_begins_beside_it(owner, name, flat, dtype):
    """There every slope is exactly 0, for ever; the root of the root of eps away, reflectances change by its root."""
    field = tb.nn.Learned(torch.tensor([flat], dtype=dtype))
    field.bind(owner.params()[name].constraint, "here")
    assert field(None).item() - flat == pytest.approx(torch.finfo(dtype).eps ** 0.25, rel=1e-3)


@pytest.mark.parametrize("constraint", [UNIT, NONNEGATIVE, ETA, tb.Interval(-2.0, 5.0)], ids=str)
def test_the_way_back_from_any_step(constraint):
    """A step of any length leaves a slope, up to where the largest number of the dtype is near."""
    for raw in (-40.0, -9.0, 3.0, 30.0, 40.0, 1e4 if constraint.high < 10 else 60.0):
        u = torch.tensor(raw, requires_grad=True)
        (slope,) = torch.autograd.grad(constraint.from_unconstrained(u), u)
        assert abs(slope.item()) > torch.finfo(torch.float32).tiny, raw


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("constraint", [UNIT, NONNEGATIVE, ETA, tb.Interval(1.0, open_low=True), tb.Interval(-2.0, 5.0)], ids=str)
def test_no_step_leaves_the_range(constraint, dtype):
    field = tb.nn.Learned(torch.tensor([1.5 if constraint.high > 1 else 0.5], dtype=dtype))
    field.bind(constraint, "here")
    for step in (1e-3, 1.0, 30.0, 1e3, 1e30, math.inf):
        for sign in (-1.0, 1.0):
            optimiser = torch.optim.SGD(field.parameters(), lr=1.0)
            field.raw.grad = torch.tensor([sign * step], dtype=dtype)
            before = field.raw.detach().clone()
            optimiser.step()
            assert bool(constraint.contains(field(None).detach()).all()), f"after a step of {sign * step}"
            with torch.no_grad():
                field.raw.copy_(before)


def test_bind_refuses_starts_outside_and_two_different_ranges():
    with pytest.raises(
        ValueError, match=r"Lambert.albedo: the field starts outside: legal range \[0, 1\], found 1.2 \(min 0.2, max 1.2\); start it inside"
    ):
        tb.nn.Material(tb.Lambert, albedo=tb.nn.Learned([0.2, 1.2]))
    shared = tb.nn.Learned([0.5])
    with pytest.raises(
        ValueError,
        match=r"Phong.exponent: its range is \[0, inf\), but this field already serves Lambert.albedo, whose range is \[0, 1\]; give each its own",
    ):
        tb.nn.Material(tb.Lambert, albedo=shared) + tb.nn.Material(tb.Phong, specular=0.1, exponent=shared)


def test_one_field_may_serve_two_parameters_of_one_range():
    one = tb.nn.Learned([0.5])
    same = tb.nn.Material(tb.Mirror, tint=one, fresnel=tb.nn.Material(tb.Schlick, f0=one))
    assert torch.equal(same(None).tint, same(None).fresnel.f0)
    assert len(list(same.parameters())) == 1
    both = tb.nn.Learned([[0.5], [0.7]])
    twice = tb.nn.Material(Pair, first=both, second=both)(None)  # the same field under two names of one module
    assert torch.equal(twice.first, twice.second)


def test_texel_centres_and_the_bottom_row():
    texels = torch.rand(3, 4, 2)
    texture = tb.nn.Texture(texels)
    for row in range(3):
        for column in range(4):
            uv = torch.tensor([(column + 0.5) / 4, 1 - (row + 0.5) / 3])
            torch.testing.assert_close(texture.at(uv), texels[row, column])
    clamped = tb.nn.Texture(texels, wrap="clamp")
    assert torch.equal(clamped.at(torch.tensor([0.0, 0.0])), texels[2, 0])  # v = 0 is the bottom edge
    assert torch.equal(clamped.at(torch.tensor([1.0, 1.0])), texels[0, 3])
    middle = texture.at(torch.tensor([0.5, 1 - 2 / 3]))
    torch.testing.assert_close(middle, texels[1:3, 1:3].mean((0, 1)))


def test_a_picture_saved_and_read_lands_the_right_way_up(tmp_path):
    picture = torch.zeros(4, 4, 3)
    picture[0] = torch.tensor([1.0, 0.0, 0.0])  # the top row is red
    tb.save_image(tmp_path / "t.png", picture)
    texture = tb.nn.Texture(tb.read_image(tmp_path / "t.png"), wrap="clamp")
    assert torch.equal(texture.at(torch.tensor([0.3, 0.99])), torch.tensor([1.0, 0.0, 0.0]))
    assert torch.equal(texture.at(torch.tensor([0.3, 0.01])), torch.zeros(3))


def test_repeat_is_the_default_and_clamp_holds_the_edge():
    texels = torch.rand(3, 4, 2, dtype=torch.float64)
    uv = torch.rand(50, 2, dtype=torch.float64)
    texture = tb.nn.Texture(texels)
    for shift in ([1.0, 0.0], [0.0, -1.0], [-3.0, 7.0]):
        torch.testing.assert_close(texture.at(uv + torch.tensor(shift)), texture.at(uv))
    across = texture.at(torch.tensor([0.0, 0.5], dtype=torch.float64))  # the seam: half of the last column, half of the first
    torch.testing.assert_close(across, 0.5 * (texels[1, 0] + texels[1, 3]))
    clamped = tb.nn.Texture(texels, wrap="clamp")
    torch.testing.assert_close(clamped.at(torch.tensor([-5.0, 9.0]).double()), texels[0, 0])
    torch.testing.assert_close(clamped.at(torch.tensor([9.0, -5.0]).double()), texels[2, 3])


def test_texture_answers_in_the_shape_of_the_points_and_planar():
    texture = tb.nn.Texture(torch.rand(5, 6, 3))
    found = texture(with_uv(torch.rand(2, 7, 8, 2)))
    assert found.shape == (2, 7, 8, 3)
    assert tb.is_planar(found)
    one = tb.nn.Texture(torch.rand(1, 1, 1))
    assert torch.equal(one(with_uv(torch.rand(4, 2))), one.raw[0, 0].expand(4, 1))


def test_interpolation_never_leaves_the_range_of_the_texels():
    """Not by one rounding: a white texture must stay a legal albedo."""
    g = with_uv(torch.rand(200, 200, 2) * 3 - 1)
    assert torch.equal(tb.nn.Texture(torch.ones(7, 5, 3))(g), torch.ones(200, 200, 3))
    found = tb.nn.Texture(torch.rand(7, 5, 1).round())(g)
    assert found.min() >= 0
    assert found.max() <= 1


def test_srgb_only_if_asked():
    coded = torch.tensor([0.02, 0.5, 1.0]).reshape(1, 1, 3)
    uv = torch.tensor([0.3, 0.3])
    assert torch.equal(tb.nn.Texture(coded).at(uv), coded[0, 0])
    expected = torch.tensor([0.02 / 12.92, ((0.5 + 0.055) / 1.055) ** 2.4, 1.0])  # IEC 61966-2-1
    torch.testing.assert_close(tb.nn.Texture(coded, srgb=True).at(uv), expected)
    grey = tb.nn.Texture(coded[..., 1:2], srgb=True)
    torch.testing.assert_close(grey.at(uv), expected[1:2])
    grey.at(uv).sum().backward()
    assert grey.raw.grad.item() > 0
    # Light mixes linearly: decoded first, then interpolated.
    pair = tb.nn.Texture(torch.tensor([0.0, 1.0]).reshape(1, 2, 1).expand(1, 2, 3), srgb=True)
    torch.testing.assert_close(pair.at(torch.tensor([0.5, 0.5])), torch.full((3,), 0.5))


@pytest.mark.parametrize("wrap", ["repeat", "clamp"])
def test_gradients_to_texels_and_uv(wrap):
    uv = torch.tensor([[0.13, 0.42], [0.97, 0.05], [0.61, 0.88], [1.7, -0.4]], dtype=torch.float64)  # off the centres' grid

    def look(texels, uv):
        return torch.func.functional_call(tb.nn.Texture(torch.zeros(3, 4, 2).double(), wrap=wrap), {"raw": texels}, (with_uv(uv),))

    assert gradcheck(look, (torch.rand(3, 4, 2, dtype=torch.float64, requires_grad=True), uv.requires_grad_()))


@pytest.mark.parametrize("junk", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("wrap", ["repeat", "clamp"])
def test_uv_that_are_no_numbers_read_some_texel_without_gradient(wrap, junk):
    uv = torch.rand(4, 2)
    uv[1] = junk
    uv.requires_grad_()
    texture = tb.nn.Texture(torch.rand(3, 4, 2), wrap=wrap)
    found = texture.at(uv)
    assert torch.isfinite(found).all()
    found.sum().backward()
    assert torch.isfinite(uv.grad).all()
    assert (uv.grad[1] == 0).all()
    assert torch.isfinite(texture.raw.grad).all()


def test_half_precision_uv_are_looked_up_in_single_precision():
    """Half a texel of 64 is lost when u * 64 itself is rounded to half precision."""
    texture = tb.nn.Texture(torch.rand(64, 64, 1))
    uv = torch.rand(50, 2).half()
    assert torch.equal(texture.at(uv), texture.at(uv.float()))


def test_channel_and_per_material():
    texture = tb.nn.Texture(torch.rand(3, 4, 3))
    g = with_uv(torch.rand(5, 2))
    channel = tb.nn.Channel(texture, 1)
    assert torch.equal(channel(g), texture(g)[..., 1:2])
    with pytest.raises(IndexError, match=r"Channel.i: found 3, legal are 0 to 2"):
        tb.nn.Channel(texture, 3)(g)
    table = torch.rand(4, 3)
    ids = torch.tensor([[0, 3, 3], [1, 2, -1]]).unsqueeze(-1)
    per = tb.nn.PerMaterial(table)
    found = per(points(2, 3, material=ids))
    assert torch.equal(found.detach(), table[ids[..., 0].clamp_min(0)])
    assert tb.is_planar(found)
    found[0].sum().backward()
    assert torch.equal(per.raw.grad, torch.tensor([1.0, 0.0, 0.0, 2.0]).unsqueeze(-1).expand(4, 3))
    assert not list(tb.nn.PerMaterial(table, learned=False).parameters())


def test_channels_of_one_texture_serve_two_parameters():
    packed = tb.nn.Texture(torch.rand(4, 4, 2))
    mirror = tb.nn.Material(tb.Mirror, tint=tb.nn.Channel(packed, 0), fresnel=tb.nn.Material(tb.Schlick, f0=tb.nn.Channel(packed, 1)))
    g = with_uv(torch.rand(6, 2))
    value = mirror(g)
    assert torch.equal(torch.cat([value.tint, value.fresnel.f0], -1), packed(g))
    assert len(list(mirror.parameters())) == 1
    with pytest.raises(ValueError, match="already serves"):
        tb.nn.Material(tb.BlinnPhong, specular=tb.nn.Channel(packed, 0), exponent=tb.nn.Channel(packed, 1))
