"""`shade`: closed forms, sums over lights, memory layout, dtypes, batches, background, shadows, mirrors."""

import math

import pytest
import torch
import trimesh

import torchbrdf as tb
from torchbrdf.effects import direct

UP = torch.tensor([0.0, 0.0, 1.0])


def sheet(n=6, dtype=torch.float32, gen=0):
    """A bumpy sheet seen from above; every pixel differs."""
    g = torch.Generator().manual_seed(gen)
    axis = torch.linspace(-1, 1, n, dtype=torch.float64)
    y, x = torch.meshgrid(axis, axis, indexing="ij")
    position = torch.stack([x, y, 0.1 * x * y], -1)
    normal = tb.normalize(UP + 0.4 * torch.randn(n, n, 3, generator=g, dtype=torch.float64))
    view = tb.normalize(torch.tensor([0.2, -0.1, 4.0], dtype=torch.float64) - position)
    return tb.GBuffer(position, normal, view).to(dtype)


def three_lights(channels=3):
    colour = torch.rand(2, channels, generator=torch.Generator().manual_seed(5)) + 0.5
    return [tb.PointLight([[0.5, 0.3, 3.0], [-2.0, 1.0, 2.0]], 9.0 * colour), tb.DirectionalLight([0.3, 0.2, 1.0], colour[0])]


def glossy(channels=3, *pixels):
    draw = torch.rand(4, *pixels, channels, generator=torch.Generator().manual_seed(6))
    return tb.Lambert(draw[0]) + tb.Phong(draw[1], 20.0, fresnel=tb.Schlick(draw[2])) + draw[3] * tb.BlinnPhong(0.5, 9.0)


def ball(n, light):
    """A unit sphere seen along -z from infinity: its shading points, orthographic, and the cosine to the light."""
    axis = (torch.arange(n, dtype=torch.float64) + 0.5) / n * 2 - 1
    y, x = torch.meshgrid(axis, axis, indexing="ij")
    inside = x * x + y * y < 1
    normal = torch.stack([x, y, torch.where(inside, 1 - x * x - y * y, 0.0).sqrt()], -1)
    return tb.GBuffer(normal, normal, UP.double(), mask=inside.unsqueeze(-1)), (normal @ light).clamp_min(0), inside


@pytest.mark.parametrize("phase", [0.0, 40.0, 110.0, 170.0])
def test_lambert_sphere_in_closed_form(phase):
    a = math.radians(phase)
    light = torch.tensor([math.sin(a), 0.0, math.cos(a)], dtype=torch.float64)
    g, cosine, inside = ball(400, light)
    image = tb.shade(g, tb.Lambert([0.8, 0.4]), tb.DirectionalLight(light, 3.0))
    albedo = torch.tensor([0.8, 0.4], dtype=torch.float64)
    torch.testing.assert_close(image, (inside * cosine).unsqueeze(-1) * albedo * 3.0 / math.pi)
    # Lambert's phase law (Lambert 1760): the mean over the disk is 2/3 of (sin a + (pi - a) cos a) / pi.
    mean = image[inside].mean(0) / (albedo * 3.0 / math.pi)
    expected = 2 / 3 * (math.sin(a) + (math.pi - a) * math.cos(a)) / math.pi
    assert (mean - expected).abs().max() < 2e-4  # a Riemann sum with 400 steps; the disk's edge is dark or smooth


@pytest.mark.parametrize("channels", [1, 3, 8])
def test_the_image_is_the_sum_of_its_lights(channels):
    g, lights = sheet(), three_lights(channels)
    material = glossy(channels, 6, 6)
    one_by_one = tb.shade(g, material, lights, per_light=True)
    assert one_by_one.shape == (3, 6, 6, channels)
    image = tb.shade(g, material, lights)
    torch.testing.assert_close(image, one_by_one.sum(0))
    assert (one_by_one.amax((1, 2, 3)) > 0.01).all()
    # A list concatenates: each light alone gives its own rows.
    alone = torch.cat([tb.shade(g, material, light, per_light=True) for light in lights])
    assert torch.equal(one_by_one, alone)
    singles = [light[k] for light in lights for k in range(len(light))]
    assert torch.equal(one_by_one, tb.shade(g, material, singles, per_light=True))


