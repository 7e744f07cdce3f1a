"""Fresnel's laws in closed form and against 320 bits; Schlick's error; the metals."""

import itertools
import math

import oracle
import pytest
import torch
from torch.autograd import grad

import torchbrdf as tb
from torchbrdf import fresnel, numerics
from torchbrdf.geometry import Layout
from torchbrdf.loading import from_state
from torchbrdf.optics import approximations
from torchbrdf.optics.metals import index_at, tables

DTYPES = (torch.float32, torch.float64)


def cosines(count=201):
    return torch.linspace(0, 1, count, dtype=torch.float64)


@pytest.mark.parametrize("eta", [0.4, 0.75, 1.33, 1.5, 2.42])
def test_normal_incidence(eta):
    expected = ((eta - 1) / (eta + 1)) ** 2
    one = torch.ones((), dtype=torch.float64)
    assert fresnel.dielectric(one, eta).item() == pytest.approx(expected, rel=1e-14)
    assert fresnel.conductor(one, eta, 3.0).item() == pytest.approx(((eta - 1) ** 2 + 9) / ((eta + 1) ** 2 + 9), rel=1e-14)
    assert fresnel.schlick(one, 0.3).item() == pytest.approx(0.3, rel=1e-15)


@pytest.mark.parametrize("eta", [0.6, 1.33, 1.5, 2.42])
def test_brewster(eta):
    """At tan(theta) = eta nothing is reflected in the plane of incidence: F is half the perpendicular part."""
    cos = 1.0 / math.sqrt(1.0 + eta * eta)
    r_s = (1.0 - eta * eta) / (1.0 + eta * eta)
    assert fresnel.dielectric(torch.tensor(cos, dtype=torch.float64), eta).item() == pytest.approx(0.5 * r_s * r_s, rel=1e-13)


def test_the_cosine_obeys_snell():
    c = cosines()
    for eta in (0.5, 0.9, 1.5, 3.0):
        s_re = fresnel.amplitudes(c, eta).s_re
        cos_t = fresnel.refraction_cosine(c, eta)
        total = 1 - c * c >= eta * eta
        torch.testing.assert_close((eta * torch.sqrt(1 - cos_t**2))[~total], torch.sqrt(1 - c * c)[~total], rtol=1e-12, atol=1e-7)
        assert bool((cos_t[total] == 0).all())
        # what is not reflected is transmitted: r_s^2 + (eta cos_t / cos_i) t_s^2 = 1 with t_s = 1 + r_s
        torch.testing.assert_close((c * (1 - s_re**2))[~total], (eta * cos_t * (1 + s_re) ** 2)[~total], rtol=1e-11, atol=1e-15)
    assert fresnel.refraction_cosine(torch.tensor([0.0, 0.3, 1.0]), 1.0).tolist() == torch.tensor([0.0, 0.3, 1.0]).tolist()


@pytest.mark.parametrize("dtype", DTYPES)
def test_total_internal_reflection(dtype):
    eta = torch.tensor(1 / 1.5, dtype=dtype)
    critical = torch.sqrt((1 - eta) * (1 + eta))
    c = (critical * torch.linspace(0, 0.9999, 50, dtype=dtype)).requires_grad_()
    r = fresnel.dielectric(c, eta)
    assert bool((r == 1).all())
    assert bool((grad(r.sum(), c)[0] == 0).all())
    outside = (critical * 1.0001).detach().requires_grad_()
    r = fresnel.dielectric(outside, eta)
    assert r < 1
    assert grad(r, outside)[0] < -10, "steep, and not capped"


@pytest.mark.parametrize("dtype", DTYPES)
def test_matched_media(dtype):
    """eta = 1 reflects nothing, grazing included, and has a finite gradient."""
    c = torch.tensor([0.0, 1e-30, 1e-3, 0.5, 1.0], dtype=dtype, requires_grad=True)
    eta = torch.ones(5, dtype=dtype, requires_grad=True)
    k = torch.zeros(5, dtype=dtype, requires_grad=True)
    for r, inputs in ((fresnel.dielectric(c, eta), (c, eta)), (fresnel.conductor(c, eta, k), (c, eta, k))):
        assert bool((r == 0).all())
        assert all(bool(torch.isfinite(g).all()) for g in grad(r.sum(), inputs))


