"""The delta pair of a smooth dielectric: power, directions, radiance; and what is seen through it."""

import oracle
import pytest
import torch

import torchbrdf as tb
from torchbrdf.bsdf.sampler import shares
from torchbrdf.optics.dielectric import split
from torchbrdf.testing.subject import above, directions, generator, mirrored, uniform

DOUBLE = torch.float64
ETAS = (0.4, 0.75, 1.0, 1.0 + 2.0**-20, 1.33, 1.5, 2.42, 10.0)
REFLECTS, REFRACTS = 0.0, 1.0 - 2.0**-53  # of the third uniform number, where both lobes have a share


def number(x):
    return torch.tensor(x, dtype=DOUBLE)


def both_sides(count=200):
    w = above(count, generator(0), least=1e-3)
    return torch.cat([w, mirrored(w)])


def pair(model, wo):
    """(R, T or radiance, refracted direction, eta) of the two lobes."""
    viewer = model.viewer(wo, None)
    mirror, through = model.deltas(viewer)
    return mirror.weight[0], through.weight[0], viewer.layout.join_vector(through.wi), through.eta


@pytest.mark.parametrize("eta", ETAS)
@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
def test_all_power_is_reflected_or_refracted(eta, dtype):
    r, t, _, _ = pair(tb.SmoothDielectric(eta, mode="flux"), both_sides().to(dtype))
    assert (r + t - 1).abs().max() <= 2 * torch.finfo(dtype).eps
    assert (r >= 0).all()
    assert (t >= 0).all()


@pytest.mark.parametrize(("cos", "eta"), [(1e-8, 1.5), (1e-3, 1.5), (0.05, 1.0 + 1e-6), (0.7, 1e4), (0.7454, 1 / 1.5), (0.866025404, 0.5)])
def test_what_little_is_refracted_has_all_its_digits(cos, eta):
    for dtype in (torch.float32, DOUBLE):
        c, n = (torch.tensor(x, dtype=dtype) for x in (cos, eta))
        exact = 1 - oracle.reflectance(float(c), float(n))
        assert abs(split(c, n).transmitted.item() - exact) <= 16 * torch.finfo(dtype).eps * exact


def test_under_total_reflection_nothing_is_refracted():
    wo = mirrored(tb.normalize(number([[0.9, 0.1, 0.3], [0.0, 1.0, 0.01], [0.7, 0.0, 0.7]])))
    for mode in ("radiance", "flux"):
        r, t, wi, _ = pair(tb.SmoothDielectric(1.5, mode), wo)
        assert r.tolist() == [1.0] * 3
        assert t.tolist() == [0.0] * 3
        assert wi.abs().max() == 0
        s = tb.SmoothDielectric(1.5, mode).sample(wo.repeat(50, 1), uniform(150, generator(1)))
        assert (s.lobe == 0).all()
        assert (s.weight == 1).all()
        assert (s.pdf == 1).all()
    eta, w = number([1.5]).requires_grad_(), wo.clone().requires_grad_()
    grads = torch.autograd.grad(tb.SmoothDielectric(eta, part="transmission").directional_albedo(w).sum(), [eta, w])
    assert all((g == 0).all() for g in grads)


@pytest.mark.parametrize("eta", ETAS)
def test_directions_are_those_of_snell(eta):
    wo, n = both_sides(), number([0.0, 0.0, 1.0])
    _, _, wi, ahead = pair(tb.SmoothDielectric(eta), wo)
    assert torch.allclose(ahead, torch.where(wo[:, 2] > 0, number(eta), number(1.0 / eta)), rtol=1e-15)
    bent, valid = tb.refract(wo, n, ahead.unsqueeze(-1))
    assert torch.allclose(wi, bent, atol=1e-14 if eta != 0.75 else 1e-12)
    passes = valid.squeeze(-1)
    assert (wi[passes].norm(dim=-1) - 1).abs().max() < 1e-14 * max(eta, 1.0 / eta)
    sines = (w[passes, :2].norm(dim=-1) for w in (wo, wi))
    assert torch.allclose(next(sines), ahead[passes] * next(sines), atol=1e-14)


