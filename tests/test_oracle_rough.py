"""Rough surfaces against Mitsuba 3 (scalar_rgb), in value and density, where the lobe exceeds 1e-6 of its peak.

Figures are relative differences at the 99.9th percentile of 20 000 pairs, half of them near the mirror direction; Mitsuba computes in
float32.
"""

import math

import pytest
import torch

import torchbrdf as tb
from torchbrdf.testing.subject import above, generator

PAIRS = 20_000
WEAKEST = 1e-6  # of the peak of the lobe
ALPHAS = [(0.02,), (0.1,), (0.35,), (1.0,), (0.4, 0.1)]
CASES = [("ggx", "exact", alpha, 1e-4) for alpha in ALPHAS] + [("beckmann", "walter", alpha, 2e-4) for alpha in ALPHAS]


@pytest.fixture(scope="module")
def mi():
    module = pytest.importorskip("mitsuba")
    module.set_variant("scalar_rgb")
    return module


def pairs(alpha):
    """Float32 directions: half of them uniform, half mirrored at normals that are spread as those of the surface."""
    rng = generator(7)
    wo, wi = above(PAIRS, rng, 0.01), above(PAIRS, rng, 0.01)
    slopes = torch.randn(PAIRS, 2, generator=rng, dtype=torch.float64) * torch.tensor(alpha, dtype=torch.float64)
    facet = tb.normalize(torch.cat([-slopes, torch.ones(PAIRS, 1, dtype=torch.float64)], -1))
    mirrored = tb.reflect(wo, facet)
    near = (torch.arange(PAIRS) % 2 == 0) & (mirrored[:, 2] > 0.01)
    return torch.where(near.unsqueeze(-1), mirrored, wi).float(), wo.float()


def theirs_of(mi, bsdf, wi, wo):
    """Value times cosine, and density, pair by pair."""
    si, context, found = mi.SurfaceInteraction3f(), mi.BSDFContext(), []
    si.sh_frame, si.n, si.wavelengths = mi.Frame3f(mi.Vector3f(0, 0, 1)), mi.Vector3f(0, 0, 1), []
    for i, o in zip(wi.tolist(), wo.tolist(), strict=True):
        si.wi = mi.Vector3f(*o)  # Mitsuba's wi is where the path comes from: our wo
        value, pdf = bsdf.eval_pdf(context, si, mi.Vector3f(*i))
        found.append((*value, pdf))
    table = torch.tensor(found, dtype=torch.float64)
    return table[:, :3], table[:, 3:]


def walter_share(cos, alpha):
    """G1 by Walter's fit over the exact one: Mitsuba draws normals by the exact law, and reports the density of the fit."""
    nu = cos / (alpha * torch.sqrt(1.0 - cos * cos))
    fit = torch.where(nu < 1.6, (3.535 * nu + 2.181 * nu**2) / (1.0 + 2.276 * nu + 2.577 * nu**2), 1.0)
    lam = 0.5 * (torch.exp(-nu * nu) / (nu * math.pi**0.5) - torch.erfc(nu))
    return fit * (1.0 + lam)


def furthest(ours, theirs, where):
    """Relative difference at the 99.9th percentile."""
    off = ((ours - theirs).abs() / ours.abs()).amax(-1)[where]
    return torch.quantile(off, 0.999).item()


@pytest.mark.parametrize(("distribution", "smith", "alpha", "bound"), CASES)
def test_rough_conductor(mi, distribution, smith, alpha, bound, record_property):
    gold = tb.Conductor.named("Au")
    metal = {name: {"type": "rgb", "value": getattr(gold, name).tolist()} for name in ("eta", "k")}
    wide = {"alpha_u": alpha[0], "alpha_v": alpha[-1], "distribution": distribution}
    bsdf = mi.load_dict({"type": "roughconductor", **wide, **metal})
    ours = tb.RoughConductor(list(alpha), gold, distribution, "smith_separable", smith)
    wi, wo = pairs(alpha)
    value, pdf = theirs_of(mi, bsdf, wi, wo)
    wi, wo = (tb.normalize(w.double()) for w in (wi, wo))
    half, normals = tb.normalize(wi + wo), {"ggx": tb.GGX, "beckmann": tb.Beckmann}[distribution](list(alpha))
    strong = (normals.d(half) > WEAKEST * normals.d(torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)))[:, 0]
    assert strong.sum() > 0.4 * PAIRS
    if smith == "walter":
        slopes = wo[:, :2] * torch.tensor(alpha, dtype=torch.float64)
        projected = torch.linalg.vector_norm(slopes, dim=-1, keepdim=True) / torch.linalg.vector_norm(wo[:, :2], dim=-1, keepdim=True)
        pdf = pdf / walter_share(wo[:, 2:], projected)
    found = furthest(ours.evaluate(wi, wo, cosine=True), value, strong), furthest(ours.pdf(wi, wo), pdf, strong)
    record_property("value, pdf", found)
    print(f"{distribution} {alpha}: value {found[0]:.1e}, pdf {found[1]:.1e}, {int(strong.sum())} pairs")
    assert max(found) < bound