def test_grazing_reflects_everything():
    zero = torch.zeros((), dtype=torch.float64)
    for r in (fresnel.dielectric(zero, 1.5), fresnel.conductor(zero, 0.2, 3.0), fresnel.schlick(zero, 0.04)):
        assert 1.0 - 1e-15 <= r.item() <= 1.0  # within an ulp, and never above


@pytest.mark.parametrize("eta", [0.5, 0.9, 1.2, 1.5, 3.0])
def test_conductor_without_absorption_is_a_dielectric(eta):
    torch.testing.assert_close(fresnel.conductor(cosines(), eta, 0.0), fresnel.dielectric(cosines(), eta), rtol=1e-12, atol=1e-14)


def test_reflectance_lies_in_the_unit_interval():
    c = cosines()[:, None].float()
    for term in (tb.Dielectric(torch.linspace(0.3, 4, 50)), tb.Conductor(torch.linspace(0.05, 4, 50), torch.linspace(0, 9, 50))):
        r = term.reflectance(c)
        assert bool(((r >= 0) & (r <= 1)).all())


def test_stokes_reversibility():
    """The same fraction is reflected on the way back along the refracted ray."""
    c = cosines()[1:]
    _, cos_t = c, torch.sqrt(1 - (1 - c * c) / 1.5**2)
    torch.testing.assert_close(fresnel.dielectric(c, 1.5), fresnel.dielectric(cos_t, 1 / 1.5), rtol=1e-10, atol=1e-14)


def critical_points(dtype):
    """(cos, eta) spread over [0, 1], and the nearest neighbours of every critical angle, outside and in."""
    for eta in (0.4, 2 / 3, 0.75, 0.95, 0.999, 1 - 1e-7, 1 + 1e-7, 1.33, 1.5, 2.42, 10.0):
        n = torch.tensor(eta, dtype=dtype)
        yield from ((c.item(), n.item()) for c in torch.linspace(0, 1, 12, dtype=dtype))
        if eta < 1:
            c = torch.sqrt((1 - n.double()) * (1 + n.double())).to(dtype)
            for toward in (2.0, 0.0):
                near = c
                for _ in range(6):
                    near = torch.nextafter(near, torch.tensor(toward, dtype=dtype))
                    yield near.item(), n.item()
            yield from (((c * (1 + d)).item(), n.item()) for d in (1e-5, 1e-4, 1e-3, 1e-2))


@pytest.mark.parametrize("dtype", DTYPES)
def test_dielectric_against_the_oracle(dtype):
    points = list(critical_points(dtype))
    c, eta = (torch.tensor(x, dtype=dtype, requires_grad=True) for x in zip(*points, strict=True))
    r = fresnel.dielectric(c, eta)
    slopes = grad(r.sum(), (c, eta))
    eps = torch.finfo(dtype).eps
    for i, (ci, ni) in enumerate(points):
        exact = oracle.reflectance(ci, ni)
        assert abs(r[i].item() - exact) <= 13 * eps * exact, (ci, ni)  # the measured worst is 7.1 eps
        g2 = oracle.mpmath.mpf(ni) ** 2 - 1 + oracle.mpmath.mpf(ci) ** 2
        if g2 > 0 and ci > 0:
            for k in range(2):
                exact = oracle.derivative(k, ci, ni)
                near = 1e-4 if dtype == torch.float32 else 1e-8  # relative, or to 1 where the true slope is small
                assert abs(slopes[k][i].item() - exact) <= near * max(1, abs(exact)), (ci, ni, k)


