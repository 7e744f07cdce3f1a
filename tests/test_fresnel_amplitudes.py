"""The complex amplitudes: signs, moduli, phases, slopes at eta = 1; and what they add up to."""

import math

import oracle
import pytest
import torch
from oracle import mpmath
from torch.autograd import grad
from torch.autograd.functional import hessian

from torchbrdf import fresnel
from torchbrdf.optics.metals import index_at

DTYPES = (torch.float32, torch.float64)


def cosines(count=201):
    return torch.linspace(0, 1, count, dtype=torch.float64)


def exact(cos, eta, k=0.0):
    """(r_s, r_p) in 320 bits, by the textbook's complex numbers."""
    c, n = mpmath.mpf(cos), mpmath.mpc(eta, k)
    z = mpmath.sqrt(n * n - 1 + c * c)
    return (c - z) / (c + z), (n * n * c - z) / (n * n * c + z)


@pytest.mark.parametrize("eta", [0.6, 1.33, 1.5, 2.42])
def test_of_a_dielectric(eta):
    """Opposite at normal incidence; r_p alone vanishes at Brewster's angle, where it changes sign; -1 both at grazing; real."""
    brewster = 1.0 / math.sqrt(1.0 + eta * eta)
    r = fresnel.amplitudes(torch.tensor([1.0, brewster * (1 + 1e-9), brewster * (1 - 1e-9), 0.0], dtype=torch.float64), eta)
    assert [r.s_re[0].item(), -r.p_re[0].item()] == pytest.approx([(1 - eta) / (1 + eta)] * 2, rel=1e-15)
    assert r.s_re[1].item() == pytest.approx((1 - eta * eta) / (1 + eta * eta), rel=1e-8)
    if eta > 1:
        assert r.p_re[1] > 0 > r.p_re[2]
        assert abs(r.p_re[1]) < 1e-8
        assert r.s_im.tolist() == r.p_im.tolist() == [0.0] * 4
    assert [r.s_re[3].item(), r.p_re[3].item()] == pytest.approx([-1.0, -1.0], rel=1e-15)


def test_squared_they_are_the_reflectance():
    c = cosines()
    for eta, k in ((0.5, 0.0), (0.9, 0.0), (1.5, 0.0), (3.0, 0.0), (0.2, 3.0), (1.5, 1e-3), (1.0, 0.5)):
        r = fresnel.amplitudes(c, eta, k)
        whole = fresnel.conductor(c, eta, k) if k else fresnel.dielectric(c, eta)
        torch.testing.assert_close(0.5 * (r.s.abs() ** 2 + r.p.abs() ** 2), whole, rtol=3e-15, atol=0.0)


@pytest.mark.parametrize("dtype", DTYPES)
def test_signs_and_parts_of_a_metal(dtype):
    """k >= 0 absorbs: the phases are those of exp(-i omega t), in which the root has an imaginary part above 0."""
    eta, k = (torch.tensor(x[0], dtype=dtype) for x in index_at("Cu", [0.55]))
    for cos in (0.0, 0.1, 0.5, 1.0):
        r = fresnel.amplitudes(torch.tensor(cos, dtype=dtype), eta, k)
        for found, true in zip((r.s, r.p), exact(cos, eta.item(), k.item()), strict=True):
            assert found.dtype == dtype.to_complex()
            assert abs(found.item() - true) <= 8 * torch.finfo(dtype).eps


@pytest.mark.parametrize("dtype", DTYPES)
def test_phases_under_total_reflection(dtype):
    """Accurate to the last bits from just inside the critical angle, where they vanish, to grazing, where they are -pi; |r| = 1."""
    eps, eta = torch.finfo(dtype).eps, torch.tensor(2 / 3, dtype=dtype)
    critical = torch.sqrt((1 - eta) * (1 + eta))
    c = [
        torch.nextafter(critical, torch.tensor(0.0, dtype=dtype)),
        *(critical * torch.tensor([1 - 4 * eps, 0.999, 0.6, 0.1, 1e-9, 0.0], dtype=dtype)),
    ]
    r = fresnel.amplitudes(torch.stack(c), eta)
    for re, im, which in ((r.s_re, r.s_im, 0), (r.p_re, r.p_im, 1)):
        for i, cos in enumerate(c):
            true = exact(cos.item(), eta.item())[which]
            phase = mpmath.atan2(mpmath.mpf(im[i].item()), mpmath.mpf(re[i].item()))
            assert abs(abs(phase) - abs(mpmath.arg(true))) <= 8 * eps * abs(phase)  # at grazing -pi and pi are one
            assert abs(mpmath.hypot(re[i].item(), im[i].item()) - 1) <= 4 * eps
        assert bool((im[:-1] < 0).all())


def test_a_fresnel_rhomb_makes_circular_light():
    """Two reflections in glass of 1.51 at 54.6 degrees turn p against s by a quarter of a wave (Born & Wolf 1999, sec. 1.5.4)."""
    r = fresnel.amplitudes(torch.cos(torch.deg2rad(torch.tensor(54.62, dtype=torch.float64))), 1 / 1.51)
    turned = torch.angle((r.p / r.s) ** 2)
    assert abs(turned.item()) == pytest.approx(math.pi / 2, abs=1e-3)


def test_nothing_between_equal_media():
    c = torch.tensor([0.0, 1e-25, 0.3, 1.0])
    for k in (0.0, torch.zeros(4)):
        assert torch.stack(fresnel.amplitudes(c, 1.0, k)).tolist() == [[0.0] * 4] * 4


