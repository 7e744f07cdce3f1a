"""`shade` under autograd's transforms and the compiler: G-buffers, materials and lights go through as pytrees."""

import warnings

import pytest
import torch
from test_shade import glossy, sheet, three_lights
from torch.autograd import gradcheck, gradgradcheck

import torchbrdf as tb
from torchbrdf import compiling, torch_compat


def test_vmap_over_materials():
    g, lights = sheet(4, torch.float64), three_lights()
    albedo, exponent = torch.rand(5, 3, dtype=torch.float64), 1 + 50 * torch.rand(5, 1, dtype=torch.float64)
    material = tb.Lambert(albedo) + tb.Phong(0.3, exponent)

    def one(albedo, exponent):
        return tb.shade(g, tb.Lambert(albedo) + tb.Phong(0.3, exponent), lights)

    images = torch.vmap(one)(albedo, exponent)
    assert images.shape == (5, 4, 4, 3)
    for k in range(5):
        torch.testing.assert_close(images[k], one(albedo[k], exponent[k]))
    # The same with the material itself as the argument, its unbatched strength expanded.
    whole = material.map(lambda t: t.expand(5, t.shape[-1]))
    torch.testing.assert_close(torch.vmap(lambda m: tb.shade(g, m, lights))(whole), images)


def test_vmap_over_g_buffers_and_over_lights():
    buffers = [sheet(4, torch.float64, gen=k) for k in range(3)]
    fields = {n: torch.stack([getattr(g, n) for g in buffers]) for n in ("position", "normal", "view")}
    material, lights = glossy(), three_lights()
    batched = torch.vmap(lambda g: tb.shade(g, material, lights))(tb.GBuffer(**fields))
    torch.testing.assert_close(batched, tb.shade(tb.GBuffer(**fields), material, lights))
    points = lights[0].to(torch.float64)
    each = torch.vmap(lambda light: tb.shade(buffers[0], material, light))(points)
    torch.testing.assert_close(each, tb.shade(buffers[0], material, points, per_light=True))


def test_grad_answers_with_a_material_and_a_g_buffer_of_gradients():
    g, lights = sheet(4, torch.float64), three_lights()
    material = tb.Lambert(torch.tensor([0.2, 0.5, 0.7]).double()) + tb.Phong(torch.tensor([0.3]).double(), torch.tensor([12.0]).double())
    dm, dg = torch.func.grad(lambda m, g: tb.shade(g, m, lights).sum(), argnums=(0, 1))(material, g)
    assert type(dm) is type(material)
    assert isinstance(dg, tb.GBuffer)
    leaf = material.map(lambda t: t.clone().requires_grad_())
    place = g.map(lambda t: t.clone().requires_grad_())
    tb.shade(place, leaf, lights).sum().backward()
    torch.testing.assert_close(dm.terms[0].albedo, leaf.terms[0].albedo.grad)
    torch.testing.assert_close(dm.terms[1].exponent, leaf.terms[1].exponent.grad)
    for name in ("position", "normal", "view"):
        torch.testing.assert_close(getattr(dg, name), getattr(place, name).grad)


def test_jvp_is_the_directional_derivative():
    g, lights = sheet(4, torch.float64), three_lights()
    material = glossy(3, 4, 4).to(torch.float64)
    tangents = tuple(v.map(torch.randn_like) for v in (g, material))
    image, along = torch.func.jvp(lambda g, m: tb.shade(g, m, lights), (g, material), tangents)
    torch.testing.assert_close(image, tb.shade(g, material, lights))
    h = 1e-6  # central differences in float64: error of the order of h^2 and eps / h

    def moved(sign):
        a, b = (torch.utils._pytree.tree_map(lambda x, d: x + sign * h * d, v, t) for v, t in zip((g, material), tangents, strict=True))
        return tb.shade(a, b, lights)

    torch.testing.assert_close(along, (moved(1) - moved(-1)) / (2 * h), rtol=1e-6, atol=1e-7)


