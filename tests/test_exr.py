"""G-buffers in EXR files: our own bit for bit, Mitsuba's and Blender's against geometry that is known."""

import math

import numpy as np
import OpenEXR
import pytest
import torch
from renders import about, cropped, spot

import torchbrdf as tb
from torchbrdf.io.exr import read_exr, write_exr


def sphere_camera(size=(64, 96), fov_x=40.0):
    """The camera of the sphere files: at (0, -4, 0), looking along +y, z up."""
    fov_y = 2 * math.degrees(math.atan(math.tan(math.radians(fov_x / 2)) * size[0] / size[1]))
    return tb.Camera.look_at([0.0, -4.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0], fov_y, size)


def sphere(camera):
    """What the rays through the pixel centres meet of the unit sphere: points (which are the normals), distance, discriminant."""
    origin, d = (t.double() for t in camera.rays())
    b = (origin * d).sum(-1, keepdim=True)
    disc = b * b - (origin * origin).sum(-1, keepdim=True) + 1
    t = -b - disc.clamp_min(0).sqrt()
    return origin + t * d, t, disc


def inside(disc):
    """Away from the rim, where one pixel spans a small piece of the sphere."""
    return (disc > 0.15)[..., 0]


def quantiles(x):
    return x.flatten().double().quantile(torch.tensor([0.5, 1.0], dtype=torch.float64)).tolist()


def sphere_gbuffer(dtype=torch.float32, **changes):
    camera = sphere_camera((12, 18))
    p, t, disc = sphere(camera)
    mask = disc > 0
    p = torch.where(mask, p, 0).to(dtype)
    view = tb.normalize(camera.origin - p).to(dtype)
    fields = {"position": p, "normal": p, "view": view, "uv": torch.rand(12, 18, 2, dtype=dtype), "depth": t.to(dtype), "mask": mask}
    fields |= {"geometric_normal": p.flip(-1), "tangent": p.roll(1, -1), "barycentric": torch.rand(12, 18, 3, dtype=dtype)}
    fields |= {"triangle": torch.randint(-1, 1 << 24, (12, 18, 1)), "material": torch.randint(0, 5, (12, 18, 1))}
    fields |= {"handedness": torch.randint(-1, 2, (12, 18, 1)).to(dtype)}
    return tb.GBuffer(**(fields | changes))


# Our own files


def test_every_field_comes_back_bit_for_bit(tmp_path, capsys):
    g = sphere_gbuffer()
    g.save(tmp_path / "g.exr")
    again = tb.GBuffer.load(tmp_path / "g.exr")
    assert {n for n, _, _ in again.own_tensors()} == set(g.params())
    for name, tensor, _ in g.own_tensors():
        assert torch.equal(getattr(again, name), tensor), name
        assert getattr(again, name).dtype == tensor.dtype
        assert tb.is_planar(getattr(again, name)), name
    assert capsys.readouterr().out == "g.exr: own G-buffer; view as stored\n"


def test_the_channels_of_our_files_are_what_the_page_says(tmp_path):
    sphere_gbuffer().save(tmp_path / "g.exr")
    (channels,) = read_exr(tmp_path / "g.exr").values()
    vectors = ("position", "normal", "view", "geometric_normal", "tangent", "barycentric")
    assert set(channels) == {f"{v}.{c}" for v in vectors for c in "XYZ"} | {
        "uv.U",
        "uv.V",
        "depth.T",
        "mask",
        "triangle",
        "material",
        "handedness",
    }
    header = OpenEXR.File(str(tmp_path / "g.exr"), separate_channels=True)
    assert {c.pixels.dtype for c in header.channels().values()} == {np.dtype(np.float32)}


def test_a_bare_gbuffer_comes_back_with_its_mask_and_a_camera_gives_view(tmp_path, capsys):
    g = sphere_gbuffer(torch.float64)
    g = tb.GBuffer(position=g.position, normal=g.normal)
    g.save(tmp_path / "g.exr")
    again = tb.GBuffer.load(tmp_path / "g.exr")
    assert again.view is None
    assert torch.equal(again.mask, g.valid)
    assert torch.equal(again.position, g.position.float())
    camera = sphere_camera((12, 18))
    seen = tb.GBuffer.load(tmp_path / "g.exr", camera)
    expected = torch.where(g.valid, tb.normalize(camera.origin - g.position), 0.0)
    assert torch.allclose(seen.view.double(), expected, atol=1e-6)
    assert capsys.readouterr().out == "g.exr: own G-buffer; no view (camera= would give it)\ng.exr: own G-buffer; view from the camera\n"