def test_matched_media_do_nothing():
    for dtype in (torch.float32, DOUBLE):
        grazing = number([[1.0, 0.0, 1e-25], [0.0, 1.0, -1e-25]])  # whose square underflows in float32
        wo = torch.cat([both_sides(), grazing]).to(dtype)
        r, t, wi, eta = pair(tb.SmoothDielectric(1.0), wo)
        wo = torch.stack(tb.SmoothDielectric(1.0).viewer(wo).wo, -1)  # made unit once more
        assert (r == 0).all()
        assert (t == 1).all()
        assert (eta == 1).all()
        assert (wi == -wo).all()


def test_radiance_grows_with_the_square_of_the_index():
    """And f(wi, wo)/n_o^2 = f(wo, wi)/n_i^2: the way back has the same power, and the light goes back where it came from."""
    eta, wo = 1.5, both_sides()
    glass = tb.SmoothDielectric(eta)
    _, flux, _, _ = pair(glass.replace(mode="flux"), wo)
    _, radiance, wi, ahead = pair(glass, wo)
    assert torch.allclose(radiance, flux / ahead**2, rtol=1e-15)
    assert pair(glass, number([[0.0, 0.0, -1.0]]))[1].item() == pytest.approx(0.96 * 2.25), "out of the glass it grows"
    passes = flux > 0
    _, back, again, behind = pair(glass, wi[passes])
    assert torch.allclose(again, wo[passes], atol=1e-12)
    assert torch.allclose(behind * ahead[passes], torch.ones_like(behind), rtol=1e-15)
    assert torch.allclose(back * behind**2, (radiance * ahead**2)[passes], atol=1e-13)


def test_samples_report_the_side_they_come_from():
    glass = tb.SmoothDielectric(1.5)
    for z, eta in ((1.0, 1.5), (-1.0, 1 / 1.5)):
        wo = number([0.0, 0.6, 0.8 * z]) if z > 0 else number([0.0, 0.3, -(0.91**0.5)])
        mirror, through = (glass.sample(wo, number([0.5, 0.5, u])) for u in (REFLECTS, REFRACTS))
        assert (mirror.eta.item(), through.eta.item()) == (1.0, pytest.approx(eta))
        assert mirror.wi[2] * z > 0 > through.wi[2] * z
        assert mirror.pdf.item() + through.pdf.item() == pytest.approx(1.0)


def test_directions_have_derivatives():
    n, wo = directions(6, generator(2)), directions(6, generator(3))
    wo = tb.normalize(wo + n * (wo * n).sum(-1, keepdim=True).sign())

    def refracted(eta, wo, n):
        model = tb.SmoothDielectric(eta)
        viewer = model.viewer(wo, n)
        return viewer.layout.join_vector(model.deltas(viewer)[1].wi)

    inputs = [x.requires_grad_() for x in (number([1.3]), wo, n)]
    assert torch.autograd.gradcheck(refracted, inputs)
    assert torch.autograd.gradgradcheck(refracted, inputs)


def test_a_part_is_one_lobe():
    glass, wo = tb.SmoothDielectric(1.5), both_sides(20)
    mirror, through = glass.select(tb.Lobe.REFLECTION), glass.select(tb.Lobe.TRANSMISSION)
    assert mirror.lobes == (tb.Lobe.DELTA_REFLECTION,)
    assert through.lobes == (tb.Lobe.DELTA_TRANSMISSION,)
    assert glass.select(tb.Lobe.DELTA).lobes == glass.lobes
    assert glass.select(tb.Lobe.SPREAD) is None
    assert through.select(tb.Lobe.REFLECTION) is None
    albedos = [m.directional_albedo(wo) for m in (mirror, through, glass)]
    assert torch.allclose(albedos[0] + albedos[1], albedos[2])
    assert torch.allclose(albedos[0].squeeze(-1), pair(glass, wo)[0])
    u = torch.full((40, 2), 0.5, dtype=DOUBLE)
    assert torch.allclose(through.sample(wo, u).weight.squeeze(-1), pair(glass, wo)[1])


