"""Environment maps: orientation against pictures and renderers, interpolation, gradients, transforms."""

import math

import numpy as np
import pytest
import torch
from PIL import Image

import torchbrdf as tb
from torchbrdf.value import validate

CONVENTIONS = ("mitsuba", "blender", "nvdiffrec")
AXES = {"+X": (1.0, 0, 0), "-X": (-1.0, 0, 0), "+Y": (0, 1.0, 0), "-Y": (0, -1.0, 0), "+Z": (0, 0, 1.0), "-Z": (0, 0, -1.0)}


def smooth_map(height=64, width=128):
    """1 + the three components of the picture's own direction (right, up, forward): smooth over the whole sphere."""
    v = (torch.arange(height, dtype=torch.float64) + 0.5).unsqueeze(1) / height * math.pi
    u = ((torch.arange(width, dtype=torch.float64) + 0.5) / width - 0.5) * 2 * math.pi
    return 1 + torch.stack([v.sin() * u.sin(), v.cos() + 0 * u, v.sin() * u.cos()], -1)


def unit(n, seed=0, dtype=torch.float64):
    return tb.normalize(torch.randn(n, 3, generator=torch.Generator().manual_seed(seed), dtype=dtype))


def uv(convention, direction):
    env = tb.EnvironmentMap(torch.ones(2, 4, 3), convention=convention)
    u, v = env.coordinates(tb.vector.components(torch.tensor([direction], dtype=torch.float64)))
    return u.item() % 1, v.item()


# u of each axis, and whether v = 0 or 1; written from the renderers' sources, not from the table in the module.
EXPECTED = {
    "mitsuba": {"+X": 0.25, "-X": 0.75, "+Z": 0.5, "-Z": 0.0, "top": "+Y"},
    "blender": {"+X": 0.5, "-X": 0.0, "+Y": 0.25, "-Y": 0.75, "top": "+Z"},
    "nvdiffrec": {"+X": 0.75, "-X": 0.25, "-Z": 0.5, "+Z": 0.0, "top": "+Y"},
}


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_the_axes_lie_where_the_convention_says(convention):
    expected = dict(EXPECTED[convention])
    top = expected.pop("top")
    for axis, u in expected.items():
        assert uv(convention, AXES[axis]) == pytest.approx((u, 0.5), abs=1e-12), axis
    assert uv(convention, AXES[top])[1] == 0
    assert uv(convention, AXES["-" + top[1]])[1] == pytest.approx(1, abs=1e-12)


def reference_uv(convention, d):
    """The renderers' own formulas: Mitsuba 3 envmap.cpp, Cycles projection.h, nvdiffrec util.py."""
    x, y, z = d.T
    if convention == "mitsuba":
        return np.arctan2(x, -z) / (2 * np.pi) % 1, np.arccos(y) / np.pi
    if convention == "blender":
        return (-np.arctan2(y, x) / (2 * np.pi) + 0.5) % 1, 1 - (np.arctan2(z, np.hypot(x, y)) / np.pi + 0.5)
    return (np.arctan2(x, -z) / (2 * np.pi) + 0.5) % 1, np.arccos(y) / np.pi


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_coordinates_follow_the_renderers_formulas(convention):
    d = unit(500)
    u, v = tb.EnvironmentMap(torch.ones(2, 4, 3), convention=convention).coordinates(tb.vector.components(d))
    expected_u, expected_v = reference_uv(convention, d.numpy())
    turn = np.abs(u.numpy() - expected_u)
    assert np.minimum(turn, 1 - turn % 1).max() < 1e-12
    assert np.abs(v.numpy() - expected_v).max() < 1e-12


def test_mitsuba_sees_the_same_sky():
    """Values of Mitsuba's emitter, rotated too. It puts the end rows on the poles: up to half a row, pi/128, of difference."""
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    texels, d = smooth_map().float(), unit(200)
    axis = tb.normalize(torch.tensor([1.0, 2.0, 3.0], dtype=torch.float64))
    for transform in (mi.ScalarTransform4f(), mi.ScalarTransform4f().rotate(axis.tolist(), 40)):
        emitter = mi.load_dict({"type": "envmap", "bitmap": mi.Bitmap(texels.numpy()), "to_world": transform})
        seen = []
        for w in d.tolist():
            si = mi.SurfaceInteraction3f()
            si.wi = mi.Vector3f(*(-c for c in w))
            seen.append(np.array(emitter.eval(si)))
        turn = torch.tensor(np.array(transform.matrix)[:3, :3])
        ours = tb.EnvironmentMap(texels, to_world=turn).radiance(d)
        assert np.abs(np.array(seen) - ours.numpy()).max() < math.pi / 128 + 1e-3  # and the error of bilinear interpolation


