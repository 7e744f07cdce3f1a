"""Closed forms of each model, and what the contract cannot know."""

import math

import pytest
import torch

import torchbrdf as tb
from torchbrdf.bsdf.base import PLANAR_CHANNELS
from torchbrdf.testing.energy import hemisphere
from torchbrdf.testing.subject import above, at_angles, directions, generator

UP = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64)
EXPONENTS = (0.0, 0.3, 1.0, 5.0, 30.0, 200.0)


def integral(bsdf, wo=UP):
    value, moved = hemisphere(bsdf, wo)
    assert moved < 1e-4
    return value.item()


@pytest.mark.parametrize("s", EXPONENTS)
def test_phong_albedo_at_normal_incidence(s):
    assert integral(tb.Phong(1.0, s, normalization="bound")) == pytest.approx((s + 1) / (s + 2), abs=1e-4)
    assert integral(tb.Phong(1.0, s, normalization="modified")) == pytest.approx(1.0, abs=1e-4)
    assert integral(tb.Phong(1.0, s, normalization="none")) == pytest.approx(2 * math.pi / (s + 2), abs=1e-4)


@pytest.mark.parametrize("s", EXPONENTS)
def test_blinn_phong_albedo_is_one_at_normal_view(s):
    assert integral(tb.BlinnPhong(1.0, s)) == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize("s", [0.0, 0.1, 0.5, 1.0, 3.0, 10.0, 100.0])
@pytest.mark.parametrize("model", [tb.Phong, tb.BlinnPhong], ids=["Phong", "BlinnPhong"])
def test_no_angle_reflects_more_than_the_strength(model, s):
    albedo = model(1.0, s).directional_albedo(at_angles(*range(0, 90, 5)), order=96)
    assert float(albedo.max()) <= 1.0 + 2e-4  # the quadrature's own error at order 96


def test_phong_by_hand():
    """wo at 30 degrees, wi at 10 degrees on the other side: 20 degrees off the mirror direction."""
    wo, wi = (torch.tensor([math.sin(a), 0.0, math.cos(a)], dtype=torch.float64) for a in (math.radians(30), -math.radians(10)))
    expected = 0.7 * math.cos(math.radians(20)) ** 12
    assert tb.Phong(0.7, 12.0, normalization="none").evaluate(wi, wo).item() == pytest.approx(expected, rel=1e-13)
    f = 0.2 + 0.8 * (1 - math.cos(math.radians(20))) ** 5  # the half angle
    tinted = tb.Phong(0.7, 12.0, fresnel=tb.Schlick(0.2), normalization="none").evaluate(wi, wo).item()
    assert tinted == pytest.approx(expected * f, rel=1e-13)
    h = math.cos(math.radians(10))
    factor = 14 * 16 / (8 * math.pi * (2**-6 + 12))
    assert tb.BlinnPhong(0.7, 12.0).evaluate(wi, wo).item() == pytest.approx(0.7 * factor * h**12, rel=1e-13)


def test_lambert():
    f = tb.Lambert([0.9, 0.5, 0.1]).evaluate(UP, UP)
    torch.testing.assert_close(f * math.pi, torch.tensor([[0.9, 0.5, 0.1]], dtype=torch.float64))
    torch.testing.assert_close(tb.Lambert(0.4).directional_albedo(above(5, generator(0))), torch.full((5, 1), 0.4, dtype=torch.float64))
    assert tb.Lambert(0.4).directional_albedo(-UP).item() == 0


def test_mirror():
    wo = at_angles(60.0)
    s = tb.Mirror([1.0, 0.5], tb.Dielectric(1.5)).sample(wo, torch.rand(1, 2, dtype=torch.float64))
    expected = tb.fresnel.dielectric(torch.tensor(0.5, dtype=torch.float64), 1.5).item()
    assert s.weight.tolist() == [[pytest.approx(expected), pytest.approx(0.5 * expected)]]
    torch.testing.assert_close(s.wi, wo * torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64))
    assert s.pdf.item() == 1
    assert tb.Mirror().evaluate(s.wi, wo).item() == 0
    assert tb.Mirror().lobes == (tb.Lobe.DELTA_REFLECTION,)
    assert tb.Mirror().sample(-wo, torch.rand(1, 2, dtype=torch.float64)).weight.item() == 0
    assert tb.Mirror([0.3, 0.5], tb.Dielectric(1.5)).energy_bound.tolist() == tb.Mirror([0.3, 0.5]).energy_bound.tolist()
    assert tb.Mirror([0.3, 0.5]).energy_bound.tolist() == pytest.approx([0.3, 0.5]), "reached at grazing, or without a Fresnel term"


