"""An optimisation started on a bound of its parameter leaves it and finds the truth."""

import importlib
import math
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

import torchbrdf as tb

nn = tb.nn  # what a field does on a bound stands in docs/numerics.md, "Parameters"
EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
FIXED = {"specular": 0.8, "exponent": 30.0, "eta": 1.5, "k": 3.0}


def phong(model=tb.Phong, fresnel=None, **parameters):
    given = {"specular": FIXED["specular"], "exponent": FIXED["exponent"], **parameters}
    return nn.Material(model, **given, fresnel=fresnel)


# name: (learned field -> material, start, truth)
CASES = {
    "albedo 0": (lambda x: nn.Material(tb.Lambert, albedo=x), [0.0] * 3, [0.6, 0.3, 0.1]),
    "albedo 1": (lambda x: nn.Material(tb.Lambert, albedo=x), [1.0] * 3, [0.6, 0.3, 0.9]),
    "specular 0": (lambda x: phong(specular=x), 0.0, 0.7),
    "exponent 0": (lambda x: phong(exponent=x), 0.0, 20.0),
    "exponent 1e5": (lambda x: phong(exponent=x), 1e5, 20.0),
    "Blinn's specular 1": (lambda x: phong(tb.BlinnPhong, specular=x), 1.0, 0.4),
    "Blinn's exponent 0": (lambda x: phong(tb.BlinnPhong, exponent=x), 0.0, 40.0),
    "Blinn's exponent 1e5": (lambda x: phong(tb.BlinnPhong, exponent=x), 1e5, 40.0),
    "eta 1": (lambda x: phong(fresnel=nn.Material(tb.Dielectric, eta=x)), 1.0, 1.5),
    "f0 0": (lambda x: phong(fresnel=nn.Material(tb.Schlick, f0=x)), [0.0] * 3, [0.9, 0.6, 0.3]),
    "f0 1": (lambda x: phong(fresnel=nn.Material(tb.Schlick, f0=x)), [1.0] * 3, [0.9, 0.6, 0.3]),
    "k 0": (lambda x: phong(fresnel=nn.Material(tb.Conductor, eta=1.4, k=x)), [0.0] * 3, [3.0, 1.0, 7.0]),
    "metal's eta 1": (lambda x: phong(fresnel=nn.Material(tb.Conductor, eta=x, k=1.0)), 1.0, 0.3),
    "tint 0": (lambda x: nn.Material(tb.Mirror, tint=x), [0.0] * 3, [0.9, 0.5, 0.2]),
    "tint 1": (lambda x: nn.Material(tb.Mirror, tint=x), [1.0] * 3, [0.9, 0.5, 0.2]),
    "mirror's eta 1": (lambda x: nn.Material(tb.Mirror, fresnel=nn.Material(tb.Dielectric, eta=x)), 1.0, 1.5),
}


def ball(dtype, n=24):
    """A unit ball seen from far away, with every normal that faces the viewer."""
    axis = (torch.arange(n, dtype=torch.float64) + 0.5) / n * 2 - 1
    y, x = torch.meshgrid(axis, axis, indexing="ij")
    inside = x * x + y * y < 0.98
    normal = torch.stack([x, y, torch.where(inside, 1 - x * x - y * y, 0.0).sqrt()], -1)[inside]
    return tb.GBuffer(normal, normal, torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).expand_as(normal)).to(dtype)


def closeup(dtype, n=48):
    """A patch of a ball whose normals differ by 0.09 degrees from pixel to pixel: the highlight of exponent 1e5 covers a few of them."""
    axis = torch.deg2rad((torch.arange(n, dtype=torch.float64) - n / 2) * 0.09)
    y, x = torch.meshgrid(axis, axis, indexing="ij")
    normal = torch.stack([x, y, (1 - x * x - y * y).sqrt()], -1).reshape(-1, 3)
    return tb.GBuffer(normal, normal, torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).expand_as(normal)).to(dtype)


