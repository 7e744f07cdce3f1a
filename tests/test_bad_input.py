"""Bad input gives one clear error each: it names the argument, what was found, what is legal, and what to do."""

import math

import pytest
import torch
import trimesh

import torchbrdf as tb

UP = torch.tensor([0.0, 0.0, 1.0])
SUN = tb.DirectionalLight([0.0, 0.0, 1.0], 1.0)


def g(**changes):
    fields = {"position": torch.zeros(4, 5, 3), "normal": UP.expand(4, 5, 3), "view": UP.expand(4, 5, 3)}
    return tb.GBuffer(**{**fields, **changes})


def square(*size):
    shape = (*size, size[-1], 3)
    return g(position=torch.zeros(shape), normal=UP.expand(shape), view=UP.expand(shape))


def plane(**changes):
    """Points that all differ."""
    y, x = torch.meshgrid(torch.linspace(1, -1, 8), torch.linspace(-1, 1, 9), indexing="ij")
    return g(**{"position": torch.stack([x, y, 0 * x], -1), "normal": UP, "view": UP, **changes})


def waves():
    x, y, _ = plane().position.unbind(-1)
    return tb.normalize(torch.stack([x, torch.sin(2 * y), torch.ones_like(x)], -1))


def box(**changes):
    b = trimesh.creation.box()
    return tb.Mesh(**{"vertices": torch.tensor(b.vertices, dtype=torch.float32), "faces": torch.tensor(b.faces), **changes})


def camera(size=(4, 4)):
    return tb.Camera.look_at([0.0, 0.0, 3.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], 40.0, size)


def nan_vertices():
    v = box().vertices.clone()
    v[2, 1] = math.nan
    return box(vertices=v)


def shade(**changes):
    return tb.shade(**{"g": g(), "bsdf": tb.Lambert(0.5), "lights": SUN, **changes})


def broken(tmp_path, name, content=b"this is no picture"):
    (tmp_path / name).write_bytes(content)
    return tmp_path / name