def test_the_picture_that_names_its_directions(real_data):
    """Each face shows, black on white, the axes that lie in it: their lines tell directions and handedness."""
    env = tb.EnvironmentMap.load(real_data / "hdri" / "OrientationLatLong.exr", convention="mitsuba")
    assert env.texels.shape[1:] == (2 * env.texels.shape[0], 3)

    def darkest(towards, aside):
        """Along the short arc from one axis towards another, how dark the line between them is."""
        points = torch.tensor([[a + t * b for a, b in zip(AXES[towards], AXES[aside], strict=True)] for t in (0.1, 0.15, 0.2)])
        return env.radiance(points).max()

    drawn = [("+Z", "+X"), ("+Z", "+Y"), ("+X", "+Y"), ("+X", "+Z"), ("-X", "+Y"), ("-X", "+Z"), ("-Z", "+X"), ("-Z", "+Y")]
    blank = [("+Z", "-Y"), ("+X", "-Y"), ("-X", "-Y"), ("-Z", "-Y"), ("+Z", "-X"), ("-Z", "-X"), ("+X", "-Z"), ("-X", "-Z")]
    assert max(darkest(*pair) for pair in drawn) < 0.5 < min(darkest(*pair) for pair in blank)


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_texel_centres_are_met_exactly(convention):
    height, width = 6, 10
    texels = torch.rand(height, width, 4, dtype=torch.float64)
    env = tb.EnvironmentMap(texels, convention=convention)
    o = tb.light.environment.ORIENTATIONS[convention]
    v = ((torch.arange(height, dtype=torch.float64) + 0.5) / height * math.pi).unsqueeze(1)
    lon = ((torch.arange(width, dtype=torch.float64) + 0.5) / width - 0.5) * 2 * math.pi
    d = torch.zeros(height, width, 3, dtype=torch.float64)
    for (axis, sign), part in zip(o, (v.sin() * lon.sin(), v.cos() + 0 * lon, v.sin() * lon.cos()), strict=True):
        d[..., axis] = sign * part
    assert torch.allclose(env.radiance(7.0 * d), texels, atol=1e-12)  # directions need not be unit


def test_interpolation_wraps_around_and_stops_at_the_poles():
    texels = torch.rand(4, 8, 3, dtype=torch.float64)
    env = tb.EnvironmentMap(texels)
    for side in (1e-9, -1e-9):  # u = 0 and u = 1, between the last column and the first
        behind = env.radiance(torch.tensor([side, 0.0, -1.0], dtype=torch.float64))
        assert torch.allclose(behind, (texels[1:3, 0] + texels[1:3, -1]).mean(0) / 2, atol=1e-7)
    a = math.pi / 16  # half a row from the pole: nothing above it but the first row
    for angle in (a, a / 2, a / 100):
        d = torch.tensor([math.sin(angle) * math.sin(0.3), math.cos(angle), -math.sin(angle) * math.cos(0.3)], dtype=torch.float64)
        u = (0.3 / (2 * math.pi)) * 8 - 0.5
        assert torch.allclose(env.radiance(d), texels[0, -1] * -u + texels[0, 0] * (1 + u), atol=1e-9)


def test_gradients_to_texels_directions_and_rotation():
    d = unit(6, 3) * torch.linspace(0.5, 2, 6, dtype=torch.float64).unsqueeze(1)
    turn, _ = torch.linalg.qr(torch.randn(3, 3, dtype=torch.float64))
    inputs = [t.requires_grad_() for t in (torch.rand(5, 7, 2, dtype=torch.float64), d, turn)]

    def look(texels, w, rotation):
        return tb.EnvironmentMap(texels, to_world=rotation).radiance(w)

    assert torch.autograd.gradcheck(look, inputs)
    assert torch.autograd.gradgradcheck(look, inputs)


HARD = [(0, 0, 0), (math.nan, 0, 1), (math.inf, 0, 1), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1), (-0.0, 0, -1), (1e-38, 1, 0), (1e-42, 1, 1e-42),
        (1e-19, 1, -1e-19), (1e-10, -1, 0), (1e30, 1e30, 1e30), (1e-30, 1e-30, 0), (0, 0, 1e-30), (1e-20, 1, 0), (1e-21, -1, 1e-21)]  # fmt: skip