@pytest.mark.parametrize("dtype", DTYPES)
def test_conductor_against_the_oracle(dtype):
    grid = itertools.product(
        (0.0, 1e-4, 0.01, 0.1, 0.3, 0.5, 0.8, 0.99, 1.0), (0.05, 0.2, 0.95, 1.0, 1.5, 3.0), (0.0, 1e-3, 0.5, 2.0, 7.0, 1e3)
    )
    points = [tuple(torch.tensor(x, dtype=dtype).item() for x in p) for p in grid]
    inputs = tuple(torch.tensor(x, dtype=dtype, requires_grad=True) for x in zip(*points, strict=True))
    r = fresnel.conductor(*inputs)
    slopes = grad(r.sum(), inputs)
    eps = torch.finfo(dtype).eps
    for i, p in enumerate(points):
        exact = oracle.reflectance(*p)
        assert abs(r[i].item() - exact) <= 16 * eps * exact, p  # the measured worst, at R = 7e-4, is 14 eps
        if p[0] > 0 and p[2] > 0:
            for k in range(3):
                exact = oracle.derivative(k, *p)
                assert abs(slopes[k][i].item() - exact) <= 512 * eps * max(1, abs(exact)), (p, k)


def test_conductor_slope_where_the_square_is_real_negative_or_zero():
    """eta^2 - k^2 = s^2 exactly: the sign of the real part changes here, and |x| has no slope at 0."""
    c, n, k = (torch.tensor(x, dtype=torch.float64, requires_grad=True) for x in (1.0, 2.0, 2.0))
    for i, slope in enumerate(grad(fresnel.conductor(c, n, k), (c, n, k))):
        assert slope.item() == pytest.approx(float(oracle.derivative(i, 1.0, 2.0, 2.0)), abs=1e-12)


def test_schlick_error_is_as_documented():
    c = cosines(2001)
    for low, high, bound in ((1.3, 1.8, 0.07), (1.2, 2.5, 0.12)):
        eta = torch.linspace(low, high, 51, dtype=torch.float64)[:, None]
        error = (fresnel.schlick(c, ((eta - 1) / (eta + 1)) ** 2) - fresnel.dielectric(c, eta)).abs().max()
        assert 0.8 * bound < error <= bound
    for metal in tables():
        term = tb.Conductor.named(metal)
        f0 = term.reflectance(torch.ones(1, dtype=torch.float64))
        error = (tb.Schlick(f0).reflectance(c[:, None]) - term.reflectance(c[:, None])).abs().max()
        assert error <= (0.04 if metal in ("Cu", "Ag", "Au") else 0.2), metal


METHODS = ("standard", "extended", "plain")


@pytest.mark.parametrize("method", METHODS)
def test_methods_by_name(method, tmp_path):
    """Asked of functions and terms alike; kept by replace, transforms of tensors and files; no tensor; shown if it is not the default."""
    c = cosines()
    for term, law in (
        (tb.Dielectric(1.5, method=method), lambda c: fresnel.dielectric(c, 1.5, method)),
        (tb.Conductor(0.2, 3.0, method), lambda c: fresnel.conductor(c, 0.2, 3.0, method=method)),
    ):
        assert (term.reflectance(c[:, None])[:, 0] == law(c)).all()
        torch.testing.assert_close(law(c), term.replace(method="standard").reflectance(c[:, None])[:, 0], rtol=1e-12, atol=0.0)
        term.to(torch.float32).save(tmp_path / "term")
        assert tb.load_value(tmp_path / "term").method == method
        assert all(isinstance(x, torch.Tensor) for x in torch.utils._pytree.tree_leaves(term))
        assert ("method" in repr(term)) == (method != "standard")


def test_methods_differ_where_they_say():
    """At the critical angle, in float32: plain sums lose their digits there, and there alone."""
    eta = torch.full((1000,), 0.7)
    c = torch.sqrt((1 - eta) * (1 + eta)) * (1 + torch.logspace(-6.5, -1, 1000))
    exact = fresnel.dielectric(c.double(), eta.double())
    standard, extended, plain = (((fresnel.dielectric(c, eta, m) - exact) / exact).abs().max().item() / 2**-23 for m in METHODS)
    assert max(standard, extended) < 16
    assert plain > 100


