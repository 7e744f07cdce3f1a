"""Shading where everything goes wrong at once: the image and every gradient are finite, and what is masked teaches nothing."""

import functools
import math

import hard_scene as hard
import pytest
import torch

import torchbrdf as tb
from torchbrdf import torch_compat
from torchbrdf.bsdf.base import Bsdf
from torchbrdf.testing.hard_cases import variations
from torchbrdf.testing.instances import instances
from torchbrdf.testing.subject import DELTA, SPREAD, leaves, sees_below

FIELDS = ("position", "normal", "view", "uv", "tangent")
LARGEST = torch.finfo(torch.float32).max
MATERIALS = {f"{label}: {where}": v for label, m in instances() if isinstance(m, Bsdf) for v, where in variations(m)}


NAMES = {torch.float64: "float64", torch.float32: "float32", torch.bfloat16: "bfloat16", torch.float16: "float16"}
# Slopes pass through radiance times exponent: with the largest exponent, 1e7, the light must leave room for it in float32.
# Through f squared, too, which of facets grows as one over the cosine, here down to 2^-60.
# float16 ends at 65504, and a slope is known to a rounding of the radiance.
DAZZLING, DAZZLING_ON_A_NEEDLE, DAZZLING_IN_HALF = 1e30, 1e22, 1e3
ON_FACETS = 0.1


@functools.cache
def points_of(kind, dtype):
    return hard.by_hand(dtype) if kind == "by hand" else hard.from_mesh(dtype)


def scene(kind, material, dtype):
    """G-buffer ``[...]`` and the lights that belong to lobes, and to deltas."""
    sharpest = max((float(t.max()) for t in leaves(material)[1]), default=0.0)
    facets = any(name.rpartition(".")[2].endswith(("alpha", "roughness")) for name in leaves(material)[0])
    bright = DAZZLING_IN_HALF if dtype == torch.float16 else DAZZLING if sharpest < 1e6 else DAZZLING_ON_A_NEEDLE
    bright = ON_FACETS if facets else bright
    lit = torch.promote_types(dtype, torch.float32)  # lights stay as precise as they are
    return points_of(kind, dtype), hard.lights(lit, bright), [hard.sky(lit, bright)]


def as_float64(scene):
    g, *lights = scene
    return g.to(torch.float64), *([light.to(torch.float64) for light in some] for some in lights)


def leaves_of(values):
    """Names and tensors of several values, and the way back."""
    taken = [leaves(v) for v in values]
    names = [f"{type(v).__name__}.{n}" for v, (ns, _, _) in zip(values, taken, strict=True) for n in ns]

    def remake(tensors):
        rest = iter(tensors)
        return [rebuild([next(rest) for _ in ts]) for _, ts, rebuild in taken]

    return names, [t for _, ts, _ in taken for t in ts], remake


def held(t, dtype):
    """A parameter in the dtype of the points: float16 ends at 65504."""
    return t.double().clamp_max(torch.finfo(dtype).max).to(dtype)


def shaded(scene, material, shade=tb.shade):
    """(image, {name: gradient}) under the lights of each lobe; parameters are spread out, so that gradients tell points apart."""
    g, local, skies = scene
    images, slopes = [], {}
    for lobes, lights, label in ((SPREAD, local, ""), (DELTA, skies, "mirror ")):
        part = material.select(lobes)
        if part is None:
            continue
        names, parameters, rebuild = leaves(part)
        parameters = [held(t, g.position.dtype).expand(*g.batch_shape, t.shape[-1]) for t in parameters]
        points = {n: getattr(g, n) for n in FIELDS if getattr(g, n) is not None}
        light_names, light_tensors, remake = leaves_of(lights)
        inputs = [t.detach().clone().requires_grad_() for t in (*points.values(), *parameters, *light_tensors)]
        a, b = len(points), len(points) + len(parameters)
        image = shade(g.replace(**dict(zip(points, inputs[:a], strict=True))), rebuild(inputs[a:b]), remake(inputs[b:]))
        found = torch.autograd.grad(image, inputs, torch.ones_like(image), allow_unused=True, materialize_grads=True)
        images.append(image.detach())
        slopes |= {label + n: d for n, d in zip([*points, *names, *light_names], found, strict=True)}
    return sum(images), slopes


