"""Loss and gradients as one graph: the same numbers as backward, for modules, tensors and values."""

import pytest
import torch

import torchbrdf as tb

COMPILED = pytest.mark.parametrize("compiled", [False, "aot_eager", pytest.param(True, marks=pytest.mark.slow)])


def scene(size=6):
    y, x = torch.meshgrid(torch.linspace(1, -1, size), torch.linspace(-1, 1, size), indexing="ij")
    position = torch.stack([x, y, 0.3 * torch.cos(3 * x)], -1)
    normal = torch.stack([0.9 * torch.sin(3 * x), 0 * x, torch.ones_like(x)], -1)
    return tb.GBuffer(position, normal, view=tb.normalize(torch.tensor([0.0, 0.0, 4.0]) - position))


G, TARGET = scene(), torch.full((6, 6, 3), 0.2)
LIGHTS = [tb.PointLight([[1.0, 2.0, 3.0], [-1.0, 0.0, 3.0]], [20.0]), tb.DirectionalLight([0.0, 0.0, 1.0], 1.0)]


def shader():
    gloss = tb.nn.Material(tb.Phong, specular=tb.nn.Learned([0.5]), exponent=tb.nn.Learned([20.0]), fresnel=tb.Schlick(0.1))
    material = tb.nn.Material(tb.Lambert, albedo=tb.nn.Learned([0.5, 0.4, 0.3])) + gloss
    return tb.nn.Shader(material, tb.plan(G, material(G), LIGHTS))


def square(shader, g, target):
    return ((shader(g, LIGHTS) - target) ** 2).mean()


def by_backward(module, *args):
    module.zero_grad()
    loss = square(module, *args)
    loss.backward()
    return loss.detach(), {name: p.grad.clone() for name, p in module.named_parameters() if p.grad is not None}


@COMPILED
def test_the_same_as_backward(compiled):
    module = shader()
    value, gradients = by_backward(module, G, TARGET)
    module.zero_grad()
    found, its = tb.value_and_grad(square, compiled=compiled)(module, G, TARGET)
    torch.testing.assert_close(found, value)
    torch.testing.assert_close(its, gradients)
    assert all(p.grad is None for p in module.parameters())
    assert not any(t.requires_grad for t in (found, *its.values()))


def test_a_loop_learns_with_one_compilation():
    """Filled gradients serve an optimiser; parameters that change in place are no reason to compile again."""
    graphs, module = [], shader()

    def counting(graph, inputs):
        graphs.append(graph)
        return graph.forward

    step = tb.value_and_grad(square, fill=True, compiled=counting)
    optimiser = torch.optim.Adam(module.parameters(), lr=0.05)
    losses = []
    for _ in range(8):
        optimiser.zero_grad()
        losses.append(float(step(module, G, TARGET)[0]))
        optimiser.step()
    assert losses[-1] < 0.7 * losses[0]
    assert losses[0] == pytest.approx(float(square(shader(), G, TARGET).detach()))
    assert len(graphs) == 1


def test_many_step_functions():
    """torch compiles one code object eight times and no more; each of ours has its own."""
    for k in range(10):
        value, _ = tb.value_and_grad(lambda x, k=k: (x**2).sum() + k, compiled="eager")(torch.ones(2))
        assert float(value) == 2 + k


def test_chunks_add_up():
    module = shader()
    _, whole = by_backward(module, G, TARGET)
    module.zero_grad()
    step = tb.value_and_grad(square, fill=True, compiled=False)
    rows = [slice(0, 2), slice(2, 6)]
    weights = [2 / 6, 4 / 6]
    step = tb.value_and_grad(lambda m, w, g, t: w * square(m, g, t), fill=True, compiled=False)
    for weight, chunk in zip(weights, rows, strict=True):
        step(module, weight, G[chunk], TARGET[chunk])
    torch.testing.assert_close({name: p.grad for name, p in module.named_parameters()}, whole)


def test_frozen_parameters_have_no_gradient():
    module = shader()
    frozen = next(iter(module.parameters()))
    frozen.requires_grad_(False)
    _, gradients = tb.value_and_grad(square, fill=True, compiled=False)(module, G, TARGET)
    assert set(gradients) == {name for name, p in module.named_parameters() if p is not frozen}
    assert frozen.grad is None
    for p in module.parameters():
        p.requires_grad_(False)
    with pytest.raises(ValueError, match=r"learned: Shader has no parameter that requires a gradient"):
        tb.value_and_grad(square, compiled=False)(module, G, TARGET)


@COMPILED
def test_tensors_and_values(compiled):
    """The gradients have the structure of what was learned: of a light and an albedo here, of both alone elsewhere."""
    light = tb.PointLight(torch.tensor([0.0, 1.0, 3.0]), torch.tensor([10.0]))

    def bright(learned):
        return tb.shade(G, tb.Lambert(learned["albedo"]), learned["light"]).mean()

    albedo = torch.tensor([0.5, 0.2, 0.1])
    _, found = tb.value_and_grad(bright, compiled=compiled)({"albedo": albedo, "light": light})
    leaves = [t.clone().requires_grad_() for t in (albedo, light.position, light.intensity)]
    image = tb.shade(G, tb.Lambert(leaves[0]), tb.PointLight(*leaves[1:]))
    want = torch.autograd.grad(image.mean(), leaves)
    assert isinstance(found["light"], tb.PointLight)
    torch.testing.assert_close([found["albedo"], found["light"].position, found["light"].intensity], list(want))


def test_what_is_not_learned_has_no_gradient():
    """Whatever it requires: no graph is kept for it."""
    other = torch.ones(3, requires_grad=True)
    value, gradient = tb.value_and_grad(lambda a, b: (a * b).sum(), compiled=False)(torch.ones(3), other)
    assert not value.requires_grad
    assert not gradient.requires_grad
    assert other.grad is None


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: tb.value_and_grad(3.0), r"value_and_grad: expected a function loss\(learned, ...\), found float"),
        (lambda: tb.value_and_grad(square, compiled=False)(0.5), r"learned: expected a module, a tensor, a value, .*found float"),
        (lambda: tb.value_and_grad(square, compiled=False)([shader()]), r"found Shader; put modules into one, such as torch.nn.ModuleList"),
        (lambda: tb.value_and_grad(square, compiled=False)(torch.ones(3, dtype=torch.int64)), r"learned: found a tensor of torch.int64"),
    ],
)
def test_errors(call, message):
    with pytest.raises((TypeError, ValueError), match=message):
        call()
