"""The energy that single scattering loses, and the lobe that gives it back."""

import math

import pytest
import torch
from torch.autograd import gradcheck, gradgradcheck

import torchbrdf as tb
from torchbrdf.bsdf import lost_energy_fit
from torchbrdf.bsdf.lost_energy import FITS, Lost, read
from torchbrdf.bsdf.make_lost_energy import CASES, exact_mean, single_albedo
from torchbrdf.layout import Layout
from torchbrdf.optics.distribution import Rough
from torchbrdf.optics.fresnel import Fresnel
from torchbrdf.quadrature import gauss_legendre
from torchbrdf.testing.energy import leaving
from torchbrdf.testing.subject import directions, generator
from torchbrdf.value import value

DOUBLE = torch.float64
COSINES = torch.tensor([1.0, 0.9, 0.6, 0.35, 0.2, 0.1, 0.05, 0.02, 0.007, 1e-3, 1e-5], dtype=DOUBLE)
ALPHAS = torch.tensor([0.02, 0.033, 0.07, 0.15, 0.3, 0.55, 0.8, 1.0], dtype=DOUBLE)
GRID = tuple(t.flatten() for t in torch.meshgrid(COSINES, ALPHAS, indexing="ij"))


def at(cos):
    """Directions of these cosines."""
    return torch.stack([torch.sqrt((1.0 - cos) * (1.0 + cos)), torch.zeros_like(cos), cos], -1)


def fit_at(case, alpha):
    return Lost.of(FITS[case], Rough(alpha, alpha, True))


@pytest.mark.parametrize("case", CASES)
def test_the_fit_is_as_near_as_it_says(case):
    mu, alpha = GRID
    lost = fit_at(case, alpha).at(mu, None)
    assert (lost >= 0).all()
    assert (single_albedo(*case, mu, alpha, 96) + lost - 1.0).abs().max() <= lost_energy_fit.ERRORS[case] + 5e-5  # that of the quadrature
    assert max(lost_energy_fit.ERRORS.values()) < 3.5e-4


def test_the_quadrature_is_an_integral_of_evaluate():
    """An adaptive one, which knows nothing of slopes."""
    for distribution, mu, alpha in (("ggx", 0.9, 0.5), ("ggx", 0.3, 0.2), ("beckmann", 0.08, 0.3)):
        cos = torch.tensor([mu], dtype=DOUBLE)
        adaptive, _ = leaving(tb.RoughConductor(alpha, distribution=distribution), at(cos), generator(0), tolerance=3e-5)
        exact = single_albedo(distribution, "smith_correlated", cos, torch.full_like(cos, alpha))
        assert adaptive.item() == pytest.approx(exact.item(), abs=6e-5)


@pytest.mark.parametrize("case", CASES)
def test_the_average_is_that_of_the_fit(case):
    found = fit_at(case, ALPHAS).mean
    assert (found / exact_mean(FITS[case], ALPHAS) - 1.0).abs().max() < 2e-3


@pytest.mark.parametrize("case", CASES)
def test_white_furnace(case):
    """The whole of it: what is evaluated beyond the single lobe, integrated, and the exact albedo of the single lobe."""
    mu, alpha = GRID
    q, weight = gauss_legendre(96)
    end = torch.asinh(1.0 / alpha)[:, None]
    cos = (alpha[:, None] * torch.sinh(end * q)).clamp_max(1.0)
    wi, wo = at(cos), at(mu)[:, None].expand(-1, len(q), 3)
    one, all_of_it = (
        tb.RoughConductor(alpha[:, None, None], distribution=case[0], shadowing=case[1], energy=energy).evaluate(wi, wo).squeeze(-1)
        for energy in ("single", "conserving")
    )
    returned = ((all_of_it - one) * 2.0 * math.pi * cos * alpha[:, None] * torch.cosh(end * q) * end * weight).sum(-1)
    assert (returned > 0).all()
    assert (single_albedo(*case, mu, alpha, 128) + returned - 1.0).abs().max() < 4e-4


@pytest.mark.parametrize("alpha", [1e-4, 1e-3, 0.02, 0.3, 1.0])
def test_float32_and_below_the_range_of_the_fit(alpha):
    w = at(COSINES)
    model = tb.RoughConductor(alpha, energy="conserving")
    exact, found = model._lost_o(model.viewer(w)), model._lost_o(model.viewer(w.float()))
    assert (found - exact).abs().max() < 3e-5
    assert (model.directional_albedo(w.float()) - 1.0).abs().max() < 2e-4
    f = model.evaluate(w[:, None], w)
    assert ((model.evaluate(w.float()[:, None], w.float()) - f).abs() <= 2e-4 * f + 1e-6 * f.max()).all()


