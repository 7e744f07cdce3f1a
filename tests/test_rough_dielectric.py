"""Rough dielectrics: limits, energy, both sides, what a facet lets through; a light behind the surface."""

import math

import oracle
import pytest
import torch

import torchbrdf as tb
from torchbrdf.bsdf.refraction import Refraction
from torchbrdf.testing import run
from torchbrdf.testing.energy import albedo
from torchbrdf.testing.reciprocity import reciprocity
from torchbrdf.testing.sampling import samples_follow_pdf
from torchbrdf.testing.subject import above, at_angles, directions, generator, mirrored, uniform
from torchbrdf.testing.weights import mean_weight

DOUBLE = torch.float64
UP = torch.tensor([0.0, 0.0, 1.0], dtype=DOUBLE)
PARTS = ("reflection", "transmission")
SHADOWINGS = ("smith_correlated", "smith_separable", "v_cavity")


def glass(alpha, eta=1.5, **choices):
    return tb.RoughDielectric(alpha, eta, **choices).to(DOUBLE)


def both_sides(*angles):
    w = at_angles(*angles)
    return torch.cat([w, mirrored(w)])


def anything(count=400, seed=0):
    return directions(count, generator(seed)), directions(count, generator(seed + 1))


def test_straight_through_by_hand():
    """At normal incidence T = 4 eta / (1 + eta)^2, D = 1 / (pi alpha^2), |H| = eta - 1."""
    for alpha, eta in ((0.3, 1.5), (0.1, 2.0), (0.5, 0.7)):
        t = 4 * eta / (1 + eta) ** 2
        f = t / (math.pi * alpha**2 * (eta - 1) ** 2)
        for mode, above_n, below_n in (("radiance", 1.0, eta), ("flux", eta, 1.0)):
            model = glass(alpha, eta, mode=mode)
            assert model.evaluate(-UP, UP).item() == pytest.approx(f * above_n**2, rel=1e-12)
            assert model.evaluate(UP, -UP).item() == pytest.approx(f * below_n**2, rel=1e-12)
        assert glass(alpha, eta).evaluate(UP, UP).item() == pytest.approx((1 - t) / (4 * math.pi * alpha**2), rel=1e-12)


@pytest.mark.parametrize("eta", [1.5, 1 / 1.5, 1.05])
def test_smooth_in_the_limit(eta):
    """Both lobes have the power of the smooth interface, and the samples its directions; total reflection within."""
    wo, smooth = both_sides(0.0, 30.0, 60.0), tb.SmoothDielectric(eta).to(DOUBLE)
    for k, part in enumerate(PARTS):
        rough = glass(1e-3, eta, part=part)
        assert torch.allclose(rough.directional_albedo(wo), smooth.replace(part=part).directional_albedo(wo), atol=1e-3)
        delta = smooth.deltas(smooth.viewer(wo, None))[k]
        s = glass(1e-5, eta, part=part).sample(wo, uniform(6, generator(1)))
        exists = (delta.weight[0] > 0).unsqueeze(-1)
        assert torch.allclose(s.wi * exists, torch.stack(torch.broadcast_tensors(*delta.wi), -1) * exists, atol=2e-3)


@pytest.mark.parametrize("shadowing", SHADOWINGS)
@pytest.mark.parametrize("alpha", [0.02, 0.3, 1.0])
def test_no_power_is_made(alpha, shadowing):
    """What is missing is what meets a second facet: nothing of it where the surface is nearly smooth."""
    wo = both_sides(0.0, 40.0, 80.0, 89.0)
    for eta in (1.5, 1 / 1.5):
        parts = [glass(alpha, eta, shadowing=shadowing, part=p).directional_albedo(wo, order=96) for p in PARTS]
        total = glass(alpha, eta, shadowing=shadowing, mode="flux").directional_albedo(wo, order=96)
        assert torch.allclose(total, parts[0] + parts[1])
        assert total.max() <= 1 + 1e-4
        assert total[[0, 1, 4]].min() > {0.02: 0.998, 0.3: 0.8, 1.0: 0.4}[alpha]


def test_the_way_back():
    """f(wi, wo)/n_o^2 = f(wo, wi)/n_i^2, and flux is the adjoint; on one side of the surface both are symmetric."""
    wi, wo = anything()
    eta, index = 1.5, lambda w: torch.where(w[:, 2:] < 0, 1.5, 1.0)
    for choices in ({}, {"distribution": "beckmann", "shadowing": "v_cavity"}):
        radiance, flux = (glass((0.4, 0.2), eta, mode=mode, **choices) for mode in ("radiance", "flux"))
        there, back = radiance.evaluate(wi, wo), radiance.evaluate(wo, wi)
        assert torch.allclose(there / index(wo) ** 2, back / index(wi) ** 2, rtol=1e-10, atol=1e-12)
        assert torch.allclose(flux.evaluate(wi, wo), back, rtol=1e-10, atol=1e-12)
        assert (there > 0).double().mean() > 0.5