def sources(material, g, polar=(8.0, 40.0, 75.0, 100.0, 125.0, 145.0)):
    """Six lamps from frontal to grazing, for what is not a mirror; for a mirror, a sky."""
    if any(lobe.is_delta for lobe in material(g).lobes):
        return tb.EnvironmentMap(torch.rand(8, 16, 3, generator=torch.Generator().manual_seed(2), dtype=g.position.dtype))
    polar = torch.deg2rad(torch.tensor(polar, dtype=torch.float64))
    turn = torch.arange(len(polar)) * 2.4
    towards = torch.stack([torch.sin(polar) * torch.cos(turn), torch.sin(polar) * torch.sin(turn), torch.cos(polar)], -1)
    return tb.DirectionalLight(towards.to(g.position.dtype), torch.full((len(polar), 1), math.pi, dtype=g.position.dtype))


def shader_and_photograph(name, dtype):
    """(learned field, truth, shader, g, lights, photograph)."""
    build, start, truth = CASES[name]
    needle = "1e5" in name
    g = closeup(dtype) if needle else ball(dtype)
    true = torch.tensor(truth, dtype=dtype).reshape(-1)
    field = nn.Learned(torch.tensor(start, dtype=dtype))
    material, exact = build(field), build(nn.Constant(true))
    lights = sources(material, g, (1.0, 2.0, 3.0)) if needle else sources(material, g)
    plan = tb.plan(g, material(g), lights)
    return field, true, nn.Shader(material, plan), g, lights, nn.Shader(exact, plan)(g, lights)


def error(field, true):
    return float(((field.value.detach() - true) / true).abs().max())


def adam(shader, g, lights, photograph, name):
    """Steps of 0.1. A needle's first slopes are 1e6 times its last: there Adam must forget them sooner than by default."""
    optimiser = torch.optim.Adam(shader.parameters(), lr=0.1, betas=(0.9, 0.9 if "1e5" in name else 0.999))
    for _ in range(260):
        optimiser.zero_grad()
        (shader(g, lights) - photograph).square().mean().backward()
        optimiser.step()


def lbfgs(shader, g, lights, photograph, name):
    optimiser = torch.optim.LBFGS(shader.parameters(), max_iter=60, line_search_fn="strong_wolfe", tolerance_grad=1e-13, tolerance_change=0)

    def closure():
        optimiser.zero_grad()
        loss = (shader(g, lights) - photograph).square().mean()
        loss.backward()
        return loss

    optimiser.step(closure)


class Residuals(torch.nn.Module):
    def __init__(self, shader, lights):
        super().__init__()
        self.shader, self.lights = shader, lights

    def forward(self, p):
        return self.shader(p.g, self.lights) - p.image


def gauss_newton(shader, g, lights, photograph, name):
    solver = importlib.import_module("recovery.gauss_newton").GaussNewton(
        Residuals(shader, lights), [SimpleNamespace(g=g, image=photograph)]
    )
    assert any(not solver.step() for _ in range(20)), "it comes to its end"


RUNS = [(adam, torch.float32, 0.01), (lbfgs, torch.float64, 1e-6), (gauss_newton, torch.float32, 1e-4)]
RUNS += [pytest.param(adam, torch.float64, 0.01, marks=pytest.mark.slow), pytest.param(lbfgs, torch.float32, 1e-4, marks=pytest.mark.slow)]
RUNS += [pytest.param(gauss_newton, torch.float64, 1e-6, marks=pytest.mark.slow)]


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize(("optimise", "dtype", "within"), RUNS, ids=lambda x: getattr(x, "__name__", str(x)))
def test_a_field_started_on_a_bound_recovers_the_truth(monkeypatch, optimise, dtype, within, name):
    monkeypatch.syspath_prepend(str(EXAMPLES))
    field, true, shader, g, lights, photograph = shader_and_photograph(name, dtype)
    start = torch.as_tensor(CASES[name][1], dtype=dtype)
    moved = (field.value.detach() - start).abs() / start.clamp_min(1.0)
    assert float(moved.max()) <= 1.001 * torch.finfo(dtype).eps ** 0.25, "it starts where it was told to"
    assert error(field, true) > 0.1
    optimise(shader, g, lights, photograph, name)
    assert error(field, true) < within


