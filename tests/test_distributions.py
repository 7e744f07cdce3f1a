"""Distributions of normals: they are normalised, their visible normals fill what is seen, and samples follow the density."""

import itertools
import math

import pytest
import torch

import torchbrdf as tb
from torchbrdf import quadrature
from torchbrdf.optics import beckmann
from torchbrdf.testing.subject import at_angles, generator

KINDS = {"GGX": tb.GGX, "Beckmann": tb.Beckmann, "Blinn": tb.Blinn}
ALPHAS = ([0.1], [0.5], [1.0], [0.6, 0.2])
DOWN = torch.tensor([0.0, 0.0, -1.0], dtype=torch.float64)
VIEWS = at_angles(0.0, 40.0, 75.0)


def hemisphere(order=400):
    """Normals by the stretched slope, dense about the pole, and weights in solid angle."""
    u, weights = quadrature.unit_square(order)
    theta = 0.5 * math.pi * u[:, 0] ** 3
    phi = 2 * math.pi * u[:, 1]
    h = torch.stack([torch.sin(theta) * torch.cos(phi), torch.sin(theta) * torch.sin(phi), torch.cos(theta)], -1)
    return h, weights * torch.sin(theta) * 0.5 * math.pi * 3 * u[:, 0] ** 2 * 2 * math.pi


@pytest.mark.parametrize("alpha", ALPHAS, ids=str)
@pytest.mark.parametrize("kind", KINDS)
def test_normals_add_up_to_the_surface(kind, alpha):
    """The projected areas of all facets add up to that of the surface, seen from above; for Smith's own laws, from anywhere."""
    normals, (h, weights) = KINDS[kind](alpha), hemisphere()
    assert float((normals.d(h)[:, 0] * h[:, 2] * weights).sum()) == pytest.approx(1.0, abs=2e-6)
    for w in VIEWS:
        seen = torch.relu((h * w).sum(-1)) * normals.d(h)[:, 0] * weights
        share = float(normals.g1(w) * seen.sum() / w[2])
        assert share == pytest.approx(1.0, abs=2e-4) or kind == "Blinn"  # whose Lambda is another's
        assert float((normals.pdf(w.expand_as(h), h)[:, 0] * weights).sum()) == pytest.approx(1.0, abs=2e-4)


@pytest.mark.parametrize("alpha", ALPHAS, ids=str)
@pytest.mark.parametrize("kind", KINDS)
def test_samples_follow_the_density(kind, alpha):
    """Mean normals of many samples are those of the density, within four standard errors."""
    normals, (h, weights) = KINDS[kind](alpha), hemisphere()
    u = torch.rand(100_000, 2, generator=generator(3), dtype=torch.float64)
    for w in VIEWS:
        drawn = normals.sample(w.expand(len(u), 3), u)
        torch.testing.assert_close(drawn.norm(dim=-1), torch.ones(len(u), dtype=torch.float64))
        assert bool((drawn[:, 2] >= 0).all())
        moments = torch.cat([drawn, drawn * drawn], -1)
        density = normals.pdf(w.expand_as(h), h) * weights[:, None]
        expected = (torch.cat([h, h * h], -1) * density).sum(0)
        assert bool(((moments.mean(0) - expected).abs() <= 4.5 * moments.std(0) / len(u) ** 0.5 + 1e-5).all())


def test_verbs_agree_with_the_functions():
    w, v = at_angles(10.0, 60.0, 85.0), at_angles(30.0, 30.0, 70.0)
    for kind, name in (("GGX", "ggx"), ("Beckmann", "beckmann")):
        normals, one = KINDS[kind]([0.3, 0.7]), KINDS[kind](0.3)
        a, b = (tb.microfacet.projected_roughness(x[:, 0], x[:, 1], 0.3, 0.7) for x in (w, v))
        of = lambda f, name=name: getattr(tb.microfacet, f"{name}_{f}")  # noqa: E731
        close = torch.testing.assert_close
        close(normals.smith_lambda(w)[:, 0], of("lambda")(w[:, 2], a))
        close(normals.g1(w)[:, 0], of("g1")(w[:, 2], a))
        close(normals.g2(w, v)[:, 0], of("g2")(w[:, 2], a, v[:, 2], b))
        close(normals.d(5.0 * w)[:, 0], of("d_anisotropic")(*w.unbind(-1), 0.3, 0.7))
        close(one.d(w)[:, 0], of("d")(w[:, 2], 1 - w[:, 2] ** 2, 0.3))


def test_below_the_horizon():
    for kind in KINDS.values():
        normals = kind(0.4)
        for found in (normals.d(DOWN), normals.g1(DOWN), normals.g2(DOWN, -DOWN), normals.pdf(DOWN, -DOWN), normals.pdf(-DOWN, DOWN)):
            assert float(found) == 0.0
        assert float(normals.smith_lambda(DOWN)) == math.inf