def test_without_a_surface_there_is_no_light_but_the_delta():
    """eta = 1: finite everywhere, value 0, also where wi = -wo and the half vector vanishes."""
    for dtype in (torch.float32, DOUBLE):
        alpha, eta = torch.tensor([0.3], dtype=dtype).requires_grad_(), torch.tensor([1.0], dtype=dtype).requires_grad_()
        wi, wo = (
            torch.cat([w, x]).to(dtype).requires_grad_()
            for w, x in zip(anything(50), (-at_angles(0.0, 50.0), at_angles(0.0, 50.0)), strict=True)
        )
        model = tb.RoughDielectric(alpha, eta)
        f, pdf = model.evaluate(wi, wo), model.pdf(wi, wo)
        assert (f == 0).all()
        assert (pdf == 0).all()
        assert all(g.isfinite().all() for g in torch.autograd.grad(f.sum() + pdf.sum(), [alpha, eta, wi, wo]))
        s = model.sample(wo, uniform(52, generator(2)).to(dtype))
        assert (s.lobe == 1).all()
        assert s.weight.isfinite().all()


@pytest.mark.parametrize("eta", [1 + 1e-4, 1.0 + 2.0**-20])
def test_nearly_equal_media_keep_their_digits(eta):
    """float32 beside float64 of the same numbers: facets between nearly opposite directions, 1 - F above a tenth."""
    model = glass(0.3, eta)
    wo = torch.cat([above(300, generator(3)), mirrored(above(300, generator(4)))]).float().double()
    wi = model.sample(wo, uniform(600, generator(5))).wi.float().double()
    n = UP.expand_as(wo)
    at = Refraction.of(model.geometry(wi, wo, n), model.eta.squeeze())
    good = ((at.there > 0) & (at.thin > 0.1) & (at.cos_n > 0.1)).unsqueeze(-1)
    exact, single = model.evaluate(wi, wo, n), model.to(torch.float32).evaluate(wi.float(), wo.float(), n.float()).double()
    error = (2 * (single - exact) / (single + exact))[good & (exact > 0)]
    assert len(error) > 300
    assert error.abs().median() < 2e-7 / (eta - 1)  # what rounding the directions does to their small sum


@pytest.mark.parametrize("eta", [1.5, 2.4, 0.6, 1.001])
def test_a_facet_transmits_what_it_does_not_reflect(eta):
    """1 - F of both cosines, without a root, against the exact law in many digits; and Snell's law holds at the facet."""
    wo = torch.cat([above(60, generator(6)), mirrored(above(60, generator(7)))])
    model = glass(0.5, eta)
    wi = model.replace(part="transmission").sample(wo, uniform(120, generator(8))).wi
    at = Refraction.of(model.geometry(wi, wo), model.eta.squeeze())
    assert (at.there > 0).sum() > 60
    for k in at.there.nonzero().squeeze(1).tolist():
        ahead = (at.n_i / at.n_o)[k].item()
        cos_o, cos_i = (x[k].item() for x in (at.wo_m, at.wi_m))
        thin, index = (cos_o, ahead) if ahead > 1 else (cos_i, 1 / ahead)
        assert at.transmitted[k].item() == pytest.approx(float(1 - oracle.reflectance(thin, index)), rel=1e-9 / abs(eta - 1))
        assert math.sqrt(1 - cos_o**2) == pytest.approx(ahead * math.sqrt(1 - cos_i**2), abs=1e-7)


def test_facets_seen_from_behind_do_nothing():
    """Both directions across the surface, but their facet lies the other way, or one of them is behind it."""
    eta, model = 1.5, glass(1.0)
    leaning = ([-0.99, 0.0, -0.127], [0.95, 0.0, 0.3], (True, True, False))  # of a facet that faces away from the normal
    steep = ([0.3, 0.3, -0.9], [0.6, 0.0, 0.2], (False, True, True))  # more than any facet bends
    for wi, wo, expected in (leaning, steep):
        wi, wo = (tb.normalize(torch.tensor(w, dtype=DOUBLE)) for w in (wi, wo))
        m = -(eta * wi + wo)
        assert (bool(wo @ m > 0), bool(wi @ m < 0), bool(m[2] > 0)) == expected
        for model in (glass(1.0), glass(1.0, distribution="beckmann"), glass(1.0, mode="flux")):
            assert model.evaluate(wi, wo).item() == model.evaluate(wo, wi).item() == 0.0
            assert model.pdf(wi, wo).item() == 0.0
    at = Refraction.of(model.geometry(*anything()), torch.tensor(eta, dtype=DOUBLE))
    assert 0 < at.there.mean() < 0.5


def test_parts_are_the_lobes():
    wi, wo = anything()
    whole = glass(0.3)
    back, through = (whole.select(kind) for kind in (tb.Lobe.REFLECTION, tb.Lobe.TRANSMISSION))
    assert (back.part, through.part) == PARTS
    assert whole.select(tb.Lobe.GLOSSY) is whole
    assert whole.select(tb.Lobe.DELTA) is None
    assert through.select(tb.Lobe.REFLECTION) is None
    f = [m.evaluate(wi, wo) for m in (back, through, whole)]
    assert torch.allclose(f[0] + f[1], f[2], rtol=1e-14)
    same = (wi[:, 2:] * wo[:, 2:]) > 0
    assert ((f[0] > 0) == (same & (f[2] > 0))).all()
    assert ((f[1] > 0) == (~same & (f[2] > 0))).all()