def test_methods_without_float64(monkeypatch):
    """Where a device has none, the compensated sum; so for float64 itself."""
    c, eta = torch.tensor([0.5, 0.9], dtype=torch.float64), torch.tensor([0.9, 0.4], dtype=torch.float64)
    exact, calls = numerics.eta2_minus_sin2, []
    monkeypatch.setattr(numerics, "eta2_minus_sin2", lambda *x: calls.append(x) or exact(*x))
    fresnel.dielectric(c, eta)
    assert len(calls) == 1
    fresnel.dielectric(c.float(), eta.float())
    assert len(calls) == 1


def test_an_unknown_method():
    for call, name in (
        (lambda m: tb.Dielectric(1.5, method=m), "Dielectric.method"),
        (lambda m: tb.Conductor(0.2, 3.0, method=m), "Conductor.method"),
        (lambda m: fresnel.dielectric(cosines(), 1.5, m), "method"),
        (lambda m: fresnel.conductor(cosines(), 0.2, 3.0, m), "method"),
    ):
        for wrong in ("fast", torch.ones(2), None):
            with pytest.raises(ValueError, match=rf"{name}: found .*, legal are \['standard', 'extended', 'plain'\]"):
                call(wrong)


def test_a_file_from_before_there_were_methods():
    state = tb.Conductor(0.2, 3.0).state()
    del state["fields"]["method"]
    assert from_state(state).method == "standard"


def test_f82_is_exact_at_both_its_angles():
    """Schlick's where nothing is lost at 82 degrees; exact at 0 and 82 degrees of any metal; eight metals within 0.024."""
    c = torch.tensor([1.0, approximations.AT_82_DEGREES, 0.0], dtype=torch.float64)
    eta, k = torch.tensor(1.4, dtype=torch.float64), torch.tensor(2.7, dtype=torch.float64)
    torch.testing.assert_close(approximations.conductor_f82(c, eta, k), fresnel.conductor(c, eta, k), rtol=1e-13, atol=0.0)
    f0 = approximations.conductor_f0(eta, k)
    schlick = fresnel.schlick(cosines(), f0)
    torch.testing.assert_close(approximations.f82_tint(cosines(), f0, torch.ones_like(f0)), schlick, rtol=1e-14, atol=0.0)
    torch.testing.assert_close(approximations.lazanyi(cosines(), eta, k, 0.0, 6.0), schlick, rtol=1e-14, atol=0.0)
    c = cosines(2001)[:, None]
    for metal in tables():
        term = tb.Conductor.named(metal)
        error = (approximations.conductor_f82(c, term.eta, term.k) - term.reflectance(c)).abs().max()
        assert error < (0.024 if metal == "Cr" else 0.022), metal


@pytest.mark.parametrize("half", [torch.float16, torch.bfloat16])
def test_half_types_round_once(half):
    c, eta, k = cosines().to(half), torch.tensor(1.7).to(half), torch.tensor(2.2).to(half)
    for found, exact in (
        (fresnel.dielectric(c, eta), fresnel.dielectric(c.double(), eta.double())),
        (fresnel.conductor(c, eta, k), fresnel.conductor(c.double(), eta.double(), k.double())),
        (fresnel.schlick(c, 0.04), fresnel.schlick(c.double(), 0.04)),
    ):
        assert found.dtype == half
        assert bool(((found.double() - exact).abs() <= 0.501 * torch.finfo(half).eps * exact).all())


@pytest.mark.parametrize("dtype", DTYPES)
def test_kink_distance_is_zero_at_the_critical_angle(dtype):
    """And grows as |g^2| to both sides; of several channels the nearest counts."""
    eta = torch.tensor([0.6, 1.5], dtype=dtype)
    cos = torch.tensor([0.8, 0.85, 0.7, 1.0, 0.0], dtype=dtype)
    mirror, wo = tb.Mirror(1.0, tb.Dielectric(eta)), torch.stack([torch.sqrt(1 - cos * cos), 0 * cos, cos], -1)
    expected = [0.0, 0.85**2 - 0.64, 0.64 - 0.49, 0.36, 0.64]
    term = tb.Dielectric(eta).kink_distance(Layout.beside(cos), cos)
    assert term.tolist() == pytest.approx(expected, abs=4 * torch.finfo(dtype).eps)
    viewer = mirror.geometry(wo * torch.tensor([-1, -1, 1], dtype=dtype), wo)
    assert mirror.kink_distance(viewer).tolist() == pytest.approx([*expected[:4], 0.0], abs=4 * torch.finfo(dtype).eps)
    assert tb.Conductor(0.2, 3.0).kink_distance(Layout.beside(cos), cos).tolist() == [1.0] * 5