def test_blinn_is_a_power_of_the_cosine():
    """Anisotropic, that of Ashikhmin & Shirley: the exponent goes from one to the other with the azimuth."""
    h = tb.normalize(torch.tensor([[0.3, 0.0, 1.0], [0.0, 0.3, 1.0], [0.2, 0.2, 0.5]], dtype=torch.float64))
    alpha = torch.tensor([0.2, 0.5], dtype=torch.float64)
    s = tb.exponent_from_alpha(alpha)
    exponent = (s[0] * h[:, 0] ** 2 + s[1] * h[:, 1] ** 2) / (h[:, 0] ** 2 + h[:, 1] ** 2)
    expected = torch.sqrt((s[0] + 2) * (s[1] + 2)) / (2 * math.pi) * h[:, 2] ** exponent
    torch.testing.assert_close(tb.Blinn(alpha).d(h)[:, 0], expected)


def test_energy_by_shadowing():
    """Light is lost, never made; but with Blinn's distribution and a Lambda that is not its own, as its page says."""
    w = at_angles(0.0, 60.0, 85.0)
    for kind, shadowing in itertools.product(("ggx", "beckmann", "blinn"), ("smith_correlated", "smith_separable", "v_cavity")):
        for alpha in (0.1, 0.5, 1.0):
            albedo = tb.RoughConductor(alpha, distribution=kind, shadowing=shadowing).directional_albedo(w, order=96)
            made = kind == "blinn" and shadowing != "v_cavity" and alpha > 0.2
            assert (float(albedo.max()) > 1.01) == made
            assert made or float(albedo.max()) < 1.002
    assert tb.RoughConductor(0.5, distribution="blinn").energy_bound is None


def test_converters():
    alpha = torch.tensor([1e-3, 0.3, 1.0], dtype=torch.float64)
    torch.testing.assert_close(tb.alpha_from_roughness(tb.roughness_from_alpha(alpha)), alpha)
    torch.testing.assert_close(tb.alpha_from_exponent(tb.exponent_from_alpha(alpha)), alpha)
    assert float(tb.exponent_from_alpha(alpha)[2]) == 0.0


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_slope_along_the_viewer_solves_its_equation(dtype):
    rng = generator(0)
    u, theta = (torch.rand(20_000, generator=rng, dtype=torch.float64) for _ in range(2))
    u[:4000] = 10.0 ** (-7 * u[:4000])
    u[4000:8000] = 1.0 - u[:4000]
    theta = 0.5 * math.pi * theta
    theta[::5] = 0.5 * math.pi * (1.0 - 10.0 ** (-10 * theta[::5]))
    u, cos, sin = (x.to(dtype) for x in (u, torch.cos(theta), torch.sin(theta)))
    x = beckmann._slope_along(u, cos, sin).double()
    u, cos, sin = u.double(), cos.double(), sin.double()
    whole = beckmann._visible(torch.clamp(cos / sin, max=6.0), cos, sin)
    error = (beckmann._visible(x, cos, sin) - u * whole).abs() / whole
    assert float(error.max()) < (1e-6 if dtype == torch.float32 else 1e-13)


def test_samples_do_not_turn_with_the_azimuth_above():
    """Within a rounding of the normal, the azimuth of the viewer is any: samples must not tell."""
    u = torch.rand(64, 2, generator=generator(1), dtype=torch.float64)
    for kind in KINDS.values():
        a, b = (kind(0.5).sample(tb.normalize(torch.tensor([x, -x, 1.0], dtype=torch.float64)).expand(64, 3), u) for x in (1e-9, -1e-9))
        torch.testing.assert_close(a, b, rtol=0, atol=1e-7)


def test_what_is_refused():
    with pytest.raises(ValueError, match=r"GGX.alpha: expected shape \[..., 1\], or \[..., 2\] along tangent and bitangent, found \[3\]"):
        tb.GGX([0.1, 0.2, 0.3])
    with pytest.raises(ValueError, match=r"RoughConductor.alpha: expected shape \[..., 1\], or \[..., 2\]"):
        tb.RoughConductor([0.1, 0.2, 0.3])
    with pytest.raises(ValueError, match=r"RoughConductor.smith: found 'walter' beside 'ggx'"):
        tb.RoughConductor(0.1, smith="walter")
    for field in ("distribution", "shadowing", "smith"):
        with pytest.raises(ValueError, match=rf"RoughConductor.{field}: found 'gauss'"):
            tb.RoughConductor(0.1, **{field: "gauss"})
    with pytest.raises(ValueError, match=r"legal range \(0, 1\], found 0"):
        tb.validate(tb.RoughConductor(0.0))
