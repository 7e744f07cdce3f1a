"""Smooth interfaces: the delta pair of a dielectric, its reflectance of diffuse light, and a coat over a diffuse base."""

import math

import mpmath
import oracle
import pytest
import torch
from torch import Tensor

import torchbrdf as tb
from torchbrdf import sampling
from torchbrdf.bsdf.lobe import Draw
from torchbrdf.bsdf.sampler import shares
from torchbrdf.interval import UNIT, Interval
from torchbrdf.optics.dielectric import split
from torchbrdf.quadrature import gauss_legendre
from torchbrdf.testing import run
from torchbrdf.testing.report import compiles
from torchbrdf.testing.subject import above, directions, generator, mirrored, uniform
from torchbrdf.value import COLOUR, SCALAR, param, value

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


# ---- the delta pair


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


# ---- under an environment map


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


# ---- the reflectance of diffuse light


def closed(eta):
    """Duntley 1942, in as many digits as it takes."""
    n = mpmath.mpf(eta)
    if n <= 1:
        return mpmath.mpf(0) if n == 1 else 1 - n * n * (1 - closed(1 / n))
    n2, n4 = n * n, n**4
    total = (
        mpmath.mpf(1) / 2 + (n - 1) * (3 * n + 1) / (6 * (n + 1) ** 2) + n2 * (n2 - 1) ** 2 / (n2 + 1) ** 3 * mpmath.log((n - 1) / (n + 1))
    )
    total -= 2 * n * n2 * (n2 + 2 * n - 1) / ((n2 + 1) * (n4 - 1))
    return total + 8 * n4 * (n4 + 1) / ((n2 + 1) * (n4 - 1) ** 2) * mpmath.log(n)


AVERAGED = (0.3, 0.5, 0.9, 1 - 1e-3, 1 - 1e-6, 1 + 1e-6, 1 + 1e-3, 1.1, 1.33, 1.5, 2.0, 2.99, 3.0, 3.01, 4.0, 10.0)


@pytest.mark.parametrize("dtype", [torch.float32, DOUBLE])
def test_diffuse_light_exactly(dtype):
    eta = torch.tensor(AVERAGED, dtype=dtype).requires_grad_()
    found = tb.fresnel.dielectric_average(eta)
    (slope,) = torch.autograd.grad(found.sum(), eta)
    for n, f, s in zip(eta.tolist(), found.tolist(), slope.tolist(), strict=True):
        exact, h = closed(n), abs(mpmath.mpf(n) - 1) * mpmath.mpf(10) ** -20
        assert abs(f - exact) <= 16 * torch.finfo(dtype).eps * exact, n
        assert s == pytest.approx(float((closed(n + h) - closed(n - h)) / (2 * h)), rel=32 * torch.finfo(dtype).eps), n


def test_diffuse_light_is_the_average():
    for eta in (1.2, 1.5, 4.0, 1 / 1.5):
        f = mpmath.quad(lambda c, eta=eta: 2 * c * oracle.reflectance(c, eta), [0, 0.1, mpmath.sqrt(max(0, 1 - eta**2)), 1], maxdegree=6)
        assert tb.fresnel.dielectric_average(number(eta)).item() == pytest.approx(float(f), abs=1e-6), eta


def test_diffuse_light_between_matched_media():
    eta = number([1.0, math.nextafter(1.0, 2.0), math.nextafter(1.0, 0.0)]).requires_grad_()
    found = tb.fresnel.dielectric_average(eta)
    assert found[0] == 0
    slopes = torch.autograd.grad(found.sum(), eta)[0]
    assert slopes.tolist() == pytest.approx([1 / 3, 1 / 3, -7 / 3])


def test_diffuse_light_of_other_kinds():
    assert tb.fresnel.dielectric_average(1.5).item() == pytest.approx(0.0917779593)
    assert tb.fresnel.dielectric_average(torch.full((2, 3), 1.5, dtype=torch.bfloat16)).dtype == torch.bfloat16


# ---- a coat


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