@pytest.mark.parametrize("channels", [1, 3, 8])
def test_the_result_is_planar(channels):
    image = tb.shade(sheet(), glossy(channels, 6, 6), three_lights(channels))
    assert tb.is_planar(image)
    rows = tb.shade(sheet(), glossy(channels, 6, 6), three_lights(channels), per_light=True)
    assert all(tb.is_planar(row) for row in rows)
    assert rows.stride() == (channels * 36, 6, 1, 36)


def test_a_grey_part_and_a_coloured_part_share_the_channels():
    """One channel serves all: grey lights, grey materials, dark rows."""
    g = sheet()
    for count in (3, 8):
        colour = torch.rand(count)
        for material, lights in [
            (tb.Lambert(0.5), [tb.PointLight([0.0, 0.0, 3.0], 9.0), tb.DirectionalLight([0.0, 0.0, 1.0], colour)]),
            (tb.Lambert(colour), [tb.PointLight([0.0, 0.0, 3.0], 9.0), tb.DirectionalLight([0.0, 0.0, 1.0], 1.0)]),
            (tb.Lambert(0.5) + tb.Mirror(colour), [tb.PointLight([0.0, 0.0, 3.0], 9.0)]),
        ]:
            rows = tb.shade(g, material, lights, per_light=True)
            assert rows.shape == (len(lights), 6, 6, count)
            torch.testing.assert_close(tb.shade(g, material, lights), rows.sum(0))
        dark = tb.shade(g, tb.Mirror(colour), tb.PointLight([0.0, 0.0, 3.0], 9.0))
        assert dark.shape == (6, 6, count)
        assert not dark.any()
    sky = tb.EnvironmentMap(torch.rand(4, 8, 3))
    rows = tb.shade(g, tb.Mirror(), [tb.PointLight([0.0, 0.0, 3.0], 1.0), sky], per_light=True)
    assert rows.shape == (2, 6, 6, 3)
    assert not rows[0].any()
    assert rows[1].all()


def test_eight_wavelengths_are_eight_times_one():
    """The wide layout against the channel-by-channel one, values and gradients."""
    g = sheet()
    normal = g.normal.clone().requires_grad_()
    g = g.replace(normal=normal)
    material, lights = glossy(8, 6, 6), three_lights(8)
    wide = tb.shade(g, material, lights)
    assert material.is_wide
    total = 0.0
    for k in range(0, 8, 2):
        two = material.map(lambda t, k=k: t[..., k : k + 2] if t.shape[-1] == 8 else t)
        assert not two.is_wide
        narrow = tb.shade(g, two, [light.map(lambda t, k=k: t[..., k : k + 2] if t.shape[-1] == 8 else t) for light in lights])
        torch.testing.assert_close(wide[..., k : k + 2], narrow, rtol=2e-6, atol=1e-7)  # float32, another order of products
        total = total + narrow.sum()
    (a,), (b,) = (torch.autograd.grad(x, normal, retain_graph=True) for x in (wide.sum(), total))
    torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float32, torch.float64])
def test_the_dtype_follows_the_points(dtype):
    g = sheet(dtype=dtype)
    material, lights = glossy(3, 6, 6).to(dtype), three_lights()
    image = tb.shade(g, material, lights)
    assert image.dtype == dtype
    assert tb.shade(g, glossy(), lights).dtype == dtype  # unbatched parameters follow
    reference = tb.shade(g.to(torch.float64), material.to(torch.float64), lights)
    # Half types compute in float32 and round once: half an ulp. float32: a few dozen roundings, magnified by the exponent 20.
    tolerance = 0.6 * torch.finfo(dtype).eps if dtype in (torch.float16, torch.bfloat16) else 100 * torch.finfo(dtype).eps
    torch.testing.assert_close(image.double(), reference, rtol=tolerance, atol=1e-6)


def test_a_batch_of_cameras():
    boxes = trimesh.creation.icosphere(subdivisions=2)
    mesh = tb.Mesh(torch.tensor(boxes.vertices, dtype=torch.float32), torch.tensor(boxes.faces))
    eyes = torch.tensor([[0.0, 0.0, 4.0], [3.0, 1.0, 2.0], [0.0, -4.0, 1.0]])
    cameras = tb.Camera.look_at(eyes, torch.zeros(3), torch.tensor([0.0, 1.0, 0.2]), 35.0, (8, 10))
    g = tb.GBuffer.from_mesh(mesh, cameras)
    image = tb.shade(g, glossy(), three_lights(), mesh=mesh)
    assert image.shape == (3, 8, 10, 3)
    assert tb.shade(g, glossy(), three_lights(), per_light=True).shape == (3, 3, 8, 10, 3)
    for k in range(3):
        torch.testing.assert_close(image[k], tb.shade(g[k], glossy(), three_lights(), mesh=mesh))
    albedo = torch.rand(3, 1, 1, 3)
    assert torch.equal(tb.shade(g, tb.Lambert(albedo), three_lights())[1], tb.shade(g[1], tb.Lambert(albedo[1, 0, 0]), three_lights()))