def test_grazing_between_equal_media_has_no_slope_where_it_would_overflow():
    """From where c^2 is no normal number: the slopes are -1/(2c^2) and 1/c."""
    c, n = torch.tensor([0.0, 1e-25, 1e-22]), torch.ones(3, requires_grad=True)
    outs = (fresnel.refraction_cosine(c, n), fresnel.dielectric(c, n), *fresnel.amplitudes(c, n))
    assert [g.tolist() for g in slopes(outs, n)] == [[0.0] * 3] * 6


def slopes(outs, by):
    return [grad(x.sum(), by, retain_graph=True)[0] for x in outs]


@pytest.mark.parametrize("dtype", DTYPES)
def test_a_search_that_starts_at_equal_media_leaves(dtype):
    """Slopes by eta at eta = 1: of cos_t s^2/c, of r_s -1/(2c^2), of r_p (2c^2 - 1)/(2c^2); by k the last two, times i."""
    c = torch.tensor([1.0, 0.7, 0.3, 1e-3, 1e-8], dtype=dtype)
    n, k = torch.ones_like(c).requires_grad_(), torch.zeros_like(c).requires_grad_()
    r, none = fresnel.amplitudes(c, n, k), torch.zeros_like(c)
    cos_t, r_s, r_p = (1 - c) * (1 + c) / c, -0.5 / c**2, (2 * c**2 - 1) / (2 * c**2)
    found = slopes((fresnel.refraction_cosine(c, n), fresnel.amplitudes(c, n).s_re, *r), n) + slopes(r, k)
    for x, true in zip(found, (cos_t, r_s, r_s, none, r_p, none, none, r_s, none, r_p), strict=True):
        torch.testing.assert_close(x, true, rtol=8 * torch.finfo(dtype).eps, atol=torch.finfo(dtype).eps)


@pytest.mark.parametrize("backend", ["eager", pytest.param("inductor", marks=pytest.mark.slow)])
def test_compiled(backend):
    """In one graph, with the same results and slopes, at the edges too."""
    c, n = (torch.tensor(x, requires_grad=True) for x in ([1.0, 0.7, 1e-3, 0.0, 0.3, 0.9], [1.0, 1.0, 1.0, 1.0, 0.7, 0.7]))
    found, true = (f(c, n) for f in (torch.compile(fresnel.amplitudes, fullgraph=True, backend=backend), fresnel.amplitudes))
    assert isinstance(found, fresnel.Amplitudes)
    for x, y in zip(
        (*found, *grad(found.s_re.sum() + found.p_im.sum(), (c, n))), (*true, *grad(true.s_re.sum() + true.p_im.sum(), (c, n))), strict=True
    ):
        torch.testing.assert_close(x, y, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("cos", [1.0, 0.6, 0.05])
def test_curvature_between_equal_media(cos):
    """Second derivatives at eta = 1, k = 0: of a reflectance r_s'^2 + r_p'^2 by eta and by k, though the slopes are 0."""
    at = tuple(torch.tensor(x, dtype=torch.float64) for x in (cos, 1.0, 0.0))
    power = (1 + (2 * cos**2 - 1) ** 2) / (4 * cos**4)
    assert grad(fresnel.dielectric(at[0], n := at[1].clone().requires_grad_()), n)[0] == 0
    (cc, cn), (_, nn) = hessian(fresnel.dielectric, at[:2])
    assert [cc.item(), cn.item(), nn.item()] == pytest.approx([0.0, 0.0, power], rel=1e-13, abs=1e-13)
    h = hessian(fresnel.conductor, at)
    assert [h[1][1].item(), h[2][2].item(), h[1][2].item()] == pytest.approx([power, power, 0.0], rel=1e-13, abs=1e-13)
    s2 = 1 - cos * cos
    (_, cn), (_, nn) = hessian(fresnel.refraction_cosine, at[:2])
    assert [cn.item(), nn.item()] == pytest.approx([-1 - 1 / cos**2, -3 * s2 / cos - s2**2 / cos**3], rel=1e-12)


@pytest.mark.parametrize("dtype", DTYPES)
def test_a_conductor_of_a_tiny_index(dtype):
    """Its square underflows at normal incidence: 1, with true slopes -4 and 8 eta k."""
    for eta, k in ((1e-20, 1e-20), (1e-30, 1e-20), (1e-45, 1e-20), (1e-10, 1e-30)):
        c, n, k = (torch.tensor(x, dtype=dtype, requires_grad=True) for x in (1.0, eta, k))
        r = fresnel.conductor(c, n, k)
        slopes = grad(r, (c, n, k))
        assert r == 1 - 4 * n
        assert all(bool(torch.isfinite(g)) for g in slopes)
        if eta == 1e-20:
            assert abs(slopes[0].item()) <= 4 * torch.finfo(dtype).eps / eta  # two slopes of 4/|z| cancel
            assert [g.item() for g in slopes[1:]] == pytest.approx([-4.0, 0.0], rel=1e-5, abs=1e-30)


def test_half_types():
    half = torch.tensor([0.2, 0.9], dtype=torch.float16)
    r = fresnel.amplitudes(half, 0.7, 0.1)
    assert {x.dtype for x in r} == {torch.float16}
    assert r.s.dtype == torch.complex64
    for found, true in zip(r, fresnel.amplitudes(half.double(), 0.7, 0.1), strict=True):
        assert bool(((found.double() - true).abs() <= 0.501 * 2**-11).all())


def test_the_oracle_agrees():
    r_s, r_p = exact(0.3, 0.2, 3.0)
    assert abs((abs(r_s) ** 2 + abs(r_p) ** 2) / 2 - oracle.reflectance(0.3, 0.2, 3.0)) < 1e-80