def test_first_and_second_derivatives():
    g, lights = sheet(2, torch.float64), three_lights(1)

    def image(position, normal, albedo, exponent):
        points = g.replace(position=position, normal=normal)
        return tb.shade(points, tb.Lambert(albedo) + tb.Phong(0.4, exponent, fresnel=tb.Dielectric(1.5)), lights)

    start = [g.position, g.normal, torch.tensor([0.5]).double(), torch.tensor([8.0]).double()]
    inputs = [x.clone().requires_grad_() for x in start]
    assert gradcheck(image, inputs)
    assert gradgradcheck(image, inputs)


def test_without_a_compiler_there_is_one_warning_and_the_eager_result(monkeypatch):
    from torch._inductor import cpp_builder

    cpp_builder.cpp_compiler_search.cache_clear()
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr(compiling, "_warned", False)
    g, material, lights = sheet(), glossy(), three_lights()
    with pytest.warns(RuntimeWarning, match=r"no C\+\+ compiler .* was found: running eagerly, .*install g\+\+") as seen:
        compiled = tb.compile(tb.shade)
    assert seen[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = tb.compile(tb.shade)  # once is enough
    for fn in (compiled, again):
        assert torch.equal(fn(g, material, lights), tb.shade(g, material, lights))


def test_with_a_compiler_there_is_no_warning(monkeypatch):
    monkeypatch.setattr(torch_compat, "has_cpp_compiler", lambda: True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        module = tb.compile(torch.nn.Linear(2, 2))
        tb.compile(tb.shade, recompute=False)
    assert isinstance(module, torch.nn.Module)  # so that DDP takes it
    assert len(list(module.parameters())) == 2


@pytest.mark.slow
@pytest.mark.parametrize(("recompute", "channels"), [(True, 3), (True, 8), (False, 3)])
def test_compiled_shade_is_eager_shade(recompute, channels):
    if not torch_compat.has_cpp_compiler():
        pytest.skip("there is no C++ compiler")
    torch.compiler.reset()
    g, material, lights = sheet(32), glossy(channels, 32, 32), three_lights(channels)
    shadows = (torch.rand(3, 32, 32, 1) > 0.3).float()

    def image(g, material, lights):
        return tb.shade(g, material, lights, visibility=shadows)

    def with_gradients(fn):
        a, b, c = (torch.utils._pytree.tree_map(lambda t: t.detach().clone().requires_grad_(), v) for v in (g, material, lights))
        out = fn(a, b, c)
        out.square().sum().backward()
        leaves = [t for v in (a, b, *c) for t in torch.utils._pytree.tree_leaves(v)]
        return [out.detach(), *(t.grad for t in leaves)]

    eager, compiled = with_gradients(image), with_gradients(tb.compile(image, recompute=recompute))
    assert tb.is_planar(compiled[0])
    for a, b in zip(compiled, eager, strict=True):
        torch.testing.assert_close(a, b, rtol=2e-4, atol=2e-5 * float(b.abs().max()))  # float32, other orders of summation


@pytest.mark.slow
def test_compiled_mirror_is_eager_mirror():
    if not torch_compat.has_cpp_compiler():
        pytest.skip("there is no C++ compiler")
    torch.compiler.reset()
    g, sky = sheet(16), tb.EnvironmentMap(torch.rand(16, 32, 3))
    material = tb.Mirror([0.9, 0.5, 0.2], tb.Conductor.named("Cu"))
    torch.testing.assert_close(tb.compile(tb.shade)(g, material, sky), tb.shade(g, material, sky), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(
    ("given", "asked"),
    [
        ({}, {"fullgraph": True, "backend": "recomputing pixels"}),
        ({"fullgraph": False}, {"fullgraph": False, "backend": "recomputing pixels"}),
        ({"recompute": True}, {"fullgraph": True, "backend": "recomputing all"}),
        ({"recompute": False}, {"fullgraph": True, "backend": "fusing"}),
    ],
)
def test_what_compile_asks_of_torch(monkeypatch, given, asked):
    monkeypatch.setattr(torch_compat, "has_cpp_compiler", lambda: True)
    monkeypatch.setattr(torch_compat, "recomputing_backend", lambda always: f"recomputing {'all' if always else 'pixels'}")
    monkeypatch.setattr(torch_compat, "fusing_backend", lambda: "fusing")
    monkeypatch.setattr(torch, "compile", lambda fn, **options: options)
    assert tb.compile(tb.shade, **given) == asked
