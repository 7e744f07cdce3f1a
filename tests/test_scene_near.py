"""Shadows of G-buffers whose points are not quite on the mesh: averages over pixels, half floats, passes of other renderers."""

import functools
import math

import numpy as np
import pytest
import torch
import torch.nn.functional as F
import trimesh
from test_scene_gbuffer import spot
from test_scene_visibility import Point, Sun, ball, plate, seen

import torchbrdf as tb
from torchbrdf.scene import start as module
from torchbrdf.scene.raycast import caster_of


@functools.cache
def spot_and_shadows(shared_data):
    mesh, view, scene = spot(shared_data / "spot")
    g, lights = tb.GBuffer.from_mesh(mesh, view), Point(*scene["lights"])
    return mesh, view, g, lights, tb.visibility(g, lights, mesh)


def pooled(t):
    """Averages over 2 x 2 pixels."""
    return F.avg_pool2d(t.movedim(-1, 0)[None], 2)[0].movedim(0, -1)


def averaged(mesh, view):
    """What a renderer writes that averages over each pixel, and where the pixel is one surface."""
    fine = tb.GBuffer.from_mesh(
        mesh, view.replace(focal=2 * view.focal, principal=2 * view.principal, size=tuple(2 * s for s in view.size))
    )
    whole = pooled(fine.mask.float()) == 1
    normal, across, towards = (tb.normalize(pooled(t)) for t in (fine.normal, fine.geometric_normal, fine.view))
    return tb.GBuffer(pooled(fine.position), normal, towards, across, mask=whole)


def stored(kind, g, mesh, view):
    """G-buffers that have lost digits on their way."""
    half = g.to(torch.float16)
    if kind == "half floats":
        return half
    if kind == "half floats, as float32":
        return half.to(torch.float32)
    if kind == "half positions alone":
        return tb.GBuffer(half.position.float(), g.normal, g.view, mask=g.mask)
    if kind == "half positions without a view":
        return tb.GBuffer(half.position.float(), g.normal, mask=g.mask)
    return averaged(mesh, view) if kind == "averages" else averaged(mesh, view).replace(geometric_normal=None, view=None)


KINDS = (
    "half floats",
    "half floats, as float32",
    "half positions alone",
    "half positions without a view",
    "averages",
    "averages without a view",
)


def away_from_shadow_edges(visible, pixels=2):
    """Where the (2 pixels + 1)² pixels around are all lit, or all dark: ``[L, H, W]``."""
    v = visible.squeeze(-1).unsqueeze(1)
    size = 2 * pixels + 1
    return (F.max_pool2d(v, size, 1, pixels) == -F.max_pool2d(-v, size, 1, pixels)).squeeze(1)


@pytest.mark.parametrize("kind", KINDS)
def test_stored_points_cast_the_shadows_of_exact_ones(shared_data, kind):
    """Before, 27 % (averages) to 50 % (half floats) of the lit pixels were black."""
    mesh, view, g, lights, exact = spot_and_shadows(shared_data)
    lossy = stored(kind, g, mesh, view)
    found = tb.visibility(lossy, lights, mesh)
    assert found.dtype == lossy.position.dtype
    counted = away_from_shadow_edges(exact) & (g.mask & lossy.mask)[..., 0]
    right = (found == exact)[..., 0]
    for light in range(4):
        lit = counted[light] & (exact[light, ..., 0] > 0)
        dark = counted[light] & ~lit
        assert lit.sum() > 9000
        assert dark.sum() > 200
        assert right[light][lit].float().mean() >= 0.998  # measured 0.9989 (averages) and 0.9999
        assert right[light][dark].all()


def test_a_list_of_stored_points_is_as_good_as_a_picture(shared_data):
    mesh, view, exact, lights, _ = spot_and_shadows(shared_data)
    g = stored("half floats, as float32", exact, mesh, view)
    assert torch.equal(tb.visibility(g, lights[:2], mesh)[:, g.mask[..., 0]], tb.visibility(g[g.mask[..., 0]], lights[:2], mesh))


@pytest.mark.parametrize(("file", "most"), [("mitsuba/diffuse", 8), ("blender/bl50_lambert", 0)])
@pytest.mark.parametrize("seen_from", [True, False])
def test_the_passes_of_renderers_have_no_acne(shared_data, file, most, seen_from):
    """Spheres by other renderers, lit by a sun, with a mesh of the sphere (before: 565 and 3208 black pixels of some 3500)."""
    view = tb.Camera.look_at(
        [0.0, -4.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0], 2 * math.degrees(math.atan(math.tan(math.radians(20)) * 2 / 3)), (64, 96)
    )
    g = tb.GBuffer.load(shared_data / f"{file}.exr", view if seen_from else None)
    sun = Sun(0.5, -1.0, 0.3)
    facing = g.mask & ((g.normal * sun.sample(g.position).wi[0]).sum(-1, keepdim=True) > 0.05)
    assert facing.sum() > 3400
    assert (tb.visibility(g, sun, ball(subdivisions=5))[0][facing] == 0).sum() <= most


