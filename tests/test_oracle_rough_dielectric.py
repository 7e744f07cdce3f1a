"""Rough dielectrics against Mitsuba 3 (scalar_rgb): value and density, reflection and transmission, from both sides."""

import itertools

import pytest
import torch

import torchbrdf as tb
from torchbrdf.bsdf import microfacets
from torchbrdf.bsdf.refraction import Refraction
from torchbrdf.optics.beckmann import Beckmann, walter_length
from torchbrdf.testing.subject import above, directions, generator, uniform

DOUBLE, PAIRS, ETA = torch.float64, 3000, 1.5
ALPHAS = (0.02, 0.1, 0.35, 1.0)
LEAST = 1e-6  # of the largest value: what is dimmer is not looked at
WORST, QUANTILE = 1e-4, 0.999


@pytest.fixture(scope="module")
def mi():
    module = pytest.importorskip("mitsuba")
    module.set_variant("scalar_rgb")
    return module


def pairs(model, seed):
    """``wi, wo``: viewers on both sides; lights near the mirror direction, near the refracted one, and half of them anywhere."""
    wo = above(PAIRS, generator(seed), least=0.02)
    wo[::2, 2] *= -1.0
    near = [model.replace(part=part).sample(wo, uniform(PAIRS, generator(seed + 1))).wi for part in ("reflection", "transmission")]
    k = torch.arange(PAIRS).unsqueeze(1)
    wi = torch.where(k % 8 < 2, near[0], torch.where(k % 8 < 4, near[1], directions(PAIRS, generator(seed + 2))))
    kept = (wi.norm(dim=-1) > 0.5) & (wi[:, 2].abs() > 1e-3)
    return wi[kept].float().double(), wo[kept].float().double()  # as Mitsuba has them


def theirs(mi, bsdf, wi, wo, mode):
    """(f cos, pdf) of each pair; Mitsuba's wi is where the path comes from: our wo."""
    si, context = mi.SurfaceInteraction3f(), mi.BSDFContext(mode)
    si.sh_frame, si.n, si.wavelengths = mi.Frame3f(mi.Vector3f(0, 0, 1)), mi.Normal3f(0, 0, 1), []
    found = []
    for a, b in zip(wi.tolist(), wo.tolist(), strict=True):
        si.wi = mi.Vector3f(*b)
        value, pdf = bsdf.eval_pdf(context, si, mi.Vector3f(*a))
        found.append((value[0], pdf))
    return torch.tensor(found, dtype=DOUBLE).unbind(1)


def difference(ours, reference, side):
    """The 99.9th percentile of the relative difference on one side of the surface, where it is not dim."""
    bright = side & (reference > LEAST * reference[side].max())
    assert bright.sum() > 50
    return torch.quantile(((ours - reference).abs() / reference)[bright], QUANTILE).item()


def near_critical(model, wi, wo):
    """Facets that the denser side sees close to their critical angle, where Mitsuba takes the few percent 1 - F in float32."""
    at = Refraction.of(model.geometry(wi, wo), model.eta.squeeze())
    near = (at.there > 0) & (at.transmitted < 0.2)
    assert near.double().mean() < 0.01
    return near


def masking(model, wo):
    """G1 of Walter's rational function over the exact one: Mitsuba draws Beckmann's visible normals by the first, we by the second."""
    if model.smith == "exact":
        return 1.0
    local = model.viewer(wo, None)
    exact, rational = (microfacets.length_o(model, by, local) for by in (Beckmann.smith_length, walter_length))
    return (local.cos_o.abs() + exact) / (local.cos_o.abs() + rational)


@pytest.mark.parametrize(("alpha", "mode"), [*((a, "radiance") for a in (*ALPHAS, (0.4, 0.1))), (0.35, "flux")])
@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
def test_rough_dielectric(mi, distribution, alpha, mode):
    """Smith's shadowing separable, and Beckmann's Lambda by Walter's rational function, as there."""
    smith = "walter" if distribution == "beckmann" else "exact"
    ours = tb.RoughDielectric(alpha, ETA, distribution, "smith_separable", smith, mode).to(DOUBLE)
    roughness = {"alpha": alpha} if isinstance(alpha, float) else {"alpha_u": alpha[0], "alpha_v": alpha[1]}
    bsdf = mi.load_dict({"type": "roughdielectric", "distribution": distribution, "int_ior": ETA, "ext_ior": 1.0, **roughness})
    wi, wo = pairs(ours, 10)
    value, pdf = theirs(mi, bsdf, wi, wo, mi.TransportMode.Radiance if mode == "radiance" else mi.TransportMode.Importance)
    f, density = ours.evaluate(wi, wo, cosine=True).squeeze(-1), ours.pdf(wi, wo).squeeze(-1) * masking(ours, wo)
    usable = ~near_critical(ours, wi, wo)
    for inside, across in itertools.product((True, False), repeat=2):
        side = usable & ((wo[:, 2] < 0) == inside) & ((wi[:, 2] * wo[:, 2] < 0) == across)
        assert difference(f, value, side) <= WORST
        assert difference(density, pdf, side) <= WORST
