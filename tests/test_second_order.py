"""Second derivatives through `shade`, and the recovery example's Gauss-Newton: fewer iterations than the best Adam."""

import importlib
import itertools
from pathlib import Path

import pytest
import torch
from torch.func import functional_call, grad, jvp, vjp, vmap

import torchbrdf as tb

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
TEXELS = 6


@pytest.fixture
def part(monkeypatch):
    monkeypatch.syspath_prepend(str(EXAMPLES))
    monkeypatch.setattr(importlib.import_module("recovery.builtin"), "TEXELS", TEXELS)
    return lambda name: importlib.import_module(f"recovery.{name}")


def small(part, seed=0):
    """The problem of the example with few pixels and texels, and the model at its start."""
    problem = part("builtin").build(seed, size=32)
    material = part("problem").make_material("glossy", TEXELS, problem.start).double()
    points = [p for view in problem.views for p in view.points()]
    plan = tb.plan(points[0].g, material(points[0].g), problem.lights.one(points[0].g, 0))
    return part("fit").Model(material, problem, plan), points


def directions(model):
    gen = torch.Generator().manual_seed(3)
    return [torch.randn(p.shape, generator=gen, dtype=p.dtype) for p in model.parameters()]


def loss_of(model, points):
    names = [n for n, _ in model.named_parameters()]
    return lambda *values: sum(functional_call(model, dict(zip(names, values, strict=True)), (p,)).square().sum() for p in points)


def test_hessian_vector_products_three_ways(part):
    """Reverse over reverse, forward over reverse, and central differences of gradients agree."""
    model, points = small(part)
    v = directions(model)
    found = part("linear").hessian_product(model, points, v)
    loss, values = loss_of(model, points), tuple(p.detach() for p in model.parameters())
    slope = grad(loss, argnums=tuple(range(len(values))))
    _, forward = jvp(slope, values, tuple(v))
    step = 1e-5  # error of the differences: step^2 times third derivatives, and rounding over step
    ahead, behind = (slope(*(x + s * d for x, d in zip(values, v, strict=True))) for s in (step, -step))
    for a, b, up, down in zip(found, forward, ahead, behind, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-9, atol=1e-9 * float(b.abs().max()))
        torch.testing.assert_close(a, (up - down) / (2 * step), rtol=1e-5, atol=1e-6 * float(b.abs().max()))
        assert float(a.abs().max()) > 0


def test_products_with_the_derivative(part):
    """J v and J'u of the example against forward mode and reverse mode of torch.func, and J'J v against both in turn."""
    model, points = small(part)
    linear, v = part("linear").Linear(model, points), directions(model)
    names = [n for n, _ in model.named_parameters()]
    values = tuple(p.detach() for p in model.parameters())

    def residuals(*values):
        return tuple(functional_call(model, dict(zip(names, values, strict=True)), (p,)) for p in points)

    _, forward = jvp(residuals, values, tuple(v))
    for a, b in zip(linear.forward(v), forward, strict=True):
        torch.testing.assert_close(a, b)
    _, back = vjp(residuals, *values)
    for a, b, c in zip(linear.product(v), linear.transposed(list(forward)), back(forward), strict=True):
        torch.testing.assert_close(a, c)
        torch.testing.assert_close(b, c)