def test_exact_points_start_where_they_are():
    """Nothing of what finds lost points touches those of from_mesh, whatever their mesh, dtype and place."""
    for dtype in (torch.float32, torch.float64):
        for scale, shift in ((1e-3, (0.007, 0.0, 0.0)), (1e3, (0.0, 0.0, 0.0)), (1.0, (300.0, -200.0, 100.0))):
            mesh = ball(scale, shift, dtype)
            g = seen(mesh, scale, shift)
            start = module.starts(g, mesh, caster_of(mesh))
            assert start.point is g.position
    bare = tb.GBuffer(g.position, g.normal, g.view, mask=g.mask)  # found again, it is the same point up to rounding
    again = module.starts(bare, mesh, caster_of(mesh))
    assert (again.point - g.position)[g.mask[..., 0]].abs().max() < 1e-10
    faces = module.starts(g, mesh, caster_of(mesh)).normal
    torch.testing.assert_close(again.normal[g.mask[..., 0]], faces[g.mask[..., 0]], atol=1e-6, rtol=0)


def test_a_surface_that_the_mesh_does_not_hold_stays_where_it_is():
    """A floor given by hand, and a box that hovers over it, a little: no floor point jumps onto the box."""
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    for gap in (0.001, 0.02):
        mesh = tb.Mesh(torch.tensor(box.vertices + np.array([0.0, 0.0, 0.5 + gap]), dtype=torch.float32), torch.tensor(box.faces))
        x, y = torch.meshgrid(torch.linspace(-1.5, 1.5, 31) + 0.01, torch.linspace(-1.5, 1.5, 31) + 0.01, indexing="xy")
        floor = torch.stack([x, y, torch.zeros_like(x)], -1)
        up = torch.tensor([0.0, 0.0, 1.0]).expand(31, 31, 3)
        under = (x.abs() < 0.5) & (y.abs() < 0.5)
        assert torch.equal(tb.visibility(tb.GBuffer(floor, up), Sun(0.0, 0.0, 1.0), mesh)[0, ..., 0] == 0, under)
        towards = torch.tensor([0.0, -3.0, 0.1]) - floor
        unhidden = ~tb.GBuffer.from_rays(mesh, floor, towards).mask
        assert (unhidden[..., 0] & under).any()  # seen through the gap
        visible = tb.visibility(tb.GBuffer(floor, up, tb.normalize(towards), mask=unhidden), Sun(0.0, 0.0, 1.0), mesh)
        assert torch.equal((visible[0] == 0)[unhidden], under.unsqueeze(-1)[unhidden])
        # The triangles and weights of another mesh put no point elsewhere.
        g = tb.GBuffer(floor, up, triangle=torch.full((31, 31, 1), 3), barycentric=torch.full((31, 31, 3), 1 / 3), geometric_normal=up)
        assert torch.equal(tb.visibility(g, Sun(0.0, 0.0, 1.0), mesh)[0, ..., 0] == 0, under)
        beyond = tb.visibility(g.replace(triangle=torch.full((31, 31, 1), 1 << 20)), Sun(0.0, 0.0, 1.0), mesh)
        assert torch.equal(beyond[0, ..., 0] == 0, under)


def test_of_two_sheets_the_nearer_is_found():
    """Points a little off the upper or the lower of two sheets, seen from above: those of the lower one are dark."""
    (big, low), (small, high) = plate(0.0, 2.0), plate(0.02, 2.0)
    mesh = tb.Mesh(torch.cat([big, small]), torch.cat([low, high + 4]))
    up = torch.tensor([0.0, 0.0, 1.0]).expand(6, 3)
    heights = torch.tensor([-0.003, 0.0, 0.003, 0.009, 0.014, 0.026])
    points = torch.stack([0.1 * heights + 0.3, 0.2 + 0.0 * heights, heights], -1)
    for view in (None, tb.normalize(torch.tensor([0.3, 0.0, 1.0])).expand(6, 3)):
        visible = tb.visibility(tb.GBuffer(points, up, view), Sun(0.2, 0.1, 1.0), mesh)
        assert visible.flatten().tolist() == [0.0, 0.0, 0.0, 0.0, 1.0, 1.0]


