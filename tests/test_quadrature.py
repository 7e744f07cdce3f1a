"""Rules for integrals, by what they must integrate exactly."""

import pytest
import torch

from torchbrdf import quadrature


@pytest.mark.parametrize("order", [1, 2, 5])
def test_gauss_is_exact_for_polynomials_and_midpoints_for_waves(order):
    x, weight = quadrature.gauss_legendre(order)
    for power in range(2 * order):
        assert float((weight * x**power).sum()) == pytest.approx(1 / (power + 1))
    y = quadrature.midpoints(order)
    assert y.tolist() == pytest.approx([(k + 0.5) / order for k in range(order)])
    u, weight = quadrature.unit_square(order)
    assert u.shape == (order * order, 3)
    assert float((weight * u[:, 0] ** (2 * order - 1)).sum()) == pytest.approx(1 / (2 * order))
    assert float((weight * (1 + torch.cos(2 * torch.pi * u[:, 1]))).sum()) == pytest.approx(1 if order > 1 else 0, abs=1e-12)
    assert (u[:, 2] == 0.5).all()


def test_points_of_the_cube_are_even_along_each_axis():
    u, weight = quadrature.unit_cube(64)
    assert float(weight.sum()) == pytest.approx(1)
    for axis in u.unbind(-1):
        assert (axis * 64).long().sort().values.tolist() == list(range(64))
