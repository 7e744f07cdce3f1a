"""G-buffers from rays: those of a camera, of mirrors and refraction, of any instrument; and the ray caster behind them."""

import math

import pytest
import torch
import trimesh
from test_scene_gbuffer import FIELDS, ball, camera, check_against_recast

import torchbrdf as tb
from torchbrdf.scene.raycast import caster_of

FLOATS = (*FIELDS, "handedness")
REAL = torch.float64
FARTHEST = "the largest number of the dtype"


def sphere(subdivisions=3, dtype=REAL, scale=1.0):
    s = trimesh.creation.icosphere(subdivisions=subdivisions)
    return tb.Mesh(torch.tensor(scale * s.vertices, dtype=dtype), torch.tensor(s.faces))


def room(dtype=torch.float32):
    """A closed box, wound to be seen from inside."""
    box = trimesh.creation.box((2.0, 3.0, 4.0))
    return tb.Mesh(torch.tensor(box.vertices, dtype=dtype), torch.tensor(box.faces).flip(-1))


def quad(half):
    v = torch.tensor([[-half, -half, 0.0], [half, -half, 0.0], [half, half, 0.0], [-half, half, 0.0]], dtype=REAL)
    return tb.Mesh(v, torch.tensor([[0, 1, 2], [0, 2, 3]]))


def bundle(count=40, dtype=REAL):
    """Rays at the ball from around it, each well inside its triangle."""
    gen = torch.Generator().manual_seed(0)
    origin = 4.0 * tb.normalize(torch.randn(400, 3, generator=gen, dtype=REAL))
    direction = 0.4 * torch.randn(400, 3, generator=gen, dtype=REAL) - origin
    inside = (tb.GBuffer.from_rays(ball(), origin, direction).barycentric.amin(-1) > 0.05).nonzero()[:count, 0]
    assert len(inside) == count
    return origin[inside].to(dtype), direction[inside].to(dtype)


def test_the_rays_of_a_camera_see_what_the_camera_sees():
    mesh = ball(subdivisions=3).replace(material=torch.arange(1280).unsqueeze(-1))
    seen, cast = tb.GBuffer.from_mesh(mesh, camera((32, 40))), tb.GBuffer.from_rays(mesh, *camera((32, 40)).rays())
    for name, t, spec in seen.own_tensors():
        again = getattr(cast, name)
        assert tb.is_planar(again), name
        assert again.dtype == t.dtype
        torch.testing.assert_close(again, t, rtol=1e-13 if spec.kind == "float" else 0, atol=1e-13 if spec.kind == "float" else 0)


@pytest.mark.parametrize("dtype", [torch.float32, REAL])
def test_shapes_broadcast_and_the_dtype_is_that_of_the_vertices(dtype):
    mesh, (origin, direction) = ball(dtype), bundle()
    whole = tb.GBuffer.from_rays(mesh, origin, direction)
    assert whole.mask.all()
    for o, d in ((origin.float(), 7.0 * direction), (origin, 1e-30 * direction), (origin, 1e200 * direction)):
        again = tb.GBuffer.from_rays(mesh, o, d)
        assert torch.equal(again.triangle, whole.triangle)
        assert all(t.dtype == dtype for _, t, s in again.own_tensors() if s.kind == "float")
        torch.testing.assert_close(again.position, whole.position, rtol=1e-6, atol=1e-6)
    assert tb.GBuffer.from_rays(mesh, origin[0], direction[0]).position.shape == (3,)
    assert tb.GBuffer.from_rays(mesh, origin[0], direction[0]).triangle.tolist() == whole.triangle[0].tolist()
    fan = tb.GBuffer.from_rays(mesh, origin[:5, None], direction[None, :7])
    assert fan.view.shape == fan.position.shape == (5, 7, 3)
    assert fan.mask.shape == (5, 7, 1)
    torch.testing.assert_close(fan.position[3, 3], whole.position[3])
    assert tb.GBuffer.from_rays(mesh, origin, direction[0]).view.shape == (40, 3)
    assert tb.GBuffer.from_rays(mesh, origin[:0], direction[:0]).position.shape == (0, 3)