JUNK = (math.nan, math.inf, -math.inf, 1e30, 0.0)


@pytest.mark.parametrize("channels", [3, 8])
@pytest.mark.parametrize("material", ["glossy", "mirror"])
@pytest.mark.parametrize("junk", JUNK)
@pytest.mark.parametrize("field", ["position", "normal", "view", "all"])
def test_background_is_exactly_zero_whatever_stands_there(field, junk, material, channels):
    g = sheet()
    hole = torch.zeros(6, 6, 1, dtype=torch.bool)
    hole[1:3, 2:5] = True
    names = ("position", "normal", "view")
    spoiled = names if field == "all" else (field,)
    leaves = {
        n: torch.where(hole, junk, getattr(g, n)).requires_grad_() if n in spoiled else getattr(g, n).clone().requires_grad_()
        for n in names
    }
    tint = torch.rand(6, 6, channels).requires_grad_()
    brdf = tb.Mirror(tint) if material == "mirror" else tb.Lambert(tint) + tb.Phong(tint, 30.0, fresnel=tb.Schlick(tint))
    lights = tb.EnvironmentMap(torch.rand(5, 7, channels)) if material == "mirror" else three_lights(channels)
    image = tb.shade(tb.GBuffer(**leaves, mask=~hole), brdf, lights)
    assert (image[hole[..., 0]] == 0).all()
    assert torch.isfinite(image).all()
    assert torch.equal(image[~hole[..., 0]], tb.shade(g, brdf, lights)[~hole[..., 0]])
    gradients = torch.autograd.grad(image.square().sum(), [*leaves.values(), tint], allow_unused=True)
    for gradient in gradients:
        assert gradient is None or (torch.isfinite(gradient).all() and (gradient[hole[..., 0]] == 0).all())
    assert gradients[-1].any()


@pytest.mark.parametrize("junk", [math.nan, 0.0, math.inf])
def test_normals_that_are_none_mask_themselves(junk):
    g = sheet()
    normal = g.normal.clone()
    normal[2, 3] = junk
    normal.requires_grad_()
    image = tb.shade(g.replace(normal=normal), glossy(), three_lights())
    assert (image[2, 3] == 0).all()
    assert (image > 0).any(-1).sum() == 35
    (gradient,) = torch.autograd.grad(image.sum(), normal)
    assert (gradient[2, 3] == 0).all()
    assert torch.isfinite(gradient).all()


def test_a_degenerate_triangle_is_dark_and_harmless():
    v = torch.tensor(
        [[-1.0, -1, 0], [1, -1, 0], [0, 1, 0], [-1, 1, 0.5], [1, 1, 0.5], [0, 1, 0.5]], dtype=torch.float64, requires_grad=True
    )
    mesh = tb.Mesh(v, torch.tensor([[0, 1, 2], [3, 4, 5], [0, 0, 0]]))
    g = tb.GBuffer.from_mesh(mesh, tb.Camera.look_at([0.0, 0.0, 3.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], 60.0, (16, 16)))
    image = tb.shade(g, glossy(), three_lights(), mesh=mesh)
    assert torch.isfinite(image).all()
    assert (image > 0).any()
    image.sum().backward()
    assert torch.isfinite(v.grad).all()
    assert (v.grad[3:] == 0).all()


@pytest.mark.filterwarnings("ignore:GBuffer. none of its")  # tests/test_doubts.py asks for it
def test_back_faces_are_black_and_light_from_below_gives_nothing():
    g = sheet()
    assert not tb.shade(g.replace(normal=-g.normal), glossy(), three_lights()).any()
    assert not tb.shade(g.replace(view=-g.view), glossy(), three_lights()).any()
    assert not tb.shade(g.replace(normal=-g.normal), tb.Mirror(), tb.EnvironmentMap(torch.ones(2, 4, 3))).any()
    assert not tb.shade(g, glossy(), tb.PointLight([0.0, 0.0, -3.0], 1.0)).any()


