"""Values and gradients of the safe operations at their edges, as their docstrings state them."""

import math

import pytest
import torch
from torch.autograd import grad

from torchbrdf import numerics as nu

DTYPES = (torch.float32, torch.float64)


def at(f, *xs, dtype=torch.float64):
    """(value, gradients) of f at single numbers."""
    ts = [torch.tensor(x, dtype=dtype, requires_grad=True) for x in xs]
    y = f(*ts)
    if not y.requires_grad:
        return y.item(), *(0.0 for _ in ts)
    return y.item(), *(g.item() for g in grad(y, ts, allow_unused=True, materialize_grads=True))


@pytest.mark.parametrize("dtype", DTYPES)
def test_edges(dtype):
    one, tiny = 1.0 + torch.finfo(dtype).eps, torch.finfo(dtype).tiny
    edges = [
        (nu.positive, -1.0, 0.0, 0.0),
        (nu.positive, 0.0, 0.0, 1.0),
        (nu.positive, 2.0, 2.0, 1.0),
        (nu.unit_interval, -0.5, 0.0, 0.0),
        (nu.unit_interval, 0.0, 0.0, 1.0),
        (nu.unit_interval, 1.0, 1.0, 1.0),
        (nu.unit_interval, one, 1.0, 0.0),
        (lambda x: nu.at_most(x, 1.0), one, 1.0, 1.0),
        (lambda x: nu.at_most(x, 1.0), 0.25, 0.25, 1.0),
        (lambda x: nu.at_least(x, -1.0), -one, -1.0, 1.0),
        (lambda x: nu.at_least(x, -1.0), -0.25, -0.25, 1.0),
        (nu.safe_sqrt, 0.25, 0.5, 1.0),
        (nu.safe_sqrt, 0.0, 0.0, 0.0),
        (nu.safe_sqrt, -1.0, 0.0, 0.0),
        (nu.reciprocal_or_zero, 0.5, 2.0, -4.0),
        (nu.reciprocal_or_zero, 0.0, 0.0, 0.0),
        (nu.step, 0.0, 0.0, 0.0),
        (nu.step, tiny, 1.0, 0.0),
        (nu.step, -3.0, 0.0, 0.0),
    ]
    for f, x, value, slope in edges:
        assert at(f, x, dtype=dtype) == (value, slope), (f.__name__, x)


@pytest.mark.parametrize("dtype", DTYPES)
def test_sqrt_slope_is_not_capped(dtype):
    x = 4.0 * torch.finfo(dtype).tiny
    assert at(nu.safe_sqrt, x, dtype=dtype)[1] == pytest.approx(0.5 / math.sqrt(x), rel=1e-6)


@pytest.mark.parametrize("dtype", DTYPES)
def test_smallest_reciprocal_has_a_finite_slope(dtype):
    least = nu.negligible(dtype)
    value, slope = at(lambda x: nu.reciprocal_or_zero(x, least), 2.0 * least, dtype=dtype)
    assert math.isfinite(value)
    assert math.isfinite(slope)
    assert at(lambda x: nu.reciprocal_or_zero(x, least), least, dtype=dtype) == (0.0, 0.0)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("s", [0.0, 0.3, 1.0, 2.5, 40.0, 1e4, 1e7])
def test_log1p_power(s, dtype):
    m = torch.tensor([0.0, 1e-9, 1e-7, 1e-4, 0.1, 0.5, 0.9, 0.999], dtype=dtype)
    exact = torch.exp(s * torch.log1p(-m.double()))
    found = nu.log1p_power(m, torch.tensor(s, dtype=dtype)).double()
    alive = exact > 4 * torch.finfo(dtype).tiny
    # the documented error, (2 + |ln value|) eps, with 1 eps more for exp and log1p themselves
    allowed = (3.0 + exact.log().abs()) * torch.finfo(dtype).eps * exact
    assert bool(((found - exact).abs() <= allowed)[alive].all())
    assert bool((found[exact < torch.finfo(dtype).tiny] == 0).all())