@pytest.mark.parametrize("convention", CONVENTIONS)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.float16, torch.bfloat16])
def test_values_and_gradients_are_finite_everywhere(convention, dtype):
    texels = torch.rand(8, 16, 3).requires_grad_()
    d = torch.tensor(HARD, dtype=dtype).requires_grad_()
    seen = tb.EnvironmentMap(texels, convention=convention).radiance(d)
    assert seen.dtype == dtype
    seen.sum().backward()
    assert torch.isfinite(seen).all()
    assert torch.isfinite(texels.grad).all()
    pole_free = torch.tensor([abs(w[1]) < 1 or max(map(abs, w)) > 2 for w in HARD])
    assert torch.isfinite(d.grad[pole_free] if dtype == torch.float16 else d.grad).all()  # 1/distance from a pole overflows float16
    assert (seen[:3] == 0).all()
    assert (d.grad[:3] == 0).all()


@pytest.mark.parametrize(("convention", "poles"), [("mitsuba", "Y"), ("nvdiffrec", "Y"), ("blender", "Z")])
def test_the_gradient_at_a_pole_is_zero(convention, poles):
    d = torch.tensor([AXES["+" + poles], AXES["-" + poles]]).requires_grad_()
    look = tb.EnvironmentMap(torch.rand(8, 16, 3), convention=convention).radiance
    (gradient,) = torch.autograd.grad(look(d).sum(), d, create_graph=True)
    assert (gradient == 0).all()
    assert (torch.autograd.grad(gradient.sum(), d)[0] == 0).all()
    assert (torch.func.jvp(look, (d.detach(),), (torch.ones_like(d),))[1] == 0).all()


def test_compiles_into_one_graph_and_maps_over_directions():
    env, d = tb.EnvironmentMap(torch.rand(8, 16, 3), torch.eye(3)), unit(40, 5, torch.float32).reshape(4, 10, 3)
    expected = env.radiance(d)
    assert expected.shape == (4, 10, 3)
    assert tb.is_planar(expected)
    compiled = torch.compile(lambda e, w: e.radiance(w), fullgraph=True, backend="aot_eager")
    assert torch.allclose(compiled(env, d), expected, atol=1e-6)
    assert torch.allclose(torch.vmap(env.radiance)(d), expected, atol=1e-6)
    assert torch.allclose(torch.vmap(torch.vmap(env.radiance))(d), expected, atol=1e-6)
    skies = torch.rand(3, 8, 16, 3)
    many = torch.vmap(lambda t: tb.EnvironmentMap(t).radiance(d))(skies)
    assert torch.equal(many[1], tb.EnvironmentMap(skies[1]).radiance(d))
    grads = torch.vmap(torch.func.grad(lambda w: env.radiance(w).sum()))(d.reshape(-1, 3))
    assert torch.isfinite(grads).all()


@pytest.mark.slow
def test_inductor_agrees_with_eager():
    env, d = tb.EnvironmentMap(torch.rand(8, 16, 3).requires_grad_(), torch.eye(3)), unit(40, 5, torch.float32)
    compiled = torch.compile(lambda e, w: e.radiance(w), fullgraph=True)
    grads = []
    for look in (compiled, lambda e, w: e.radiance(w)):
        w = d.clone().requires_grad_()
        (look(env, w) ** 2).sum().backward()
        grads += [w.grad, env.texels.grad]
        env.texels.grad = None
    assert torch.allclose(grads[0], grads[2], atol=1e-4)
    assert torch.allclose(grads[1], grads[3], atol=1e-5)


def test_a_map_is_one_light_whose_axes_are_no_batch(tmp_path):
    env = tb.EnvironmentMap(torch.rand(4, 8, 3), convention="blender")
    assert env.batch_shape == ()
    assert len(env) == 1
    with pytest.raises(TypeError, match="EnvironmentMap: has no batch axes to index"):
        env[2]
    assert env.to(torch.float64).texels.dtype == torch.float64
    env.save(tmp_path / "sky.pt")
    again = tb.load_value(tmp_path / "sky.pt")
    assert again.convention == "blender"
    assert torch.equal(again.texels, env.texels)
    validate(env)
    with pytest.raises(ValueError, match="legal range"):
        validate(env.replace(texels=-env.texels))


