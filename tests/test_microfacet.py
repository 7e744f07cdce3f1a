"""Microfacet theory: closed forms, integrals that must come out, 320 bits, every derivative, every edge, Mitsuba."""

import itertools
import math
import random

import mpmath
import numpy as np
import pytest
import torch
from mpmath import mpf
from torch.autograd import grad

from torchbrdf import microfacet
from torchbrdf.optics import erf_tail

DTYPES = (torch.float32, torch.float64)
F64 = torch.float64


# --- the laws as the books have them, in 320 bits ---------------------------------------------------------------------


def ggx_lambda(c, a):
    return (mpmath.sqrt(1 + (a / c) ** 2) - 1) / 2


def beckmann_lambda(c, a):
    nu = c / a if a else mpmath.inf
    return mpmath.exp(-nu * nu) / (2 * nu * mpmath.sqrt(mpmath.pi)) - mpmath.erfc(nu) / 2 if nu < 100 else mpf(0)


def ggx_d(c, s2, alpha):
    return 1 / (mpmath.pi * (s2 / alpha + alpha * c * c) ** 2)


def ggx_d_anisotropic(x, y, z, ax, ay):
    length2 = x * x + y * y + z * z
    return length2**2 / (mpmath.pi * ax * ay * ((x / ax) ** 2 + (y / ay) ** 2 + z * z) ** 2)


def beckmann_d(c, s2, alpha):
    return mpmath.exp(-s2 / (alpha * c) ** 2) / (mpmath.pi * alpha**2 * c**4)


def beckmann_d_anisotropic(x, y, z, ax, ay):
    cos2 = z * z / (x * x + y * y + z * z)
    return mpmath.exp(-((x / ax) ** 2 + (y / ay) ** 2) / z**2) / (mpmath.pi * ax * ay * cos2**2)


EXACT = {
    "ggx_d": ggx_d,
    "ggx_d_anisotropic": ggx_d_anisotropic,
    "beckmann_d": beckmann_d,
    "beckmann_d_anisotropic": beckmann_d_anisotropic,
    "projected_roughness": lambda x, y, ax, ay: mpmath.sqrt((ax * x) ** 2 + (ay * y) ** 2),
    "ggx_lambda": ggx_lambda,
    "ggx_g1": lambda c, a: 1 / (1 + ggx_lambda(c, a)),
    "ggx_g2": lambda c, a, d, b: 1 / (1 + ggx_lambda(c, a) + ggx_lambda(d, b)),
    "ggx_visibility": lambda c, a, d, b: 1 / (1 + ggx_lambda(c, a) + ggx_lambda(d, b)) / (4 * c * d),
    "beckmann_lambda": beckmann_lambda,
    "beckmann_g1": lambda c, a: 1 / (1 + beckmann_lambda(c, a)),
    "beckmann_g2": lambda c, a, d, b: 1 / (1 + beckmann_lambda(c, a) + beckmann_lambda(d, b)),
}
# float32, in ULP: at p99.9, and at most; Beckmann's D has a bound of its own
ULP = {
    "ggx_d": (4.5, 6.5),
    "ggx_d_anisotropic": (6.5, 8.7),
    "projected_roughness": (2.6, 4.0),
    "ggx_lambda": (2.6, 4.0),
    "ggx_g1": (2.6, 4.0),
    "ggx_g2": (2.6, 4.0),
    "ggx_visibility": (2.6, 4.0),
    "beckmann_lambda": (8.0, 12.0),  # an exponential: (4 + 2 nu^2) eps would do, but its exponent is compensated
    "beckmann_g1": (4.2, 6.0),
    "beckmann_g2": (4.2, 6.0),
}


@pytest.fixture(autouse=True)
def _precision():
    with mpmath.workprec(320):
        yield


def directions(rng, hard):
    """cos, sin of an angle: anywhere, or (hard) close to the pole or the horizon, down to 1e-8 and the ends themselves."""
    t = rng.uniform(0.05, 1.5)
    if hard:
        t = rng.choice([rng.uniform(0, math.pi / 2), 10 ** rng.uniform(-8, 0), 0.0, math.pi / 2 - 10 ** rng.uniform(-8, 0)])
    return math.cos(t), math.sin(t)