def test_in_other_models():
    wo, u = both_sides(30), uniform(60, generator(4))
    tinted = number([0.9, 0.5, 0.1]) * tb.SmoothDielectric(1.5)
    assert torch.allclose(tinted.directional_albedo(wo), number([0.9, 0.5, 0.1]).expand(60, 3))
    mixed = 0.5 * tb.SmoothDielectric(1.5) + tb.TwoSided(tb.Lambert([0.1, 0.2, 0.3, 0.4, 0.5]))
    assert torch.allclose(mixed.directional_albedo(wo), 0.5 + number([0.1, 0.2, 0.3, 0.4, 0.5]).expand(60, 5))
    few = [0.5 * tb.SmoothDielectric(1.5) + tb.TwoSided(tb.Lambert(a)) for a in (0.1, 0.5)]
    for k, model in ((0, few[0]), (4, few[1])):
        s, one = mixed.sample(wo, u), model.sample(wo, u)
        same = (s.lobe == one.lobe).squeeze(-1)
        assert same.sum() > 30
        assert torch.allclose((s.weight * s.pdf)[same, k], (one.weight * one.pdf)[same, 0])
    with pytest.raises(ValueError, match="sends light through the surface"):
        tb.TwoSided(tb.SmoothDielectric(1.5))


def test_what_a_model_keeps_for_a_viewer_is_its_own():
    """Beside what the sampler keeps for it."""
    glass = tb.SmoothDielectric(1.5)
    viewer = glass.viewer(both_sides(3), None)
    first, again = shares(glass, viewer), shares(glass, viewer)
    assert first is again
    assert glass.crossing(viewer) is glass.crossing(viewer)


@pytest.mark.parametrize("make", [tb.SmoothDielectric, lambda eta: tb.Coated(tb.Lambert(0.5), eta)])
def test_one_index_for_all_channels(make):
    for eta in ([1.51, 1.52, 1.53], torch.rand(4, 3) + 1.0):
        with pytest.raises(ValueError, match=r"eta: expected shape \[..., 1\], found .*; every channel would be refracted elsewhere"):
            make(eta)
    assert make([[1.5], [1.6]]).batch_shape == (2,)


def test_choices_are_named():
    with pytest.raises(ValueError, match=r"SmoothDielectric\.mode"):
        tb.SmoothDielectric(1.5, "importance")
    with pytest.raises(ValueError, match=r"SmoothDielectric\.part"):
        tb.SmoothDielectric(1.5, part="refraction")


def sphere_view():
    n = tb.normalize(number([[[0.0, 0.0, 1.0], [0.3, 0.1, 0.9], [0.6, -0.5, 0.2]]]))
    return tb.GBuffer(torch.zeros_like(n), n, view=number([0.0, 0.0, 1.0]))


def test_an_environment_is_seen_through_the_interface():
    """Radiance 1 everywhere: R + T/eta^2; as power, 1."""
    g, sky = sphere_view(), tb.EnvironmentMap(torch.ones(8, 16, 1, dtype=DOUBLE))
    f = tb.fresnel.dielectric(g.normal[..., 2:], number(1.5))
    assert torch.allclose(tb.shade(g, tb.SmoothDielectric(1.5), sky), f + (1 - f) / 2.25)
    assert torch.allclose(tb.shade(g, tb.SmoothDielectric(1.5, "flux"), sky), torch.ones_like(f))


def test_the_map_is_looked_up_in_the_refracted_direction():
    g = sphere_view()
    texels = torch.rand(64, 128, 3, dtype=DOUBLE, generator=generator(5))
    sky = tb.EnvironmentMap(texels)
    eta = number([1.3]).requires_grad_()
    image = tb.shade(g, tb.SmoothDielectric(eta, part="transmission"), sky)
    wi, _ = tb.refract(g.view.expand_as(g.normal), g.normal, eta)
    t = (1 - tb.fresnel.dielectric(g.normal[..., 2:], eta)) / eta**2
    assert torch.allclose(image, t * sky.radiance(wi))
    assert torch.autograd.grad(image.sum(), eta)[0].abs() > 0
    plan = tb.plan(g, tb.SmoothDielectric(1.5), sky)
    assert "refraction" in str(plan)
    assert "no environment" in str(tb.plan(g, tb.SmoothDielectric(1.5), tb.PointLight([0.0, 0.0, 2.0], 1.0)))