@pytest.mark.parametrize("dtype", DTYPES)
def test_log1p_power_edges(dtype):
    def power(m, s):
        return at(nu.log1p_power, m, s, dtype=dtype)

    assert power(1.5, 0.0) == (0.0, 0.0, 0.0)  # the far hemisphere
    assert power(1.5, 2.0) == (0.0, 0.0, 0.0)
    assert power(1.0, 0.0)[:2] == (1.0, 0.0)
    assert power(1.0, 1.0)[0] <= torch.finfo(dtype).eps
    assert power(1.0, 0.5)[1] == 0.0  # true slope infinite
    assert power(0.0, 1e7)[:2] == (1.0, -1e7)
    assert power(0.5, 1e7) == (0.0, 0.0, 0.0)  # flushed
    least = -math.log2(torch.finfo(dtype).tiny)
    assert power(0.5, least - 3.0)[0] == pytest.approx(8.0 * torch.finfo(dtype).tiny, rel=1e-4, abs=0)  # normal numbers are kept
    assert power(0.5, least)[0] == 0.0


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("s", [0.0, 0.3, 1.0, 2.5, 40.0, 1e4])
def test_cosine_power(s, dtype):
    theta = torch.tensor([0.0, 1e-4, 1e-2, 0.3, 1.0471, 1.0472, 1.0473, 1.4, 1.57], dtype=torch.float64)
    cos, sin2 = torch.cos(theta).to(dtype), (torch.sin(theta) ** 2).to(dtype)
    exact = torch.exp(s * torch.where(theta < 1.0472, 0.5 * torch.log1p(-sin2.double()), torch.log(cos.double())))
    found = nu.cosine_power(cos, sin2, torch.tensor(s, dtype=dtype)).double()
    alive = exact > 4 * torch.finfo(dtype).tiny
    # the same error, and at the seam one rounding of the input that the exact value did not take, times s
    allowed = (4.0 + exact.log().abs() + 4.0 * s) * torch.finfo(dtype).eps * exact
    assert bool(((found - exact).abs() <= allowed)[alive].all())
    assert at(lambda c, q: nu.cosine_power(c, torch.tensor(1.0, dtype=dtype), q), 0.0, 2.0, dtype=dtype) == (0.0, 0.0, 0.0)
    assert at(lambda c, q: nu.cosine_power(c, torch.tensor(1.0, dtype=dtype), q), 0.0, 0.0, dtype=dtype)[0] == 1.0


@pytest.mark.parametrize("dtype", DTYPES)
def test_g_squared_at_the_critical_angle(dtype):
    """Every digit, where the plain sum keeps none."""
    from oracle import mpmath  # at 320 bits

    eta = torch.linspace(0.3, 0.99, 50, dtype=torch.float64).to(dtype)
    cos = torch.sqrt((1.0 - eta) * (1.0 + eta))
    for step_up in range(3):
        exact = [mpmath.mpf(n) ** 2 - 1 + mpmath.mpf(c) ** 2 for n, c in zip(eta.tolist(), cos.tolist(), strict=True)]
        found = nu.eta2_minus_sin2(cos, eta).tolist()
        worst = max(abs(f - e) / max(abs(e), mpmath.mpf(torch.finfo(dtype).eps) ** 2) for f, e in zip(found, exact, strict=True))
        assert worst <= 8 * torch.finfo(dtype).eps, step_up
        cos = torch.nextafter(cos, torch.ones_like(cos))
    c, n = (x.detach().requires_grad_() for x in (cos, eta))
    gc, gn = grad(nu.eta2_minus_sin2(c, n).sum(), (c, n))
    torch.testing.assert_close(gc, 2 * cos)
    torch.testing.assert_close(gn, 2 * eta)


@pytest.mark.parametrize("dtype", DTYPES)
def test_errors_of_sums_and_products_are_exact(dtype):
    from fractions import Fraction as F

    x, y = (torch.randn(200, generator=torch.Generator().manual_seed(k), dtype=torch.float64).to(dtype) * 10.0**k for k in (0, 3))
    product, total = x * y, nu.two_sum(x, y)
    errors = nu.product_error(x, y, product)
    for i in range(200):
        assert F(x[i].item()) * F(y[i].item()) == F(product[i].item()) + F(errors[i].item())
        assert F(x[i].item()) + F(y[i].item()) == F(total[0][i].item()) + F(total[1][i].item())