def test_what_float32_or_one_file_cannot_hold_is_refused(tmp_path):
    g = sphere_gbuffer(triangle=torch.full((12, 18, 1), (1 << 24) + 1))
    with pytest.raises(ValueError, match=r"g\.exr: triangle holds ids beyond 16777216"):
        g.save(tmp_path / "g.exr")
    with pytest.raises(ValueError, match=r"expected a G-buffer \[H, W\], found \[12\]"):
        sphere_gbuffer()[:, 3].save(tmp_path / "g.exr")


# Mitsuba


def test_mitsubas_averaged_sphere(real_data, capsys):
    """Averages over a pixel lie up to about half a pixel's spread from the centre; depth counts from the near plane, positions do not."""
    path = real_data / "mitsuba" / "diffuse.exr"
    camera = cropped(sphere_camera(), about(path))
    g = tb.GBuffer.load(path, camera)
    p, t, disc = sphere(camera)
    core = inside(disc)
    assert g.mask[core].all()
    assert not g.mask[disc <= -0.15].any()
    median, worst = quantiles((g.position - p).norm(dim=-1)[core])
    assert median < 2e-3  # 0.0012: noise of 64 samples in a pixel of width 0.028
    assert worst < 1e-2
    assert quantiles((g.normal - p).norm(dim=-1)[core])[0] < 2e-3
    assert (g.normal.norm(dim=-1)[g.mask[..., 0]] - 1).abs().max() < 1e-6
    assert quantiles((g.depth - t).abs()[core])[0] < 1e-3  # the stored depth is 0.010 short
    assert torch.allclose(g.view[core].double(), tb.normalize(camera.origin - g.position.double())[core], atol=1e-6)
    # Every pixel of the mask is nearly whole: what blends with the background lies inside the sphere.
    assert g.position.norm(dim=-1)[g.mask[..., 0]].min() > 0.95
    assert (g.position[~g.mask[..., 0]] == 0).all()
    printed = capsys.readouterr().out
    assert printed.startswith("diffuse.exr: Mitsuba AOVs: position<-pos, normal<-nn, depth<-depth, uv<-uv;")
    assert "normals averaged, renormalised" in printed
    assert printed.count("\n") == 1


def test_mitsubas_spot_is_the_mesh(spot_aovs, capsys):
    """Traced through pixel centres: mask, triangle, position, normal, uv and depth against our own ray caster."""
    mesh, camera, _ = spot(spot_aovs)
    theirs = tb.GBuffer.load(spot_aovs / "aov.exr", camera)
    ours = tb.GBuffer.from_mesh(mesh, camera)
    same = ((theirs.triangle == ours.triangle) & theirs.mask & ours.mask)[..., 0]
    assert same.sum() >= 0.995 * theirs.mask.sum()
    assert (theirs.triangle[~theirs.mask] == -1).all()
    for field in ("position", "normal", "geometric_normal", "uv", "view", "depth"):
        assert quantiles((getattr(theirs, field) - getattr(ours, field))[same].abs())[0] < 1e-6, field
    printed = capsys.readouterr().out
    assert "normals as given" in printed
    assert "v turned upwards" in printed


# Blender


@pytest.mark.parametrize("name", ["bl50_lambert", "bl50_ggx"])
def test_blender_5_passes(real_data, capsys, name):
    path = real_data / "blender" / f"{name}.exr"
    camera = cropped(sphere_camera(), about(path))
    g = tb.GBuffer.load(path, camera)
    p, t, disc = sphere(camera)
    core = inside(disc)
    assert torch.equal(g.mask, disc > 0)  # position and depth belong to the pixel centre's own ray, or near it
    assert quantiles((g.position - p).norm(dim=-1)[core])[1] < 2e-3
    assert quantiles((g.normal - p).norm(dim=-1)[core])[0] < 1e-3
    assert (g.normal.norm(dim=-1)[g.mask[..., 0]] - 1).abs().max() < 1e-6
    assert quantiles((g.depth - t).abs()[core])[1] < 2e-3
    assert (g.material[g.mask] == 7).all()
    assert (g.material[~g.mask] == 0).all()
    printed = capsys.readouterr().out
    assert printed.startswith(f"{name}.exr: Blender passes: position<-ViewLayer.Position, normal<-ViewLayer.Normal,")
    bare = tb.GBuffer.load(path)
    assert bare.view is None
    assert bare.depth is None
    assert "planar depth left out" in capsys.readouterr().out


def blender_files(real_data, tmp_path, drop=()):
    """The passes of a Blender 5 file in the other layouts that Blender writes."""
    layers = read_exr(real_data / "blender" / "bl50_lambert.exr")
    flat = {n: a for channels in layers.values() for n, a in channels.items() if not any(f".{d}." in n for d in drop)}
    write_exr(tmp_path / "single.exr", {n.replace("Material Index", "IndexMA"): a for n, a in flat.items()})
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    for name, strip in (("unprefixed", lambda n: n.removeprefix("ViewLayer.")), ("bare", lambda n: n.rpartition(".")[2])):
        parts: dict[str, dict] = {}
        for n, a in flat.items():
            parts.setdefault(n.split(".")[1], {})[strip(n)] = np.ascontiguousarray(a)
        with OpenEXR.File([OpenEXR.Part(dict(header), channels, part) for part, channels in parts.items()]) as file:
            file.write(str(tmp_path / f"{name}.exr"))
    return [tmp_path / f"{n}.exr" for n in ("single", "unprefixed", "bare")]