def test_beyond_the_interval_as_at_its_ends():
    c = torch.tensor([-0.2, 1.0 + 1e-6], dtype=torch.float64, requires_grad=True)
    for r in (fresnel.dielectric(c, 1.5), fresnel.conductor(c, 0.2, 3.0), fresnel.schlick(c, 0.04)):
        assert 1.0 - 1e-15 <= r[0].item() <= 1.0
        assert grad(r.sum(), c)[0].tolist() == [0.0, 0.0]


def test_metals():
    assert set(tables()) == {"Cu", "Au", "Ag", "Al", "Cr", "Fe", "Ni", "Ti"}
    eta, k = index_at("Au", [0.5821])  # a row of Johnson & Christy
    assert (eta, k) == ([0.29], [2.863])
    (n0, n1, n2), _ = index_at("Au", [0.5821, 0.5 * (0.5821 + 0.6168), 0.6168])
    assert n1 == pytest.approx(0.5 * (n0 + n2), abs=1e-12), "linear between rows"
    assert n0 > n2
    for metal, table in tables().items():
        assert "(19" in table["source"]
        eta, k = index_at(metal, [0.3, 0.45, 0.55, 0.65, 0.9])
        assert min(eta + k) > 0
    r, g, b = tb.Conductor.named("Au").reflectance(torch.ones(1)).tolist()
    assert r > g > b, "gold is yellow"


def test_metals_are_those_of_the_database(real_data):
    for metal, table in tables().items():
        name = f"{metal}_{'Rakic' if metal == 'Al' else 'Johnson'}.yml"
        lines = (real_data / "nk" / name).read_text(encoding="utf-8").split("data: |")[1].splitlines()
        rows = [[float(x) for x in line.split()] for line in lines if len(line.split()) == 3]
        assert [row for row in rows if table["rows"][0][0] <= row[0] <= table["rows"][-1][0]] == table["rows"]


def test_metal_errors():
    with pytest.raises(ValueError, match=r"found 'Unobtainium', known are \['Ag', 'Al'"):
        tb.Conductor.named("Unobtainium")
    with pytest.raises(ValueError, match="found 550 um, the table of Cu covers"):
        tb.Conductor.named("Cu", (550.0,))


def test_reflectance_shapes():
    assert tb.Schlick([0.1, 0.2, 0.3]).reflectance(torch.rand(4, 5, 1)).shape == (4, 5, 3)
    with pytest.raises(ValueError, match=r"expected shape \[..., 1\], found \[4\]; did you mean"):
        tb.Schlick(0.1).reflectance(torch.rand(4))


@pytest.mark.parametrize("eta", [0.1, 1.0, 1e12, 1e18])
@pytest.mark.parametrize("k", [1e10, 1e13, 1e18])
def test_a_conductor_of_huge_index_has_a_value_and_slopes(eta, k):
    """Where a line search from k = 0 may look: the squares of z^2 overflow float32 from 1e10 on."""
    c = torch.tensor([1.0, 0.5, 1e-3], requires_grad=True)
    n, k = (torch.tensor(x, requires_grad=True) for x in (eta, k))
    found = fresnel.conductor(c, n, k)
    torch.testing.assert_close(found, fresnel.conductor(c.double(), n.double(), k.double()).float(), rtol=16 * 2.0**-23, atol=0.0)
    assert all(torch.isfinite(slope).all() for slope in torch.autograd.grad(found.sum(), (c, n, k)))
