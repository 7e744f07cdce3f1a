"""A compiled plan or shader: one graph serves any number of lights, with eager's numbers, in memory that does not grow with them."""

from functools import partial

import pytest
import torch
from test_nn_material import textured
from test_shade import glossy, sheet, three_lights
from torch import nn
from torch._dynamo.backends.common import aot_autograd
from torch._dynamo.backends.debugging import aot_eager
from torch._functorch import config
from torch._functorch.partitioners import min_cut_rematerialization_partition

import torchbrdf as tb
from torchbrdf import torch_compat
from torchbrdf.effects.direct import Direct

COUNTS = (1, 3, 4, 5, 8, 17)


@pytest.fixture
def graphs(monkeypatch):
    """What ``tb.compile`` hands to the compiler, which here only traces, forward and backward."""
    found = []

    def tracing(graph, inputs):
        found.append(graph)
        learns = any(isinstance(x, torch.Tensor) and x.requires_grad for x in inputs)
        return aot_eager(graph, inputs) if learns else graph.forward

    torch._dynamo.reset()
    monkeypatch.setattr(torch_compat, "has_cpp_compiler", lambda: True)
    monkeypatch.setattr(torch_compat, "recomputing_backend", lambda always: tracing)
    return found


def points(count, *views):
    gen = torch.Generator().manual_seed(count)
    above = torch.tensor([0.0, 0.0, 3.0])
    return tb.PointLight(above + torch.randn(*views, count, 3, generator=gen), 9 * torch.rand(*views, count, 3, generator=gen))


def shader(g, albedo=None, glossy=False):
    made = tb.nn.Material(tb.Lambert, albedo=albedo or tb.nn.Learned([0.5, 0.4, 0.3]))
    if glossy:
        made += tb.nn.Material(tb.Phong, specular=tb.nn.Learned([0.5]), exponent=tb.nn.Learned([20.0]), fresnel=tb.Schlick(0.1))
    return tb.nn.Shader(made, tb.plan(g, made(g), three_lights()))


def with_gradients(render, *values, **kwargs):
    """The image, and the gradients of its square by every tensor of the values."""
    leaves = [v.map(lambda t: t.detach().clone().requires_grad_()) for v in values]
    image = render(*leaves, **kwargs)
    image.square().sum().backward()
    return [image.detach(), *(t.grad for v in leaves for _, t in v.named_tensors())]


def assert_close(found, wanted):
    for a, b in zip(found, wanted, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-6 * float(b.abs().max()))  # sums taken in another order