def points(name, count, hard=True):
    """Legal arguments of a function: its everyday range, or (hard) all of it."""
    rng = random.Random(name)
    for _ in range(count):
        alpha, beta = (10 ** rng.uniform(-4 if hard else -1.3, 0) for _ in range(2))
        (c, s), (d, t) = directions(rng, hard), directions(rng, hard)
        angle = rng.uniform(0, 2 * math.pi)
        if name.endswith(("_d", "_d_anisotropic")):
            beta = beta if name.endswith("anisotropic") else alpha
            spread = rng.uniform(0.05, 2.5)
            x, y, z = alpha * spread * math.cos(angle), beta * spread * math.sin(angle), 1.0
            k = 1 / math.sqrt(x * x + y * y + z * z) * (rng.choice([1, 1, 1e-30, 1e30]) if hard else 1)
            yield (
                (k * x, k * y, k * z, alpha, beta)
                if name.endswith("anisotropic")
                else (k / k / math.sqrt(1 + x * x + y * y), x * x + y * y, alpha)
            )
        elif name == "projected_roughness":
            yield s * math.cos(angle), s * math.sin(angle), alpha, beta
        elif "g2" in name or "visibility" in name:
            yield c, alpha * s, d, beta * t
        else:
            yield c, alpha * s


def arguments(name, dtype, count, hard=True):
    """The points as tensors, and exactly those numbers in 320 bits."""
    tensors = [torch.tensor(x, dtype=dtype, requires_grad=True) for x in zip(*points(name, count, hard), strict=True)]
    return tensors, [tuple(mpf(v) for v in p) for p in zip(*(t.tolist() for t in tensors), strict=True)]


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("name", EXACT)
def test_against_the_oracle(name, dtype):
    tensors, numbers = arguments(name, dtype, 1000)
    found, info = getattr(microfacet, name)(*tensors), torch.finfo(dtype)
    assert bool(torch.isfinite(found).all())
    errors, normal = [], 0
    for value, p in zip(found.tolist(), numbers, strict=True):
        exact = EXACT[name](*p)
        if exact < 4 * info.tiny:  # not a normal number, or close to it: flushed
            assert value <= 4 * info.tiny
            continue
        normal += 1
        ulp = mpf(2) ** mpmath.floor(mpmath.log(exact, 2)) * info.eps
        error = abs(value - exact) / ulp
        if name.startswith("beckmann_d"):
            peak = 1 / (mpmath.pi * p[-1] * p[-2 if "anisotropic" in name else -1])
            error = abs(value - exact) / exact / info.eps / (4 + 2 * abs(mpmath.log(exact / peak)))
        errors.append(float(error))
    typical, largest = ULP.get(name, (1.0, 1.0))
    errors.sort()
    assert normal >= (250 if name == "beckmann_lambda" else 700)
    assert errors[int(0.999 * len(errors)) - 1] <= typical
    assert errors[-1] <= largest


def exact_derivative(f, p, *which):
    """A partial derivative of first or second order, by central differences that leave 70 digits and more."""
    h = [mpf(10) ** -30 * (abs(v) or max(map(abs, p))) for v in p]
    if not which:
        return f(*p)
    i, *rest = which
    up, down = ([*p[:i], p[i] + s * h[i], *p[i + 1 :]] for s in (1, -1))
    return (exact_derivative(f, up, *rest) - exact_derivative(f, down, *rest)) / (2 * h[i])


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("name", EXACT)
def test_first_and_second_derivatives(name, dtype):
    """Relative error, not one relative to 1: the everyday range is held to what is asked of a scalar formula."""
    tensors, numbers = arguments(name, dtype, 12, hard=False)
    info, size = torch.finfo(dtype), len(tensors)
    near = (1e-4, 1e-3) if dtype == torch.float32 else (1e-9, 1e-9)
    first = grad(getattr(microfacet, name)(*tensors).sum(), tensors, create_graph=True)
    second = [grad(g.sum(), tensors, retain_graph=True) for g in first]
    with mpmath.workprec(500):
        for k, p in enumerate(numbers):
            value = EXACT[name](*p)
            if value < 1e3 * info.tiny:
                continue
            for i, j in itertools.combinations_with_replacement(range(size), 2):
                for order, found, which in ((0, first[i][k], (i,)), (1, second[i][j][k], (i, j)), (1, second[j][i][k], (j, i))):
                    exact = exact_derivative(EXACT[name], p, *which)
                    scale = abs(value / math.prod(p[w] for w in which))  # of the terms that a derivative is the sum of
                    # second derivatives, and those of D, pass through 0: there the rounding of the arguments is all that is left
                    crosses = order == 1 or "_d" in name
                    allowed = near[order] * max(abs(exact), scale * mpf(10) ** -3 if crosses else 0)
                    floor = 1e8 * info.tiny if dtype == torch.float32 else 1e-60  # what these 500 bits still tell from 1
                    assert abs(found.item() - exact) <= max(allowed, floor), (which, [float(v) for v in p], found, float(exact))


