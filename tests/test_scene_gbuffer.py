"""G-buffers: against an independent renderer, against re-cast differences, and at the hard cases."""

import math

import numpy as np
import pytest
import torch
import trimesh
from renders import spot

import torchbrdf as tb
from torchbrdf import vector
from torchbrdf.interval import UNIT
from torchbrdf.scene import intersect
from torchbrdf.value import COLOUR, param, value

FIELDS = ("position", "depth", "normal", "geometric_normal", "uv", "barycentric", "view", "tangent")


def ball(dtype=torch.float64, subdivisions=1, uv=True):
    s = trimesh.creation.icosphere(subdivisions=subdivisions)
    v = torch.tensor(s.vertices * [1.0, 1.3, 0.8], dtype=dtype)
    return tb.Mesh(v, torch.tensor(s.faces), uv=torch.stack([0.3 * v[:, 0] + v[:, 2], v[:, 1] - 0.2 * v[:, 0]], -1) if uv else None)


def camera(size=(9, 11), **changes):
    return tb.Camera.look_at([0.7, 0.9, 3.0], [0.0, 0.1, 0.0], [0.0, 1.0, 0.0], 45.0, size).replace(**changes)


def test_spot_as_mitsuba_sees_it(spot_aovs):
    import OpenEXR

    mesh, view, _ = spot(spot_aovs)
    g = tb.GBuffer.from_mesh(mesh, view)
    channels = OpenEXR.File(str(spot_aovs / "aov.exr"), separate_channels=True).channels()

    def aov(name, parts):
        return torch.from_numpy(np.stack([channels[f"{name}.{p}"].pixels for p in parts], -1).astype(np.float64))

    triangle = aov("id", "I").long()
    theirs, ours = triangle >= 0, g.mask
    assert (theirs & ours).sum() >= 0.999 * (theirs | ours).sum()
    both = (theirs & ours)[..., 0]
    same = both & (triangle == g.triangle)[..., 0]
    assert same.sum() >= 0.995 * both.sum()
    diagonal = (mesh.vertices.amax(0) - mesh.vertices.amin(0)).norm()
    off = (aov("pos", "XYZ") - g.position)[same].norm(dim=-1)
    assert off.median() <= 1e-6 * diagonal
    for name, n in (("nn", g.normal), ("gn", g.geometric_normal)):
        chord = (aov(name, "XYZ") - n)[same].norm(dim=-1)
        assert torch.rad2deg(2.0 * torch.asin(0.5 * chord)).median() <= 1e-3
    flipped = aov("uv", "UV") * torch.tensor([1.0, -1.0]) + torch.tensor([0.0, 1.0])  # Mitsuba turns v over
    assert (flipped - g.uv)[same].abs().max() < 1e-5  # measured 2e-6; a wrong seam would be of the order of 1


def directional(field, at, along):
    """J(at) along, pixel by pixel, by the double-backward trick (which also shows that second derivatives exist)."""
    w = torch.ones_like(field, requires_grad=True)
    (pulled,) = torch.autograd.grad((w * field).sum(), at, create_graph=True)
    return torch.autograd.grad((pulled * along).sum(), w)[0]


def check_against_recast(build, start, names=FIELDS, step=1e-5):
    at = start.clone().requires_grad_()
    along = torch.randn_like(start)
    g, above, below = build(at), build(start + step * along), build(start - step * along)
    stable = g.mask & (g.triangle == above.triangle) & (g.triangle == below.triangle)
    assert stable.sum() > 20
    checked = [n for n in names if getattr(g, n).requires_grad]
    for name in checked:
        expected = (getattr(above, name) - getattr(below, name)) / (2.0 * step)
        error = torch.where(stable, directional(getattr(g, name), at, along) - expected, 0.0).abs().max()
        # Truncation step^2 times the third derivative, large where a ray grazes its triangle; measured below 1e-7 of the size.
        assert error < 1e-6 * (1.0 + expected[stable.squeeze(-1)].abs().max()), (name, error)
    return checked


def test_derivatives_to_vertices_against_recast_differences():
    mesh = ball()
    checked = check_against_recast(lambda v: tb.GBuffer.from_mesh(mesh.replace(vertices=v), camera()), mesh.vertices)
    assert checked == [n for n in FIELDS if n != "view"]


@pytest.mark.parametrize("name", ["origin", "rotation", "focal", "principal"])
def test_derivatives_to_the_camera_against_recast_differences(name):
    mesh = ball()
    checked = check_against_recast(lambda x: tb.GBuffer.from_mesh(mesh, camera(**{name: x})), getattr(camera(), name))
    follow = {"position", "depth", "normal", "uv", "barycentric"}
    assert (follow if name == "origin" else follow | {"view"}) <= set(checked), "a ray keeps its direction where the camera moves"


