"""Shadows: none of a surface's own making, and all that others cast. (With Mitsuba they are compared in test_shade_renderers.)"""

import math
from typing import NamedTuple

import numpy as np
import pytest
import torch
import torch.nn.functional as F
import trimesh

import torchbrdf as tb
from torchbrdf.scene import start as module


def Point(*positions):
    return tb.PointLight(torch.tensor(positions), 1.0)


def Sun(*direction):
    return tb.DirectionalLight(torch.tensor(direction), 1.0)


def Sky():
    """A light without a direction to cast a ray in."""
    return tb.EnvironmentMap(torch.ones(2, 4, 3))


def ball(scale=1.0, shift=(0.0, 0.0, 0.0), dtype=torch.float32, subdivisions=4):
    s = trimesh.creation.icosphere(subdivisions=subdivisions)
    return tb.Mesh(torch.tensor(s.vertices * scale + np.array(shift), dtype=dtype), torch.tensor(s.faces))


def seen(mesh, scale=1.0, shift=(0.0, 0.0, 0.0), size=(96, 96)):
    at = torch.tensor(shift, dtype=torch.float64)
    eye = at + scale * torch.tensor([0.4, 0.6, 3.0], dtype=torch.float64)
    return tb.GBuffer.from_mesh(mesh, tb.Camera.look_at(eye, at, [0.0, 1.0, 0.0], 40.0, size))


def geometric_side(g, light):
    wi = light.sample(g.position.double()).wi
    return (g.geometric_normal.double() * wi[0]).sum(-1, keepdim=True)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("shift", [(0.0, 0.0, 0.0), (7.0, -3.0, 11.0)])
def test_a_closed_sphere_has_no_acne(scale, shift, dtype):
    """Every point whose true surface faces the light is lit, every other one dark, up to rounding at the terminator."""
    shift = tuple(scale * s for s in shift)
    mesh = ball(scale, shift, dtype)
    g = seen(mesh, scale, shift)
    for light in (Sun(1.0, 0.3, 0.2), Sun(-0.2, 1.0, -0.9), Point([scale * 1.2 + shift[0], scale + shift[1], scale + shift[2]])):
        lit = tb.visibility(g, light, mesh)[0] > 0
        side = geometric_side(g, light)
        clear = g.mask & (side.abs() > 8 * torch.finfo(torch.float32).eps)
        assert clear.sum() > 3000
        assert torch.equal(lit[clear], (side > 0)[clear])
        assert not lit[~g.mask].any()


def test_without_the_offset_there_is_acne(monkeypatch):
    """The bound is what keeps the surface clean: the test above can fail."""
    mesh = ball()
    g = seen(mesh)
    light = Sun(1.0, 0.3, 0.2)
    facing = g.mask & (geometric_side(g, light) > 1e-3)
    assert (tb.visibility(g, light, mesh)[0][facing] > 0).all()
    monkeypatch.setattr(module, "offset_bound", lambda points, normal, caster: torch.zeros_like(points[..., :1]))
    assert not (tb.visibility(g, light, mesh)[0][facing] > 0).all()


def plate(z, half, lower=-1.0):
    v = torch.tensor([[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]])
    return v, torch.tensor([[0, 1, 2], [0, 2, 3]])


@pytest.mark.parametrize("gap", [1e-5, 1.0])
def test_a_shadow_has_its_shape_and_stays_attached(gap):
    """A small plate above a large one, lit from above: also one that almost touches (the offset may not step over it)."""
    (big, low), (small, high) = plate(0.0, 2.0), plate(gap, 0.5)
    mesh = tb.Mesh(torch.cat([big, small]), torch.cat([low, high + 4]))
    x, y = torch.meshgrid(torch.linspace(-1.5, 1.5, 31) + 0.01, torch.linspace(-1.5, 1.5, 31) + 0.01, indexing="xy")
    floor = torch.stack([x, y, torch.zeros_like(x)], -1)
    up = torch.tensor([0.0, 0.0, 1.0]).expand(31, 31, 3)
    g = tb.GBuffer(floor, up, up, up)
    under = (x.abs() < 0.5) & (y.abs() < 0.5)
    assert torch.equal(tb.visibility(g, Sun(0.0, 0.0, 1.0), mesh)[0, ..., 0] == 0, under)
    # A light below the plate is not hidden by it.
    if gap == 1.0:
        assert (tb.visibility(g, Point([0.0, 0.0, 0.5]), mesh) == 1).all()
        assert (tb.visibility(g, Point([0.0, 0.0, 1.5]), mesh)[0, 15, 15] == 0).all()