def second(name, p, i, j, dtype=torch.float32):
    """A second derivative as found, and exactly."""
    tensors = [torch.tensor(x, dtype=dtype, requires_grad=True) for x in p]
    first = grad(getattr(microfacet, name)(*tensors), tensors, create_graph=True)[i]
    with mpmath.workprec(900):
        exact = exact_derivative(EXACT[name], tuple(mpf(t.item()) for t in tensors), i, j)
    return grad(first, tensors)[j].item(), float(exact)


@pytest.mark.parametrize(
    ("name", "p", "i", "j"),
    [
        *(("ggx_lambda", (k * 0.3, 0.3), 1, 1) for k in (0.2, 1e-3, 1e-6)),  # almost linear in a
        *(("ggx_g1", (k * 0.3, 0.3), 1, 1) for k in (0.2, 1e-3, 1e-6)),
        *(("projected_roughness", (0.5, 0.5 * k, 0.2, 0.2), 0, 0) for k in (0.3, 1e-2, 1e-4)),
        ("ggx_visibility", (1e-25, 1.0, 1e-25, 0.5), 1, 1),  # the square of the denominator would underflow
        ("ggx_visibility", (1e-25, 1.0, 1e-25, 0.5), 1, 3),
        ("ggx_g2", (1e-25, 1.0, 1e-25, 0.5), 0, 0),
        ("ggx_g2", (1e-25, 1.0, 1e-25, 0.5), 0, 2),
        ("beckmann_g2", (1e-25, 1.0, 1e-25, 0.5), 0, 2),
        ("ggx_g1", (1.0, 1e-6), 0, 0),
        ("beckmann_g1", (0.9, 0.2), 0, 1),
    ],
)
def test_second_derivatives_that_cancel_or_overflow_in_the_plain_forms(name, p, i, j):
    found, exact = second(name, p, i, j)
    assert found == pytest.approx(exact, rel=1e-4)


# --- edges -----------------------------------------------------------------------------------------------------------


def all_finite(name, points, dtype, order=2):
    """Value, and derivatives up to an order, finite at every point."""
    tensors = [torch.tensor(x, dtype=dtype, requires_grad=True) for x in zip(*points, strict=True)]
    value = getattr(microfacet, name)(*tensors)
    found = [value, *grad(value.sum(), tensors, create_graph=True)]
    if order == 2:
        found += [h for g in found[1:] for h in grad(g.sum(), tensors, retain_graph=True)]
    bad = {k for f in found for k in (~torch.isfinite(f)).nonzero().flatten().tolist()}
    return value, [points[k] for k in sorted(bad)]


@pytest.mark.parametrize("dtype", DTYPES)
def test_everything_is_finite_at_the_edges(dtype):
    info = torch.finfo(dtype)
    denormal, one = info.tiny * info.eps, 1 + info.eps
    roughness = (1e-4, 1e-3, 0.03, 0.5, 1.0)
    cosines = (-1.0, -1e-30, -0.0, 0.0, denormal, info.tiny, 1e-30, 1e-15, 1e-4, 0.3, 0.9, 1 - info.eps / 2, 1.0, one)
    pairs = [(c, a * math.sqrt(max(0.0, 1 - c * c))) for c in cosines for a in roughness] + [(1.0, denormal), (0.5, 0.0)]
    for name in ("ggx_g1", "beckmann_g1"):
        assert all_finite(name, pairs, dtype)[1] == [], name
    # both cosines denormal: second derivatives by them are beyond the largest number, and the mixed ones pass by there
    two = [p + q for p in pairs for q in pairs]
    for name in ("ggx_g2", "beckmann_g2"):
        assert all_finite(name, two, dtype, order=1)[1] == [], name
        assert all_finite(name, [p for p in two if min(abs(p[0]), abs(p[2])) > info.tiny or max(p[0], p[2]) > 1e-4], dtype)[1] == [], name
    # in truth infinite: Lambda at cos = 0, and visibility where both directions graze
    above = [p for p in pairs if p[0] > 1e-5]
    for name in ("ggx_lambda", "beckmann_lambda", "beckmann_lambda_walter"):
        assert all_finite(name, above, dtype)[1] == [], name
    assert all_finite("ggx_visibility", [p for p in two if p[0] <= 0 or p[2] <= 0 or max(p[0], p[2]) > 1e-5], dtype)[1] == []