@pytest.mark.parametrize("fresnel", [None, tb.Dielectric(1.5), tb.Conductor.named("Cu")])
def test_a_mirror_shows_the_environment(fresnel):
    g = sheet(dtype=torch.float64)
    sky = tb.EnvironmentMap(torch.rand(16, 32, 3, dtype=torch.float64))
    image = tb.shade(g, tb.Mirror([0.9, 0.5, 0.2], fresnel), sky)
    cosine = (g.normal * g.view).sum(-1, keepdim=True)
    towards = 2 * cosine * g.normal - g.view
    expected = torch.tensor([0.9, 0.5, 0.2]) * sky.radiance(towards) * (1.0 if fresnel is None else fresnel.reflectance(cosine))
    torch.testing.assert_close(image, torch.where(cosine > 0, expected, 0.0))
    both = tb.shade(g, tb.Mirror([0.9, 0.5, 0.2], fresnel), [sky, tb.DirectionalLight([0.0, 0.0, 1.0], 5.0), sky])
    torch.testing.assert_close(both, 2 * image)


def plate_over_floor():
    """A floor with a small plate above it, and a light straight above."""
    n = 24
    axis = (torch.arange(n) + 0.5) / n * 3 - 1.5
    y, x = torch.meshgrid(axis, axis, indexing="ij")
    g = tb.GBuffer(torch.stack([x, y, 0 * x], -1), UP.expand(n, n, 3), UP.expand(n, n, 3), geometric_normal=UP.expand(n, n, 3))
    h = 0.5
    v = torch.tensor([[-h, -h, 1.0], [h, -h, 1], [h, h, 1], [-h, h, 1], [-2, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0]])
    faces = torch.tensor([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    return g, tb.Mesh(v, faces), (x.abs() < h) & (y.abs() < h)


def test_shadows_by_mesh_by_visibility_and_off():
    g, mesh, under = plate_over_floor()
    lights = [tb.DirectionalLight([0.0, 0.0, 1.0], 3.0), tb.PointLight([0.0, 0.0, 0.5], 1.0)]
    free = tb.shade(g, tb.Lambert(0.5), lights, per_light=True)
    cast = tb.shade(g, tb.Lambert(0.5), lights, mesh=mesh, per_light=True)
    assert torch.equal(cast[0], free[0] * ~under.unsqueeze(-1))
    assert torch.equal(cast[1], free[1])  # this light stands below the plate
    known = tb.visibility(g, lights, mesh)
    assert torch.equal(tb.shade(g, tb.Lambert(0.5), lights, visibility=known, per_light=True), cast)
    assert torch.equal(tb.shade(g, tb.Lambert(0.5), lights, visibility=known.bool(), per_light=True), cast)
    planned = tb.plan(g, tb.Lambert(0.5), lights, mesh)
    for prepared in (known, planned.prepare(g, lights, mesh)):
        assert torch.equal(planned(g, tb.Lambert(0.5), lights, prepared, per_light=True), cast)
    wide = tb.shade(g, tb.Lambert(torch.full((8,), 0.5)), lights, visibility=known, per_light=True)
    torch.testing.assert_close(wide, cast.expand_as(wide))
    # A visibility that is given wins over the mesh, and may be soft, and learned.
    half = torch.full((2, 1, 1, 1), 0.5, requires_grad=True)
    soft = tb.shade(g, tb.Lambert(0.5), lights, visibility=half, mesh=mesh)
    torch.testing.assert_close(soft, 0.5 * free.sum(0))
    (gradient,) = torch.autograd.grad(soft.sum(), half)
    torch.testing.assert_close(gradient.flatten(), free.sum((1, 2, 3)))
    assert torch.equal(tb.shade(g, tb.Lambert(0.5), lights, mesh=mesh, visibility=known, shadow="off", per_light=True), free)


def test_fields_of_the_g_buffer_broadcast():
    """A flat wall under the sun seen from afar: one normal and one view for all pixels still give an image."""
    g, _, _ = plate_over_floor()
    wall = tb.GBuffer(g.position, UP, UP)
    for lights in (tb.DirectionalLight([0.3, 0.0, 1.0], 2.0), tb.PointLight([0.0, 0.0, 2.0], 2.0)):
        for material in (glossy(), glossy(8)):
            torch.testing.assert_close(tb.shade(wall, material, lights), tb.shade(g, material, lights))
    sky = tb.EnvironmentMap(torch.rand(4, 8, 3))
    torch.testing.assert_close(tb.shade(wall, tb.Mirror(), sky), tb.shade(g, tb.Mirror(), sky))


@pytest.mark.parametrize("channels", [1, 3, 8])
def test_a_single_point_is_a_g_buffer_too(channels):
    g, material, lights = sheet(), glossy(channels), three_lights(channels)
    point = tb.GBuffer(*(getattr(g, name)[2, 3] for name in ("position", "normal", "view")))
    torch.testing.assert_close(tb.shade(point, material, lights), tb.shade(g, material, lights)[2, 3])
    torch.testing.assert_close(tb.shade(point, material, lights, per_light=True), tb.shade(g, material, lights, per_light=True)[:, 2, 3])


def test_a_scaled_mirror_shows_a_scaled_environment():
    g, sky = sheet(dtype=torch.float64), tb.EnvironmentMap(torch.rand(16, 32, 3, dtype=torch.float64))
    k = torch.tensor([0.5, 0.25, 2.0], dtype=torch.float64)
    torch.testing.assert_close(tb.shade(g, k * tb.Mirror(0.8), sky), k * 0.8 * tb.shade(g, tb.Mirror(), sky))


def test_what_a_mirror_shows_follows_the_normal():
    """A mirror that turns by an angle moves what it shows by twice that; the map here is 1 + the direction's own components."""
    v = (torch.arange(128, dtype=torch.float64).unsqueeze(1) + 0.5) / 128 * math.pi
    u = ((torch.arange(256, dtype=torch.float64) + 0.5) / 256 - 0.5) * 2 * math.pi
    sky = tb.EnvironmentMap(1 + torch.stack([-v.sin() * u.sin(), v.cos() + 0 * u, v.sin() * u.cos()], -1))
    g = sheet(dtype=torch.float64)
    normal, view = (t.clone().requires_grad_() for t in (g.normal, g.view))
    image = tb.shade(g.replace(normal=normal, view=view), tb.Mirror(), sky)
    truth = 1 + tb.reflect(tb.normalize(view), tb.normalize(normal))
    w = torch.randn(image.shape, dtype=torch.float64) * ((normal * view).sum(-1, keepdim=True) > 0)
    for found, expected in zip(*(torch.autograd.grad((w * x).sum(), (normal, view)) for x in (image, truth)), strict=True):
        assert (found - expected).norm() < 0.03 * expected.norm()  # piecewise linear between 256 texels: an error of the slope of pi / 256


def test_the_side_without_a_mirror_shows_nothing():
    """Of a surface that is a mirror on one side, the other side is black under an environment, whichever it is."""
    g, sky = sheet(dtype=torch.float64), tb.EnvironmentMap(torch.rand(16, 32, 3, dtype=torch.float64))
    behind, matt, shiny = g.replace(normal=-g.normal), tb.Lambert(0.5), tb.Mirror(0.8)
    for inside, outside in ((shiny, matt), (matt, shiny)):
        both = tb.TwoSided(inside, outside).select(tb.Lobe.DELTA)
        seen, unseen = (behind, g) if inside is shiny else (g, behind)
        torch.testing.assert_close(tb.shade(seen, both, sky), tb.shade(g, shiny, sky))
        assert not tb.shade(unseen, both, sky).any()


@pytest.mark.parametrize("size", [1, 80, 1 << 15])
def test_groups_of_lights_are_rows_in_order(monkeypatch, size):
    """Of 36 pixels, lights one by one, two at a time or all at once are what each is alone, with its own shadow."""
    g, sun = sheet(), three_lights()[1]
    lights = [sun, tb.PointLight(torch.randn(5, 3) + 3 * UP, torch.rand(5, 3)), sun]
    seen = torch.rand(7, 6, 6, 1)
    single = [sun, *(lights[1][k] for k in range(5)), sun]
    rows = torch.stack([tb.shade(g, glossy(), one, visibility=v.unsqueeze(0)) for one, v in zip(single, seen, strict=True)])
    monkeypatch.setattr(direct, "GROUP", size)
    torch.testing.assert_close(tb.shade(g, glossy(), lights, visibility=seen, per_light=True), rows)
    torch.testing.assert_close(tb.shade(g, glossy(), lights, visibility=seen), rows.sum(0))