def test_derivatives_to_vertices_origin_and_direction():
    mesh, (origin, direction) = ball(), bundle(6)

    def fields(v, o, d):
        g = tb.GBuffer.from_rays(mesh.replace(vertices=v), o, d)
        return tuple(getattr(g, name) for name in FIELDS)

    leaves = tuple(t.clone().requires_grad_() for t in (mesh.vertices, origin, direction))
    assert all(x.requires_grad for x in fields(*leaves)), "gradcheck passes over what is cut off"
    assert torch.autograd.gradcheck(fields, leaves, fast_mode=True)
    assert torch.autograd.gradcheck(lambda o, d: fields(mesh.vertices, o, d), leaves[1:])
    assert torch.autograd.gradgradcheck(lambda o, d: fields(mesh.vertices, o, d)[0], leaves[1:])
    assert "view" in check_against_recast(lambda d: tb.GBuffer.from_rays(mesh, bundle()[0], d), bundle()[1])


@pytest.mark.parametrize("dtype", [torch.float32, REAL])
@pytest.mark.parametrize(
    ("origins", "directions"), [((0.0, 0.0), (0.0, math.nan)), ((math.nan, math.inf), (1.0, 1.0)), ((0.0, FARTHEST), (-math.inf, 1.0))]
)
def test_a_ray_that_is_none_meets_nothing_and_has_no_slope(origins, directions, dtype):
    """The first two of eight rays: of no direction, or from no point (or from so far that float64 cannot square it)."""
    mesh, (origin, direction) = ball(dtype), bundle(8, dtype)
    vertices = (5.0 * mesh.vertices).requires_grad_()
    origin = 5.0 * origin
    for k, (at, along) in enumerate(zip(origins, directions, strict=True)):
        origin[k, 1] = torch.finfo(dtype).max if at == FARTHEST else at
        direction[k] = along
    o, d = origin.requires_grad_(), direction.requires_grad_()
    g = tb.GBuffer.from_rays(mesh.replace(vertices=vertices), o, d)
    assert g.mask[:, 0].tolist() == [False] * 2 + [True] * 6
    total = sum(getattr(g, name).sum() for name in FLOATS)
    slopes = torch.autograd.grad(total, (o, d, vertices))
    assert torch.isfinite(total)
    assert all(torch.isfinite(s).all() for s in slopes)
    assert not slopes[0][:2].any()
    assert slopes[0][2:].any()
    for name, t, _ in g.own_tensors():
        assert name in ("triangle", "view") or not t[:2].any(), name


def test_a_convex_mirror_sees_nothing_of_itself_and_glass_sees_its_far_side():
    """Without leaving the surface rays meet it again; that is why a G-buffer may be the origin."""
    for dtype in (torch.float32, REAL):
        for at in (0.0, 37.0):
            mesh = sphere(4, dtype)
            mesh = mesh.replace(vertices=mesh.vertices + at)
            g = tb.GBuffer.from_mesh(mesh, tb.Camera.look_at([at, at + 0.5, at + 3.0], [at] * 3, [0.0, 1.0, 0.0], 40.0, (64, 64)))
            outward = tb.reflect(g.view, g.geometric_normal)
            assert tb.GBuffer.from_rays(mesh, g.position, outward).mask.any()
            assert not tb.GBuffer.from_rays(mesh, g, outward).mask.any()
            through, _ = tb.refract(g.view, g.geometric_normal, 1.5)
            far = tb.GBuffer.from_rays(mesh, g, through)
            assert torch.equal(far.mask, g.mask)
            chord = -2.0 * (through * (g.position - at)).sum(-1, keepdim=True)
            assert (far.depth - chord)[g.mask].abs().max() < 0.02  # of a sphere of flat facets
            torch.testing.assert_close(far.view, torch.where(g.mask, -tb.normalize(through), 0.0))