def test_the_estimated_diagonal(part):
    """Its mean over many draws is the diagonal, column by column; the errors of 400 draws are a few times sqrt(2/400)."""
    model, points = small(part)
    linear = part("linear").Linear(model, points)
    found = linear.diagonal(torch.Generator().manual_seed(1), probes=400)
    for k, p in enumerate(linear.parameters):
        for i in range(0, p.numel(), max(p.numel() // 5, 1)):
            unit = [torch.zeros_like(q) for q in linear.parameters]
            unit[k].view(-1)[i] = 1.0
            exact = sum(float(y.square().sum()) for y in linear.forward(unit))
            assert found[k].view(-1)[i].item() == pytest.approx(exact, rel=0.4, abs=1e-12)


def test_the_whole_hessian_is_the_gauss_newton_one_without_residuals(part):
    """At a perfect fit the residual's own curvature drops out: H = 2 J'J. Away from one it does not."""
    model, points = small(part)
    v = directions(model)
    noisy = part("linear").hessian_product(model, points, v)
    rough = part("linear").Linear(model, points).product(v)
    assert any(float((a - 2 * b).abs().max()) > 0.1 * float(a.abs().max()) for a, b in zip(noisy, rough, strict=True))
    for p in points:
        p.image = p.image + model(p).detach()
    whole, half = part("linear").hessian_product(model, points, v), part("linear").Linear(model, points).product(v)
    for a, b in zip(whole, half, strict=True):
        torch.testing.assert_close(a, 2 * b, rtol=1e-9, atol=1e-9 * float(a.abs().max()))


def iterations_until(steps, loss):
    return next((k for k, step in enumerate(steps) if step.loss <= loss), None)


RACES = [(0, (0.1, 0.2), 0), pytest.param(0, (0.03, 0.1, 0.2, 0.3), 500, marks=pytest.mark.slow), pytest.param(1, (0.03, 0.1, 0.2, 0.3), 500, marks=pytest.mark.slow)]  # fmt: skip


@pytest.mark.parametrize(("seed", "rates", "iterations"), RACES)  # exponents started at a fifth, and at five times the truth
def test_gauss_newton_needs_fewer_iterations_than_the_best_adam(part, seed, rates, iterations):
    """Five times fewer. That Adam gets there at all takes as many ``iterations``; without, it runs as long as it must not."""
    fit = part("fit").fit
    model, points = small(part, seed)
    newton = fit(model, points)
    least = newton[-1].loss
    assert len(newton) <= 15
    goals = [least * (1 + excess) for excess in (0.1, 0.01, 1e-4)]
    needed = [iterations_until(newton, goal) for goal in goals]
    best = [10**9] * len(goals)
    for rate in rates:
        model, points = small(part, seed)
        adam = fit(model, points, iterations or 5 * max(needed), "adam", rate)
        assert min(step.loss for step in adam) > least * (1 - 1e-6), "no optimiser goes lower"
        best = [min(b, iterations_until(adam, goal) or 10**9) for b, goal in zip(best, goals, strict=True)]
    assert not iterations or best[0] <= iterations, "Adam does get there"
    assert all(5 * ours <= adam for ours, adam in zip(needed, best, strict=True))


def test_gauss_newton_ends_at_a_minimum(part):
    """The gradient is gone, the steps only ever went down, and the curvature is positive."""
    model, points = small(part)
    steps = part("fit").fit(model, points)
    assert all(b.loss <= a.loss for a, b in itertools.pairwise(steps))
    linear = part("linear").Linear(model, points)
    start, _ = small(part)
    before = part("linear").Linear(start, points).gradient()
    for a, b in zip(linear.gradient(), before, strict=True):
        assert float(a.abs().max()) < 1e-5 * float(b.abs().max())
    v = directions(model)
    assert part("linear").dot(v, part("linear").hessian_product(model, points, v)) > 0


def test_gauss_newton_stops_where_nothing_can_be_gained(part):
    """No photograph shows the parameters: their derivative is 0, and so is every step."""
    model, points = small(part)
    dark = [type(p)(p.g.replace(mask=torch.zeros_like(p.g.valid)), p.light, torch.zeros_like(p.image)) for p in points]
    before = [p.detach().clone() for p in model.parameters()]
    steps = part("fit").fit(model, dark)
    assert [s.loss for s in steps] == [0.0, 0.0]  # the start, and one try
    assert all(torch.equal(a, b) for a, b in zip(before, model.parameters(), strict=True))


def test_curvature_of_a_batch_of_materials():
    """Per-sample Hessians by vmap over jacfwd of grad, here of eight glossy materials, against double backward."""
    gen = torch.Generator().manual_seed(0)
    wi, wo = (tb.normalize(torch.tensor(w, dtype=torch.float64)) for w in ((0.3, 0.1, 0.8), (-0.2, 0.1, 0.9)))
    x = torch.tensor([0.5, 30.0, 1.5], dtype=torch.float64) * (1 + 0.2 * torch.rand(8, 3, generator=gen, dtype=torch.float64))

    def value(x):
        k, s, eta = x.unsqueeze(-1).unbind(0)
        return tb.Phong(k, s, fresnel=tb.Dielectric(eta)).evaluate(wi, wo).sum()

    found = vmap(torch.func.hessian(value))(x)
    for one, h in zip(x, found, strict=True):
        torch.testing.assert_close(h, torch.autograd.functional.hessian(value, one))
    assert float(found.abs().amin(0).max()) > 0


def test_confidence_is_that_of_linear_least_squares(part):
    """Residuals A x - b of two photographs: the covariance is s^2 (A'A)^-1 with s^2 the mean of the squared residuals."""
    gen = torch.Generator().manual_seed(0)
    factors = [torch.randn(n, 3, 4, generator=gen, dtype=torch.float64) * torch.tensor([1.0, 3.0, 0.1, 1.0]) for n in (20, 31)]
    points = [part("problem").Points(None, k, torch.randn(a.shape[:-1], generator=gen, dtype=torch.float64)) for k, a in enumerate(factors)]
    model = torch.nn.Linear(4, 1, bias=False).double()
    model.forward = lambda p: (factors[p.light] @ model.weight.t()).squeeze(-1) - p.image
    whole = torch.cat(factors).flatten(0, 1)
    rest = torch.cat([model(p).detach() for p in points])
    covariance = rest.square().mean() * torch.linalg.inv(whole.t() @ whole)
    confidence = part("confidence").Confidence(model, points)
    for c in (torch.eye(4)[0], torch.eye(4)[2], torch.tensor([1.0, -2.0, 3.0, 0.5])):
        c = c.double()
        assert confidence.of((model.weight * c).sum()) == pytest.approx(float((c @ covariance @ c).sqrt()), rel=1e-9)