@pytest.mark.parametrize("glossy", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_six_numbers_of_lights_and_three_sizes_are_two_compilations(graphs, glossy):
    made = shader(sheet(4), glossy=glossy)
    fast = tb.compile(made)
    for size, compilations in ((4, 1), (6, 2), (9, 2)):
        g = sheet(size)
        for count in COUNTS:
            found, wanted = (with_gradients(partial(f, g), points(count)) for f in (fast, made))
            assert_close(found, wanted)
            assert tb.is_planar(found[0])
        assert len(graphs) == compilations


@pytest.mark.parametrize("per_light", [False, True])
def test_a_plan_gives_what_it_gives_eagerly(graphs, per_light):
    g, material = sheet(5), tb.Lambert(torch.rand(5, 5, 3)) + tb.Phong(0.3, 9.0)
    plan = tb.plan(g, material, points(1))
    fast = tb.compile(plan)
    for count in COUNTS:
        found, wanted = (with_gradients(f, g, material, points(count), per_light=per_light) for f in (fast, plan))
        assert_close(found, wanted)
        assert found[0].shape == ((count,) if per_light else ()) + (5, 5, 3)
        assert all(map(tb.is_planar, found[0] if per_light else [found[0]]))
    assert len(graphs) == 1


def test_views_shadows_and_lights_of_several_kinds(graphs):
    g, lights = tb.stack([sheet(4), sheet(4, gen=1)]), [points(3, 2), tb.DirectionalLight([[0.0, 0.0, 1.0], [0.2, 0.0, 1.0]], 0.5)]
    material, share = tb.Lambert([0.3, 0.4, 0.5]), torch.rand(5, 2, 4, 4, 1)
    plan = tb.plan(g, material, lights, visibility=share)
    fast = tb.compile(plan)
    for per_light in (False, True):
        for given in ({"visibility": share}, {"prepared": share > 0.5}, {"prepared": plan.prepare(g, lights, visibility=share)}):
            torch.testing.assert_close(
                fast(g, material, lights, per_light=per_light, **given), plan(g, material, lights, per_light=per_light, **given)
            )
    assert len(graphs) == 4, "of each kind of light one, and one more for rows"
    with pytest.raises(ValueError, match=r"visibility: expected shape \[5, 2, 4, 4, 1\]"):
        fast(g, material, lights, visibility=share[:3])


def test_a_mesh_casts_shadows_outside_of_the_graph(graphs):
    up = torch.tensor([0.0, 0.0, 1.0])
    g = tb.GBuffer(torch.tensor([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), up.expand(2, 3), up.expand(2, 3))
    plate = tb.Mesh([[-0.5, -0.5, 1.0], [0.5, -0.5, 1.0], [0.5, 0.5, 1.0], [-0.5, 0.5, 1.0]], [[0, 1, 2], [0, 2, 3]])
    lights = tb.PointLight([[1.0, 0.0, 2.0], [-1.0, 0.0, 2.0]], 9.0)
    plan = tb.plan(g, tb.Lambert(0.5), lights, plate)
    found = tb.compile(plan)(g, tb.Lambert(0.5), lights, mesh=plate, per_light=True)
    assert (found > 0)[..., 0].tolist() == [[False, True], [True, False]]


def test_an_environment_among_the_lights_keeps_its_row(graphs):
    g, sky = sheet(4), tb.EnvironmentMap(torch.rand(4, 8, 3))
    lights, mirror = [points(1), sky, points(2)], tb.Mirror(0.5)
    plan = tb.plan(g, mirror, lights)
    torch.testing.assert_close(tb.compile(plan)(g, mirror, lights, per_light=True), plan(g, mirror, lights, per_light=True))


@pytest.mark.slow
def test_lights_of_one_channel_and_of_three(graphs):
    g, grey, lights = sheet(4), tb.Lambert(0.5), [tb.PointLight([0.0, 0.0, 3.0], 9.0), points(2)]
    plan = tb.plan(g, grey, lights)
    fast = tb.compile(plan)
    for per_light in (False, True):
        found = fast(g, grey, lights, per_light=per_light)
        torch.testing.assert_close(found, plan(g, grey, lights, per_light=per_light))
        assert all(map(tb.is_planar, found if per_light else [found]))


def test_half_types_are_added_up_in_float32(graphs):
    g, lights = sheet(4).to(torch.bfloat16), tb.PointLight([0.0, 0.0, 3.0], torch.full((64, 1), 0.1))
    plan = tb.plan(g, tb.Lambert(0.5), lights)
    exact = plan(g.to(torch.float64), tb.Lambert(0.5), lights)
    found = tb.compile(plan)(g, tb.Lambert(0.5), lights)
    assert found.dtype == torch.bfloat16
    torch.testing.assert_close(found.double(), exact, rtol=0.01, atol=1e-4)


class Net(nn.Module):
    """Random in training, as dropout is."""

    def forward(self, g):
        return torch.rand_like(g.position)


def test_a_network_is_asked_once_for_all_lights(graphs):
    g = textured(4)
    fast = tb.compile(shader(g, Net()))
    one, other, third = fast(g, [points(1)] * 3, per_light=True)
    assert torch.equal(one, other)
    assert torch.equal(one, third)
    assert len(graphs) == 2, "the material, and the light"


@pytest.mark.slow
def test_a_look_up_has_the_gradients_of_eager(graphs):
    g = textured(4)
    made = shader(g, tb.nn.Texture(0.2 + 0.6 * torch.rand(4, 5, 3)))
    fast, found = tb.compile(made), []
    for f in (fast, made):
        made.zero_grad()
        f(g, three_lights()).square().sum().backward()
        found.append([p.grad.clone() for p in made.parameters()])
    assert_close(*found)
    assert [n.removeprefix("_orig_mod.") for n, _ in fast.named_parameters()] == [n for n, _ in made.named_parameters()]
    assert fast.material is made.material


def test_an_effect_of_ones_own_sees_all_lights(graphs):
    class Counting(Direct):
        def run(self, bsdf, surface, lights, prepared):
            share = 1.0 / sum(len(light) for _, light in lights)
            return [p._replace(radiance=tuple(share * c for c in p.radiance)) for p in super().run(bsdf, surface, lights, prepared)]

    g, material, lights = sheet(4), tb.Lambert([0.3, 0.4, 0.5]), points(4)
    plan = tb.plan(g, material, lights, effects=[Counting()])
    torch.testing.assert_close(tb.compile(plan)(g, material, lights), plan(g, material, lights))


def test_within_another_graph(graphs):
    g, lights = sheet(4), three_lights()
    made = shader(g)
    fast = tb.compile(made)
    whole = torch.compile(lambda g, lights: fast(g, lights).sqrt(), fullgraph=True, backend="eager")
    torch.testing.assert_close(whole(g, lights), made(g, lights).sqrt())
    assert not graphs


def kept(monkeypatch, count):
    """Bytes that forward keeps for backward under the package's own budget, each memory counted once."""
    torch._dynamo.reset()

    def budgeted(graph, inputs):
        with config.patch(activation_memory_budget=0.0):
            run = aot_autograd(fw_compiler=lambda g, _: g.forward, partition_fn=min_cut_rematerialization_partition)
            return run(graph, inputs)

    monkeypatch.setattr(torch_compat, "recomputing_backend", lambda always: budgeted)
    g, lights, sizes = sheet(32), points(count), {}
    material = tb.Lambert(torch.rand(32, 32, 3, requires_grad=True))

    def pack(t):
        sizes[t.untyped_storage().data_ptr()] = t.untyped_storage().nbytes()
        return t

    with torch.autograd.graph.saved_tensors_hooks(pack, lambda t: t):
        tb.compile(tb.plan(g, material, lights))(g, material, lights)
    return sum(sizes.values())


def test_memory_does_not_grow_with_the_number_of_lights(graphs, monkeypatch):
    one, many = kept(monkeypatch, 1), kept(monkeypatch, 17)
    assert many - one <= 16 * 64, "a light, and not one number for each pixel"
    assert one > 32 * 32 * 4


@pytest.mark.slow
def test_inductor_gives_what_eager_gives():
    torch.compiler.reset()
    g, material = sheet(32), glossy(3, 32, 32)
    plan = tb.plan(g, material, points(1))
    fast = tb.compile(plan)
    for count in (1, 5):
        assert_close(*(with_gradients(f, g, material, points(count)) for f in (fast, plan)))