@pytest.mark.parametrize("dtype", DTYPES)
def test_distributions_are_finite_at_the_edges(dtype):
    info = torch.finfo(dtype)
    denormal = info.tiny * info.eps
    roughness = (1e-4, 1e-2, 1.0)
    cosines = (-1.0, -0.0, 0.0, denormal, 1e-30, 1e-4, 0.3, 1 - info.eps / 2, 1.0, 1 + info.eps)
    angles = [
        (c, s2, a)
        for c in cosines
        for a in roughness
        for s2 in ((0.0, denormal, 1e-10, -1e-8) if c > 0.9 else (0.0, 1.0) if c <= 0 else (1 - c * c,))
    ]
    parts = (0.0, denormal, 1e-30, -1e-4, 0.5, -1.0)
    vectors = [(x, y, z, a, b) for x in parts for y in parts for z in parts for a in roughness for b in roughness]
    unit = [v for v in vectors if max(map(abs, v[:3])) >= 0.5 or v[2] <= 0]
    for law in ("ggx_d", "beckmann_d"):
        value, bad = all_finite(law, angles, dtype)
        assert bad == []
        assert value.tolist() == [0.0 if p[0] <= 0 else v for v, p in zip(value.tolist(), angles, strict=True)]
        value, bad = all_finite(law + "_anisotropic", unit, dtype)
        assert bad == []
        assert value.tolist() == [0.0 if p[2] <= 0 else v for v, p in zip(value.tolist(), unit, strict=True)]
    tips = [(x, y, a, b) for x in parts for y in parts for a in roughness for b in roughness]
    assert all_finite("projected_roughness", tips, dtype, order=1)[1] == []
    assert all_finite("projected_roughness", [p for p in tips if p[0] == p[1] == 0 or max(map(abs, p[:2])) > 1e-20], dtype)[1] == []


@pytest.mark.parametrize("name", ["ggx_d_anisotropic", "beckmann_d_anisotropic"])
@pytest.mark.parametrize("length", [1e-42, 1e-38, 1e-20, 1e20, 1e38])
def test_a_half_vector_may_have_any_length(name, length):
    h = (torch.tensor([0.02, -0.01, 1.0], dtype=F64) * length).float()
    f, alphas = getattr(microfacet, name), (0.03, 0.015)
    assert f(*h, *alphas).item() == pytest.approx(f(*h.double(), *alphas).item(), rel=2e-6)


def test_horizon():
    """0 with gradient 0 at and below it, although the slope above is not; Lambda is infinite there, its limit."""
    c = torch.tensor([0.0, -0.0, -0.5], dtype=F64, requires_grad=True)
    a, up = torch.full((3,), 0.3, dtype=F64, requires_grad=True), torch.tensor([0.7, -0.2, 0.0], dtype=F64, requires_grad=True)
    for name in ("ggx_g1", "beckmann_g1"):
        value = getattr(microfacet, name)(c, a)
        assert value.tolist() == [0.0] * 3
        assert all((g == 0).all() for g in grad(value.sum(), (c, a)))
    for name in ("ggx_g2", "beckmann_g2", "ggx_visibility"):
        for order in ((c, a, up, a), (up, a, c, a)):
            value = getattr(microfacet, name)(*order)
            assert value.tolist() == [0.0] * 3
            assert all((g == 0).all() for g in grad(value.sum(), (c, a, up)))
    for name in ("ggx_lambda", "beckmann_lambda", "beckmann_lambda_walter"):
        value = getattr(microfacet, name)(c, a)
        assert value.tolist() == [math.inf] * 3
        assert all((g == 0).all() for g in grad(value.sum(), (c, a)))
    below, denormal = (torch.tensor(x, dtype=F64, requires_grad=True) for x in (-0.5, 5e-324))
    value = microfacet.ggx_visibility(below, 0.3, denormal, 0.0)  # above alone it would overflow
    assert [value.item(), *(g.item() for g in grad(value, (below, denormal)))] == [0.0] * 3
    above = torch.tensor(1e-300, dtype=F64, requires_grad=True)
    assert grad(microfacet.ggx_g1(above, 0.5), above)[0].item() == pytest.approx(2 / 0.5, rel=1e-14)
    assert grad(microfacet.beckmann_g1(above, 0.5), above)[0].item() == pytest.approx(2 * math.sqrt(math.pi) / 0.5, rel=1e-14)


