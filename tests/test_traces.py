"""Shading traces into one full graph, forward and backward, by ``aot_eager``: seconds, where inductor (slow tests) takes a minute.

What fusing does to the numbers is the slow tests' to find; models by themselves are traced in test_contract, formulas of lights
where the lights are.
"""

import pytest
import torch
from test_nn_material import shader
from test_shade import glossy, sheet, three_lights
from torch.utils import _pytree as pytree

import torchbrdf as tb


def with_gradients(fn, *values):
    """The image, and its gradients by every tensor of its arguments."""
    mine = [pytree.tree_map(lambda t: t.detach().clone().requires_grad_(), v) for v in values]
    image = fn(*mine)
    image.square().sum().backward()
    return image.detach(), [t.grad for t in pytree.tree_leaves(mine) if t.grad is not None]


@pytest.mark.parametrize("kind", ["glossy", "mirror"])
def test_shade_traces_into_one_graph(kind):
    torch._dynamo.reset()
    material = tb.Mirror([0.9, 0.5, 0.2], tb.Conductor.named("Cu")) if kind == "mirror" else glossy(3, 8, 8)
    lights = tb.EnvironmentMap(torch.rand(4, 8, 3), torch.eye(3)) if kind == "mirror" else three_lights()
    visibility = None if kind == "mirror" else (torch.rand(3, 8, 8, 1) > 0.3).float()

    def image(g, material, lights):
        return tb.shade(g, material, lights, visibility=visibility)

    (expected, wanted), (traced, found) = (
        with_gradients(fn, sheet(8), material, lights) for fn in (image, torch.compile(image, fullgraph=True, backend="aot_eager"))
    )
    torch.testing.assert_close(traced, expected)
    assert tb.is_planar(traced)
    for a, b in zip(found, wanted, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-6 * float(b.abs().max()))  # sums over pixels, taken in another order


def test_a_shader_traces_into_one_graph():
    torch._dynamo.reset()
    made, g = shader()
    made.material.terms[0].albedo.srgb = True
    lights, found = three_lights()[:1], []
    for fn in (made, torch.compile(made, fullgraph=True, backend="aot_eager")):
        made.zero_grad()
        fn(g, lights).square().sum().backward()
        found.append([p.grad.clone() for p in made.parameters()])
    for a, b in zip(*found, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-6 * float(b.abs().max()))
