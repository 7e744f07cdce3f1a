"""A smooth coat over a diffuse base."""

import math

import pytest
import torch
from torch import Tensor

import torchbrdf as tb
from torchbrdf import sampling
from torchbrdf.bsdf.lobe import Draw
from torchbrdf.interval import UNIT, Interval
from torchbrdf.quadrature import gauss_legendre
from torchbrdf.testing import run
from torchbrdf.testing.report import compiles
from torchbrdf.testing.subject import above, directions, generator, uniform
from torchbrdf.value import COLOUR, SCALAR, param, value

DOUBLE = torch.float64
ETAS = (0.4, 0.75, 1.0, 1.0 + 2.0**-20, 1.33, 1.5, 2.42, 10.0)


def number(x):
    return torch.tensor(x, dtype=DOUBLE)


@value
class Minnaert(tb.Bsdf):
    """A diffuse base that is not Lambert's."""

    albedo: Tensor = param(UNIT, COLOUR, "strength")
    darkening: Tensor = param(Interval(1.0, 8.0, typical=(1.1, 3.0)), SCALAR, "k; 1 is Lambert")

    lobes = (tb.Lobe.DIFFUSE_REFLECTION,)

    def formula(self, g):
        power = g.scalar(self.darkening) - 1.0
        log_cos = torch.log(torch.where(g.above, g.cos_i, 1.0)) + torch.log(torch.where(g.above, g.cos_o, 1.0))
        return tuple(a * (power + 2.0) / (2.0 * math.pi) * torch.exp(power * log_cos) for a in g.colour(self.albedo))

    def density(self, g):
        return torch.relu(g.cos_i) / math.pi

    def draw(self, viewer, u):
        return Draw(sampling.cosine_hemisphere(u.x, u.y))


WHITE = torch.cat([above(60, generator(6), least=1e-6), number([[0.0, 0.0, 1.0], [1.0, 0.0, 1e-8]])])


@pytest.mark.parametrize("eta", ETAS)
def test_a_white_base_returns_everything(eta):
    coated = tb.Coated(tb.Lambert([1.0, 0.5]), eta)
    for dtype, most in ((DOUBLE, 4e-15), (torch.float32, 4e-7)):
        albedo = coated.directional_albedo(WHITE.to(dtype))
        assert (albedo[:, 0] - 1).abs().max() <= most
        assert (albedo[:, 1] <= 1).all()


@pytest.mark.parametrize("eta", ETAS)
@pytest.mark.parametrize("rho", [0.3, 1.0])
def test_the_closed_albedo_is_the_integral(eta, rho):
    edge = math.sqrt(max(0.0, 1.0 - eta * eta))
    x, weight = gauss_legendre(200)
    cos, weight = edge + (1.0 - edge) * x**2, (1.0 - edge) * 2.0 * x * weight  # the kink at an end, and its root made smooth
    wi = torch.stack([torch.sqrt(1.0 - cos**2), 0.0 * cos, cos], -1)
    coated = tb.Coated(tb.Lambert(rho), eta)
    for z in (1.0, 0.95, 0.5, 0.05):
        wo = number([0.0, math.sqrt(1.0 - z * z), z])
        found = (coated.evaluate(wi, wo).squeeze(-1) * cos * weight).sum() * 2.0 * math.pi + coated.deltas(coated.viewer(wo))[0].weight[0]
        assert found.item() == pytest.approx(coated.directional_albedo(wo).item(), abs=1e-9)


def walk(base, eta, wo, count, rng):
    """The albedo by chance: in through the glass, off the base, against the glass from inside, until all are out or absorbed."""
    glass, out = tb.SmoothDielectric(eta, mode="flux"), 0.0
    w, power = wo.expand(count, 3), torch.ones(count, 1, dtype=DOUBLE)
    s = glass.sample(w, uniform(count, rng))
    inside = s.lobe.squeeze(-1) == 1
    out, w, power = float(power[~inside].sum()), -s.wi[inside], power[inside]
    for _ in range(60):
        s = base.sample(w, uniform(len(w), rng))
        power, up = power * s.weight, s.wi
        s = glass.sample(-up, uniform(len(w), rng))
        leaves = s.lobe.squeeze(-1) == 1
        out += float(power[leaves].sum())
        w, power = -s.wi[~leaves], power[~leaves]
        w = w * w[:, 2:].sign()
        if not len(w):
            break
    return out / count


@pytest.mark.parametrize(("eta", "z"), [(1.5, 1.0), (1.5, 0.2), (2.42, 0.6), (0.8, 0.9)])
def test_a_coated_lambert_is_what_light_does(eta, z):
    base, wo = tb.Lambert(0.8), number([math.sqrt(1.0 - z * z), 0.0, z])
    albedo = tb.Coated(base, eta).directional_albedo(wo).item()
    assert walk(base, eta, wo, 100_000, generator(7)) == pytest.approx(albedo, abs=5e-3)


def test_another_base_is_near_to_what_light_does():
    """Only the first scattering is exact; the others are taken as diffuse."""
    base, wo = Minnaert(0.8, 1.5), number([0.6, 0.0, 0.8])
    coated = tb.Coated(base, 1.5)
    assert coated.energy_bound is None
    assert walk(base, 1.5, wo, 100_000, generator(8)) == pytest.approx(coated.directional_albedo(wo).item(), abs=0.01)
    wi = above(50, generator(9))
    v, w = (tb.refract(x, number([0.0, 0.0, 1.0]), 1.5)[0] for x in (wo, wi))
    t = [1 - tb.fresnel.dielectric(x[..., 2:], number(1.5)) for x in (wo, wi)]
    mean = 0.8 * 2 * 2.5 / (2.5**2)  # of a (k + 1)/(2 pi) (cos cos)^(k-1): 2 a (k + 1)/(k + 1)^2
    within = 1 - (1 - tb.fresnel.dielectric_average(number(1.5))) / 2.25
    again = mean * mean * within / (1 - mean * within) / math.pi
    expected = t[0] * t[1] / 2.25 * (base.evaluate(-w, (-v).expand_as(w)) + again)
    assert torch.allclose(coated.evaluate(wi, wo), expected, rtol=1e-5)