def test_lobes_are_chosen_by_the_facets_reflectance():
    wo = torch.tensor([0.0, 0.28, -0.96], dtype=DOUBLE)
    u = uniform(4000, generator(9))
    s = glass(0.05).sample(wo, u)
    assert s.lobe.double().mean().item() == pytest.approx(1 - tb.fresnel.dielectric(torch.tensor(0.96), 1 / 1.5).item(), abs=0.02)
    found = s.pdf > 0
    assert torch.allclose(s.eta, torch.where(s.lobe == 1, 1 / 1.5, 1.0).double())
    assert ((s.wi[:, 2:] < 0) == (s.lobe == 0))[found].all()
    assert (s.weight[~found] == 0).all()


@pytest.mark.parametrize(("alpha", "choices"), [(0.02, {}), (1.0, {}), ((0.5, 0.1), {})])
def test_samples_follow_their_density(alpha, choices):
    outcome = run(samples_follow_pdf, glass(alpha, **choices))
    assert outcome.ok, outcome


def test_under_total_reflection_only_facets_that_lean_transmit():
    """Within, beyond the critical angle of the surface (41.8 degrees): nearly everything is reflected."""
    wo = mirrored(at_angles(60.0))
    assert glass(0.02, part="transmission").directional_albedo(wo).item() < 1e-2
    assert glass(0.02).directional_albedo(wo).item() > 0.99
    assert glass(0.5, part="transmission").directional_albedo(wo).item() > 0.05


def test_in_other_models():
    wi, wo = anything(60)
    f = glass(0.3).evaluate(wi, wo)
    tint = torch.tensor([0.9, 0.5, 0.1, 0.3, 0.7], dtype=DOUBLE)
    assert torch.allclose((tint * glass(0.3)).evaluate(wi, wo), tint * f, rtol=1e-12)
    mixed = 0.5 * glass(0.3) + tb.TwoSided(tb.Lambert(0.4)).to(DOUBLE)
    same = ((wi[:, 2:] * wo[:, 2:]) > 0).double()
    assert torch.allclose(mixed.evaluate(wi, wo), 0.5 * f + same * 0.4 / math.pi, rtol=1e-12)
    power = 0.5 * glass(0.3, mode="flux") + 0.4 * tb.TwoSided(tb.Lambert(1.0)).to(DOUBLE)
    for prop in (albedo, mean_weight, reciprocity):
        outcome = run(prop, power)
        assert outcome.ok, outcome


@pytest.mark.parametrize("height", [2.0, -2.0])
def test_a_light_lights_what_lies_between(height):
    """A pane seen from above: of a light above it what is reflected, of one behind what passes; |cos| of either side counts."""
    n = UP.expand(1, 3, 3)
    at = torch.tensor([[[0.0, 0.0, 0.0], [0.5, 0.2, 0.0], [-1.0, 0.4, 0.0]]], dtype=DOUBLE)
    view = tb.normalize(torch.tensor([0.2, 0.0, 1.0], dtype=DOUBLE))
    place = torch.tensor([0.3, -0.1, height], dtype=DOUBLE)
    g, model = tb.GBuffer(at, n, view=view), tb.RoughDielectric(0.4, 1.5)
    light = tb.PointLight(place, 3.0)
    image = tb.shade(g, model, light)
    wi = tb.normalize(place - at)
    f = model.evaluate(wi, view.expand_as(wi)) * wi[..., 2:].abs() * 3.0 / ((place - at) ** 2).sum(-1, keepdim=True)
    assert torch.allclose(image, f, rtol=1e-6)
    assert (image > 0).all()
    part = PARTS[height < 0]
    assert torch.allclose(tb.shade(g, model.replace(part=part), light), image, rtol=1e-6)
    assert (tb.shade(g, model.replace(part=PARTS[height > 0]), light) == 0).all()


def test_choices_are_named():
    with pytest.raises(ValueError, match=r"RoughDielectric\.mode"):
        tb.RoughDielectric(0.2, 1.5, mode="importance")
    with pytest.raises(ValueError, match=r"RoughDielectric\.part"):
        tb.RoughDielectric(0.2, 1.5, part="refraction")
    with pytest.raises(ValueError, match=r"RoughDielectric\.smith: found 'walter' beside 'ggx'"):
        tb.RoughDielectric(0.2, 1.5, smith="walter")
    with pytest.raises(ValueError, match=r"RoughDielectric\.distribution"):
        tb.RoughDielectric(0.2, 1.5, distribution="phong")
    with pytest.raises(
        ValueError, match=r"RoughDielectric\.eta: expected shape \[\.\.\., 1\], found \[3\]; every channel would be refracted elsewhere"
    ):
        tb.RoughDielectric(0.2, [1.5, 1.51, 1.52])
    with pytest.raises(ValueError, match=r"RoughDielectric\.alpha: expected shape"):
        tb.RoughDielectric([0.1, 0.2, 0.3], 1.5)