def test_a_light_in_the_plane_of_a_plate_does_not_light_it():
    """Not even where it touches a point, nor where a shading normal leans towards it; and every gradient is finite."""
    mesh = tb.Mesh(*plate(0.0, 1.0))
    x = torch.tensor([-0.5, 0.0, 0.25, 0.75])
    up = torch.tensor([0.0, 0.0, 1.0]).expand(4, 3)
    points, at = torch.stack([x, 0 * x, 0 * x], -1).requires_grad_(), torch.tensor([[0.25, 0.0, 0.0]], requires_grad=True)
    light, bsdf = tb.PointLight(at, 1.0), tb.Lambert(0.5) + tb.Phong(0.3, 20.0)
    leaning = tb.normalize(up + torch.tensor([[0.3, 0.0, 0.0], [0.3, 0.0, 0.0], [0.0, 0.0, 0.0], [-0.3, 0.0, 0.0]]))
    for normal in (up, leaning):
        g = tb.GBuffer(points, normal, up, up)
        assert (tb.visibility(g, light, mesh) == 0).all()
        radiance = tb.shade(g, bsdf, light, mesh=mesh)
        assert (radiance == 0).all()
        for slope in torch.autograd.grad(radiance.sum(), (points, at), allow_unused=True, materialize_grads=True):
            assert torch.isfinite(slope).all()
    free = tb.shade(tb.GBuffer(points, up, up, up), bsdf, light)
    assert (free == 0).all(), "without shadows too: the cosine is 0, and nothing comes from no distance"


def test_the_lit_side_is_the_one_that_is_seen():
    """A sheet seen from behind (two-sided): the light on the viewer's side is visible, the one beyond is not."""
    v, faces = plate(0.0, 1.0)
    mesh = tb.Mesh(v, faces.flip(-1))  # wound away from the viewer
    g = seen(mesh, size=(8, 8))
    assert ((g.geometric_normal * g.view).sum(-1)[g.mask[..., 0]] < 0).all()
    both = tb.visibility(g, [Sun(0.1, 0.0, 1.0), Sun(0.1, 0.0, -1.0)], mesh)
    assert torch.equal(both[0], g.mask.float())
    assert (both[1] == 0).all()


def test_rows_shapes_and_what_has_no_row():
    mesh = ball(subdivisions=2)
    g = seen(mesh, size=(6, 8))
    three = Point([0.0, 3.0, 0.0], [3.0, 0.0, 0.0], [0.0, 0.0, 3.0])
    v = tb.visibility(g, [Sky(), three, Sun(0.0, 0.0, 1.0)], mesh)
    assert v.shape == (4, 6, 8, 1)
    assert v.dtype == torch.float32
    assert torch.equal(v[:3], tb.visibility(g, three, mesh))
    assert set(v.unique().tolist()) == {0.0, 1.0}
    assert tb.visibility(g, Sky(), mesh).shape == (0, 6, 8, 1)
    leaf = mesh.vertices.clone().requires_grad_()
    assert not tb.visibility(seen(mesh.replace(vertices=leaf), size=(6, 8)), three, mesh).requires_grad


def test_a_g_buffer_without_geometric_normals_takes_them_from_the_mesh():
    mesh = ball(subdivisions=2)
    g = seen(mesh)
    sun = Sun(1.0, 0.2, 0.1)
    full = tb.visibility(g, sun, mesh)
    assert torch.equal(tb.visibility(g.replace(geometric_normal=None), sun, mesh), full)
    bare = tb.GBuffer(g.position, g.normal, g.view, mask=g.mask)
    assert (tb.visibility(bare, sun, mesh) == full).float().mean() > 0.98  # shading normals differ near the terminator
    broken = g.replace(position=torch.where(g.mask, g.position, float("nan")))
    assert torch.equal(tb.visibility(broken, sun, mesh), full)
    left = torch.arange(96).reshape(1, -1, 1) < 48
    assert torch.equal(tb.visibility(g.replace(mask=g.mask & left), sun, mesh), full * left)