def test_a_delta_has_no_density_but_a_probability():
    """`pdf` is that of the other lobes; a sample of a delta says how likely its lobe was."""
    wo = at_angles(30.0)
    for model, delta in ((tb.Mirror(0.5), 0), (tb.Lambert(0.5) + tb.Mirror(0.5), 1)):
        for u in (0.01, 0.99):
            s = model.sample(wo, torch.tensor([[0.3, 0.6, u]], dtype=torch.float64))
            density = model.pdf(s.wi, wo)
            chosen_delta = s.lobe.item() == delta
            assert chosen_delta == bool(model.lobes[s.lobe.item()] & tb.Lobe.DELTA)
            if chosen_delta:
                assert s.pdf.item() == pytest.approx(1.0 if delta == 0 else 0.5)
                lambert = 0.5 * tb.Lambert(0.5).pdf(s.wi, wo).item()
                assert density.item() == pytest.approx(0.0 if delta == 0 else lambert)
            else:
                assert s.pdf.item() == pytest.approx(density.item())


def test_sum_and_scaled():
    a, b = tb.Lambert([0.1, 0.2, 0.3]), tb.Phong(0.4, 9.0)
    wi, wo = above(50, generator(1)), above(50, generator(2))
    both = 2.0 * (a + b) + b * [0.5, 0.0, 1.0]
    expected = 2 * a.evaluate(wi, wo) + (2 + torch.tensor([0.5, 0.0, 1.0], dtype=torch.float64)) * b.evaluate(wi, wo)
    torch.testing.assert_close(both.evaluate(wi, wo), expected)
    assert len((a + b + a).terms) == 3, "flat"
    assert both.lobes == (tb.Lobe.DIFFUSE_REFLECTION, tb.Lobe.GLOSSY_REFLECTION, tb.Lobe.GLOSSY_REFLECTION)
    assert both.energy_bound.tolist() == pytest.approx([2 * 0.5 + 0.2, 2 * 0.6, 2 * 0.7 + 0.4])
    assert (a + tb.Phong(0.4, 9.0, normalization="none")).energy_bound is None
    assert both.select(tb.Lobe.DELTA) is None
    torch.testing.assert_close((a + b).select(tb.Lobe.GLOSSY).evaluate(wi, wo), b.evaluate(wi, wo).expand(50, 1))


def test_pdf_and_sampler_agree_in_any_frame():
    """The choice between the terms of a sum must not depend on the azimuth of the frame it is made in."""
    bsdf = tb.Lambert(0.3) + tb.Phong(0.5, 8.0) + tb.BlinnPhong(0.4, 60.0)
    n = tb.normalize(torch.randn(500, 3, dtype=torch.float64))
    wo = tb.Frame.from_normal(n).to_world(above(500, generator(3)))
    s = bsdf.sample(wo, torch.rand(500, 3, dtype=torch.float64), n)
    torch.testing.assert_close(s.pdf, bsdf.pdf(s.wi, wo, n), rtol=1e-9, atol=1e-12)


def test_local_frame_is_z_up():
    wi, wo = above(20, generator(4)), above(20, generator(5))
    bsdf = tb.Phong(0.5, 8.0, fresnel=tb.Dielectric(1.5)) + tb.BlinnPhong(0.4, 60.0)
    torch.testing.assert_close(bsdf.evaluate(wi, wo), bsdf.evaluate(wi, wo, UP.expand(20, 3)))
    torch.testing.assert_close(bsdf.evaluate(3 * wi, wo / 7), bsdf.evaluate(wi, wo, assume_unit=True))