def trouble(scene, material, shade=tb.shade):
    """What is not finite though the truth is a number of its dtype, and what is not 0 though nothing is to be seen there."""
    g = scene[0]
    image, slopes = shaded(scene, material, shade)
    itself = g.position.dtype == torch.float64 and shade is tb.shade
    true_image, true_slopes = (image, slopes) if itself else shaded(as_float64(scene), material.map(lambda t: held(t, g.position.dtype)))
    cos = (tb.normalize(g.normal.double()) * tb.normalize(g.view.double())).sum(-1)
    hidden = ~g.valid.squeeze(-1)
    if not sees_below(material):
        hidden = hidden | (cos < -2 * torch.finfo(torch.float32).eps)  # rounding may turn what lies in the horizon
    for name, x, true in (("image", image, true_image), *((n, d, true_slopes[n]) for n, d in slopes.items())):
        if not bool(torch.isfinite(true).all()):
            yield f"{name}: not finite in float64"
        # A component of a slope is known to a rounding of its length.
        size = true.norm(dim=-1, keepdim=True) if name.removeprefix("mirror ") in FIELDS else true.abs()
        wrong = (size <= torch.finfo(x.dtype).max) & ~torch.isfinite(x)
        if bool(wrong.any()):
            yield f"{name}: {int(wrong.sum())} not finite, first at {wrong.nonzero()[0].tolist()}, where the truth is {true[wrong][0]:g}"
        if name == "image" and not bool((x >= 0).all()):
            yield "image: negative"
        if x.shape[:-1] == hidden.shape and bool(x[hidden].any()):  # any() counts NaN
            yield f"{name}: not 0 where nothing is to be seen"


KINDS, EVERY, FEW, SOME = ("by hand", "mesh"), 1, 3, 7
RUNS = [
    ("by hand", torch.float32, FEW),
    ("by hand", torch.bfloat16, SOME),
    ("by hand", torch.float16, SOME),
    ("mesh", torch.float32, SOME),
]
RUNS += [pytest.param(kind, dtype, EVERY, marks=pytest.mark.slow) for kind in KINDS for dtype in (torch.float64, torch.float32)]
# Halves are computed in float32: a third of the materials before each kind of points, not the same.
RUNS += [pytest.param(kind, dtype, FEW, marks=pytest.mark.slow) for kind in KINDS for dtype in (torch.bfloat16, torch.float16)]


@pytest.mark.parametrize(("kind", "dtype", "stride"), RUNS, ids=str)
def test_image_and_gradients_are_finite(kind, dtype, stride):
    """Every material (of halves some) with every parameter at every hard value, under every light, at every hard point."""
    bad = []
    # float16 ends far below the peak of so narrow a distribution, 3e7, and below what rounding leaves of its slopes.
    narrow = ("alpha = 0.0001", "roughness = 0.01") if dtype == torch.float16 else ()
    for label, material in [m for m in list(MATERIALS.items())[KINDS.index(kind) :: stride] if not m[0].endswith(narrow)]:
        bad += [f"{label}: {what}" for what in trouble(scene(kind, material, dtype), material)]
    assert not bad, "\n".join(bad[:20])