def test_derivatives_to_given_normals_and_uv():
    mesh = ball().replace(normals=ball().vertices.clone())
    assert check_against_recast(lambda n: tb.GBuffer.from_mesh(mesh.replace(normals=n), camera()), mesh.normals) == ["normal"]
    assert check_against_recast(lambda t: tb.GBuffer.from_mesh(mesh.replace(uv=t), camera()), mesh.uv) == ["uv", "tangent"]


def test_what_it_holds_fits_together():
    mesh = ball(subdivisions=3).replace(material=7 + torch.arange(1280).unsqueeze(-1))  # face 0 is not of material 0, the background's
    g = tb.GBuffer.from_mesh(mesh, camera((32, 40)))
    m = g.mask.squeeze(-1)
    origin, direction = camera((32, 40)).rays()
    corners = mesh.vertices[mesh.faces[g.triangle.squeeze(-1)]]
    assert torch.allclose(torch.einsum("hwc,hwcx->hwx", g.barycentric, corners)[m], g.position[m], atol=1e-12)  # float64
    assert torch.allclose((origin + g.depth * direction)[m], g.position[m])
    assert torch.equal(g.view, -direction)
    assert g.barycentric[m].min() > -1e-6  # embree decides in float32 which side of an edge a ray passes
    assert ((g.geometric_normal * g.view).sum(-1)[m] > 0).all()
    assert torch.equal(g.material, torch.where(g.mask, 7 + g.triangle, 0))
    assert torch.equal(g.triangle == -1, ~g.mask)
    # tangent: u grows along it, and v does not
    gradient = torch.linalg.lstsq(
        corners[m][:, 1:] - corners[m][:, :1], (mesh.uv[mesh.faces] - mesh.uv[mesh.faces][:, :1])[g.triangle[m][:, 0], 1:]
    )[0]
    turn = torch.einsum("px,pxk->pk", g.tangent[m], gradient)
    assert turn[:, 0].min() > 0
    assert turn[:, 1].abs().max() < 1e-10
    for name, t, spec in g.own_tensors():
        assert tb.is_planar(t), name
        assert torch.isfinite(t).all() if spec.kind == "float" else True
        assert (t[~m] == 0).all() or name in ("view", "triangle"), name


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_cameras_batch_and_dtype_follows_the_vertices(dtype):
    mesh = ball(dtype, uv=False)
    eyes = torch.tensor([[0.7, 0.9, 3.0], [-2.0, 0.5, 2.5]])
    g = tb.GBuffer.from_mesh(mesh, tb.Camera.look_at(eyes, [0.0, 0.1, 0.0], [0.0, 1.0, 0.0], 45.0, (9, 11)))
    assert g.position.shape == (2, 9, 11, 3)
    assert g.uv is None
    assert g.tangent is None
    assert all(t.dtype == dtype for _, t, s in g.own_tensors() if s.kind == "float")
    single = tb.GBuffer.from_mesh(mesh, camera())
    assert torch.equal(g.triangle[0], single.triangle)
    assert torch.allclose(g[0].position, single.position, atol=1e-6)  # eyes are float32


def test_back_faces_keep_their_normals():
    mesh = ball()
    inside_out = mesh.replace(faces=mesh.faces.flip(-1), normals=-mesh.shading_normals())
    g, turned = tb.GBuffer.from_mesh(mesh, camera()), tb.GBuffer.from_mesh(inside_out, camera())
    assert torch.allclose(turned.normal, -g.normal)
    assert torch.allclose(turned.geometric_normal, -g.geometric_normal)


def test_degenerate_triangles_are_masked_out_without_a_gradient(monkeypatch):
    """Whatever the ray caster says: every pixel is sent to a triangle without area."""

    class Stubborn:
        def first_hit(self, origin, direction):
            return torch.full(direction.shape[:-1], 80)

    mesh = ball()
    bad = torch.tensor([[0, 0, 1]])
    v = mesh.vertices.clone().requires_grad_()
    eye = torch.tensor([0.7, 0.9, 3.0], dtype=torch.float64, requires_grad=True)
    mesh = mesh.replace(vertices=v, faces=torch.cat([mesh.faces, bad]))
    monkeypatch.setattr(intersect, "caster_of", lambda mesh: Stubborn())
    g = tb.GBuffer.from_mesh(mesh, tb.Camera.look_at(eye, [0.0, 0.1, 0.0], [0.0, 1.0, 0.0], 45.0, (4, 4)))
    assert not g.mask.any()
    total = sum(getattr(g, n).sum() for n in FIELDS if n != "view")
    grads = torch.autograd.grad(total, (v, eye))
    assert total == 0
    assert all((x == 0).all() for x in grads)