def test_smooth_surface_hides_nothing():
    c, zero = torch.tensor([1e-4, 0.5, 1.0], dtype=F64), torch.zeros(3, dtype=F64)
    for law in ("ggx", "beckmann"):
        assert getattr(microfacet, law + "_lambda")(c, zero).tolist() == [0.0] * 3
        assert getattr(microfacet, law + "_g1")(c, zero).tolist() == [1.0] * 3
        torch.testing.assert_close(
            getattr(microfacet, law + "_g2")(c, zero, c, 0.3 * c), getattr(microfacet, law + "_g1")(c, 0.3 * c), rtol=1e-15, atol=0
        )
    torch.testing.assert_close(microfacet.ggx_visibility(c, zero, c, zero), 0.25 / (c * c), rtol=1e-15, atol=0)


def test_curvature_of_masking_at_normal_incidence():
    """G1 of GGX is 1 - a^2/4 there: first derivative 0, second -1/2."""
    a = torch.zeros((), dtype=F64, requires_grad=True)
    (slope,) = grad(microfacet.ggx_g1(torch.ones((), dtype=F64), a), a, create_graph=True)
    assert (slope.item(), grad(slope, a)[0].item()) == (0.0, -0.5)


def test_beckmann_is_flushed_below_the_smallest_normal_number():
    tan = torch.linspace(8.0, 12.0, 400).requires_grad_()  # D = exp(-tan^2) / pi at alpha = 1
    c = 1 / torch.sqrt(1 + tan * tan)
    d = microfacet.beckmann_d(c, (tan * c) ** 2, 1.0)
    tiny = torch.finfo(torch.float32).tiny
    assert bool(((d == 0) | (d >= 0.999 * tiny)).all())
    assert (d == 0).any()
    assert (d > 0).any()
    assert bool((grad(d.sum(), tan)[0][d == 0] == 0).all())
    nu = torch.linspace(8.0, 10.0, 400).requires_grad_()
    value = microfacet.beckmann_lambda(0.1 * nu, 0.1)
    assert bool(((value == 0) | (value > tiny)).all())
    assert bool((grad(value.sum(), nu)[0][value == 0] == 0).all())
    assert 8.7 < nu[value > 0].max() < 9.0, "not earlier than it must"


# --- what must come out ----------------------------------------------------------------------------------------------


def test_closed_forms():
    one, zero = torch.ones((), dtype=F64), torch.zeros((), dtype=F64)
    for alpha in (1e-4, 0.1, 1.0):
        for law in ("ggx_d", "beckmann_d"):
            assert getattr(microfacet, law)(one, zero, alpha).item() == pytest.approx(1 / (math.pi * alpha**2), rel=1e-15)
            assert getattr(microfacet, law + "_anisotropic")(zero, zero, one, alpha, 0.3).item() == pytest.approx(
                1 / (math.pi * alpha * 0.3), rel=1e-15
            )
    half = torch.tensor(0.5, dtype=F64)  # cos^2 = sin^2 at 45 degrees
    root = torch.sqrt(half)
    assert microfacet.ggx_d(root, half, 1.0).item() == pytest.approx(1 / math.pi, rel=1e-15)
    assert microfacet.beckmann_d(root, half, 1.0).item() == pytest.approx(4 * math.exp(-1) / math.pi, rel=1e-15)
    assert microfacet.ggx_lambda(0.3 * one, 0.4 * one).item() == pytest.approx((5 / 3 - 1) / 2, rel=1e-15)
    assert microfacet.ggx_g1(0.3 * one, 0.4 * one).item() == pytest.approx(0.75, rel=1e-15)
    assert microfacet.ggx_g2(0.3 * one, 0.4 * one, 0.4 * one, 0.3 * one).item() == pytest.approx(24 / 35, rel=1e-15)
    assert microfacet.ggx_visibility(0.3 * one, 0.4 * one, 0.4 * one, 0.3 * one).item() == pytest.approx(1 / 0.7, rel=1e-15)
    expected = (math.erf(1.5) - 1) / 2 + math.exp(-2.25) / (3 * math.sqrt(math.pi))
    assert microfacet.beckmann_lambda(0.3 * one, 0.2 * one).item() == pytest.approx(expected, rel=1e-14)
    assert microfacet.projected_roughness(3 * one, -4 * one, 0.1, 0.1).item() == pytest.approx(0.5, rel=1e-15)