ALL_LOBES = tb.Lambert([0.5, 0.0, 1.0]) + tb.Phong(0.5, 1e4, tb.Dielectric([1.0, 0.5, 1.5])) + tb.BlinnPhong([0.0, 1.0, 0.2], 0.5, tb.Conductor(0.5, [0.0, 3.0, 1e3])) + 0.3 * tb.Mirror(1.0, tb.Schlick([0.0, 1.0, 0.04]))  # fmt: skip


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.float16], ids=NAMES.get)
def test_eight_wavelengths(dtype):
    """The layout of many colours."""
    wide = ALL_LOBES.map(lambda t: t.repeat(1, 3)[0, :8] if t.shape[-1] == 3 else t)
    g, local, skies = scene("by hand", wide, dtype)
    eight = [[light.map(lambda t: t[..., [0, 1, 2, 0, 1, 2, 0, 1]] if t.dim() == 3 else t) for light in some] for some in (local, skies)]
    local = [
        light.replace(**{n: getattr(light, n)[:, [0, 1, 2, 0, 1, 2, 0, 1]]})
        for light, n in zip(eight[0], ("intensity", "irradiance"), strict=True)
    ]
    assert not list(trouble((g, local, eight[1]), wide))


def test_what_is_masked_may_hold_anything():
    """Other garbage in pixels that do not count changes no bit of the image or of what light and shared parameters learn."""
    g, local, skies = scene("by hand", ALL_LOBES, torch.float32)
    other = {n: getattr(g, n).clone() for n in FIELDS}
    for k, v in enumerate(other.values()):
        v[~g.mask.squeeze(-1)] = (math.nan, -math.inf, 7.0, LARGEST, 0.0)[k]
    (image, slopes), (other_image, other_slopes) = (shaded((h, local, skies), ALL_LOBES) for h in (g, g.replace(**other)))
    assert torch.equal(image, other_image)
    for name, d in slopes.items():
        assert torch.equal(d, other_slopes[name]), name


def test_nothing_to_be_seen_teaches_nothing():
    """With everything masked, all slopes are exactly 0: of lights, environment, parameters, points."""
    for kind in ("by hand", "mesh"):
        g, local, skies = scene(kind, ALL_LOBES, torch.float32)
        image, slopes = shaded((g.replace(mask=torch.zeros_like(g.valid)), local, skies), ALL_LOBES)
        assert not bool(image.any())
        for name, d in slopes.items():
            assert not bool(d.any()), name


def test_what_is_unseen_may_stand_in_a_blinding_light():
    """Its slope by the cosine is infinite; behind the horizon, the silhouette or the mask it must still end in exactly 0."""
    origin, up = torch.zeros(3, 3), torch.tensor([[0.0, 0.0, 1.0]])
    g = tb.GBuffer(origin, torch.cat([up, up, -up]), torch.cat([up, -up, -up]), mask=torch.tensor([[False], [True], [True]]))
    blinding = tb.PointLight([0.0, 0.0, 2.0**-63], 1e30).to(torch.float32)
    image, slopes = shaded((g, [blinding], [hard.sky(torch.float32)]), ALL_LOBES.select(SPREAD))
    assert not bool(image.any())
    for name, d in slopes.items():
        assert not bool(d.any()), name


def fields(g):
    """A material of every kind of field, all of them learned."""
    learned, texels = torch.rand(*g.batch_shape, 3), torch.rand(4, 5, 3)
    table = torch.rand(3, 1) * 50
    return tb.nn.Material(tb.Lambert, albedo=tb.nn.Texture(texels, srgb=True)) + tb.nn.Material(
        tb.Phong,
        specular=tb.nn.Learned(learned),
        exponent=tb.nn.PerMaterial(table),
        fresnel=tb.nn.Material(tb.Dielectric, eta=tb.nn.Channel(tb.nn.Texture(texels + 1.0, wrap="clamp"), 1)),
    )