def test_nothing_leaves_a_closed_room():
    mesh = room()
    g = tb.GBuffer.from_mesh(mesh, tb.Camera.look_at([0.1, 0.2, 0.3], [1.0, 0.5, -0.2], [0.0, 1.0, 0.0], 90.0, (48, 48)))
    for _ in range(8):
        assert g.mask.all()
        g = tb.GBuffer.from_rays(mesh, g, tb.reflect(g.view, g.geometric_normal))
        on_a_wall = (g.position.abs() / torch.tensor([1.0, 1.5, 2.0])).amax(-1)
        torch.testing.assert_close(on_a_wall, torch.ones_like(on_a_wall))


def test_a_plane_mirror_shows_the_mirror_image_with_its_derivatives():
    """A ball before a mirror in the plane z = h: its image stands at 2h - z and moves twice as fast as the mirror."""
    floor, block = quad(6.0), ball(uv=False)
    block = block.replace(vertices=block.vertices + torch.tensor([0.0, 0.0, 2.5], dtype=REAL))
    view = tb.Camera.look_at([0.4, -5.0, 2.0], [0.0, 0.0, -2.0], [0.0, 0.0, 1.0], 30.0, (24, 24))

    def image(h):
        lifted = floor.replace(vertices=floor.vertices + torch.tensor([0.0, 0.0, 1.0], dtype=REAL) * h)
        whole = tb.Mesh(torch.cat([lifted.vertices, block.vertices]), torch.cat([lifted.faces, block.faces + 4]))
        g = tb.GBuffer.from_mesh(lifted, view)
        return g, tb.GBuffer.from_rays(whole, g, tb.reflect(g.view, g.geometric_normal))

    h = torch.zeros((), dtype=REAL, requires_grad=True)
    g, mirrored = image(h)
    step = 1e-6
    ends = [image(h.detach() + s) for s in (step, -step)]
    flipped = block.replace(vertices=block.vertices * torch.tensor([1.0, 1.0, -1.0], dtype=REAL), faces=block.faces.flip(-1))
    direct = tb.GBuffer.from_mesh(flipped, view)
    both = (direct.mask & mirrored.mask)[..., 0]
    assert both.sum() > 100
    assert torch.equal(mirrored.mask, direct.mask)
    assert torch.equal(mirrored.triangle[both], direct.triangle[both] + 2)
    torch.testing.assert_close((direct.position * torch.tensor([1.0, 1.0, -1.0]))[both], mirrored.position[both].detach())
    torch.testing.assert_close(direct.depth[both], (g.depth + mirrored.depth)[both].detach())
    same = both & torch.stack([end.triangle == mirrored.triangle for _, end in ends]).all(0)[..., 0]
    assert same.sum() > 100
    slope = torch.autograd.grad((g.depth + mirrored.depth)[same].sum(), h)[0]
    above, below = ((first.depth + second.depth)[same].sum() for first, second in ends)
    assert float(slope) == pytest.approx(float(above - below) / (2 * step), rel=1e-6)


