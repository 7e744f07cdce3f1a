"""The reflectance of a dielectric for diffuse light."""

import math

import mpmath
import oracle
import pytest
import torch

import torchbrdf as tb

DOUBLE = torch.float64


def number(x):
    return torch.tensor(x, dtype=DOUBLE)


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
