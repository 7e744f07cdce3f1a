"""Values against Mitsuba 3 (scalar_rgb): an independent renderer's diffuse, conductor and dielectric."""

import itertools

import pytest
import torch

import torchbrdf as tb
from torchbrdf.testing.subject import above, generator

SINGLE = 16 * torch.finfo(torch.float32).eps  # Mitsuba computes in float32


@pytest.fixture(scope="module")
def mi():
    module = pytest.importorskip("mitsuba")
    module.set_variant("scalar_rgb")
    return module


def interaction(mi, wo):
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(*wo.tolist())  # Mitsuba's wi is where the path comes from: our wo
    si.sh_frame = mi.Frame3f(mi.Vector3f(0, 0, 1))
    si.n = mi.Vector3f(0, 0, 1)
    si.wavelengths = []
    return si


def rgb(colour):
    return {"type": "rgb", "value": colour}


def test_diffuse(mi):
    colour = [0.7, 0.4, 0.1]
    theirs, ours = mi.load_dict({"type": "diffuse", "reflectance": rgb(colour)}), tb.Lambert(colour)
    wi, wo = above(50, generator(0)), above(50, generator(1))
    for i in range(50):
        value, pdf = theirs.eval_pdf(mi.BSDFContext(), interaction(mi, wo[i]), mi.Vector3f(*wi[i].tolist()))
        f = ours.evaluate(wi[i], wo[i]) * wi[i, 2]
        assert f.tolist() == pytest.approx(list(value), rel=SINGLE)
        assert ours.pdf(wi[i], wo[i]).item() == pytest.approx(pdf, rel=SINGLE)


def test_diffuse_below_the_horizon(mi):
    theirs = mi.load_dict({"type": "diffuse"})
    for up, down in ((0.5, -0.5), (-0.5, 0.5), (-0.5, -0.5)):
        wi, wo = (tb.normalize(torch.tensor([0.3, 0.2, z], dtype=torch.float64)) for z in (up, down))
        assert list(theirs.eval(mi.BSDFContext(), interaction(mi, wo), mi.Vector3f(*wi.tolist()))) == [0.0] * 3
        assert tb.Lambert(0.5).evaluate(wi, wo).item() == 0.0


@pytest.mark.parametrize(("eta", "k"), [(1.5, 0.0), (1 / 1.5, 0.0), (0.2, 3.0), (3.0, 0.4)])
def test_polarised_amplitudes_are_its_conjugates(mi, eta, k):
    """Mitsuba's time runs as exp(+i omega t)."""
    index = type(mi.fresnel_polarized(0.5, 1.5)[0])(eta, k)
    for cos in (0.05, 0.3, 0.6, 0.9, 1.0):
        ours = tb.fresnel.amplitudes(torch.tensor(cos, dtype=torch.float64), eta, k)
        for theirs, r in zip(mi.fresnel_polarized(cos, index)[:2], (ours.s, ours.p), strict=True):
            assert (theirs.real, theirs.imag) == pytest.approx((r.real.item(), -r.imag.item()), abs=SINGLE)


@pytest.mark.parametrize("metal", ["Au", "Cu", "Ag", "Al"])
def test_smooth_conductor_is_a_mirror(mi, metal):
    fresnel = tb.Conductor.named(metal)
    theirs = mi.load_dict({"type": "conductor", "eta": rgb(fresnel.eta.tolist()), "k": rgb(fresnel.k.tolist())})
    ours, wo = tb.Mirror(1.0, fresnel), above(50, generator(2))
    for i in range(50):
        sample, weight = theirs.sample(mi.BSDFContext(), interaction(mi, wo[i]), 0.5, mi.Point2f(0.5, 0.5))
        s = ours.sample(wo[i], torch.full((2,), 0.5, dtype=torch.float64))
        assert s.wi.tolist() == pytest.approx(list(sample.wo), abs=SINGLE)
        assert s.weight.tolist() == pytest.approx(list(weight), rel=4 * SINGLE)


@pytest.mark.parametrize("eta", [1.33, 1.5, 2.42])
def test_smooth_dielectric_reflects_the_fresnel_share(mi, eta):
    """Chosen with the probability of reflection, from outside and from inside, where Mitsuba turns eta over itself."""
    theirs = mi.load_dict({"type": "dielectric", "int_ior": eta, "ext_ior": 1.0})
    wo = above(50, generator(3))
    for i, side in itertools.product(range(50), (1.0, -1.0)):
        w = wo[i] * torch.tensor([1.0, 1.0, side], dtype=torch.float64)
        sample, _ = theirs.sample(mi.BSDFContext(), interaction(mi, w), 0.0, mi.Point2f(0.5, 0.5))  # 0: always the reflection
        share = tb.fresnel.dielectric(wo[i, 2], eta if side > 0 else 1.0 / eta)
        assert sample.pdf == pytest.approx(share.item(), rel=256 * SINGLE, abs=SINGLE)
        r, _, _, eta_ti = mi.fresnel(side * wo[i, 2].item(), eta)
        assert r == pytest.approx(share.item(), rel=256 * SINGLE, abs=SINGLE)
        n = torch.tensor([0.0, 0.0, side], dtype=torch.float64)
        wt, valid = tb.refract(w, n, eta if side > 0 else 1.0 / eta)
        if bool(valid):
            sample, _ = theirs.sample(mi.BSDFContext(), interaction(mi, w), 1.0, mi.Point2f(0.5, 0.5))
            assert wt.tolist() == pytest.approx(list(sample.wo), abs=64 * SINGLE)
        assert eta_ti == pytest.approx(1 / eta if side > 0 else eta, rel=SINGLE)


