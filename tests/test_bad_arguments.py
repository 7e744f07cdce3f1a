"""Every public entry, every argument, everything that it may not be: one error that names the argument and says what to do.

(:mod:`test_bad_input` has the messages of everyday mistakes word by word; here nothing is left out.)
"""

import math
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

import torchbrdf as tb

UP = torch.tensor([0.0, 0.0, 1.0])
BOX = trimesh.creation.box()
MESH = tb.Mesh(torch.tensor(BOX.vertices).float(), torch.tensor(BOX.faces))
CAMERA = tb.Camera.look_at([0.0, 0.0, 3.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], 40.0, (4, 4))
SUN = tb.DirectionalLight([0.0, 0.0, 1.0], 1.0)
LAMBERT, PHONG, SKY = tb.Lambert(0.5), tb.Phong(0.5, 2.0), tb.EnvironmentMap(torch.ones(2, 4, 3))
TEXTURE = tb.nn.Texture(torch.rand(2, 2, 3))
MATERIAL = tb.nn.Material(tb.Lambert, albedo=0.5)


def g(**changes):
    fields = {"position": torch.zeros(4, 5, 3), "normal": UP.expand(4, 5, 3), "view": UP.expand(4, 5, 3)}
    return tb.GBuffer(**{**fields, **changes})


PLAN = tb.plan(g(), LAMBERT, SUN)

# What is no tensor of floats, by name.
NO_TENSORS = {
    "a list": [0.0, 0.0, 1.0],
    "a number": 1.0,
    "a word": "up",
    "an array": UP.numpy(),
}
NO_FLOATS = {
    "whole numbers": torch.tensor([0, 0, 1]),
    "bools": UP > 0,
    "complex numbers": UP.to(torch.complex64),
    "eight bits": UP.to(torch.float8_e4m3fn),
    "sparse": UP.to_sparse(),
}
NO_VECTORS = {"four components": torch.ones(4), "no component": torch.tensor(1.0), "an empty axis": torch.ones(5, 0)}
ELSEWHERE = {"another device": UP.to("meta")}

# Arguments that must be tensors [..., 3]: name of the argument -> call. Those of values take lists and arrays as well.
VECTORS = {
    "wi": lambda x: LAMBERT.evaluate(x, UP),
    "wo": lambda x: PHONG.evaluate(UP, x),
    "n": lambda x: LAMBERT.evaluate(UP, UP, x),
    "tangent": lambda x: (LAMBERT + PHONG).evaluate(UP, UP, UP, x),
    "wi of pdf": lambda x: PHONG.pdf(x, UP),
    "wo of sample": lambda x: PHONG.sample(x, torch.rand(2)),
    "n of sample": lambda x: PHONG.sample(UP, torch.rand(2), x),
    "w of directional_albedo": lambda x: PHONG.directional_albedo(x),
    "w of Lambert's": lambda x: LAMBERT.directional_albedo(x),
    "points": lambda x: SUN.sample(x),
    "points of PointLight": lambda x: tb.PointLight(UP, 1.0).sample(x),
    "wi of radiance": lambda x: SKY.radiance(x),
    "points of project": lambda x: CAMERA.project(x),
}
PARAMETERS = {
    "GBuffer.position": lambda x: tb.shade(g(position=x), LAMBERT, SUN),
    "GBuffer.normal": lambda x: tb.shade(g(normal=x), LAMBERT, SUN),
    "GBuffer.view": lambda x: tb.shade(g(view=x), LAMBERT, SUN),
    "GBuffer.tangent": lambda x: tb.shade(g(tangent=x), LAMBERT, SUN),
    "GBuffer.geometric_normal": lambda x: tb.shade(g(geometric_normal=x), LAMBERT, SUN),
    "PointLight.position": lambda x: tb.shade(g(), LAMBERT, tb.PointLight(x, 1.0)),
    "DirectionalLight.direction": lambda x: tb.shade(g(), LAMBERT, tb.DirectionalLight(x, 1.0)),
    "Camera.origin": lambda x: tb.GBuffer.from_mesh(MESH, CAMERA.replace(origin=x)),
}


def table(arguments, *wrong):
    return [(name, call, kind, x) for name, call in arguments.items() for group in wrong for kind, x in group.items()]