def test_single_scattering_is_untouched():
    rng = generator(3)
    wi, wo = directions(64, rng).abs(), directions(64, rng).abs()
    single = tb.RoughConductor(0.4, tb.Schlick([0.9, 0.5, 0.2]))
    more = single.replace(energy="conserving").evaluate(wi, wo)
    assert (more > single.evaluate(wi, wo)).all()
    assert single.lobes == single.replace(energy="conserving").lobes


def test_colour_of_further_reflections():
    """The dark absorb more: F_ms against the series of reflections, and black and white."""
    f0 = torch.tensor([0.0, 0.3, 1.0], dtype=DOUBLE)
    term = tb.Schlick(f0)
    model = tb.RoughConductor(0.8, term, energy="conserving")
    viewer = model.viewer(at(torch.tensor([0.5], dtype=DOUBLE)))
    lost = model._lost(viewer)
    f, e = f0 + (1.0 - f0) / 21.0, 1.0 - lost.mean
    series = sum(f ** (k + 2) * e * lost.mean**k for k in range(200))
    assert torch.allclose(torch.stack(lost.gain(term, viewer), -1).squeeze(0), series, rtol=1e-12)
    assert torch.stack(lost.gain(term, viewer), -1).flatten()[-1].item() == pytest.approx(1.0, abs=1e-15)


@value
class Own(Fresnel):
    """A term of a user, which says no average."""

    def terms(self, layout, cos):
        return (cos * cos,)


@pytest.mark.parametrize(
    ("term", "error"),
    [
        (tb.Schlick([0.0, 0.04, 1.0]), 1e-13),
        (tb.Dielectric([1.2, 1.5, 2.5]), 1e-6),
        (tb.Conductor.named("Au"), 2e-6),
        (tb.Conductor.named("Al"), 2e-6),
        (Own(), 1e-13),
    ],
)
def test_average_of_fresnel_terms(term, error):
    x, weight = gauss_legendre(400)
    expected = (term.reflectance((x * x).unsqueeze(-1)) * (4.0 * x**3 * weight).unsqueeze(-1)).sum(0)
    found = torch.stack(term.average(Layout(False, DOUBLE, torch.device("cpu"))))
    assert (found - expected).abs().max() < error
    assert torch.allclose(term.average(Layout(True, DOUBLE, torch.device("cpu")))[0], found, atol=1e-15)
    assert torch.allclose(term.average(Layout(False, DOUBLE, torch.device("cpu"), 2))[0].flatten(), found, atol=1e-15)


@pytest.mark.parametrize("axes", [1, 2])
def test_derivatives_by_alpha_and_f0(axes):
    wi, wo = at(torch.tensor([0.5, 0.1], dtype=DOUBLE)), at(torch.tensor([0.8, 0.03], dtype=DOUBLE)) * torch.tensor([-1.0, 1.0, 1.0])
    alpha = torch.tensor([[0.3, 0.6], [0.05, 0.1]], dtype=DOUBLE)[:, :axes].requires_grad_()
    f0 = torch.tensor([0.9, 0.4], dtype=DOUBLE, requires_grad=True)

    def f(alpha, f0):
        return tb.RoughConductor(alpha, tb.Schlick(f0), energy="conserving").evaluate(wi, wo)

    assert gradcheck(f, (alpha, f0))
    assert gradgradcheck(f, (alpha, f0))
    eta, k = (torch.tensor([x], dtype=DOUBLE, requires_grad=True) for x in (0.3, 3.0))

    def metal(eta, k):
        return tb.RoughConductor(0.4, tb.Conductor(eta, k), energy="conserving").evaluate(wi, wo)

    assert gradcheck(metal, (eta, k))


def test_many_channels_and_a_roughness_for_each_point():
    """More than 4 channels broadcast; many points take the fit another way than few."""
    rng = generator(5)
    wi, wo = directions(2, rng).abs(), directions(2, rng).abs()
    alpha = torch.rand(20000, 1, 1, generator=rng, dtype=DOUBLE) * 0.9 + 0.1
    f0 = torch.linspace(0.1, 0.9, 6, dtype=DOUBLE)
    many = tb.RoughConductor(alpha, tb.Schlick(f0), energy="conserving").evaluate(wi, wo)
    few = tb.RoughConductor(alpha[7], tb.Schlick(f0[3:4]), energy="conserving").evaluate(wi, wo)
    assert torch.allclose(many[7, :, 3:4], few, rtol=1e-12)


@pytest.mark.parametrize("choice", [{"distribution": "blinn"}, {"distribution": "beckmann", "smith": "walter"}])
def test_what_has_no_such_lobe(choice):
    with pytest.raises(ValueError, match=r"RoughConductor.energy: found 'conserving' beside"):
        tb.RoughConductor(0.2, energy="conserving", **choice)
    with pytest.raises(ValueError, match=r"RoughConductor.energy: found 'both'"):
        tb.RoughConductor(0.2, energy="both")


def test_the_shipped_numbers_are_what_the_script_writes():
    assert set(read(lost_energy_fit.TEXT)) == set(lost_energy_fit.ERRORS) == set(CASES)