def test_pixels_that_are_none_send_no_ray_and_stored_points_are_mended():
    mesh = sphere(4, torch.float32)
    g = tb.GBuffer.from_mesh(mesh, tb.Camera.look_at([0.0, 0.5, 3.0], [0.0] * 3, [0.0, 1.0, 0.0], 40.0, (64, 64)))
    inward = -g.normal
    half = g.replace(mask=g.mask & (torch.arange(64) < 32).unsqueeze(-1))
    assert torch.equal(tb.GBuffer.from_rays(mesh, half, inward).mask, half.mask)
    broken = g.replace(position=torch.where(half.mask, g.position, math.nan).requires_grad_())
    cast = tb.GBuffer.from_rays(mesh, broken, inward)
    assert torch.equal(cast.mask, half.mask)
    (slope,) = torch.autograd.grad(cast.position.sum(), broken.position)
    assert torch.isfinite(slope).all()
    for stored in (g.to(torch.float16), g.to(torch.float16).to(torch.float32), tb.GBuffer(g.position.half().float(), g.normal, g.view)):
        out = tb.reflect(stored.view, stored.normal).float()
        above = (out * g.geometric_normal).sum(-1, keepdim=True) > 0.01  # a shading normal may send a grazing ray inside
        assert tb.GBuffer.from_rays(mesh, stored.position, out).mask[above].any()
        assert not tb.GBuffer.from_rays(mesh, stored, out).mask[above].any()
        assert tb.GBuffer.from_rays(mesh, stored, -g.normal).mask[g.mask].all()
    fan = tb.GBuffer.from_rays(mesh, g, torch.randn(5, 1, 1, 3))
    assert fan.position.shape == (5, 64, 64, 3)
    middle = g[32, 32]
    one = tb.GBuffer(middle.position, middle.normal, triangle=middle.triangle, mask=torch.tensor([[True], [False]]))
    assert tb.GBuffer.from_rays(mesh, one, -middle.normal).mask.tolist() == [[True], [False]]


def test_what_is_wrong_with_rays_is_named():
    mesh, (o, d) = ball(), bundle(4)
    with pytest.raises(ValueError, match=r"from_rays: batch shapes do not broadcast.*origin.*\[3\].*direction.*\[4\]"):
        tb.GBuffer.from_rays(mesh, o[:3], d)
    with pytest.raises(ValueError, match=r"direction: expected shape \[\.\.\., 3\], found \[4, 2\]"):
        tb.GBuffer.from_rays(mesh, o, d[:, :2])
    with pytest.raises(TypeError, match=r"origin: expected a tensor of floats, found list"):
        tb.GBuffer.from_rays(mesh, [0.0, 0.0, 3.0], d)
    with pytest.raises(TypeError, match=r"origin: expected a tensor of floats, found torch.int64"):
        tb.GBuffer.from_rays(mesh, o.long(), d)
    with pytest.raises(TypeError, match=r"direction: on the meta device"):
        tb.GBuffer.from_rays(mesh, o, d.to("meta"))
    with pytest.raises(TypeError, match=r"mesh: expected a Mesh .*found Camera"):
        tb.GBuffer.from_rays(camera(), o, d)


def test_the_caster_notices_every_change_of_the_numbers():
    """Also those through .data and numpy, that torch does not count."""
    mesh = sphere(1)
    ray = torch.tensor([0.3, 0.2, 5.0], dtype=REAL), torch.tensor([0.0, 0.0, -1.0], dtype=REAL)
    depths = []

    def changed():
        depths.append(float(tb.GBuffer.from_rays(mesh, *ray).depth))
        assert depths[-1] == float(tb.GBuffer.from_rays(tb.Mesh(mesh.vertices.clone(), mesh.faces.clone()), *ray).depth)
        return len(set(depths)) == len(depths)

    first = caster_of(mesh)
    assert caster_of(mesh) is first
    assert changed()
    mesh.vertices.data.mul_(2.0)
    assert changed()
    mesh.vertices.data.add_(torch.tensor([0.0, 0.0, 0.5], dtype=REAL))
    assert changed()
    mesh.vertices.numpy()[:, 2] += 0.25
    assert changed()
    mesh.faces.data[tb.GBuffer.from_rays(mesh, *ray).triangle] = 0
    assert changed()  # through the hole, to the far side
    kept = caster_of(mesh)
    with torch.inference_mode():
        assert caster_of(mesh) is kept
    mesh.vertices.data = mesh.vertices.data.float()
    assert caster_of(mesh) is not kept
    mesh, depths = quad(0.25), []
    assert changed()
    mesh.vertices.data.mul_(2.0)  # the sum of all numbers stays
    assert changed()