def test_every_layout_of_blender_gives_the_same(real_data, tmp_path):
    whole = real_data / "blender" / "bl50_lambert.exr"
    camera = cropped(sphere_camera(), about(whole))
    expected = tb.GBuffer.load(whole, camera)
    for path in blender_files(real_data, tmp_path):
        g = tb.GBuffer.load(path, camera)
        for name, tensor, _ in expected.own_tensors():
            assert torch.equal(getattr(g, name), tensor), (path.name, name)


def test_positions_are_made_from_planar_depth(real_data, tmp_path):
    camera = cropped(sphere_camera(), about(real_data / "blender" / "bl50_lambert.exr"))
    p, t, disc = sphere(camera)
    core = inside(disc)
    for path in blender_files(real_data, tmp_path, drop=["Position"]):
        g = tb.GBuffer.load(path, camera)
        assert quantiles((g.position - p).norm(dim=-1)[core])[1] < 2e-3
        assert quantiles((g.depth - t).abs()[core])[1] < 2e-3  # 0.09 if planar depth were taken for distance
        with pytest.raises(ValueError, match=r"single\.exr|unprefixed\.exr|bare\.exr.*no layer looks like positions.*camera="):
            tb.GBuffer.load(path)


# Names, and files that do not fit


def channels_of(g, **layers):
    """Channels of a file under the given layer names (field=layer)."""
    out = {}
    for field, layer in layers.items():
        t = getattr(g, field)
        letters = {"depth": "T", "triangle": "I", "uv": "UV"}.get(field, "XYZ")
        out |= {f"{layer}.{c}": part for c, part in zip(letters, t.unbind(-1), strict=True)}
    return out


@pytest.fixture
def ball():
    return sphere_gbuffer()


def test_names_of_your_own(tmp_path, ball):
    write_exr(tmp_path / "a.exr", channels_of(ball, position="where", normal="a.up", depth="far"))
    names = {"position": "where", "normal": "up", "depth": "far"}
    g = tb.GBuffer.load(tmp_path / "a.exr", names=names)
    assert torch.equal(g.position, ball.position)
    assert torch.allclose(g.normal, ball.normal, atol=1e-6)
    assert torch.equal(g.depth, torch.where(ball.mask, ball.depth, 0))
    assert torch.equal(g.mask, ball.mask)
    with pytest.raises(ValueError, match=r"a\.exr: no layer looks like normals.*names=.*'far'"):
        tb.GBuffer.load(tmp_path / "a.exr")
    with pytest.raises(ValueError, match=r"no layer 'here' for the position; the file has \['a.up', 'far', 'where'\]"):
        tb.GBuffer.load(tmp_path / "a.exr", names=names | {"position": "here"})
    with pytest.raises(ValueError, match=r"unknown fields \['albedo'\]"):
        tb.GBuffer.load(tmp_path / "a.exr", names={"albedo": "where"})
    with pytest.raises(ValueError, match=r"layer 'far' cannot be the position: it has channels \['T'\]"):
        tb.GBuffer.load(tmp_path / "a.exr", names=names | {"position": "far"})


def test_the_rest_of_a_file_with_names_is_still_recognised(tmp_path, ball):
    write_exr(
        tmp_path / "a.exr", channels_of(ball, position="where", normal="sh_normal", geometric_normal="geo_normal", triangle="prim_index")
    )
    g = tb.GBuffer.load(tmp_path / "a.exr", names={"position": "where"})
    assert torch.allclose(g.geometric_normal, ball.geometric_normal, atol=1e-6)
    assert torch.equal(g.triangle, torch.where(g.mask, ball.triangle, -1))
    assert torch.equal(g.mask, ball.mask & (ball.triangle >= 0))


def test_two_layers_for_one_field_are_asked_about(tmp_path, ball):
    write_exr(tmp_path / "a.exr", channels_of(ball, position="pos", normal="nn") | channels_of(ball, view="back.pos"))
    with pytest.raises(ValueError, match=r"several layers could be the position: \['back.pos', 'pos'\]; say which with names="):
        tb.GBuffer.load(tmp_path / "a.exr")
    assert torch.equal(tb.GBuffer.load(tmp_path / "a.exr", names={"position": "pos"}).position, ball.position)