@pytest.mark.parametrize("channels", [1, 2, 3, 4, 5, 31])
def test_any_number_of_channels(channels):
    """Few are written out, many broadcast; each channel is what it is alone."""
    gen = generator(channels)
    k, f0, eta = (torch.rand(channels, generator=gen, dtype=torch.float64) + 0.1 for _ in range(3))
    wi, wo, u = above(6, gen), above(6, gen), torch.rand(6, 3, generator=gen, dtype=torch.float64)

    def model(i):
        diffuse = tb.Lambert(k[i] * 0.5) + tb.Phong(k[i], 9.0, fresnel=tb.Schlick(f0[i] * 0.5))
        return (
            diffuse + tb.BlinnPhong(k[i] * 0.5, 9.0, fresnel=tb.Conductor(eta[i], k[i])) + k[i] * tb.Mirror(0.5, tb.Dielectric(1 + eta[i]))
        )

    every = slice(None)
    assert model(every).is_wide == (channels > PLANAR_CHANNELS)
    for c in range(0, channels, max(1, channels // 5)):
        one = slice(c, c + 1)
        torch.testing.assert_close(model(every).evaluate(wi, wo)[:, one], model(one).evaluate(wi, wo))
        torch.testing.assert_close(model(every).directional_albedo(wo)[:, one], model(one).directional_albedo(wo))
    assert model(every).pdf(wi, wo).shape == (6, 1)
    sample = model(every).sample(wo, u)
    assert [tuple(x.shape) for x in sample] == [(6, 3), (6, channels), (6, 1), (6, 1), (6, 1)]


def test_sharp_lobe_in_float32():
    """Exponent 1e6: the peak must be right, and the lobe must integrate, where the cosine has no digits left."""
    theta = torch.linspace(0, 5e-3, 2001, dtype=torch.float64)
    wi = torch.stack([torch.sin(theta), torch.zeros_like(theta), torch.cos(theta)], -1)
    exact = torch.cos(theta) ** 1e6
    found = tb.Phong(1.0, 1e6, normalization="none").evaluate(wi.float(), UP.float().expand(2001, 3)).squeeze(-1).double()
    alive = exact > 1e-3
    # 2e-5 holds to exponents of 3e3; beyond, the rounding of the directions costs s theta eps
    assert float(((found - exact) / exact)[alive].abs().max()) <= 1e-2
    assert float((found - exact).abs().max()) <= 1e-3


@pytest.mark.parametrize("kind", ["cuda", "meta"])
def test_parameters_given_as_numbers_follow_the_device(kind):
    """Without a device of that kind: shapes and devices are traced, nothing is computed."""
    from torch._subclasses.fake_tensor import FakeTensorMode

    for channels in (3, 6):
        c = [0.5] * channels
        bsdf = (
            tb.Lambert(c) + tb.Phong(c, 20.0, fresnel=tb.Dielectric(1.5)) + 0.3 * tb.Mirror(c, tb.Conductor(c, c)) + tb.BlinnPhong(0.2, 9.0)
        )
        with FakeTensorMode(allow_non_fake_inputs=True):
            w, u = torch.empty(7, 3, device=kind), torch.empty(7, 3, device=kind)
            s = bsdf.sample(w, u, w)
            results = (bsdf.evaluate(w, w, w), bsdf.pdf(w, w), bsdf.directional_albedo(w), s.wi, s.weight, s.pdf)
            assert all(r.device.type == kind and r.dtype == torch.float32 for r in results)


BELOW = (tb.Lambert(0.3), tb.Phong(0.5, 8.0), tb.BlinnPhong(0.4, 60.0), tb.Mirror(0.5))
SUMS = (BELOW[0] + BELOW[1] + BELOW[2], BELOW[0] + BELOW[3], 2.0 * BELOW[1], tb.TwoSided(BELOW[1] + BELOW[0]))


@pytest.mark.parametrize("bsdf", [*BELOW, *SUMS], ids=lambda b: type(b).__name__)
def test_no_direction_below_the_horizon_has_a_density(bsdf):
    """Neither to the light nor to the viewer; a two-sided model has one where both are below."""
    wi, wo = above(200, generator(6)), above(200, generator(7))
    assert bsdf.pdf(wi, wo).any() or isinstance(bsdf, tb.Mirror)
    for a, b in ((-wi, wo), (wi, -wo), (-wi, -wo)):
        both = isinstance(bsdf, tb.TwoSided) and a is not wi and b is not wo
        assert both or not bsdf.pdf(a, b).any()


def test_a_sum_samples_its_terms_as_they_reflect():
    """Shares 1 : 2 : 1 among lobes, a factor and a mirror counted in; every weight is then about the whole albedo."""
    wo = at_angles(0.0).expand(4000, 3)
    u = torch.quasirandom.SobolEngine(3, scramble=True, seed=0).draw(4000, dtype=torch.float64)
    for bsdf, shares in {
        tb.Lambert([0.1, 0.3]) + tb.Lambert(0.4) + 0.5 * tb.Lambert(0.4): [0.25, 0.5, 0.25],
        tb.Mirror([0.1, 0.3]) + tb.Lambert(0.4) + 0.5 * tb.Mirror(0.4): [0.25, 0.5, 0.25],
        tb.Lambert(0.2) + tb.BlinnPhong(0.2, 0.0) + tb.Lambert(0.0): [0.5, 0.5, 0.0],
    }.items():
        s = bsdf.sample(wo, u)
        assert [(s.lobe == k).double().mean().item() for k in range(3)] == pytest.approx(shares, abs=2e-3)
        torch.testing.assert_close(s.weight.mean(0), bsdf.directional_albedo(wo[0]), rtol=0.02, atol=0)


def test_shares_teach_nothing():
    """Weights of samples that stay where they are have the gradient of the albedo only if the choice among terms has none."""
    a = torch.tensor([0.2, 0.6], dtype=torch.float64, requires_grad=True)
    wo, u = at_angles(30.0).expand(4096, 3), torch.quasirandom.SobolEngine(3, scramble=True, seed=0).draw(4096, dtype=torch.float64)
    for bsdf in (tb.Lambert(a) + tb.Lambert(0.3), tb.Mirror(a) + tb.Lambert(0.3)):
        (slope,) = torch.autograd.grad(bsdf.sample(wo, u).weight.mean(0).sum(), a)
        torch.testing.assert_close(slope, torch.ones_like(a), rtol=0.01, atol=0)
        assert not bsdf.pdf(wo, wo).requires_grad


def test_a_black_sum_still_samples():
    black = tb.Lambert(0.0) + tb.BlinnPhong(0.0, 5.0)
    wi, wo = above(20, generator(8)), above(20, generator(9))
    mean = 0.5 * (tb.Lambert(0.5).pdf(wi, wo) + tb.BlinnPhong(0.5, 5.0).pdf(wi, wo))
    torch.testing.assert_close(black.pdf(wi, wo), mean)
    s = black.sample(wo, torch.rand(20, 3, dtype=torch.float64))
    assert (s.weight == 0).all()
    torch.testing.assert_close(s.wi.norm(dim=-1), torch.ones(20, dtype=torch.float64))


@pytest.mark.parametrize("local", [True, False])
def test_delta_lobes_know_their_cosine(local):
    """On the viewer's side of the surface, whichever that is."""
    frame = tb.Frame.from_normal(directions(40, generator(10)))
    wo, n = directions(40, generator(11)), torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64) if local else frame.normal
    for bsdf in (tb.Mirror(), tb.TwoSided(tb.Mirror(0.5)), tb.TwoSided(tb.Mirror(0.5), 0.5 * tb.Mirror()) + tb.Lambert(0.1)):
        viewer = bsdf.viewer(wo, None if local else n)
        for d in bsdf.deltas(viewer):
            wi = viewer.layout.join_vector(d.wi)
            torch.testing.assert_close(d.cos_i, (n * wi).sum(-1))
            torch.testing.assert_close(wi, tb.reflect(wo, n.expand_as(wo)))


def test_a_two_sided_term_is_sampled_as_its_viewers_side_reflects():
    bsdf = tb.TwoSided(tb.Lambert(0.1), tb.Lambert(0.4)) + tb.TwoSided(tb.Lambert(0.3))
    u = torch.quasirandom.SobolEngine(3, scramble=True, seed=0).draw(4000, dtype=torch.float64)
    for wo, shares in ((UP, [0.0, 4 / 7, 3 / 7]), (-UP, [1 / 4, 0.0, 3 / 4])):
        lobe = bsdf.sample(wo.expand(4000, 3), u).lobe
        assert [(lobe == k).double().mean().item() for k in range(3)] == pytest.approx(shares, abs=2e-3)