@pytest.mark.slow
def test_a_base_that_is_not_lamberts_signs():
    report = tb.testing.check(tb.Coated(0.5 * (tb.Lambert(0.5) + Minnaert([0.8, 0.5, 0.3], 1.7)), 1.5))
    assert report.ok, f"\n{report}"
    assert run(compiles, tb.Coated(Minnaert(0.5, 1.7), 1.5), backend="aot_eager").ok


def test_lambert_by_the_long_way():
    """A base that is Lambert's and does not say so."""
    wi, wo, n = above(50, generator(10)), above(50, generator(11)), directions(50, generator(12))
    for args in ((wi, wo), (directions(50, generator(13)), directions(50, generator(14)), n)):
        plain, long = (tb.Coated(b, 1.5).evaluate(*args) for b in (tb.Lambert([0.9, 0.5, 0.1]), Minnaert([0.9, 0.5, 0.1], 1.0)))
        assert torch.allclose(plain, long, rtol=1e-12)
    many = [0.9, 0.5, 0.1, 0.2, 0.3]
    wide = tb.Coated(Minnaert(many, 1.0), 1.5).evaluate(wi, wo)
    assert torch.allclose(wide, tb.Coated(tb.Lambert(many), 1.5).evaluate(wi, wo), rtol=1e-12)
    batch = tb.Coated(Minnaert(torch.rand(50, 3, dtype=DOUBLE, generator=generator(15)), 1.0), number([[1.5]]))
    assert torch.allclose(batch.evaluate(wi, wo)[7], batch[7].evaluate(wi[7], wo[7]), rtol=1e-12)


def test_no_coat_is_the_base():
    wi, wo = above(50, generator(16)), above(50, generator(17))
    for base in (tb.Lambert([0.9, 0.1]), Minnaert([0.9, 0.1], 2.0)):
        assert torch.allclose(tb.Coated(base, 1.0).evaluate(wi, wo), base.evaluate(wi, wo), rtol=1e-12)


def test_a_coat_in_parts():
    coated, wo = tb.Coated(tb.Lambert([0.9, 0.5, 0.1]), 1.5), above(30, generator(18))
    gloss, diffuse = coated.select(tb.Lobe.DELTA), coated.select(tb.Lobe.SPREAD)
    assert isinstance(gloss, tb.Mirror)
    assert diffuse.lobes == (tb.Lobe.DIFFUSE_REFLECTION,)
    assert diffuse.select(tb.Lobe.DELTA) is None
    assert coated.select(tb.Lobe.TRANSMISSION) is None
    parts = gloss.directional_albedo(wo) + diffuse.directional_albedo(wo)
    assert torch.allclose(parts, coated.directional_albedo(wo))
    half = 0.5 * tb.Lambert([0.9, 0.5, 0.1]) + tb.Lambert(0.0)
    assert torch.allclose(
        tb.Coated(half, 1.5).directional_albedo(wo), tb.Coated(tb.Lambert([0.45, 0.25, 0.05]), 1.5).directional_albedo(wo)
    )


def test_what_may_lie_below_a_coat():
    for base, found in ((tb.Mirror(1.0), "delta reflection of Mirror"), (tb.Phong(0.5, 9.0), "glossy reflection of Phong")):
        with pytest.raises(ValueError, match=rf"Coated\.base: expected lobes of diffuse reflection alone, found {found}"):
            tb.Coated(base, 1.5)
    with pytest.raises(TypeError, match=r"Coated\.base: expected a BSDF"):
        tb.Coated(0.5, 1.5)

    class Brighter(tb.Lambert):
        def formula(self, g):
            return tuple(f * g.cos_o for f in super().formula(g))

    assert Brighter(0.5).lambertian is None


def test_a_coat_is_learned():
    """Albedo and index from noisy reflectances over angles."""
    wi, wo = above(400, generator(19)), above(400, generator(20))
    seen = tb.Coated(tb.Lambert([0.7, 0.4, 0.2]), 1.5).evaluate(wi, wo)
    seen = seen * (1 + 0.01 * torch.randn(seen.shape, dtype=DOUBLE, generator=generator(21)))
    raw = [number([0.0, 0.0, 0.0]).requires_grad_(), number([-1.0]).requires_grad_()]
    optimizer = torch.optim.LBFGS(raw, max_iter=200, tolerance_grad=1e-12, tolerance_change=1e-15, line_search_fn="strong_wolfe")

    def coated():
        return tb.Coated(tb.Lambert(torch.sigmoid(raw[0])), 1.0 + torch.exp(raw[1]))

    def closure():
        optimizer.zero_grad()
        loss = (coated().evaluate(wi, wo) - seen).square().mean()
        loss.backward()
        return loss

    optimizer.step(closure)
    found = coated()
    assert found.base.albedo.tolist() == pytest.approx([0.7, 0.4, 0.2], rel=0.02)
    assert found.eta.item() == pytest.approx(1.5, rel=0.02)