def test_fields_learn_from_what_is_seen_alone():
    g = points_of("by hand", torch.float32)
    ids = torch.arange(len(g.position)).unsqueeze(-1) % 3
    ids[~g.mask] = torch.tensor([-7, 0, 2**31])[ids[~g.mask]]  # ids of what is masked may be nonsense, too
    g = g.replace(material=torch.where(g.mask, ids, ids.clamp(-7, 2)))
    local = hard.lights(torch.float32)
    material = fields(g)

    def learn(h):
        tb.shade(h, material(h), local).sum().backward()
        found = {n: p.grad.clone() for n, p in material.named_parameters()}
        material.zero_grad()
        return found

    for name, d in learn(g.replace(mask=torch.zeros_like(g.mask))).items():
        assert not bool(d.any()), name
    whole = learn(g)
    assert all(bool(torch.isfinite(d).all()) and bool(d.any()) for d in whole.values())
    assert not bool(whole["terms.1.specular.raw"][~g.valid.squeeze(-1)].any())
    uv = torch.where(g.mask, g.uv, 0.5)
    for name, d in learn(g.replace(uv=uv)).items():
        assert torch.equal(d, whole[name]), name


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=NAMES.get)
@pytest.mark.parametrize("given", ["normals", "no normals"])
def test_gradients_by_the_vertices_of_a_damaged_mesh(given, dtype):
    """Through the G-buffer to vertices, normals, uv and camera, with cast shadows."""
    mesh = hard.damaged_mesh(dtype)
    mesh = mesh if given == "normals" else mesh.replace(normals=None)
    leaves = {n: getattr(mesh, n).clone().requires_grad_() for n in ("vertices", "normals", "uv") if getattr(mesh, n) is not None}
    eye = torch.tensor([0.3, 0.4, 3.0], dtype=dtype, requires_grad=True)
    mesh = mesh.replace(**leaves)
    camera = tb.Camera.look_at(eye, torch.zeros(3, dtype=dtype), torch.tensor([0.0, 1.0, 0.1], dtype=dtype), 45.0, (24, 24))
    g = tb.GBuffer.from_mesh(mesh, camera)
    material = tb.nn.Material(tb.Lambert, albedo=tb.nn.Texture(torch.rand(4, 4, 3, dtype=dtype))) + tb.nn.Material(tb.Phong, specular=0.5, exponent=200.0)  # fmt: skip
    image = tb.shade(g, material(g), hard.lights(dtype, dazzling=10.0)[0], mesh=mesh)
    found = torch.autograd.grad(image.sum(), [eye, *leaves.values()])
    assert bool(torch.isfinite(image).all())
    for name, d in zip(["eye", *leaves], found, strict=True):
        assert bool(torch.isfinite(d).all()), name
        assert bool(d.any()), name
    if given == "normals":
        unused = ~torch.isfinite(mesh.normals.detach()).all(-1)
        assert not bool(found[2][unused].any())


def test_half_types_are_points_too_and_say_so_where_a_parameter_overflows():
    g = points_of("by hand", torch.float16)
    with pytest.raises(ValueError, match=r"Phong.exponent \[430, 1\]: legal range \[0, inf\), found inf"):
        tb.shade(g, tb.Phong(0.5, torch.full((430, 1), 1e7).half()), hard.lights(torch.float32))
    assert tb.shade(g, tb.Phong(0.5, 1e7), hard.lights(torch.float32)).dtype == torch.float16  # one number stays as precise as it is


COMPILED = {
    "needle": tb.Lambert([0.5, 0.0, 1.0]) + tb.Phong([0.5, 0.0, 1.0], 1e7, tb.Dielectric([1.0, 0.5, 1.5])),
    "flat": tb.BlinnPhong([0.0, 1.0, 0.2], [0.5], tb.Conductor([0.5, 1.0, 10.0], [0.0, 3.0, 1e3])),
    "mirror": 0.3 * tb.Mirror([1.0, 0.0, 0.5], tb.Schlick([0.0, 1.0, 0.04])),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", COMPILED)
def test_compiled(name):
    """The same through `tb.compile`, fused and recomputed, under the light that almost touches and the one that dazzles."""
    if not torch_compat.has_cpp_compiler():
        pytest.skip("there is no C++ compiler")
    torch._dynamo.reset()
    g, local, skies = scene("by hand", COMPILED[name], torch.float32)
    assert not list(trouble((g, [local[0][1:3]], skies), COMPILED[name], tb.compile(tb.shade)))