@pytest.mark.parametrize(
    ("name", "call", "kind", "wrong"),
    [
        *table(VECTORS, NO_TENSORS, NO_FLOATS, NO_VECTORS),
        *table({k: v for k, v in VECTORS.items() if k in ("wo", "n", "tangent", "n of sample")}, ELSEWHERE),
        *table(PARAMETERS, {"a word": "up"}, NO_FLOATS, NO_VECTORS, ELSEWHERE),
    ],
    ids=lambda x: x if isinstance(x, str) else "",
)
def test_a_vector(name, call, kind, wrong):
    # A device is wrong beside another one, and the message names whichever argument is read second.
    expected = r"GBuffer\.|camera: " if kind == "another device" and name in PARAMETERS else name.split()[0]
    if name in ("PointLight.position", "DirectionalLight.direction") and kind == "another device":
        expected = name
    with pytest.raises((TypeError, ValueError), match=rf"^({expected}).*(expected|beside|meta).*(found|convert|move)") as caught:
        call(wrong)
    assert "\n" not in str(caught.value)
    assert caught.value.__cause__ is None


NAN = math.nan
# name of the call: (call, what the message must say)
CASES = {
    # models
    "Lambert None": (lambda: tb.Lambert(None), r"Lambert.albedo: expected a number, .* found None"),
    "Lambert without channels": (lambda: tb.Lambert(torch.ones(4, 0)), r"Lambert.albedo: expected shape \[..., C\] with one channel at least, found \[4, 0\]"),
    "Phong exponent of two": (lambda: tb.Phong(0.5, torch.rand(4, 5, 2)), r"Phong.exponent: expected shape \[..., 1\], found \[4, 5, 2\]"),
    "TwoSided of a number": (lambda: tb.TwoSided(0.5), "TwoSided.inside: expected a BSDF such as .*found float"),
    "TwoSided with a number": (lambda: tb.TwoSided(LAMBERT, 0.5), "TwoSided.outside: expected a BSDF such as .*found float"),
    "Phong fresnel": (lambda: tb.Phong(0.5, 2.0, fresnel="schlick"), "Phong.fresnel: expected a Fresnel term such as .*found str"),
    "Phong fresnel module": (lambda: tb.Phong(0.5, 2.0, fresnel=MATERIAL), "Phong.fresnel: expected a Fresnel term such as .*found Material"),
    "Phong normalization": (lambda: tb.Phong(0.5, 2.0, normalization=[]), r"Phong.normalization: found \[\], legal are"),
    "BlinnPhong specular": (lambda: tb.validate(tb.BlinnPhong(1.5, 2.0)), r"BlinnPhong.specular \[1\]: legal range \[0, 1\], found 1.5"),
    "BlinnPhong exponent": (lambda: tb.validate(tb.BlinnPhong(0.5, -2.0)), r"BlinnPhong.exponent \[1\]: legal range \[0, inf\), found -2"),
    "SmoothDielectric index": (lambda: tb.validate(tb.SmoothDielectric(0.0)), r"SmoothDielectric.eta \[1\]: legal range \(0, inf\), found 0"),
    "SmoothDielectric indices": (
        lambda: tb.SmoothDielectric([1.51, 1.52, 1.53]),
        r"SmoothDielectric.eta: expected shape \[..., 1\], found \[3\]; every channel would be refracted elsewhere",
    ),
    "SmoothDielectric mode": (lambda: tb.SmoothDielectric(1.5, "importance"), "SmoothDielectric.mode: .*importance"),
    "SmoothDielectric part": (lambda: tb.SmoothDielectric(1.5, part="refraction"), "SmoothDielectric.part: .*refraction"),
    "Coated number": (lambda: tb.Coated(0.5, 1.5), "Coated.base: expected a BSDF such as .*found float"),
    "Coated mirror": (lambda: tb.Coated(tb.Mirror(1.0), 1.5), "Coated.base: expected .*diffuse reflection alone, found delta reflection of Mirror"),
    "Coated gloss": (lambda: tb.Coated(LAMBERT, 1.5, gloss=0.5), "Coated.gloss: .*0.5"),
    "CookTorrance normalization": (lambda: tb.CookTorrance(0.5, 0.5, 0.3, normalization="1981"), "CookTorrance.normalization: found '1981', legal are"),
    "CookTorrance share": (lambda: tb.validate(tb.CookTorrance(0.5, 1.5, 0.3)), r"CookTorrance.specular \[1\]: legal range \[0, 1\], found 1.5"),
    "Principled roughness": (lambda: tb.validate(tb.Principled(0.5, 0, 0.0)), r"Principled.roughness \[1\]: legal range \(0, 1\], found 0"),
    "Sheen roughness": (lambda: tb.validate(tb.Sheen(0.5, 0.0)), r"Sheen.roughness \[1\]: legal range \(0, 1\], found 0"),
    "Principled part": (lambda: tb.Principled(0.5, parts=["coat"]), r"Principled.parts: found \('coat',\), of this material there are"),
    "Mirror tint": (lambda: tb.validate(tb.Mirror(-0.1)), r"Mirror.tint \[1\]: legal range \[0, 1\], found -0.1"),
    "Mirror fresnel": (lambda: tb.Mirror(1.0, fresnel=LAMBERT), "Mirror.fresnel: expected a Fresnel term such as .*found Lambert"),
    "Sum of nothing": (lambda: tb.Sum(()), r"Sum.terms: expected one BSDF or more, found \[\]"),
    "Sum of None": (lambda: tb.Sum(None), "Sum.terms: expected one BSDF or more, found NoneType"),
    "Sum of Fresnel terms": (lambda: tb.Sum((tb.Schlick(0.04),)), r"Sum.terms: expected one BSDF or more, found \['Schlick'\]"),
    "a sum with a number": (lambda: LAMBERT + 5, "unsupported operand"),
    "Scaled inner": (lambda: tb.Scaled(tb.Dielectric(1.5), 0.5), "Scaled.inner: expected a BSDF such as .*found Dielectric"),
    "Scaled by a word": (lambda: "bright" * LAMBERT, "Scaled.factor: expected a number, .*found str"),
    "Scaled by a model": (lambda: LAMBERT * LAMBERT, "Scaled.factor: expected a number, .*found Lambert"),
    "Scaled below 0": (lambda: tb.shade(g(), -1.0 * LAMBERT, SUN), r"Scaled.factor \[1\]: legal range \[0, inf\), found -1"),
    "Dielectric eta 0": (lambda: tb.validate(tb.Dielectric(0.0)), r"Dielectric.eta \[1\]: legal range \(0, inf\), found 0"),
    "Dielectric eta below 0": (lambda: tb.validate(tb.Dielectric(-1.5)), r"Dielectric.eta \[1\]: legal range \(0, inf\), found -1.5"),
    "Conductor k below 0": (lambda: tb.validate(tb.Conductor(0.2, -3.0)), r"Conductor.k \[1\]: legal range \[0, inf\), found -3"),
    "Schlick above 1": (lambda: tb.validate(tb.Schlick(1.5)), r"Schlick.f0 \[1\]: legal range \[0, 1\], found 1.5"),
    "a metal unknown": (lambda: tb.Conductor.named("Xx"), r"metal: found 'Xx', known are \['Ag'"),
    "a metal of a list": (lambda: tb.Conductor.named(["Cu"]), r"metal: found \['Cu'\], known are"),
    "wavelengths beyond": (lambda: tb.Conductor.named("Cu", (5.0,)), "wavelengths_um: found 5 um, the table of Cu covers"),
    "wavelengths NaN": (lambda: tb.Conductor.named("Cu", (NAN,)), "wavelengths_um: found nan um, the table of Cu covers"),
    "wavelengths of words": (lambda: tb.Conductor.named("Cu", "red"), "wavelengths_um: expected numbers in micrometres .*found 'red'"),
    "one wavelength": (lambda: tb.Conductor.named("Cu", 0.5), "wavelengths_um: expected numbers in micrometres .*found 0.5"),
    "u None": (lambda: PHONG.sample(UP, None), "u: expected a tensor of floats, found NoneType"),
    "u of whole numbers": (lambda: PHONG.sample(UP, torch.tensor([0, 0])), "u: expected a tensor of floats, found torch.int64"),
    "u elsewhere": (lambda: PHONG.sample(UP, torch.rand(2, device="meta")), "u: on meta beside wo on cpu"),
    "batch of u": (lambda: PHONG.sample(torch.rand(3, 3), torch.rand(4, 2)), r"batch shapes do not broadcast: .*'wo': \(3,\).*'u': \(4,\)"),
    "batches of directions": (lambda: LAMBERT.evaluate(torch.rand(3, 3), torch.rand(4, 3)), r"batch shapes do not broadcast: .*'wi': \(3,\), 'wo': \(4,\)"),
    "batch of parameters": (lambda: tb.Lambert(torch.rand(5, 3)).evaluate(torch.rand(4, 3), UP), r"batch shapes do not broadcast: .*'parameters': \(5,\)"),
    "order 0": (lambda: PHONG.directional_albedo(UP, order=0), "order: expected .* a whole number >= 1, found 0"),
    "order 1.5": (lambda: PHONG.directional_albedo(UP, order=1.5), "order: expected .* a whole number >= 1, found 1.5"),
    # values
    "validate a number": (lambda: tb.validate(5), "validate: expected a Value such as .*found int"),
    "validate a module": (lambda: tb.validate(MATERIAL), r"validate: expected a Value .*found Material; call the module .*module\(g\)"),
    "to whole numbers": (lambda: LAMBERT.to(torch.int64), "to: expected a floating dtype such as torch.float32, found torch.int64"),
    "save to nowhere": (lambda: LAMBERT.save("nowhere/x.pt"), "save: nowhere/x.pt: no such folder: nowhere"),
    "save to nothing": (lambda: LAMBERT.save(None), "save: expected the path of a file, found NoneType"),
    "stack one value": (lambda: tb.stack(LAMBERT), "stack: values: expected a list of values, found Lambert; pass \\[a, b\\]"),
    "stack a module": (lambda: tb.stack([torch.nn.ReLU()]), "stack: values\\[0\\]: expected values, tensors, .*, found ReLU; call the module"),
    "stack an object": (lambda: tb.stack([(LAMBERT, object())]), "stack: values\\[0\\]\\[1\\]: expected .*, found object; leave it out"),
    "stack along a word": (lambda: tb.stack([LAMBERT, LAMBERT], "up"), "stack: dim: expected a whole number, found 'up'"),
    "load_value None": (lambda: tb.load_value(None), "load_value: expected the path of a file, found NoneType"),
    # lights
    "a light at NaN": (lambda: tb.shade(g(), LAMBERT, tb.PointLight([NAN, 0.0, 0.0], 1.0)), r"PointLight.position \[1, 3\]: legal range .* found nan"),
    "an infinite light": (lambda: tb.shade(g(), LAMBERT, tb.DirectionalLight([0.0, 0.0, 1.0], math.inf)), r"DirectionalLight.irradiance \[1, 1\]: legal range .* found inf"),
    "lights in a grid": (lambda: tb.shade(g(), LAMBERT, tb.PointLight(torch.rand(2, 2, 3), torch.rand(2, 2, 1))), r"PointLight: batch shape \[2, 2\], read as \[2\] views with 2 lights each, does not fit a G-buffer of \[4, 5\]"),
    "a row of points channels first": (lambda: LAMBERT.evaluate(torch.rand(3, 5, 6), UP), r"wi: expected shape \[..., 3\], found \[3, 5, 6\]; did you mean x.movedim\(-3, -1\) -> \[5, 6, 3\]"),
    "bytes for directions": (lambda: LAMBERT.evaluate(UP.byte(), UP), r"wi: expected a tensor of floats, found torch.uint8; bytes of a picture become x / 255"),
    "bytes for texels": (lambda: tb.bilinear(torch.zeros(4, 4, 3, dtype=torch.uint8), torch.rand(5, 2)), r"texels: .*found torch.uint8; bytes of a picture become x / 255 .*tb.read_image"),
    "bytes for a texture": (lambda: tb.nn.Texture(torch.zeros(4, 4, 3, dtype=torch.uint8), srgb=True), r"Texture: found torch.uint8; bytes of a picture become x / 255 .*tb.read_image"),
    "bytes for a field": (lambda: tb.nn.Constant(np.zeros((4, 5, 3), np.uint8)), r"Constant: found torch.uint8; bytes of a picture become x / 255"),
    "bytes for a sky": (lambda: tb.EnvironmentMap(torch.ones(2, 4, 3, dtype=torch.uint8)), r"EnvironmentMap.texels: .*found torch.uint8; bytes of a picture become x / 255"),
    "a texture channels first": (lambda: tb.nn.Texture(torch.rand(3, 32, 40)), r"Texture.texels: expected shape \[Ht, Wt, C\] with pixels in it, found \[3, 32, 40\]; channels first\? x.permute\(1, 2, 0\) -> \[32, 40, 3\]"),
    "a sky channels first": (lambda: tb.EnvironmentMap(torch.rand(3, 16, 32)), r"EnvironmentMap.texels: .*found \[3, 16, 32\]; channels first\? x.permute"),
    "bilinear channels first": (lambda: tb.bilinear(torch.rand(4, 32, 40), torch.rand(5, 2)), r"texels: .*channels first\? x.permute\(1, 2, 0\) -> \[32, 40, 4\]"),
    "a batch of textures": (lambda: tb.nn.Texture(torch.rand(2, 8, 8, 3)), r"Texture.texels: .*found \[2, 8, 8, 3\]; take one picture of the batch"),
    "a grey sky": (lambda: tb.EnvironmentMap(torch.rand(4, 8)), r"EnvironmentMap.texels: expected shape \[..., Hm, Wm, C\], found \[4, 8\]; did you mean x.unsqueeze\(-1\) -> \[4, 8, 1\]"),
    "a map without channels": (lambda: LAMBERT.replace(albedo=torch.rand(5, 5)).evaluate(UP.expand(5, 5, 3), UP), r"Lambert.albedo: expected shape \[..., C\], found \[5, 5\] beside wi; a map without channels is x\[..., None\] -> \[5, 5, 1\]"),
    "lights None": (lambda: tb.shade(g(), LAMBERT, None), "lights: expected a light or a list of lights such as .*found NoneType"),
    "lights in a dictionary": (lambda: tb.shade(g(), LAMBERT, {"sun": SUN}), r"lights\[0\]: expected a light such as .*found str"),
    "a sky elsewhere": (lambda: SKY.to("meta").radiance(UP), "EnvironmentMap.texels: float32 on meta beside wi: float32 on cpu; convert one"),
    "a sky below 0": (lambda: tb.shade(g(), tb.Mirror(1.0), tb.EnvironmentMap(-torch.ones(2, 4, 3))), r"EnvironmentMap.texels .*legal range \[0, inf\), found -1"),
    "a sky turned and stretched": (lambda: tb.shade(g(), tb.Mirror(1.0), SKY.replace(to_world=2 * torch.eye(3))), r"EnvironmentMap.to_world \[3, 3\]: not a rotation; take the scale"),
    "a sky mirrored": (lambda: tb.validate(SKY.replace(to_world=-torch.eye(3))), r"EnvironmentMap.to_world \[3, 3\]: not a rotation; take the scale, or the mirroring"),
    "a sky turned by NaN": (lambda: tb.validate(SKY.replace(to_world=torch.full((3, 3), NAN))), r"EnvironmentMap.to_world \[3, 3\]: not a rotation"),
    "the convention of a sky": (lambda: tb.EnvironmentMap(torch.ones(2, 4, 3), convention=["mitsuba"]), r"EnvironmentMap.convention: found \['mitsuba'\], legal are"),
    "the scale of a sky": (lambda: tb.EnvironmentMap.load("sky.exr", scale=NAN), "scale: expected a finite number >= 0, found nan"),
    "a sky from nothing": (lambda: tb.EnvironmentMap.load(None), "read_image: expected the path of a file, found NoneType"),
    # meshes, cameras, G-buffers
    "Mesh vertices": (lambda: tb.Mesh(None, [[0, 1, 2]]), "Mesh.vertices: expected a number, .* found None"),
    "Mesh vertices of whole numbers": (lambda: tb.Mesh(torch.zeros(3, 3, dtype=torch.int64), [[0, 1, 2]]), "Mesh.vertices: expected a tensor of floats, found torch.int64"),
    "Mesh normals of faces beyond": (lambda: tb.Mesh(torch.rand(3, 3), [[0, 1, 9]]).shading_normals(), "Mesh.faces: legal are 0 to 2 .* found 0 to 9"),
    "Mesh normals of faces below": (lambda: tb.Mesh(torch.rand(3, 3), [[0, 1, -1]]).shading_normals(), "Mesh.faces: legal are 0 to 2 .* found -1 to 1"),
    "Mesh material below 0": (lambda: tb.GBuffer.from_mesh(MESH.replace(material=torch.full((12, 1), -5)), CAMERA), "Mesh.material: ids count from 0, found -5"),
    "load_mesh a number": (lambda: tb.load_mesh(5), "load_mesh: expected the path of a file, found int"),
    "load_mesh a folder": (lambda: tb.load_mesh("/"), "load_mesh: no such file: /"),
    "from_mesh a path": (lambda: tb.GBuffer.from_mesh("spot.obj", CAMERA), "mesh: expected a Mesh such as .*found str"),
    "from_mesh without a camera": (lambda: tb.GBuffer.from_mesh(MESH, None), "camera: expected a Camera such as .*found NoneType"),
    "from_mesh elsewhere": (lambda: tb.GBuffer.from_mesh(MESH.to("meta"), CAMERA), "Mesh.vertices: on the meta device"),
    "from_mesh seen from elsewhere": (lambda: tb.GBuffer.from_mesh(MESH, CAMERA.to("meta")), "camera: on the meta device"),
    "a camera at NaN": (lambda: tb.GBuffer.from_mesh(MESH, CAMERA.replace(origin=[NAN, 0.0, 0.0])), r"Camera.origin \[3\]: legal range .* found nan"),
    "a focal length below 0": (lambda: tb.GBuffer.from_mesh(MESH, CAMERA.replace(focal=[-1.0, 1.0])), r"Camera.focal \[2\]: legal range \(0, inf\), found -1"),
    "a camera of 10^18 pixels": (lambda: CAMERA.replace(size=(10**9, 10**9)), "Camera.size: found .*more than 268435456 pixels; take tiles"),
    "a camera of infinite height": (lambda: CAMERA.replace(size=(math.inf, 4)), "Camera.size: expected .*found"),
    "a field of view 0": (lambda: tb.Camera.look_at(3 * UP, 0 * UP, [0.0, 1.0, 0.0], 0.0), r"look_at: fov_y .* lies in \(0, 180\), found \[0.0\]"),
    "a field of view 180": (lambda: tb.Camera.look_at(3 * UP, 0 * UP, [0.0, 1.0, 0.0], 180.0), r"look_at: fov_y .* lies in \(0, 180\), found \[180.0\]"),
    "a field of view NaN": (lambda: tb.Camera.look_at(3 * UP, 0 * UP, [0.0, 1.0, 0.0], NAN), r"look_at: fov_y .* found \[nan\]"),
    "a field of view of words": (lambda: tb.Camera.look_at(3 * UP, 0 * UP, [0.0, 1.0, 0.0], "wide"), "fov_y: expected numbers, .*found str"),
    "five fields of view": (lambda: tb.Camera.look_at(3 * UP, 0 * UP, [0.0, 1.0, 0.0], torch.ones(5)), r"look_at: fov_y: expected a number or shape \[..., 1\], found \[5\]"),
    "an eye at NaN": (lambda: tb.Camera.look_at([NAN, 0.0, 0.0], 0 * UP, [0.0, 1.0, 0.0]), "look_at: eye and target are the same point .or not finite"),
    "a complex eye": (lambda: tb.Camera.look_at(UP.to(torch.complex64), 0 * UP, [0.0, 1.0, 0.0]), "eye: expected a tensor of floats, found torch.complex64"),
    "up along the view": (lambda: tb.Camera.look_at(3 * UP, 0 * UP, UP), "look_at: up is zero or points along the view"),
    "two eyes, three targets": (lambda: tb.Camera.look_at(torch.rand(2, 3), torch.rand(3, 3), UP), "look_at: batch shapes do not broadcast"),
    "K of size 2": (lambda: tb.Camera.from_matrix(torch.eye(2), torch.eye(4), (4, 4)), r"from_matrix: K: expected shape \[..., 3, 3\], found \[2, 2\]"),
    "K of words": (lambda: tb.Camera.from_matrix("K", torch.eye(4), (4, 4)), "K: expected numbers, .*found str"),
    "complex K": (lambda: tb.Camera.from_matrix(torch.eye(3, dtype=torch.complex64), torch.eye(4), (4, 4)), "K: expected a tensor of floats, found torch.complex64"),
    "K with a negative focal length": (lambda: tb.Camera.from_matrix(torch.diag(torch.tensor([-1.0, 1.0, 1.0])), torch.eye(4), (4, 4)), "from_matrix: K: the focal lengths .*pixels > 0, found"),
    "K of NaN": (lambda: tb.Camera.from_matrix(torch.full((3, 3), NAN), torch.eye(4), (4, 4)), "from_matrix: K or world_to_camera holds numbers that are not finite"),
    "a translation of NaN": (lambda: tb.Camera.from_matrix(torch.eye(3), torch.tensor([[1.0, 0, 0, NAN], [0, 1, 0, 0], [0, 0, 1, 0]]), (4, 4)), "world_to_camera holds numbers that are not finite"),
    "a stretched pose": (lambda: tb.Camera.from_matrix(torch.eye(3), 2 * torch.eye(4)[:3], (4, 4)), "the upper 3x3 of world_to_camera is not a rotation"),
    "a camera's convention": (lambda: tb.Camera.from_matrix(torch.eye(3), torch.eye(4), (4, 4), convention=[]), r"from_matrix: unknown convention \[\], legal are"),
    "a mask elsewhere": (lambda: tb.shade(g(mask=torch.ones(4, 5, 1, dtype=torch.bool, device="meta")), LAMBERT, SUN), "GBuffer.mask: bool on meta beside position"),
    "GBuffer.load None": (lambda: tb.GBuffer.load(None), "read_exr: expected the path of a file, found NoneType"),
    "GBuffer.load camera": (lambda: tb.GBuffer.load("g.exr", camera=5), "camera: expected a Camera such as .*found int"),
    "GBuffer.load names": (lambda: tb.GBuffer.load("g.exr", names=5), "names: expected a dictionary such as .*found int"),
    "GBuffer.save nowhere": (lambda: g().save("nowhere/a.exr"), "nowhere/a.exr: no such folder: nowhere"),
    # pictures
    "read_image None": (lambda: tb.read_image(None), "read_image: expected the path of a file, found NoneType"),
    "save_image a list": (lambda: tb.save_image("a.png", [[[0.0]]]), "save_image: image: expected a Tensor such as .*found list"),
    "save_image elsewhere": (lambda: tb.save_image(None, torch.rand(2, 2, 3)), "save_image: expected the path of a file, found NoneType"),
    "exposure NaN": (lambda: tb.save_image("a.png", torch.rand(2, 2, 3), exposure=NAN), "save_image: exposure: expected stops from -126 to 126, found nan"),
    "exposure of words": (lambda: tb.save_image("a.png", torch.rand(2, 2, 3), exposure="bright"), "save_image: exposure: expected stops from -126 to 126, found 'bright'"),
    "exposure 5000": (lambda: tb.save_image("a.png", torch.rand(2, 2, 3), exposure=5000), "save_image: exposure: expected stops from -126 to 126, found 5000"),
    # shadows and plans
    "visibility of a number": (lambda: tb.visibility(5, SUN, MESH), "g: expected a GBuffer such as .*found int"),
    "visibility of numbers for lights": (lambda: tb.visibility(g(), 5, MESH), r"lights\[0\]: expected a Value such as .*found int"),
    "visibility without a mesh": (lambda: tb.visibility(g(), SUN, None), "mesh: expected a Mesh such as .*found NoneType"),
    "the triangles of another mesh": (lambda: tb.shade(g(triangle=torch.full((4, 5, 1), 99)), LAMBERT, SUN, mesh=MESH), "GBuffer.triangle: found 99, and the mesh has 12 faces; pass the mesh"),
    "visibility NaN": (lambda: tb.shade(g(), LAMBERT, SUN, visibility=torch.full((1, 4, 5, 1), NAN)), r"visibility: legal range \[0, 1\], found min nan"),
    "visibility 2": (lambda: tb.shade(g(), LAMBERT, SUN, visibility=torch.full((1, 4, 5, 1), 2.0)), r"visibility: legal range \[0, 1\], found min 2, max 2"),
    "complex visibility": (lambda: tb.shade(g(), LAMBERT, SUN, visibility=torch.ones(1, 4, 5, 1, dtype=torch.complex64)), "visibility: expected floats or bools, found torch.complex64"),
    "plan of a word": (lambda: tb.plan(g(), "matt", SUN), "bsdf: expected a BSDF such as .*found str"),
    "plan with tolerance": (lambda: tb.plan(g(), LAMBERT, SUN, tolerance=-1), "tolerance: found -1; .*leave it None"),
    "a plan run on nothing": (lambda: PLAN(None, LAMBERT, SUN), "g: expected a G-buffer such as .*found NoneType"),
    "a plan run without lights": (lambda: PLAN(g(), LAMBERT, []), "lights: found none"),
    "learn a number": (lambda: tb.value_and_grad(5), r"value_and_grad: expected a function loss\(learned, ...\), found int"),
    "compile a number": (lambda: tb.compile(5), "compile: expected a function, a plan or a module, found int"),
    "check a number": (lambda: tb.testing.check(5), "check: expected a BSDF or a Fresnel term, found int"),
    # learning
    "Learned complex": (lambda: tb.nn.Learned(1j), "Learned: expected real numbers, one at least, found torch.complex64"),
    "Learned nothing": (lambda: tb.nn.Learned([]), "Learned: expected real numbers, one at least, found .* \\[0\\]"),
    "Learned NaN": (lambda: tb.nn.Material(tb.Lambert, albedo=tb.nn.Learned(NAN)), "Lambert.albedo: the field starts outside: legal range"),
    "Constant 1.2": (lambda: tb.nn.Material(tb.Lambert, albedo=1.2), r"Lambert.albedo: the field starts outside: legal range \[0, 1\]"),
    "Texture NaN": (lambda: tb.nn.Material(tb.Lambert, albedo=tb.nn.Texture(torch.full((2, 2, 3), NAN))), "Lambert.albedo: the field starts outside: legal range"),
    "Texture of a number": (lambda: TEXTURE(5), "g: expected a GBuffer such as .*found int"),
    "bilinear of a row": (lambda: tb.bilinear(torch.rand(4, 3), torch.rand(5, 2)), r"texels: expected shape \[Ht, Wt, C\] with pixels in it, found \[4, 3\]"),
    "bilinear of nothing": (lambda: tb.bilinear(torch.rand(4, 0, 3), torch.rand(5, 2)), r"texels: expected shape \[Ht, Wt, C\] with pixels in it, found \[4, 0, 3\]"),
    "bilinear wrap": (lambda: tb.bilinear(torch.rand(4, 4, 3), torch.rand(5, 2), wrap="mirror"), r"wrap: found 'mirror', legal are \('repeat', 'clamp'\)"),
    "sky without numbers": (lambda: SKY.sample(torch.rand(5, 3)), r"u: an environment map is sampled with uniform numbers \[..., 2\] in \[0, 1\)"),
    "shade with light and material swapped": (lambda: tb.shade(g(), SUN, LAMBERT), "lights: expected a light or a list of lights such as .*found Lambert"),
    "a value without batch axes": (lambda: list(LAMBERT), "Lambert: has no batch axes to index or to go through one by one"),
    "Texture at points": (lambda: TEXTURE.at(torch.rand(4, 3)), r"uv: expected shape \[..., 2\], found \[4, 3\]"),
    "Texture at whole numbers": (lambda: TEXTURE.at(torch.tensor([[0, 1]])), "uv: expected a tensor of floats, found torch.int64"),
    "PerMaterial id": (lambda: tb.nn.PerMaterial(torch.rand(3, 3))(g(material=torch.full((4, 5, 1), 7))), "PerMaterial.table: 3 rows serve the ids 0 to 2, found id 7"),
    "PerMaterial of nothing": (lambda: tb.nn.PerMaterial(torch.rand(0, 3)), "PerMaterial: expected real numbers, one at least"),
    "Channel 7": (lambda: tb.nn.Channel(tb.nn.Learned([0.1, 0.2]), 7)(g()), "Channel.i: found 7, legal are 0 to 1"),
    "Channel 1.5": (lambda: tb.nn.Channel(TEXTURE, 1.5), "Channel: expected a field and the number of a channel, found Texture and 1.5"),
    "Channel of a number": (lambda: tb.nn.Channel(0.5, 0), "Channel: expected a field and the number of a channel, found float and 0"),
    "Material of a word": (lambda: tb.nn.Material("Lambert", albedo=0.5), "Material: expected a model .a class such as tb.Lambert., found 'Lambert'"),
    "Material of a value": (lambda: tb.nn.Material(LAMBERT, albedo=0.5), "Material: expected a model .*found Lambert"),
    "Material without": (lambda: tb.nn.Material(tb.Lambert), r"Material\(Lambert\): missing parameter \['albedo'\]"),
    "Material with another": (lambda: tb.nn.Material(tb.Lambert, colour=0.5), r"Material\(Lambert\): unknown parameter \['colour'\]; did you mean albedo \(fraction .*\)\? legal are"),
    "Material of None": (lambda: tb.nn.Material(tb.Lambert, albedo=None)(g()), "Lambert.albedo: expected a number, .*found None"),
    "MaterialSum of nothing": (lambda: tb.nn.MaterialSum(), "MaterialSum: expected one material or more"),
    "MaterialSum with a number": (lambda: MATERIAL + 5, "MaterialSum: expected one material or more, found"),
    "Shader of a value": (lambda: tb.nn.Shader(LAMBERT, PLAN), "material: expected a Module such as .*found Lambert"),
    "Shader without a plan": (lambda: tb.nn.Shader(MATERIAL, None), "plan: expected a Plan such as .*found NoneType"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_one_clear_error(case, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    call, message = CASES[case]
    with pytest.raises((TypeError, ValueError, IndexError, FileNotFoundError), match=message) as caught:
        call()
    assert "\n" not in str(caught.value).strip()
    assert caught.value.__cause__ is None, "one error, not a chain of them"
    assert type(caught.value) in {TypeError, ValueError, FileNotFoundError} or case == "Channel 7"
    assert not list(tmp_path.iterdir()), "what is refused leaves no file behind"


def test_lights_may_come_one_by_one():
    """A generator is used up by the first look at it."""
    assert torch.equal(tb.shade(g(), LAMBERT, (light for light in [SUN, SUN])), tb.shade(g(), LAMBERT, [SUN, SUN]))


def test_every_public_name_is_asked_here_or_beside():
    asked = Path(__file__).read_text(encoding="utf-8") + Path(__file__).with_name("test_bad_input.py").read_text(encoding="utf-8")
    named = {name for name in tb.__all__ if f"tb.{name}" in asked}
    # types that nobody makes by hand, interfaces, and functions of numbers, whose own tests ask them
    apart = {
        "BSDFSample",
        "Bsdf",
        "Constraint",
        "Contribution",
        "Decision",
        "Effect",
        "Fresnel",
        "Geometry",
        "Interval",
        "Layout",
        "Light",
        "LightKind",
    }
    apart |= {"LightSample", "Lobe", "Plan", "Prepared", "Scene", "Surface", "Value", "Viewer", "param"}
    numbers = {"Frame", "fresnel", "is_planar", "microfacet", "normalize", "planar", "reflect", "refract"}
    numbers |= {name for name in tb.__all__ if "_from_" in name}
    apart |= {"Distribution", "GGX", "Beckmann", "Blinn", "RoughConductor", "RoughDielectric", "F82Tint"}  # their own tests ask them
    assert set(tb.__all__) - named - apart - numbers == set()