def test_degenerate_texture_coordinates_give_no_tangent():
    mesh = ball()
    t = torch.zeros_like(mesh.uv, requires_grad=True)
    g = tb.GBuffer.from_mesh(mesh.replace(uv=t), camera())
    assert (g.tangent == 0).all()
    (grad,) = torch.autograd.grad((g.tangent + g.position).sum() + g.uv.sum(), t)
    assert torch.isfinite(grad).all()


def sheet(uv, turned=False, normals=None, half=2.0):
    """A square in the plane z = 0 whose corners, from the lower left counter-clockwise, have the given uv."""
    v = torch.tensor([[-half, -half, 0.0], [half, -half, 0.0], [half, half, 0.0], [-half, half, 0.0]], dtype=torch.float64)
    faces = torch.tensor([[0, 1, 2], [0, 2, 3]])
    normals = None if normals is None else torch.tensor([normals], dtype=torch.float64).expand(4, 3)
    return tb.Mesh(v, faces.flip(-1) if turned else faces, normals, torch.tensor(uv, dtype=torch.float64))


UPRIGHT = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))
MIRRORED = tuple((1.0 - u, v) for u, v in UPRIGHT)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("normals", [None, (0.0, 0.0, 1.0), (0.1, 0.2, -1.0)])
@pytest.mark.parametrize(
    ("uv", "u_along", "v_along"), [(UPRIGHT, 1.0, 1.0), (MIRRORED, -1.0, 1.0), (tuple((u, 1.0 - v) for u, v in UPRIGHT), 1.0, -1.0)]
)
def test_the_bitangent_points_along_growing_v(uv, u_along, v_along, turned, normals):
    mesh = sheet(uv, turned, normals)
    seen = tb.GBuffer.from_mesh(mesh, camera((6, 8)))
    rays = tb.GBuffer.from_rays(mesh, *camera((6, 8)).rays())
    given = tb.GBuffer.from_triangles(mesh, seen.triangle, seen.barycentric, camera())
    for g in (seen, rays, given):
        assert g.mask.all()
        bitangent = g.handedness * torch.linalg.cross(g.normal, g.tangent)
        assert ((g.tangent * torch.tensor([u_along, 0.0, 0.0])).sum(-1) > 0.9).all()
        assert ((bitangent * torch.tensor([0.0, v_along, 0.0])).sum(-1) > 0.9).all()
        axes = tb.Surface.of(g, wide=False).viewer.axes  # what models get
        assert (axes[1].y * v_along > 0.9).all()


def test_handedness_is_one_or_minus_one_or_none():
    g = tb.GBuffer.from_mesh(ball(), camera())
    assert (g.handedness[g.mask].abs() == 1).all()
    assert set(g.handedness.unique().tolist()) == {-1.0, 0.0, 1.0}  # the uv of that ball are mirrored on one side
    assert not g.handedness[~g.mask].any()
    flat = tb.GBuffer.from_mesh(ball().replace(uv=torch.zeros_like(ball().uv)), camera())
    assert not flat.handedness.any()
    assert tb.GBuffer.from_mesh(ball(uv=False), camera()).handedness is None


@value
class Slanted(tb.Bsdf):
    """Brushed at 45 degrees between tangent and bitangent: not the same when the bitangent turns over."""

    colour: torch.Tensor = param(UNIT, COLOUR, "factor")
    lobes = (tb.Lobe.GLOSSY_REFLECTION,)

    def formula(self, g):
        h = vector.scale(g.viewer.to_local(g.half), g.inverse_half)
        return tuple(c * torch.exp(-20.0 * (h.x + h.y) ** 2) for c in g.colour(self.colour))


@pytest.mark.parametrize("channels", [3, 5])
def test_a_mirrored_texture_turns_what_is_brushed_over(channels):
    """The picture of a mirrored uv is that of the upright one with the world mirrored, in both layouts of colours."""
    light = tb.PointLight([1.5, 0.7, 2.0], 10.0)
    across = tb.PointLight([-1.5, 0.7, 2.0], 10.0)
    view = tb.Camera.look_at([0.0, 0.0, 3.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], 45.0, (8, 8))
    slanted = Slanted([0.5] * channels)
    upright, mirrored = (tb.GBuffer.from_mesh(sheet(uv), view) for uv in (UPRIGHT, MIRRORED))
    expected = tb.shade(upright, slanted, light).flip(-2)
    torch.testing.assert_close(tb.shade(mirrored, slanted, across), expected)
    assert (tb.shade(mirrored.replace(handedness=None), slanted, across) - expected).abs().max() > 0.1 * expected.max()