def test_isotropic_is_a_case_of_anisotropic():
    t, angle = torch.rand(200, dtype=F64) * 1.5, torch.rand(200, dtype=F64) * 6
    for law in ("ggx_d", "beckmann_d"):
        expected = getattr(microfacet, law)(torch.cos(t), torch.sin(t) ** 2, 0.2)
        found = getattr(microfacet, law + "_anisotropic")(
            *(torch.sin(t) * f(angle) for f in (torch.cos, torch.sin)), torch.cos(t), 0.2, 0.2
        )
        torch.testing.assert_close(found, expected, rtol=1e-11, atol=1e-300)
    a = microfacet.projected_roughness(torch.sin(t) * torch.cos(angle), torch.sin(t) * torch.sin(angle), 0.2, 0.2)
    torch.testing.assert_close(a, 0.2 * torch.sin(t), rtol=1e-14, atol=0)


def nodes(count):
    return (torch.from_numpy(v) for v in np.polynomial.legendre.leggauss(count))


@pytest.mark.parametrize("alphas", [(1.0, 1.0), (0.3, 0.3), (0.01, 0.01), (0.8, 0.05), (0.01, 1e-4)])
@pytest.mark.parametrize("law", ["ggx", "beckmann"])
def test_distributions_are_normalised(law, alphas):
    """The integral of D cos over solid angle is that of D cos^4 over slopes (x, y) = alpha rho (cos, sin), rho^2 = u / (1 - u)."""
    (ax, ay), (u, wu), (p, wp) = alphas, nodes(64), nodes(32)
    u, wu, p, wp = 0.5 * (u + 1)[:, None], 0.5 * wu[:, None], math.pi * (p + 1), math.pi * wp
    rho = torch.sqrt(u / (1 - u))
    x, y = ax * rho * torch.cos(p), ay * rho * torch.sin(p)
    cos2 = 1 / (1 + x * x + y * y)
    weight = ax * ay * 0.5 / (1 - u) ** 2 * cos2**2 * wu * wp
    assert (getattr(microfacet, law + "_d_anisotropic")(x, y, torch.ones_like(x), ax, ay) * weight).sum().item() == pytest.approx(
        1, abs=1e-7
    )
    if ax == ay:
        d = getattr(microfacet, law + "_d")(torch.sqrt(cos2), cos2 * (x * x + y * y), ax)
        assert (d * weight).sum().item() == pytest.approx(1, abs=1e-7)


@pytest.mark.parametrize("alphas", [(0.5, 0.5), (0.01, 0.01), (0.9, 0.1)])
@pytest.mark.parametrize("law", ["ggx", "beckmann"])
def test_visible_normals_project_to_the_surface(law, alphas):
    """Smith: cos_o = G1 * the integral of max(0, wo . h) D(h), here over slopes along and across the direction."""
    ax, ay = alphas
    for theta, phi in ((0.2, 0.3), (1.0, 2.0), (1.5, 4.0)):
        ox, oy, oz = math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)
        a = microfacet.projected_roughness(*torch.tensor([ox, oy], dtype=F64), ax, ay)
        dx, dy, nu = ax * ox / a, ay * oy / a, oz / a
        (u, wu), (v, wv) = nodes(100), nodes(64)
        span = 0.5 * (torch.atan(nu) + 0.5 * math.pi)
        u, wu, v, wv = (span * (u + 1) - 0.5 * math.pi)[:, None], span * wu[:, None], 0.5 * math.pi * v, 0.5 * math.pi * wv
        along = torch.tan(u)  # up to nu, where the microfacets face wo
        wide = torch.sqrt(1 + along * along)
        across = wide * torch.tan(v)
        jacobian = ax * ay / torch.cos(u) ** 2 * wide / torch.cos(v) ** 2 * wu * wv
        x, y = ax * (along * dx - across * dy), ay * (along * dy + across * dx)
        d = getattr(microfacet, law + "_d_anisotropic")(-x, -y, torch.ones_like(x), ax, ay)
        facing = (oz - a * along) * d / (1 + x * x + y * y) ** 2  # wo . h = cos_h (oz - a along), and dw = cos_h^3 dx dy
        g1 = getattr(microfacet, law + "_g1")(torch.tensor(oz, dtype=F64), a)
        assert (g1 * (facing * jacobian).sum()).item() == pytest.approx(oz, rel=1e-6), (theta, phi)


