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
        (nu.at_most_one, one, 1.0, 1.0),
        (nu.at_most_one, 0.25, 0.25, 1.0),
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