def test_everything_on_a_bound_at_once(monkeypatch):
    """White albedo, no highlight, and that of exponent 0: none hides the others."""
    monkeypatch.syspath_prepend(str(EXAMPLES))
    g = ball(torch.float64)
    fields = {"albedo": nn.Learned(torch.ones(3).double()), "specular": nn.Learned(torch.zeros(1).double()), "exponent": nn.Learned(torch.zeros(1).double())}  # fmt: skip
    truth = {"albedo": [0.6, 0.3, 0.1], "specular": [0.5], "exponent": [25.0]}
    fresnel = tb.Dielectric(1.5)

    def build(albedo, **rest):
        return nn.Material(tb.Lambert, albedo=albedo) + nn.Material(tb.Phong, **rest, fresnel=fresnel)

    material = build(**fields)
    lights = sources(material, g)
    exact = build(**{n: torch.tensor(v, dtype=torch.float64) for n, v in truth.items()})
    plan = tb.plan(g, material(g), lights)
    gauss_newton(nn.Shader(material, plan), g, lights, nn.Shader(exact, plan)(g, lights), "")
    for name, value in truth.items():
        assert fields[name].value.tolist() == pytest.approx(value, rel=1e-6), name


# A leaf tensor of one's own, held in its range by a clamp after each step: (value -> BSDF, start, truth, highest, step of Adam).
PLAIN = {
    "albedo 0": (tb.Lambert, 0.0, 0.3, 1.0, 0.05),
    "albedo 1": (tb.Lambert, 1.0, 0.3, 1.0, 0.05),
    "specular 0": (lambda x: tb.Phong(x, 30.0), 0.0, 0.7, math.inf, 0.05),
    "exponent 0": (lambda x: tb.Phong(0.8, x), 0.0, 20.0, math.inf, 1.0),
    "f0 0": (lambda x: tb.Phong(0.8, 30.0, tb.Schlick(x)), 0.0, 0.6, 1.0, 0.05),
    "f0 1": (lambda x: tb.Phong(0.8, 30.0, tb.Schlick(x)), 1.0, 0.6, 1.0, 0.05),
    "tint 0": (tb.Mirror, 0.0, 0.6, 1.0, 0.05),
    "tint 1": (tb.Mirror, 1.0, 0.6, 1.0, 0.05),
}


@pytest.mark.parametrize("name", PLAIN)
def test_a_plain_tensor_started_on_a_bound_recovers_the_truth(name):
    build, start, truth, highest, rate = PLAIN[name]
    x = torch.tensor([start], requires_grad=True)
    g = ball(torch.float32)
    lights = sources(lambda _: build(x), g)
    photograph = tb.shade(g, build(torch.tensor([truth])), lights)
    optimiser = torch.optim.Adam([x], lr=rate)
    for _ in range(100):
        optimiser.zero_grad()
        (tb.shade(g, build(x), lights) - photograph).square().mean().backward()
        optimiser.step()
        with torch.no_grad():
            x.clamp_(0.0, highest)
    assert x.item() == pytest.approx(truth, rel=0.01)


@pytest.mark.parametrize(("build", "flat"), [(tb.Dielectric, 1.0), (lambda k: tb.Conductor(1.4, k), 0.0)], ids=["eta 1", "k 0"])
def test_where_no_slope_is_a_plain_tensor_stays(build, flat):
    """F ~ (eta - 1)^2 and R ~ const + k^2: that is the truth, and why fields begin beside these values."""
    x = torch.tensor([flat], dtype=torch.float64, requires_grad=True)
    g = ball(torch.float64)
    image = tb.shade(g, tb.Phong(0.8, 30.0, build(x)), sources(lambda _: tb.Phong(0.8, 30.0), g))
    (slope,) = torch.autograd.grad(image.sum(), x)
    assert slope.item() == pytest.approx(0.0, abs=1e-15)