def test_smith_functions_fit_together():
    tensors, _ = arguments("ggx_g2", F64, 400)
    c, a, d, b = (t.detach() for t in tensors)
    for law in ("ggx", "beckmann"):
        f = {n: getattr(microfacet, f"{law}_{n}") for n in ("lambda", "g1", "g2")}
        torch.testing.assert_close(f["g1"](c, a), 1 / (1 + f["lambda"](c, a)), rtol=1e-14, atol=0)
        torch.testing.assert_close(f["g2"](c, a, d, b), 1 / (1 + f["lambda"](c, a) + f["lambda"](d, b)), rtol=1e-14, atol=0)
        assert torch.equal(f["g2"](c, a, d, b), f["g2"](d, b, c, a)), "reciprocal to the last bit"
        g1, g2 = f["g1"](c, a), f["g2"](c, a, d, b)
        assert bool(((g2 >= 0) & (g2 <= g1 * (1 + 1e-15)) & (g1 <= 1)).all())
        assert bool((g2 >= g1 * f["g1"](d, b) * (1 - 1e-15)).all()), "correlated masking hides no more than uncorrelated"
    torch.testing.assert_close(microfacet.ggx_visibility(c, a, d, b) * (4 * c * d), microfacet.ggx_g2(c, a, d, b), rtol=1e-14, atol=0)


def test_walter_error_is_as_documented():
    nu = torch.logspace(-6, 1, 20001, dtype=F64)
    exact, fit = (f(nu, torch.ones_like(nu)) for f in (microfacet.beckmann_lambda, microfacet.beckmann_lambda_walter))
    g1, fit_g1 = 1 / (1 + exact), 1 / (1 + fit)
    error = (fit_g1 / g1 - 1).abs()
    assert 0.0031 < error.max() <= 0.0032
    assert nu[error.argmax()].item() == pytest.approx(1.34, abs=0.01)
    assert 0.045 < (fit / exact - 1).abs()[nu < 1].max() <= 0.05
    some = slice(0, None, 40)
    pair = (1 + exact[some, None] + exact[None, some]) / (1 + fit[some, None] + fit[None, some]) - 1
    assert 0.0062 < pair.abs().max() <= 0.0063
    assert bool((fit >= 0).all())
    assert bool((fit[nu > 1.549] == 0).all())
    assert bool((fit[nu < 1.547] > 0).all())


@pytest.mark.parametrize(("dtype", "end", "bound"), [(torch.float32, 9.3, 6.0), (torch.float64, 26.6, 6.0)])
def test_tail(dtype, end, bound):
    """w(nu) in units of eps over all of its range: a rounding of nu is not multiplied by nu^2."""
    rng, worst = random.Random(0), 0.0
    for _ in range(500):
        a = torch.tensor(10 ** rng.uniform(-4, 0), dtype=dtype)
        c = torch.tensor(rng.choice([rng.uniform(0, end), 10 ** rng.uniform(-30, 0)]), dtype=dtype) * a
        nu = mpf(c.item()) / mpf(a.item())
        exact = mpmath.exp(-nu * nu) / mpmath.sqrt(mpmath.pi) - nu * mpmath.erfc(nu)
        if exact > torch.finfo(dtype).tiny:
            worst = max(worst, float(abs(erf_tail.exponential_tail(c, a).item() / exact - 1) / torch.finfo(dtype).eps))
    assert worst <= bound


def test_fit_of_the_tail_is_as_good_as_documented():
    for (numerator, denominator), end, bound in ((erf_tail._SINGLE, 9.4, 7e-11), (erf_tail._DOUBLE, 26.7, 1.2e-16)):
        for i in range(400):
            nu = mpf(end) * i / 400
            h = 1 / mpmath.sqrt(mpmath.pi) - nu * mpmath.exp(nu * nu) * mpmath.erfc(nu)
            fit = mpmath.polyval(numerator[::-1], nu) / mpmath.polyval(denominator[::-1], nu)
            assert abs(fit / h - 1) <= bound, float(nu)
        assert min(*numerator, *denominator) > 0, "nothing cancels"