@pytest.mark.parametrize("slope", [1.0, 0.06])
def test_a_sheet_is_found_from_behind_and_at_grazing_views(slope):
    """Wound away from the viewer, with normals turned to the viewer, as Blender does: the line of sight alone finds it."""
    v, faces = plate(0.0, 2.0)
    mesh = tb.Mesh(v, faces.flip(-1))
    heights = torch.tensor([-0.004, -1e-4, 0.0, 1e-4, 0.004])
    points = torch.stack([0.1 + 0.0 * heights, 0.2 + 0.0 * heights, heights], -1)
    tilted = tb.normalize(torch.tensor([0.3, 0.2, 1.0])).expand(5, 3)
    g = tb.GBuffer(points, tilted, tb.normalize(torch.tensor([1.0, 0.0, slope])).expand(5, 3))
    start = module.starts(g, mesh, caster_of(mesh))
    assert start.point[:, 2].abs().max() < 1e-12
    assert (start.normal == torch.tensor([0.0, 0.0, 1.0])).all()
    assert tb.visibility(g, Sun(0.2, 0.1, 1.0), mesh).all()


def test_what_stands_close_over_a_surface_does_not_draw_its_points():
    """A sun low in the sky shines under the edge of a box whose floor is not in the mesh."""
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    mesh = tb.Mesh(torch.tensor(box.vertices + np.array([0.0, 0.0, 0.508]), dtype=torch.float32), torch.tensor(box.faces))
    points = torch.tensor([[-0.49, 0.1, 0.0], [-0.3, 0.1, 0.0]])
    g = tb.GBuffer(points, torch.tensor([0.0, 0.0, 1.0]))
    assert tb.visibility(g, Sun(-1.0, 0.0, 0.2), mesh).flatten().tolist() == [1.0, 0.0]


def test_points_out_of_reach_stay():
    """Over a plate with a wall on it: a point that hovers sees past the wall, one on the plate does not."""
    (floor, low), (wall, _) = plate(0.0, 2.0), plate(0.0, 2.0)
    wall = torch.stack([0.0 * wall[:, 0], wall[:, 0], torch.tensor([0.0, 0.0, 0.03, 0.03])], -1)
    mesh = tb.Mesh(torch.cat([floor, wall]), torch.cat([low, low + 4]))
    points = torch.tensor([[-0.02, 0.1, 0.05], [-0.02, 0.1, 0.002]])
    up = torch.tensor([0.0, 0.0, 1.0])
    for view in (None, up):
        assert tb.visibility(tb.GBuffer(points, up, view), Sun(1.0, 0.0, 0.5), mesh).flatten().tolist() == [1.0, 0.0]


def test_rounded_weights_stay_on_their_triangle():
    """Weights of half precision do not sum to 1; the point is on the plane of its triangle all the same."""
    v, faces = plate(1.0, 2.0)
    mesh, up = tb.Mesh(v, faces), torch.tensor([0.0, 0.0, 1.0])
    weights = torch.tensor([[0.25, 0.374, 0.375]])
    point = (weights.unsqueeze(-1) * v[faces[0]]).sum(1)
    start = module.starts(tb.GBuffer(point, up, up, triangle=torch.tensor([[0]]), barycentric=weights), mesh, caster_of(mesh))
    torch.testing.assert_close(start.point, point.double() / weights.sum().double(), rtol=1e-6, atol=0)
    assert (start.point[:, 2] - 1.0).abs() < 1e-12


def test_a_line_of_sight_that_meets_the_surface_far_off_is_not_followed():
    """It lies 0.004 over the plate, and 0.8 before it along the line of sight: the point below it counts."""
    mesh, up = tb.Mesh(*plate(0.0, 2.0)), torch.tensor([0.0, 0.0, 1.0])
    g = tb.GBuffer(torch.tensor([[-0.5, 0.1, 0.004]]), up, tb.normalize(torch.tensor([1.0, 0.0, 0.005])))
    start = module.starts(g, mesh, caster_of(mesh))
    torch.testing.assert_close(start.point, torch.tensor([[-0.5, 0.1, 0.0]], dtype=torch.float64))


def test_a_half_float_is_looked_for_on_its_triangle():
    """Its own rounding, 2e-4 here, would let rays start as far off the surface."""
    mesh, up = tb.Mesh(*plate(1 / 3, 2.0)), torch.tensor([0.0, 0.0, 1.0])
    g = tb.GBuffer(torch.tensor([[-0.5, 0.1, 1 / 3]]), up, up, triangle=torch.tensor([[0]])).to(torch.float16)
    start = module.starts(g, mesh, caster_of(mesh))
    assert (start.point[:, 2] - mesh.vertices[0, 2]).abs() < 1e-12
    assert start.offset < 1e-5