def test_two_view_layers_are_told_apart_by_their_parts(tmp_path, ball):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    parts = []
    for layer, factor in (("A", 1.0), ("B", 2.0)):
        for name, field in (("Position", factor * ball.position), ("Normal", ball.normal)):
            channels = {f"{name}.{c}": np.ascontiguousarray(x) for c, x in zip("XYZ", field.unbind(-1), strict=True)}
            parts.append(OpenEXR.Part(dict(header), channels, f"{layer}.{name}"))
    with OpenEXR.File(parts) as file:
        file.write(str(tmp_path / "a.exr"))
    with pytest.raises(ValueError, match=r"several layers could be the position: \['A.Position', 'B.Position'\]"):
        tb.GBuffer.load(tmp_path / "a.exr")
    g = tb.GBuffer.load(tmp_path / "a.exr", names={"position": "B.Position", "normal": "A.Normal"})
    assert torch.equal(g.position, 2 * ball.position)


def test_depth_along_the_ray_gives_positions(tmp_path, ball):
    write_exr(tmp_path / "a.exr", channels_of(ball, normal="nn", depth="dd"))
    camera = sphere_camera((12, 18))
    g = tb.GBuffer.load(tmp_path / "a.exr", camera)
    assert torch.allclose(g.position, ball.position, atol=1e-6)
    assert torch.allclose(g.view, torch.where(ball.mask, ball.view, 0), atol=1e-6)


def test_a_camera_that_does_not_fit_is_refused(tmp_path, ball):
    write_exr(tmp_path / "a.exr", channels_of(ball, position="pos", normal="nn"))
    with pytest.raises(ValueError, match=r"one camera of size \(18, 12\), expected one of size \(12, 18\)"):
        tb.GBuffer.load(tmp_path / "a.exr", sphere_camera((18, 12)))
    camera = sphere_camera((12, 18))
    with pytest.raises(ValueError, match=r"\[2\] cameras"):
        tb.GBuffer.load(tmp_path / "a.exr", camera.replace(origin=camera.origin.expand(2, 3)))


def test_broken_pixels_are_masked_out(tmp_path, ball):
    position, normal = ball.position.clone(), ball.normal.clone()
    position[5, 8, 0], normal[6, 9, 1], normal[6, 8] = math.nan, math.inf, 0.5 * normal[6, 8]
    write_exr(tmp_path / "a.exr", channels_of(ball.replace(position=position, normal=normal), position="pos", normal="nn"))
    g = tb.GBuffer.load(tmp_path / "a.exr", sphere_camera((12, 18)))
    expected = ball.mask.clone()
    expected[5, 8] = expected[6, 9] = expected[6, 8] = False
    assert ball.mask[5, 8]
    assert ball.mask[6, 8:10].all()
    assert torch.equal(g.mask, expected)
    for name, tensor, _ in g.own_tensors():
        assert torch.isfinite(tensor.float()).all(), name


def test_averaged_ids_mean_nothing(tmp_path, ball):
    channels = channels_of(ball, position="pos", normal="nn", triangle="id")
    ids = torch.full((12, 18), 7.0)
    ids[6, 9] = 6.5
    g_ids = (write_exr(tmp_path / "a.exr", channels | {"id.I": ids}), tb.GBuffer.load(tmp_path / "a.exr"))[1].triangle
    assert g_ids[6, 9] == -1
    assert g_ids[6, 8] == 7


def test_a_missing_and_a_damaged_file_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"gone\.exr"):
        tb.GBuffer.load(tmp_path / "gone.exr")
    (tmp_path / "bad.exr").write_bytes(b"no picture")
    with pytest.raises(ValueError, match=r"bad\.exr is damaged"):
        tb.GBuffer.load(tmp_path / "bad.exr")


def test_names_do_not_make_our_own_file_another_renderers(tmp_path, capsys):
    """The file says whose it is, whatever the caller says about layers."""
    g = sphere_gbuffer()
    g.save(tmp_path / "g.exr")
    again = tb.GBuffer.load(tmp_path / "g.exr", names={"position": "position", "normal": "geometric_normal", "view": "view"})
    for name, tensor, _ in g.replace(normal=g.geometric_normal).own_tensors():
        assert torch.equal(getattr(again, name), tensor), name
    assert capsys.readouterr().out == "g.exr: own G-buffer; view as stored\n"
    for names, message in [
        ({"position": "P"}, r"names: no channels \['P.X', 'P.Y', 'P.Z'\] for the position; the file has layers"),
        ({"normal": "uv"}, r"names: no channels \['uv.X', 'uv.Y', 'uv.Z'\] for the normal; the file has layers"),
        ({"albedo": "uv"}, r"names: unknown fields \['albedo'\], legal are \['barycentric', "),
    ]:
        with pytest.raises(ValueError, match=message):
            tb.GBuffer.load(tmp_path / "g.exr", names=names)