def test_the_triangle_is_right_for_a_far_camera_and_a_far_mesh():
    """embree works in float32; a telephoto lens and a mesh far from the origin must not cost it its digits."""
    mesh = ball(subdivisions=4)
    near = tb.GBuffer.from_mesh(mesh, camera((64, 64)))
    shift = torch.tensor([4096.0, -8192.0, 2048.0], dtype=torch.float64)
    moved = camera((64, 64)).replace(origin=camera().origin + shift)
    far_mesh = tb.GBuffer.from_mesh(mesh.replace(vertices=mesh.vertices + shift), moved)
    assert (near.triangle == far_mesh.triangle).double().mean() > 0.999  # all but rays within float32 rounding of an edge
    away = tb.Camera.look_at([4e5, 5e5, 7.7e5], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], 1.5e-4, (64, 64))
    g = tb.GBuffer.from_mesh(mesh, away)
    assert g.barycentric[g.mask.squeeze(-1)].min() > -1e-3  # of small triangles; without the shortened rays whole triangles are missed


def test_one_made_elsewhere():
    n = torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [0.0, float("nan"), 1.0], [0.0, 0.0, 1.0]])
    g = tb.GBuffer(torch.zeros(4, 3), n)
    assert g.valid[:, 0].tolist() == [True, False, False, True]
    assert g.replace(mask=torch.tensor([[False], [True], [True], [True]])).valid[:, 0].tolist() == [False, False, False, True]
    with pytest.raises(ValueError, match=r"GBuffer.view is missing.*camera"):
        g.require_view()
    assert g.replace(view=n).require_view() is n
    with pytest.raises(ValueError, match=r"GBuffer.depth: expected shape \[..., 1\], found \[4\]"):
        g.replace(depth=torch.zeros(4))
    with pytest.raises(TypeError, match=r"GBuffer.mask: expected a tensor of bools"):
        g.replace(mask=torch.zeros(4, 1))
    with pytest.raises(ValueError, match="do not broadcast"):
        g.replace(uv=torch.zeros(3, 2))


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32, torch.bfloat16, torch.float16])
def test_a_long_normal_is_valid_and_one_that_is_no_number_is_not(dtype):
    """Found by hypothesis: the components of a legal normal may add up to more than its dtype holds."""
    most = torch.finfo(dtype).max
    normal = torch.tensor(
        [[most, most, most], [0.0, -most, 1.0], [0.0, 0.0, 0.0], [math.inf, 0.0, 0.0], [0.0, math.nan, most]], dtype=dtype
    )
    assert tb.GBuffer(torch.zeros(5, 3, dtype=dtype), normal).valid.flatten().tolist() == [True, True, False, False, False]


@pytest.mark.parametrize("wrong", [math.nan, math.inf])
def test_a_uv_that_is_no_number_does_not_poison_the_slopes_of_the_rest(wrong):
    """Found by hypothesis: a weight that multiplies a NaN has a NaN for a slope, even where nothing depends on it."""
    ball = trimesh.creation.icosphere(subdivisions=1)
    vertices, uv = torch.tensor(ball.vertices).requires_grad_(), torch.rand(len(ball.vertices), 2, dtype=torch.float64)
    uv[::2, 0] = wrong
    mesh = tb.Mesh(vertices, torch.tensor(ball.faces), uv=uv)
    g = tb.GBuffer.from_mesh(mesh, tb.Camera.look_at([0.0, 0.0, 3.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], 40.0, (9, 9)))
    albedo = tb.nn.Texture(torch.rand(3, 3, 3, dtype=torch.float64))(g)
    image = tb.shade(g, tb.Lambert(albedo), tb.PointLight([1.0, 1.0, 3.0], 9.0))
    assert bool(torch.isfinite(image).all())
    assert float(image.detach().sum()) > 0
    (slope,) = torch.autograd.grad(image.sum(), vertices)
    assert bool(torch.isfinite(slope).all())
    assert bool(slope.any())


@pytest.mark.parametrize("wrong", [math.nan, math.inf])
def test_one_normal_that_is_no_number_masks_out_its_faces_and_no_others(wrong):
    v = torch.tensor([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    normals = torch.tensor([[0.0, 0.0, 1.0]]).repeat(4, 1)
    normals[1, 2] = wrong
    g = tb.GBuffer.from_mesh(tb.Mesh(v, [[0, 1, 2], [0, 2, 3]], normals=normals), camera((16, 16)))
    assert {0, 1} <= set(g.triangle.unique().tolist())
    assert torch.equal(g.valid, g.triangle == 1)
    assert (g.normal[~g.valid.squeeze(-1)] == 0).all()
