"""A rough coat over a diffuse base."""

import pytest
import torch

import torchbrdf as tb
from torchbrdf.bsdf.boundary_albedo import BOUNDARY_FITS
from torchbrdf.testing.subject import above, at_angles, generator

DOUBLE = torch.float64
CASES = [case for case in BOUNDARY_FITS if case[1] not in ("inside", "through")]
ALPHAS, ETAS = torch.tensor([0.02, 0.05, 0.1, 0.3, 1.0], dtype=DOUBLE), torch.tensor([1.125, 1.25, 1.5, 3.0], dtype=DOUBLE)
VIEWS = at_angles(0.0, 20.0, 45.0, 60.0, 75.0, 85.0, 89.0, 89.7).to(DOUBLE)


def white(distribution="ggx", shadowing="smith_correlated", **choices):
    """Of every roughness and index, ``[alpha, eta, 1]`` beside the views."""
    return tb.RoughPlastic(
        torch.ones(1, dtype=DOUBLE), ALPHAS[:, None, None, None], ETAS[:, None, None], distribution, shadowing, **choices
    )


@pytest.mark.parametrize(("distribution", "shadowing"), CASES)
def test_a_white_base_returns_everything(distribution, shadowing):
    found = white(distribution, shadowing).directional_albedo(VIEWS)
    assert (found - 1.0).abs().max() <= 1e-3


def test_the_base_returns_what_its_closed_albedo_says():
    base = white(gloss=False).replace(albedo=0.7)
    viewer = base.viewer(VIEWS[:-1])
    closed, integral = base.albedo_at(viewer, 32)[0], tb.Bsdf.albedo_at(base, viewer, 48)[0]
    assert (closed - integral).abs().max() <= 2e-5


@pytest.mark.parametrize("eta", [1.2, 1.5, 2.5])
def test_a_smooth_one_is_the_coated_lambert(eta):
    rho = torch.tensor([0.9, 0.3], dtype=DOUBLE)
    ours, theirs = tb.RoughPlastic(rho, 1e-4, eta, gloss=False), tb.Coated(tb.Lambert(rho), eta, gloss=False)
    wi, wo = (above(200, generator(k), least=0.05) for k in (1, 2))
    assert torch.allclose(ours.evaluate(wi, wo), theirs.evaluate(wi, wo), rtol=1e-3)


def test_derivatives_by_every_parameter():
    rng = generator(3)
    wi, wo = (above(3, rng, least=0.2) for _ in range(2))
    inputs = [torch.tensor(x, dtype=DOUBLE, requires_grad=True) for x in ([0.8, 0.2], [0.3], [1.5])]

    def call(*p):
        return tb.RoughPlastic(*p).evaluate(wi, wo)

    assert torch.autograd.gradcheck(call, inputs)
    assert torch.autograd.gradgradcheck(call, inputs)


REFUSED = {
    "index": (lambda: tb.validate(tb.RoughPlastic(0.5, 0.2, 1.05)), r"RoughPlastic\.eta.*\[1\.125, 3\]"),
    "dense": (lambda: tb.validate(tb.RoughPlastic(0.5, 0.2, 3.1)), r"RoughPlastic\.eta.*\[1\.125, 3\]"),
    "axes": (lambda: tb.RoughPlastic(0.5, [0.2, 0.1], 1.5), r"RoughPlastic\.alpha"),
    "shadowing": (lambda: tb.RoughPlastic(0.5, 0.2, 1.5, "blinn"), r"RoughPlastic\.shadowing: found 'smith_correlated' beside 'blinn'"),
    "coupling": (lambda: tb.RoughPlastic(0.5, 0.2, 1.5, coupling="none"), r"RoughPlastic\.coupling: .*none"),
    "mitsuba": (lambda: tb.RoughPlastic(0.5, 0.2, 1.5, coupling="mitsuba"), r"goes with shadowing='smith_separable'"),
    "gloss": (lambda: tb.RoughPlastic(0.5, 0.2, 1.5, gloss=0.5), r"RoughPlastic\.gloss: found 0\.5"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_not_legal_is_named(case):
    make, match = REFUSED[case]
    with pytest.raises((TypeError, ValueError), match=match):
        make()


def test_selection():
    plastic = tb.RoughPlastic(0.5, 0.2, 1.5)
    glossy, diffuse = plastic.select(tb.Lobe.GLOSSY), plastic.select(tb.Lobe.DIFFUSE)
    wi, wo = above(20, generator(4)).float(), above(20, generator(5)).float()
    assert torch.allclose(glossy.evaluate(wi, wo) + diffuse.evaluate(wi, wo), plastic.evaluate(wi, wo), rtol=1e-5)
    assert (glossy.lobes, diffuse.lobes) == ((tb.Lobe.GLOSSY_REFLECTION,), (tb.Lobe.DIFFUSE_REFLECTION,))
    assert plastic.select(tb.Lobe.TRANSMISSION) is None


@pytest.fixture(scope="module")
def mi():
    module = pytest.importorskip("mitsuba")
    module.set_variant("scalar_rgb")
    return module


def theirs(mi, bsdf, wi, wo):
    """f cos of each pair; Mitsuba's wi is where the path comes from: our wo."""
    si, context = mi.SurfaceInteraction3f(), mi.BSDFContext()
    si.sh_frame, si.n, si.wavelengths = mi.Frame3f(mi.Vector3f(0, 0, 1)), mi.Normal3f(0, 0, 1), []
    found = []
    for a, b in zip(wi.tolist(), wo.tolist(), strict=True):
        si.wi = mi.Vector3f(*b)
        found.append(bsdf.eval(context, si, mi.Vector3f(*a))[0])
    return torch.tensor(found, dtype=DOUBLE)


@pytest.mark.parametrize("nonlinear", [True, False])
@pytest.mark.parametrize(("distribution", "alpha"), [("ggx", 0.1), ("ggx", 0.4), ("beckmann", 0.3)])
def test_mitsuba(mi, distribution, alpha, nonlinear):
    """The base alone, whose T is a fit within 4e-3, twice, and which Mitsuba interpolates; then with the coat."""
    rho, eta = 0.6, 1.5
    ours = tb.RoughPlastic(rho, alpha, eta, distribution, "smith_separable", "mitsuba", nonlinear).to(DOUBLE)
    make = {"type": "roughplastic", "distribution": distribution, "alpha": alpha, "int_ior": eta, "ext_ior": 1.0, "nonlinear": nonlinear}
    make["diffuse_reflectance"] = {"type": "rgb", "value": rho}
    wi, wo = (above(300, generator(k), least=0.05).float().double() for k in (6, 7))
    base = theirs(mi, mi.load_dict({**make, "specular_reflectance": {"type": "rgb", "value": 0.0}}), wi, wo)
    f = ours.replace(gloss=False).evaluate(wi, wo, cosine=True).squeeze(-1)
    assert ((f - base).abs() / base).max() <= 1.2e-2
    both = theirs(mi, mi.load_dict(make), wi, wo)
    assert ((ours.evaluate(wi, wo, cosine=True).squeeze(-1) - both).abs() / both).max() <= 1.2e-2