def away_from_edges(g, pixels=2, jump=0.02):
    """Pixels at least so far from the edge of the mask and from a jump of depth between neighbours."""
    mask, depth = g.mask[..., 0], g.depth[..., 0]
    edge = ~mask
    for axis in (0, 1):
        a, b = depth.narrow(axis, 0, depth.shape[axis] - 1), depth.narrow(axis, 1, depth.shape[axis] - 1)
        jumps = (a - b).abs() > jump * torch.minimum(a, b)
        edge = edge | F.pad(jumps, (0, 1, 0, 0) if axis else (0, 0, 0, 1)) | F.pad(jumps, (1, 0, 0, 0) if axis else (0, 0, 1, 0))
    return F.max_pool2d(edge.float()[None, None], 2 * pixels + 1, 1, pixels)[0, 0] == 0


class Draws(NamedTuple):
    """What a user's light may return."""

    distance: torch.Tensor
    wi: torch.Tensor


def test_samples_are_taken_for_lights():
    mesh = ball(subdivisions=2)
    g = seen(mesh, size=(6, 8))
    three, sun = Point([0.0, 3.0, 0.0], [3.0, 0.0, 0.0], [0.0, 0.0, 3.0]), Sun(0.2, 0.4, 1.0)
    expected = tb.visibility(g, [three, sun], mesh)
    assert torch.equal(tb.visibility(g, three.sample(g.position), mesh), expected[:3])
    assert torch.equal(tb.visibility(g, [three.sample(g.position), sun], mesh), expected)
    assert torch.equal(tb.visibility(g, (three, sun.sample(g.position)), mesh), expected)
    drawn = Draws(wi=tb.normalize(torch.randn(3, 6, 8, 3)), distance=torch.full((3, 6, 8, 1), torch.inf))
    above = (drawn.wi * g.geometric_normal).sum(-1, keepdim=True) > 1e-6
    assert torch.equal(tb.visibility(g, drawn, mesh) > 0, above & g.mask)  # a convex mesh hides nothing else
    rows = Draws(wi=drawn.wi.unflatten(0, (1, 3)), distance=drawn.distance.unflatten(0, (1, 3)))
    assert torch.equal(tb.visibility(g, rows, mesh)[0], tb.visibility(g, drawn, mesh))  # three draws of one light
    none = Draws(wi=torch.tensor([0.0, math.nan]).reshape(2, 1, 1, 1).expand(2, 6, 8, 3), distance=torch.ones(2, 6, 8, 1))
    assert not tb.visibility(g, none, mesh).any()


def test_what_is_wrong_with_a_sample_is_named():
    mesh = ball(subdivisions=1)
    g = seen(mesh, size=(6, 8))
    wi, far = torch.rand(2, 6, 8, 3), torch.ones(2, 6, 8, 1)
    with pytest.raises(
        ValueError, match=r"a sample has wi \[L, \.\.\., 3\] and distance \[L, \.\.\., 1\], found wi \[3\] and distance \[1\]"
    ):
        tb.visibility(g, Draws(wi=wi[0, 0, 0], distance=far[0, 0, 0]), mesh)
    with pytest.raises(ValueError, match=r"a sample has wi .* found wi \[2, 6, 8, 3\] and distance \[6, 8, 1\]"):
        tb.visibility(g, Draws(wi=wi, distance=far[0]), mesh)
    with pytest.raises(ValueError, match=r"wi: expected shape \[\.\.\., 3\], found \[2, 6, 8, 1\]"):
        tb.visibility(g, Draws(wi=far, distance=wi), mesh)
    with pytest.raises(ValueError, match=r"visibility: batch shapes do not broadcast"):
        tb.visibility(g, Draws(wi=wi[:, :5], distance=far[:, :5]), mesh)
    with pytest.raises(TypeError, match=r"lights\[1\]: expected a Value such as tb.PointLight"):
        tb.visibility(g, [Sun(0.0, 0.0, 1.0), (wi, far)], mesh)