# --- derivatives, dtypes, transforms ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [*EXACT, "beckmann_lambda_walter"])
def test_gradcheck(name):
    tensors, _ = arguments(name, F64, 200, hard=False)
    slow = torch.stack([t.detach().abs() for t in tensors]).amin(0) > 0.1  # finite differences of 1e-6 are exact enough here
    tensors = [t.detach()[slow][:4].requires_grad_() for t in tensors]
    assert tensors[0].numel() >= 3
    f = getattr(microfacet, name)
    assert torch.autograd.gradcheck(f, tensors, check_forward_ad=True)
    assert torch.autograd.gradgradcheck(f, tensors, atol=1e-4)


@pytest.mark.parametrize("half", [torch.float16, torch.bfloat16])
@pytest.mark.parametrize("name", EXACT)
def test_half_types_round_once(name, half):
    info = torch.finfo(half)
    tensors = [t.detach() for t in arguments(name, half, 300, hard=False)[0]]
    found, exact = (getattr(microfacet, name)(*(t.to(d) for t in tensors)) for d in (half, F64))
    assert found.dtype == half
    normal = (exact > 4 * info.tiny) & (exact < info.max)
    assert normal.sum() > 60
    assert bool(((found.double() - exact).abs() <= 0.51 * info.eps * exact)[normal].all())
    assert microfacet.ggx_g1(torch.tensor(0.5, dtype=half), 1e-4).dtype == half, "numbers do not widen a result"


@pytest.mark.parametrize("name", EXACT)
def test_transforms(name):
    f = getattr(microfacet, name)
    tensors = [t.detach() for t in arguments(name, torch.float32, 40, hard=False)[0]]
    torch.testing.assert_close(torch.vmap(f)(*tensors), f(*tensors), rtol=1e-6, atol=1e-35)
    which = tuple(range(len(tensors)))
    hessian = torch.vmap(torch.func.hessian(f, which))(*tensors)  # forward over reverse
    leaves = [t.clone().requires_grad_() for t in tensors]
    first = grad(f(*leaves).sum(), leaves, create_graph=True)
    for i, j in itertools.product(which, which):
        expected = grad(first[i].sum(), leaves[j], retain_graph=True)[0]
        scale = (f(*tensors) / (tensors[i] * tensors[j])).abs() + expected.abs()
        assert bool(((hessian[i][j] - expected).abs() <= 1e-4 * scale + 1e-30).all()), (i, j)


def test_broadcasting():
    c, a = torch.rand(3, 1), torch.rand(4)
    assert microfacet.ggx_d(c, 0.5, a).shape == (3, 4)
    assert microfacet.ggx_g2(c, a, 0.5 * c, 0.2).shape == (3, 4)
    assert microfacet.beckmann_d_anisotropic(c, a, torch.ones(2, 1, 1), 0.1, 0.2).shape == (2, 3, 4)


# --- Mitsuba ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("law", ["GGX", "Beckmann"])
def test_mitsuba(law):
    """D and G1 of Mitsuba 3, whose Beckmann G1 is Walter's fit."""
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    rng = random.Random(0)
    for _ in range(200):
        ax, ay = (10 ** rng.uniform(-1.5, 0) for _ in range(2))
        theory = mi.MicrofacetDistribution(getattr(mi.MicrofacetType, law), ax, ay, False)
        t, p, spread = rng.uniform(0.05, 1.5), rng.uniform(0, 6.28), rng.uniform(0, 1.5)
        x, y = ax * spread * math.cos(p), ay * spread * math.sin(p)
        h = torch.nn.functional.normalize(torch.tensor([x, y, 1.0], dtype=F64), dim=0)
        d = getattr(microfacet, law.lower() + "_d_anisotropic")(*h, ax, ay)
        assert d.item() == pytest.approx(theory.eval(mi.ScalarVector3f(*h.tolist())), rel=2e-4)
        o = torch.tensor([math.sin(t) * math.cos(p), math.sin(t) * math.sin(p), math.cos(t)], dtype=F64)
        a = microfacet.projected_roughness(o[0], o[1], ax, ay)
        g1 = microfacet.ggx_g1(o[2], a) if law == "GGX" else 1 / (1 + microfacet.beckmann_lambda_walter(o[2], a))
        found = theory.smith_g1(mi.ScalarVector3f(*o.tolist()), mi.ScalarVector3f(0, 0, 1))
        assert g1.item() == pytest.approx(found, rel=7e-5)  # 5e-5 is what Walter's fit exceeds 1 by