def cut(tmp_path, name):
    """A picture whose file ends half way."""
    tb.save_image(tmp_path / "whole.exr", torch.rand(16, 16, 3))
    if name.endswith(".exr"):
        whole = (tmp_path / "whole.exr").read_bytes()
    elif name.endswith(".png"):
        tb.save_image(tmp_path / "whole.png", torch.rand(16, 16, 3))
        whole = (tmp_path / "whole.png").read_bytes()
    else:
        whole = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 16 +X 16\n" + bytes(16 * 16 * 4)
    return broken(tmp_path, name, whole[: len(whole) // 2])


def not_a_value(tmp_path):
    torch.save({"weights": torch.zeros(3)}, tmp_path / "weights.pt")
    return tmp_path / "weights.pt"


META = torch.rand(4, 5, 3, device="meta")
# name: (what is done, the error, what its message must say, in this order)
CASES = {
    # files
    "no mesh file": (lambda t: tb.load_mesh(t / "absent.obj"), FileNotFoundError, "load_mesh: no such file: .*absent.obj"),
    "mesh file without faces": (lambda t: trimesh.PointCloud([[0.0, 0, 0], [1, 0, 0]]).export(t / "p.ply") and tb.load_mesh(t / "p.ply"), ValueError, "load_mesh: .*p.ply holds no faces .*export it as a triangle mesh"),
    "no EXR": (lambda t: tb.read_image(t / "absent.exr"), FileNotFoundError, "read_image: no such file: .*absent.exr"),
    "no G-buffer": (lambda t: tb.GBuffer.load(t / "absent.exr"), FileNotFoundError, "no such file: .*absent.exr"),
    "no environment": (lambda t: tb.EnvironmentMap.load(t / "absent.hdr"), FileNotFoundError, "no such file: .*absent.hdr"),
    "damaged EXR": (lambda t: tb.read_image(broken(t, "b.exr")), ValueError, "b.exr is damaged, truncated or not an EXR"),
    "half an EXR": (lambda t: tb.read_image(cut(t, "c.exr")), ValueError, "c.exr is damaged, truncated or not an EXR"),
    "damaged HDR": (lambda t: tb.read_image(broken(t, "b.hdr")), ValueError, "b.hdr is damaged, truncated or not a Radiance picture"),
    "half an HDR": (lambda t: tb.read_image(cut(t, "c.hdr")), ValueError, "c.hdr is damaged, truncated or not a Radiance picture"),
    "damaged PNG": (lambda t: tb.read_image(broken(t, "b.png")), ValueError, "b.png is damaged, truncated or no picture"),
    "half a PNG": (lambda t: tb.read_image(cut(t, "c.png")), ValueError, "c.png is damaged, truncated or no picture"),
    "no saved value": (lambda t: tb.load_value(t / "absent.pt"), FileNotFoundError, "load_value: no such file: .*absent.pt"),
    "a file that is no saved value": (lambda t: tb.load_value(broken(t, "b.pt")), ValueError, "load_value: .*b.pt is not a saved torchbrdf value"),
    "weights are no saved value": (lambda t: tb.load_value(not_a_value(t)), ValueError, "not a saved torchbrdf value"),
    # meshes and cameras
    "no faces": (lambda t: box(faces=torch.zeros(0, 3, dtype=torch.int64)), ValueError, "Mesh.faces: found no faces; a mesh needs at least one triangle"),
    "NaN vertices": (lambda t: tb.GBuffer.from_mesh(nan_vertices(), camera()), ValueError, "Mesh.vertices: 1 of 8 are NaN or infinite; remove"),
    "NaN vertices cast shadows": (lambda t: shade(mesh=nan_vertices()), ValueError, "Mesh.vertices: 1 of 8 are NaN or infinite; remove"),
    "camera size 0": (lambda t: camera((0, 4)), ValueError, r"Camera.size: expected \(height, width\), two positive whole numbers, found \(0, 4\)"),
    "camera size 1.5": (lambda t: camera((1.5, 4)), ValueError, r"Camera.size: expected .* found \(1.5, 4\)"),
    "camera size 4": (lambda t: camera(4), ValueError, r"Camera.size: expected \(height, width\).* found 4"),
    "unknown camera convention": (lambda t: tb.Camera.from_matrix(torch.eye(3), torch.eye(4), (4, 4), convention="maya"), ValueError, r"unknown convention 'maya', legal are \['blender', 'mitsuba', 'opencv', 'opengl'\]"),
    # sizes of every kind of parameter
    "size 1": (lambda t: tb.Phong(0.5, torch.ones(4, 5)), ValueError, r"Phong.exponent: expected shape \[..., 1\], found \[4, 5\]; did you mean x.unsqueeze\(-1\)"),
    "size 2": (lambda t: g(uv=torch.zeros(4, 5, 3)), ValueError, r"GBuffer.uv: expected shape \[..., 2\], found \[4, 5, 3\]"),
    "size 3": (lambda t: g(normal=torch.zeros(4, 5, 2)), ValueError, r"GBuffer.normal: expected shape \[..., 3\], found \[4, 5, 2\]"),
    "size 3 of a light": (lambda t: tb.PointLight([0.0, 1.0], 1.0), ValueError, r"PointLight.position: expected shape \[..., 3\], found \[2\]"),
    "size 1 of a mask": (lambda t: g(mask=torch.ones(4, 5, dtype=torch.bool)), ValueError, r"GBuffer.mask: expected shape \[..., 1\], found \[4, 5\]; did you mean x.unsqueeze"),
    "size C": (lambda t: tb.Phong(torch.rand(3), 1.0) + tb.Lambert(torch.rand(4)), ValueError, r"different numbers of colour channels: .*3.*4.*use one C, or 1"),
    "size C within a model": (lambda t: tb.Conductor(torch.ones(3), torch.ones(2)), ValueError, r"Conductor: colour parameters have different numbers of channels: .*3.*2.*use one C, or 1"),
    "size C of a Fresnel term": (lambda t: tb.Phong([1.0] * 3, 5.0, fresnel=tb.Schlick([0.1] * 4)), ValueError, r"Phong: different numbers of colour channels: .*'own parameters': 3.*Schlick': 4.*; use one C, or 1"),
    "size of u for two lobes": (lambda t: (tb.Lambert(0.5) + tb.Phong(0.5, 9.0)).sample(UP, torch.rand(2)), ValueError, r"found \[2\], the third chooses among the 2 lobes: torch.rand\(..., 3\)"),
    "size C of a light": (lambda t: shade(bsdf=tb.Lambert(torch.rand(8)), lights=[SUN, tb.PointLight(UP, torch.ones(3))]), ValueError, r"bsdf and lights have different numbers of colour channels: .*'bsdf': 8, .*'lights\[1\]': 3.*; use one C, or 1"),
    "size of u": (lambda t: tb.Lambert(0.5).sample(UP, torch.rand(4)), ValueError, r"u: expected shape \[..., 3\] of numbers in \[0, 1\), found \[4\]"),
    "size of wi": (lambda t: tb.Lambert(0.5).evaluate(torch.rand(2), UP), ValueError, r"wi: expected shape \[..., 3\], found \[2\]"),
    "size of cos_i": (lambda t: tb.Schlick(0.04).reflectance(torch.rand(2)), ValueError, r"cos_i: expected shape \[..., 1\], found \[2\]; did you mean cos_i.unsqueeze"),
    "kind of mask": (lambda t: g(mask=torch.ones(4, 5, 1)), TypeError, r"GBuffer.mask: expected a tensor of bools, found torch.float32; compare it, for example x > 0.5"),
    "mask of bytes": (lambda t: g(mask=torch.ones(4, 5, 1, dtype=torch.uint8)), TypeError, r"GBuffer.mask: expected a tensor of bools, found torch.uint8; compare it, for example x > 0.5"),
    "ids of floats": (lambda t: g(material=torch.ones(4, 5, 1)), TypeError, r"GBuffer.material: expected a tensor of ints, found torch.float32; round it: x.round\(\).to\(torch.int64\)"),
    "normals channels first": (lambda t: g(normal=torch.rand(3, 4, 5)), ValueError, r"GBuffer.normal: expected shape \[..., 3\], found \[3, 4, 5\]; did you mean x.movedim\(-3, -1\) -> \[4, 5, 3\]"),
    "bytes for an albedo": (lambda t: tb.Lambert(torch.ones(4, 5, 3, dtype=torch.uint8)), TypeError, r"Lambert.albedo: expected a tensor of floats, found torch.uint8; bytes of a picture become x / 255 .*tb.read_image"),
    "a map without channels": (lambda t: shade(bsdf=tb.Lambert(torch.rand(4, 5))), ValueError, r"Lambert.albedo: expected shape \[..., C\], found \[4, 5\] beside the G-buffer's position; a map without channels is x\[..., None\] -> \[4, 5, 1\]"),
    "a map in a sum": (lambda t: shade(bsdf=tb.Lambert(0.5) + 0.5 * tb.Phong(torch.rand(4, 5), 2.0)), ValueError, r"Phong.specular: expected shape \[..., C\], found \[4, 5\]"),
    "a square map without channels": (lambda t: shade(g=square(6), bsdf=tb.Lambert(torch.rand(6, 6))), ValueError, r"Lambert.albedo: .*found \[6, 6\] .*a map without channels is x\[..., None\]"),
    "a map for several views": (lambda t: shade(g=square(2, 6), bsdf=tb.Lambert(torch.rand(6, 6))), ValueError, r"Lambert.albedo: .*found \[6, 6\] .*x\[..., None\] -> \[6, 6, 1\]"),
    "a square picture channels first": (lambda t: shade(g=square(6), bsdf=tb.Lambert(torch.rand(1, 6, 6))), ValueError, r"Lambert.albedo: .*found \[1, 6, 6\] .*channels come last: x.movedim\(-3, -1\) -> \[6, 6, 1\]"),
    "a picture channels first": (lambda t: shade(bsdf=tb.Lambert(torch.rand(3, 4, 5))), ValueError, r"Lambert.albedo: .*found \[3, 4, 5\] .*channels come last: x.movedim\(-3, -1\) -> \[4, 5, 3\]"),
    "pictures channels first": (lambda t: shade(g=square(2, 6), bsdf=tb.Lambert(torch.rand(2, 3, 6, 6))), ValueError, r"Lambert.albedo: .*channels come last: x.movedim\(-3, -1\) -> \[2, 6, 6, 3\]"),
    "a picture with alpha": (lambda t: shade(bsdf=tb.Lambert(torch.rand(4, 5, 4)), lights=tb.PointLight(UP, torch.ones(3))), ValueError, r"different numbers of colour channels: .*use one C, or 1 \(alpha is no colour: x\[..., :3\]\)"),
    "a picture with alpha beside another": (lambda t: tb.Lambert(torch.rand(4, 5, 4)) + tb.Phong(torch.rand(3), 2.0), ValueError, r"\(alpha is no colour: x\[..., :3\]\)"),
    "a picture channels first beside another": (lambda t: tb.Conductor(torch.rand(3, 4, 5), torch.rand(3)), ValueError, r"use one C, or 1 \(channels come last: x.permute\(1, 2, 0\)\)"),
    "a camera's position for the view": (lambda t: shade(g=plane(view=torch.tensor([0.0, 0.0, 4.0]).expand(8, 9, 3))), ValueError, r"GBuffer.view: points at different positions have one view, of length 4; .*tb.normalize\(camera.origin - g.position\); of parallel rays, tb.normalize\(view\)"),
    "cameras' positions for the views": (lambda t: shade(g=plane(view=torch.tensor([[0.0, 0.0, 4.0], [0.0, 1.0, 3.0]])[:, None, None])), ValueError, r"GBuffer.view: points at different positions have one view, of length"),
    "a camera's position, looked at alone": (lambda t: tb.validate(plane(view=torch.tensor([0.0, 0.0, 4.0]))), ValueError, r"GBuffer.view: points at different positions have one view"),
    "a normal map": (lambda t: shade(g=plane(normal=0.5 * waves() + 0.5)), ValueError, r"GBuffer.normal: no component is negative, and 2 \* normal - 1 has unit length: a normal map stored in \[0, 1\]; decode it: tb.normalize\(2 \* normal - 1\)"),
    "a normal map of eight bits": (lambda t: shade(g=plane(normal=(127.5 * waves() + 127.5).round() / 255)), ValueError, r"a normal map stored in \[0, 1\]"),
    "a normal map of bytes": (lambda t: shade(g=plane(normal=(127.5 * waves() + 127.5).round())), ValueError, r"a normal map stored in \[0, 255\]; decode it: tb.normalize\(normal / 127.5 - 1\)"),
    "kind of position": (lambda t: g(position=torch.zeros(4, 5, 3, dtype=torch.int64)), TypeError, r"GBuffer.position: expected a tensor of floats, found torch.int64; convert it"),
    "a word for a number": (lambda t: tb.Lambert("red"), TypeError, r"Lambert.albedo: expected a number, list, array or tensor, found str"),
    # values
    "exponent -1": (lambda t: shade(bsdf=tb.Phong(0.5, -1.0)), ValueError, r"Phong.exponent \[1\]: legal range \[0, inf\), found -1 .*clamp or re-parametrise"),
    "albedo 1.2": (lambda t: shade(bsdf=tb.Lambert([0.5, 1.2, 1.5])), ValueError, r"Lambert.albedo \[3\]: legal range \[0, 1\], found 1.2 and 1 more \(min 0.5, max 1.5\); clamp"),
    "NaN parameter": (lambda t: shade(bsdf=tb.Lambert(torch.full((4, 5, 1), math.nan))), ValueError, r"Lambert.albedo \[4, 5, 1\]: legal range \[0, 1\], found nan and 19 more"),
    "eta 0 within": (lambda t: shade(bsdf=tb.Lambert(0.5) + tb.Phong(0.2, 3.0, fresnel=tb.Dielectric(0.0))), ValueError, r"Sum > Phong > Dielectric.eta \[1\]: legal range \(0, inf\), found 0"),
    "negative light": (lambda t: shade(lights=tb.PointLight(UP, [1.0, -1.0])), ValueError, r"PointLight.intensity .*legal range \[0, inf\), found -1"),
    "plan looks too": (lambda t: tb.plan(g(), tb.Lambert(1.2), SUN), ValueError, r"Lambert.albedo \[1\]: legal range \[0, 1\], found 1.2"),
    "validate looks too": (lambda t: tb.validate(tb.Lambert(1.2)), ValueError, r"Lambert.albedo \[1\]: legal range \[0, 1\], found 1.2"),
    # lights
    "lights of mismatched batch": (lambda t: tb.PointLight(torch.zeros(3, 3), torch.ones(2, 3)), ValueError, r"PointLight: batch shapes do not broadcast: .*\(3,\).*\(2,\)"),
    "views of lights": (lambda t: shade(lights=tb.PointLight(torch.rand(3, 2, 3), 1.0)), ValueError, r"PointLight: batch shape \[3, 2\], read as \[3\] views with 2 lights each, does not fit a G-buffer of \[4, 5\]"),
    "no lights": (lambda t: shade(lights=[]), ValueError, r"lights: found none; pass at least one, such as"),
    "what is no light": (lambda t: shade(lights=[SUN, UP]), TypeError, r"lights\[1\]: expected a light such as tb.PointLight.*, found Tensor"),
    "a list in a list": (lambda t: shade(lights=[[SUN]]), TypeError, r"lights\[0\]: expected a light such as .*, found list"),
    "a number for lights": (lambda t: shade(lights=3.0), TypeError, r"lights: expected a light or a list of lights such as .*, found float"),
    "environment convention": (lambda t: tb.EnvironmentMap(torch.ones(2, 4, 3), convention="maya"), ValueError, r"EnvironmentMap.convention: found 'maya', legal are \['blender', 'mitsuba', 'nvdiffrec'\]"),
    "environment for a glossy lobe": (lambda t: shade(lights=tb.EnvironmentMap(torch.ones(2, 4, 3))), ValueError, r"lights: .*EnvironmentMap lights mirror lobes alone, .*shade the parts apart"),
    # devices and dtypes
    "device of a parameter": (lambda t: shade(bsdf=tb.Lambert(META)), TypeError, r"Lambert.albedo: float32 on meta beside the G-buffer's position: float32 on cpu; convert one with .to"),
    "device of an unbatched parameter": (lambda t: shade(bsdf=tb.Lambert(META[0, 0])), TypeError, r"Lambert.albedo: float32 on meta beside the G-buffer's position"),
    "device of a light": (lambda t: shade(lights=tb.PointLight(META[0, 0], 1.0)), TypeError, r"PointLight.position: float32 on meta beside the G-buffer's position: float32 on cpu; convert one with .to"),
    "device of a visibility": (lambda t: shade(visibility=META[None, ..., :1]), TypeError, r"visibility: on meta beside a G-buffer on cpu; convert it with .to"),
    "device of the view": (lambda t: shade(g=g(view=META)), TypeError, r"GBuffer.view: float32 on meta beside position: float32 on cpu; convert one with .to"),
    "dtype of a parameter": (lambda t: shade(bsdf=tb.Lambert(torch.rand(4, 5, 3).double())), TypeError, r"Lambert.albedo: float64 on cpu beside the G-buffer's position: float32 on cpu; convert one with .to"),
    "dtype of the normal": (lambda t: shade(g=g(normal=UP.double().expand(4, 5, 3))), TypeError, r"GBuffer.normal: float64 on cpu beside position: float32 on cpu; convert one with .to"),
    "dtype of wo": (lambda t: tb.Lambert(0.5).evaluate(UP, UP.double()), TypeError, r"wo: float64 on cpu beside wi: float32 on cpu; convert one with .to"),
    "dtype in sample": (lambda t: tb.Lambert(torch.rand(4, 3)).sample(UP.double(), torch.rand(2).double()), TypeError, r"Lambert.albedo: float32 on cpu beside wo: float64 on cpu; convert one with .to"),
    "dtype in evaluate": (lambda t: tb.Lambert(torch.rand(4, 3)).evaluate(UP.double(), UP.double()), TypeError, r"Lambert.albedo: float32 on cpu beside wi: float64 on cpu; convert one with .to"),
    "device in evaluate": (lambda t: tb.Lambert(META).evaluate(UP, UP), TypeError, r"Lambert.albedo: float32 on meta beside wi: float32 on cpu; convert one with .to"),
    # names and switches
    "normalization": (lambda t: tb.Phong(0.5, 2.0, normalization="half"), ValueError, r"Phong.normalization: found 'half', legal are \['bound', 'modified', 'none'\]"),
    "wrap": (lambda t: tb.nn.Texture(torch.rand(2, 2, 3), wrap="mirror"), ValueError, r"Texture.wrap: found 'mirror', legal are \('repeat', 'clamp'\)"),
    "shadow": (lambda t: shade(shadow="soft"), ValueError, r"shadow: found 'soft', legal are 'auto' and 'off'"),
    "tolerance": (lambda t: tb.plan(g(), tb.Lambert(0.5), SUN, tolerance=0.01), ValueError, r"tolerance: found 0.01; .*leave it None"),
    "what is no Fresnel term": (lambda t: tb.Phong(0.5, 2.0, fresnel=0.04), TypeError, r"Phong.fresnel: expected a Fresnel term such as Schlick\(f0\) or None, found float"),
    "what is no BSDF": (lambda t: shade(bsdf=tb.Schlick(0.04)), TypeError, r"bsdf: expected a BSDF such as tb.Lambert\(albedo\), found Schlick"),
    "what is no G-buffer": (lambda t: shade(g=box()), TypeError, r"g: expected a G-buffer such as tb.GBuffer.from_mesh\(mesh, camera\), found Mesh"),
    "what is no mesh": (lambda t: shade(mesh="spot.obj"), TypeError, r"mesh: expected a mesh such as tb.load_mesh\(path\), found str"),
    # shapes of a scene
    "no view": (lambda t: shade(g=g(view=None)), ValueError, r"GBuffer.view is missing: .*GBuffer.from_mesh.*or set it: g.replace\(view="),
    "material batch": (lambda t: shade(bsdf=tb.Lambert(torch.rand(4, 6, 3))), ValueError, r"bsdf: parameters of batch shape \[4, 6\] do not fit a G-buffer of \[4, 5\]; give"),
    "a batch that would grow the image": (lambda t: shade(bsdf=tb.Lambert(torch.rand(2, 4, 5, 3))), ValueError, r"bsdf: parameters of batch shape \[2, 4, 5\] do not fit a G-buffer of \[4, 5\].* or shade many materials: torch.vmap"),
    "G-buffer batch": (lambda t: g(view=torch.zeros(3, 5, 3)), ValueError, r"GBuffer: batch shapes do not broadcast: .*view"),
    "rows of visibility": (lambda t: shade(visibility=torch.ones(2, 4, 5, 1)), ValueError, r"visibility: expected shape \[1, 4, 5, 1\], .* found \[2, 4, 5, 1\]; compute it with tb.visibility"),
    "pixels of visibility": (lambda t: shade(visibility=torch.ones(1, 5, 4, 1)), ValueError, r"visibility: expected shape \[1, 4, 5, 1\], .* found \[1, 5, 4, 1\]"),
    "trailing axis of visibility": (lambda t: shade(visibility=torch.ones(1, 4, 5)), ValueError, r"visibility: expected shape \[1, 4, 5, 1\], .* found \[1, 4, 5\]"),
    "visibility that would grow the image": (lambda t: shade(visibility=torch.ones(1, 2, 4, 5, 1)), ValueError, r"visibility: expected shape \[1, 4, 5, 1\], .* found \[1, 2, 4, 5, 1\]"),
    "visibility that is no tensor": (lambda t: shade(visibility=1.0), TypeError, r"visibility: expected a tensor such as tb.visibility\(g, lights, mesh\), found float"),
    # learning
    "texture without uv": (lambda t: tb.nn.Texture(torch.rand(2, 2, 3))(g()), ValueError, r"Texture: this G-buffer has no uv; give the mesh texture coordinates, or use"),
    "PerMaterial without ids": (lambda t: tb.nn.PerMaterial(torch.rand(2, 3))(g()), ValueError, r"PerMaterial: this G-buffer has no material ids; load a mesh with"),
    "texels": (lambda t: tb.nn.Texture(torch.rand(2, 2)), ValueError, r"Texture.texels: expected shape \[Ht, Wt, C\] with pixels in it, found \[2, 2\]; a map without channels is x\[..., None\]"),
    "table": (lambda t: tb.nn.PerMaterial(torch.rand(2)), ValueError, r"PerMaterial.table: expected shape \[M, C\], .*found \[2\]"),
    "srgb of four channels": (lambda t: tb.nn.Texture(torch.rand(2, 2, 4), srgb=True), ValueError, r"Texture.srgb: decodes 1 or 3 channels, found 4; put the others"),
    "field of words": (lambda t: tb.nn.Learned("red"), TypeError, r"Learned: expected a number, list, array or tensor, found str"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_one_clear_error(case, tmp_path):
    call, kind, message = CASES[case]
    with pytest.raises(kind, match=message) as caught:
        call(tmp_path)
    assert type(caught.value) is kind
    assert "\n" not in str(caught.value).strip()
    assert caught.value.__cause__ is None, "one error, not a chain of them"