def test_conductor_reflectance(mi):
    for n, k, cos in itertools.product((0.1, 0.5, 1.0, 1.5, 3.0), (0.5, 2.0, 7.0), (0.01, 0.1, 0.4, 0.8, 1.0)):
        theirs = mi.fresnel_conductor(cos, mi.Complex2f(n, k))
        ours = tb.fresnel.conductor(torch.tensor(cos, dtype=torch.float64), n, k).item()
        assert ours == pytest.approx(theirs, rel=16 * SINGLE), (n, k, cos)  # Mitsuba's float32 loses up to 1e-5 here


def test_frame_is_mitsubas(mi):
    for n in tb.normalize(torch.randn(50, 3, dtype=torch.float64)):
        theirs = mi.Frame3f(mi.Vector3f(*n.tolist()))
        ours = tb.Frame.from_normal(n)
        assert ours.tangent.tolist() == pytest.approx(list(theirs.s), abs=SINGLE)
        assert ours.bitangent.tolist() == pytest.approx(list(theirs.t), abs=SINGLE)


@pytest.mark.parametrize("eta", [1.33, 1.5, 2.42])
def test_smooth_dielectric_is_its_dielectric(mi, eta):
    """Radiance along a path from the camera, which is its default: weight, direction and index of both lobes, from both sides."""
    theirs, ours = mi.load_dict({"type": "dielectric", "int_ior": eta, "ext_ior": 1.0}), tb.SmoothDielectric(eta)
    wo = above(50, generator(4))
    wo[::2, 2] *= -1.0
    for w in wo:
        viewer = ours.viewer(w, None)
        for delta, u in zip(ours.deltas(viewer), (0.0, 1.0), strict=True):
            power = delta.weight[0].item()
            if power == 0.0:
                continue  # total reflection
            sample, weight = theirs.sample(mi.BSDFContext(), interaction(mi, w), u, mi.Point2f(0.5, 0.5))
            assert next(iter(weight)) * sample.pdf == pytest.approx(power, rel=256 * SINGLE, abs=SINGLE)
            assert viewer.layout.join_vector(delta.wi).tolist() == pytest.approx(list(sample.wo), abs=64 * SINGLE)
            assert float(delta.eta) == pytest.approx(sample.eta, rel=SINGLE)


@pytest.mark.parametrize("nonlinear", [True, False])
@pytest.mark.parametrize("eta", [1.3, 1.5, 1.9])
def test_coated_is_its_plastic(mi, eta, nonlinear):
    """But for its fit of F_di, which is put in place of ours. Linear, each return is white, and rho a factor of the whole."""
    colour, wi, wo = [0.7, 0.4, 0.1], above(50, generator(5)), above(50, generator(6))
    theirs = mi.load_dict({"type": "plastic", "diffuse_reflectance": rgb(colour), "int_ior": eta, "ext_ior": 1.0, "nonlinear": nonlinear})
    fit, exact = mi.fresnel_diffuse_reflectance(1.0 / eta), 1.0 - (1.0 - tb.fresnel.dielectric_average(torch.tensor(eta).double())) / eta**2
    assert fit == pytest.approx(exact.item(), abs=1.5e-3)
    rho = torch.tensor(colour, dtype=torch.float64)
    base = rho if nonlinear else torch.ones_like(rho)
    ours = tb.Coated(tb.Lambert(base), eta)
    scale = (1.0 - base * exact) / (1.0 - base * fit) * (1.0 if nonlinear else rho)
    for i in range(50):
        value = theirs.eval(mi.BSDFContext(), interaction(mi, wo[i]), mi.Vector3f(*wi[i].tolist()))
        f = ours.evaluate(wi[i], wo[i]) * wi[i, 2] * scale
        assert f.tolist() == pytest.approx(list(value), rel=256 * SINGLE)
        sample, weight = theirs.sample(mi.BSDFContext(), interaction(mi, wo[i]), 0.0, mi.Point2f(0.5, 0.5))  # 0: always the reflection
        (mirror,) = ours.deltas(ours.viewer(wo[i], None))
        assert next(iter(weight)) * sample.pdf == pytest.approx(mirror.weight[0].item(), rel=256 * SINGLE)


@pytest.mark.parametrize(("roughness", "anisotropic"), [(0.2, 0.0), (0.6, 0.0), (0.5, 0.5), (0.9, 1.0)])
def test_a_metal_is_its_principled(mi, roughness, anisotropic):
    """With its separable masking; base and coat are other laws there."""
    colour, wi, wo = [0.9, 0.6, 0.2], above(100, generator(7)), above(100, generator(8))
    wi[::2] = tb.normalize(wi[::2] * 0.1 + wo[::2] * torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64))  # near the mirror direction
    given = {"metallic": 1.0, "roughness": roughness, "anisotropic": anisotropic}
    theirs = mi.load_dict({"type": "principled", "base_color": rgb(colour), **given})
    ours = tb.Principled(colour, 1, roughness, anisotropy=anisotropic, shadowing="smith_separable")
    for i in range(100):
        value, pdf = theirs.eval_pdf(mi.BSDFContext(), interaction(mi, wo[i]), mi.Vector3f(*wi[i].tolist()))
        f = ours.evaluate(wi[i], wo[i]) * wi[i, 2]
        assert f.tolist() == pytest.approx(list(value), rel=1e-4, abs=1e-9)
        assert ours.pdf(wi[i], wo[i]).item() == pytest.approx(pdf, rel=1e-4, abs=1e-9)