@pytest.mark.parametrize("channels", [1, 3, 6])
def test_any_number_of_channels(channels):
    assert tb.EnvironmentMap(torch.rand(4, 8, channels)).radiance(unit(5)).shape == (5, channels)


def test_load_scales_and_drops_alpha(tmp_path):
    texels = torch.rand(4, 8, 3)
    tb.save_image(tmp_path / "a.exr", texels)
    env = tb.EnvironmentMap.load(tmp_path / "a.exr", convention="nvdiffrec", scale=2.5)
    assert torch.equal(env.texels, texels * 2.5)
    assert env.convention == "nvdiffrec"
    tb.save_image(tmp_path / "b.exr", texels.index_put((torch.tensor(1), torch.tensor(2)), torch.tensor(math.nan)))
    with pytest.raises(ValueError, match=r"b\.exr.*3 values are negative or not finite"):
        tb.EnvironmentMap.load(tmp_path / "b.exr")
    with pytest.raises(FileNotFoundError, match="gone"):
        tb.EnvironmentMap.load(tmp_path / "gone.hdr")


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: tb.EnvironmentMap(torch.rand(8, 3)), r"EnvironmentMap.*Hm, Wm, C\]"),
        (lambda: tb.EnvironmentMap(torch.rand(0, 8, 3)), r"EnvironmentMap.*Hm, Wm, C\]"),
        (lambda: tb.EnvironmentMap(torch.rand(4, 8, 3), convention="opengl"), "'blender', 'mitsuba', 'nvdiffrec'"),
        (lambda: tb.EnvironmentMap(torch.rand(4, 8, 3), torch.eye(4)[:, :3]), r"EnvironmentMap.*3, 3\]"),
        (lambda: tb.EnvironmentMap(torch.rand(4, 8, 3)).radiance(torch.rand(5, 2)), r"wi: expected shape \[\.\.\., 3\]"),
    ],
)
def test_wrong_shapes_and_names_are_errors(make, match):
    with pytest.raises(ValueError, match=match):
        make()


def test_sampling_answers_for_the_whole_sphere():
    """The mean of radiance over density is the integral over the sphere; the density is that of the samples."""
    env = tb.EnvironmentMap(torch.rand(8, 16, 3, dtype=torch.float64) ** 4, convention="blender")
    u = torch.quasirandom.SobolEngine(2, scramble=True, seed=0).draw(1 << 15, dtype=torch.float64)
    wi, distance, radiance, density = env.sample(torch.zeros(len(u), 3, dtype=torch.float64), u)
    assert wi.shape == (1, len(u), 3)
    assert torch.isinf(distance).all()
    torch.testing.assert_close(radiance[0], env.radiance(wi[0]))
    torch.testing.assert_close(density, env.pdf(wi[0]))
    z, weight = np.polynomial.legendre.leggauss(256)
    phi = (np.arange(512) + 0.5) * (2 * math.pi / 512)
    z, phi = (torch.from_numpy(x) for x in np.meshgrid(z, phi, indexing="ij"))
    sphere = torch.stack([torch.sqrt(1 - z * z) * torch.cos(phi), torch.sqrt(1 - z * z) * torch.sin(phi), z], -1)
    integral = (env.radiance(sphere) * torch.from_numpy(weight)[:, None, None] * (2 * math.pi / 512)).sum((0, 1))
    torch.testing.assert_close((radiance[0] / density[0]).mean(0), integral, rtol=2e-3, atol=0)
    torch.testing.assert_close(env.pdf(sphere).mean() * 4 * math.pi, torch.tensor(1.0, dtype=torch.float64))
    half = env.sample(torch.zeros(5, 3).half(), torch.rand(4, 5, 2))
    assert [x.shape[1:-1] for x in half] == [(4, 5)] * 4
    assert all(x.dtype == torch.float16 for x in half)


def test_load_decodes_pictures_and_turns_the_map(tmp_path):
    """A PNG holds sRGB codes: 128 is 0.2158605 by IEC 61966-2-1, not 128/255."""
    Image.fromarray(np.full((2, 4, 3), 128, np.uint8)).save(tmp_path / "grey.png")
    turn = torch.tensor([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    env = tb.EnvironmentMap.load(tmp_path / "grey.png", to_world=turn, scale=2.0)
    torch.testing.assert_close(env.texels, torch.full((2, 4, 3), 2.0 * 0.2158605))
    assert torch.equal(env.to_world, turn)