@pytest.mark.parametrize("dtype", DTYPES)
def test_sum_of_products_keeps_what_cancels(dtype):
    """a b - a b (1 - 2^-40) of factors that do not fit: the plain sum keeps nothing of it."""
    from fractions import Fraction as F

    rng = torch.Generator().manual_seed(1)
    a, b, c = (torch.rand(100, generator=rng, dtype=torch.float64).to(dtype) for _ in range(3))
    d = (a * b / c).to(dtype)
    found, rest = nu.sum_of_products((a, b), (-c, d))
    eps = torch.finfo(dtype).eps
    for i in range(100):
        exact = F(a[i].item()) * F(b[i].item()) - F(c[i].item()) * F(d[i].item())
        assert abs(F(found[i].item()) + F(rest[i].item()) - exact) <= F(8 * eps * eps) * F(a[i].item()) * F(b[i].item())
    assert not nu.sum_of_products((a.requires_grad_(), b))[0].requires_grad


def test_huge_products_fall_back_to_the_plain_sum():
    big = torch.tensor([1e37])
    total, rest = nu.sum_of_products((big, torch.tensor([3.0])), (big, torch.tensor([2.0])))
    assert total.item() == pytest.approx(5e37, rel=1e-6)
    assert rest.item() == 0.0


@pytest.mark.parametrize("dtype", DTYPES)
def test_value_of_one_formula_with_slopes_of_another(dtype):
    exact = 1.0 + torch.finfo(dtype).eps
    x = torch.tensor(3.0, dtype=dtype, requires_grad=True)
    y = nu.with_slope_of(torch.tensor(exact, dtype=dtype), 1e6 * x)
    assert y.item() == exact, "to the last bit, however far the other is"
    assert grad(y, x)[0].item() == 1e6


def test_working_dtypes_follow_torch():
    f32, f64 = torch.ones(2), torch.ones(2, dtype=torch.float64)
    half, scalar64 = f32.half(), torch.tensor(0.1, dtype=torch.float64)
    for xs, made, result in (
        ((f32, 0.1), torch.float32, torch.float32),
        ((f32, scalar64), torch.float32, torch.float32),
        ((f32, f64), torch.float64, torch.float64),
        ((half, 0.1), torch.float32, torch.float16),
        ((0.1, half), torch.float32, torch.float16),
        ((scalar64, 0.1), torch.float64, torch.float64),
    ):
        found, dtype = nu.working(*xs)
        assert {t.dtype for t in found} == {made}
        assert dtype == result
    number = nu.working(half, 0.04)[0][1]
    assert number.item() == torch.tensor(0.04).item(), "a number is not rounded to the half type"


def test_huge_eta_does_not_overflow():
    assert nu.eta2_minus_sin2(torch.tensor(0.5), torch.tensor(1e18)).item() == pytest.approx(1e36, rel=1e-6)


def test_half_types_compute_in_float32():
    for half in nu.HALF_TYPES:
        assert nu.working_dtype(half) == torch.float32
        assert nu.widen(torch.ones(2, dtype=half)).dtype == torch.float32
        assert nu.rounded_back(torch.ones(2), half).dtype == half
    x = torch.ones(2, dtype=torch.float64)
    assert nu.widen(x) is x


def test_masks_do_not_poison():
    """No NaN gradient where a branch is not taken."""
    x = torch.tensor([-1.0, 0.0, 1.0], requires_grad=True)
    total = nu.safe_sqrt(x).sum() + nu.reciprocal_or_zero(x).sum() + nu.log1p_power(x + 1.0, x.abs() * 1e8).sum()
    assert bool(torch.isfinite(grad(total, x)[0]).all())


def test_g_squared_by_float64_is_that_of_the_compensated_sum():
    """To an ulp, slopes exactly: about the critical angle, for tiny indices at normal incidence, at grazing between equal media."""
    eta = torch.rand(2000) * 0.9 + 0.05
    cos = torch.sqrt((1 - eta) * (1 + eta)) * (1 + 1e-5 * torch.randn(2000))
    hard = torch.tensor([[1.0, 1e-10, 0.0], [1.0, 1e-20, 1e-19], [1.0, 0.3, 0.3], [1e-10, 1.0, 0.0], [0.5, 1e3, 1e3]])
    points = torch.cat([torch.stack([cos, eta, torch.zeros_like(cos)], 1), hard]).requires_grad_()
    widened, compensated = (f(*points.unbind(1)) for f in (nu.eta2_minus_sin2_widened, nu.eta2_minus_sin2))
    torch.testing.assert_close(widened, compensated, rtol=2e-7, atol=1e-44)
    by_widened, by_compensated = (grad(g.sum(), points)[0] for g in (widened, compensated))
    assert (by_widened == by_compensated).all()
