"""Hypothesis draws whole scenes: degenerate meshes, odd cameras, learned materials, lights of all kinds at awkward places.

Whatever is legal gives a finite image that is not negative, and finite slopes by everything that can be learned.
"""

import math

import pytest
import torch
from hypothesis import HealthCheck, given, note, reject, settings
from hypothesis import strategies as st

import torchbrdf as tb

# What is drawn is odd on purpose.
pytestmark = [pytest.mark.filterwarnings("ignore:GBuffer. none of its"), pytest.mark.filterwarnings("ignore:look_at. fov_y")]
SINGLE, DOUBLE = torch.float32, torch.float64
SETTINGS = {"deadline": None, "suppress_health_check": list(HealthCheck), "derandomize": True}
coordinates = st.one_of(st.floats(-1.0, 1.0, width=16), st.sampled_from([0.0, -0.0, 1.0, -1.0, 0.5, 2.0**-10, 2.0**-24]))
unit = st.one_of(st.sampled_from([0.5, 1.0, 0.0, 1e-12]), st.floats(0.0, 1.0))
strengths = st.sampled_from([1.0, 30.0, 0.0, 1e-6, 1e6])
etas = st.sampled_from([1.0, 1.0 + 1e-7, 1.5, 1 / 1.5, 0.2, 4.0])


def vectors(n):
    return st.lists(coordinates, min_size=n, max_size=n)


CORNERS = [[-0.9, -0.8, 0.1], [1.0, -0.7, 0.0], [0.1, 0.9, -0.1], [0.0, 0.1, 0.8], [0.9, 0.8, 0.2], [-1.0, 0.7, 0.3], [0.2, 0.0, -1.0]]


# --- meshes: proper triangles, slivers, points, duplicates, vertices of no face ---------------------------------------------


@st.composite
def meshes(draw, dtype):
    count = draw(st.integers(3, 7))
    moved = draw(st.sampled_from([0.25, 1.0]))
    points = [[b + moved * x for b, x in zip(corner, draw(vectors(3)), strict=True)] for corner in CORNERS[:count]]
    points += [points[draw(st.integers(0, count - 1))] for _ in range(draw(st.integers(0, 2)))]  # the same place twice
    index = st.integers(0, len(points) - 1)
    point, edge = index.map(lambda k: [k, k, k]), st.tuples(index, index).map(lambda k: [k[0], k[1], k[0]])
    proper = st.lists(index, min_size=3, max_size=3)
    faces = [[0, 1, 2], *draw(st.lists(st.one_of(proper, point, edge), max_size=6))]
    faces += [face[::-1] for face in faces] if draw(st.sampled_from([True, True, False])) else []  # to be seen from both sides
    scale, shift = draw(st.sampled_from([(1.0, 0.0), (1e-3, 0.0), (1e4, 0.0), (1.0, 100.0)]))
    fields = {"vertices": scale * torch.tensor(points, dtype=dtype) + shift, "faces": torch.tensor(faces)}
    if draw(st.sampled_from([False, False, True])):
        fields["normals"] = torch.tensor(
            [draw(st.one_of(st.sampled_from([[0.0, 0.2, 1.0], [math.nan, 0.0, 1.0], [0.0, math.inf, 0.0]]), vectors(3))) for _ in points],
            dtype=dtype,
        )
    uv = draw(st.sampled_from(["none", "vertices", "corners"]))
    if uv != "none":
        fields["uv"] = torch.tensor([draw(vectors(2)) for _ in points], dtype=dtype) * draw(st.sampled_from([1.0, 50.0, math.nan]))
    if uv == "corners":
        fields["uv_faces"] = fields["faces"].flip(0)
    if draw(st.booleans()):
        fields["material"] = torch.arange(len(faces)).unsqueeze(-1) % 3
    return tb.Mesh(**fields), scale, shift


@st.composite
def cameras(draw, mesh, scale, shift, dtype):
    """From outside, from within, along a face; one, or two at once; of sizes down to a single pixel."""
    batch = draw(st.sampled_from([(), (2,)]))
    eye = torch.tensor([draw(vectors(3)) for _ in range(math.prod(batch))], dtype=dtype) + torch.tensor([0.0, 0.1, 3.0], dtype=dtype)
    eye = (eye * scale * draw(st.sampled_from([0.1, 1.0, 30.0])) + shift).reshape(*batch, 3)
    size = draw(st.sampled_from([(1, 1), (3, 5), (5, 4)]))
    corners = mesh.vertices[mesh.faces[draw(st.integers(0, len(mesh.faces) - 1))]]
    target = (corners * torch.tensor([[0.5], [0.3], [0.2]], dtype=dtype)).sum(0)
    fov = draw(st.sampled_from([1.0, 40.0, 150.0]))
    return eye.requires_grad_(), lambda e: tb.Camera.look_at(e, target, [0.3, 1.0, 0.2], fov, size)


# --- materials: fields of every kind ------------------------------------------------------------------------------------------


@st.composite
def fields(draw, channels, values, g, dtype):
    """A field that starts at legal values; textures have odd sizes."""

    def numbers(*shape):
        flat = [draw(values) for _ in range(math.prod(shape))]
        return torch.tensor(flat, dtype=dtype).reshape(shape)

    kinds = ["constant", "learned", "channel" if channels == 1 else "learned"]
    kinds += ["texture"] * (g.uv is not None) + ["table"] * (g.material is not None) + ["pixels"]
    kind = draw(st.sampled_from(kinds))
    if kind == "constant":
        return tb.nn.Constant(numbers(channels))
    if kind == "learned":
        return tb.nn.Learned(numbers(channels))
    if kind == "pixels":
        return tb.nn.Learned(numbers(1, channels).expand(*g.batch_shape, channels).contiguous())
    if kind == "channel":
        return tb.nn.Channel(tb.nn.Learned(numbers(2)), 1)
    if kind == "table":
        return tb.nn.PerMaterial(numbers(3, channels))
    height, width = draw(st.sampled_from([(1, 1), (1, 3), (2, 1)]))
    return tb.nn.Texture(numbers(height, width, channels), wrap=draw(st.sampled_from(["repeat", "clamp"])))


@st.composite
def fresnel_terms(draw, g, dtype):
    kind = draw(st.sampled_from(["none", "schlick", "dielectric", "conductor", "fixed"]))
    if kind == "schlick":
        return tb.nn.Material(tb.Schlick, f0=draw(fields(3, unit, g, dtype)))
    if kind == "dielectric":
        return tb.nn.Material(tb.Dielectric, eta=draw(fields(1, etas, g, dtype)))
    if kind == "conductor":
        return tb.nn.Material(
            tb.Conductor, eta=draw(fields(3, etas, g, dtype)), k=draw(fields(3, st.sampled_from([0.0, 1e-3, 2.0, 1e3]), g, dtype))
        )
    return tb.Dielectric(1.5) if kind == "fixed" else None


@st.composite
def materials(draw, g, dtype):
    parts = []
    for kind in draw(st.lists(st.sampled_from(["lambert", "phong", "blinn"]), min_size=1, max_size=3)):
        if kind == "lambert":
            parts.append(tb.nn.Material(tb.Lambert, albedo=draw(fields(3, unit, g, dtype))))
            continue
        exponent = draw(fields(1, st.sampled_from([0.0, 0.5, 1.0, 20.0, 1e4, 1e7]), g, dtype))
        specular = draw(fields(3, unit, g, dtype))
        model = tb.Phong if kind == "phong" else tb.BlinnPhong
        parts.append(tb.nn.Material(model, specular=specular, exponent=exponent, fresnel=draw(fresnel_terms(g, dtype))))
    return parts[0] if len(parts) == 1 else tb.nn.MaterialSum(*parts)


# --- lights: on the surface, inside, far away; of no direction ------------------------------------------------------------


@st.composite
def lights(draw, g, mesh, eye, scale, shift, dtype):
    found = []
    for kind in draw(st.lists(st.sampled_from(["eye", "eye", "surface", "vertex", "near", "far", "sun", "suns"]), min_size=1, max_size=4)):
        colour = torch.tensor([draw(strengths) for _ in range(draw(st.sampled_from([1, 3])))], dtype=dtype)
        if kind in ("sun", "suns"):
            rows = 1 if kind == "sun" else 2
            length = draw(st.sampled_from([0.0, 1e-20, 1.0, 1e30]))  # its square is no float32, and the slope of the shortest still is
            direction = length * torch.tensor([draw(vectors(3)) for _ in range(rows)], dtype=dtype)
            found.append((tb.DirectionalLight, direction, colour))
            continue
        where = {
            "eye": eye.detach().reshape(-1, 3)[0],
            "surface": g.position.detach().reshape(-1, 3)[draw(st.integers(0, g.position[..., 0].numel() - 1))],
            "vertex": mesh.vertices.detach()[draw(st.integers(0, len(mesh.vertices) - 1))],
            "near": scale * torch.tensor(draw(vectors(3)), dtype=dtype) + shift,
            "far": scale * 1e6 * torch.tensor(draw(vectors(3)), dtype=dtype) + shift,
        }[kind]
        found.append((tb.PointLight, where.to(dtype), colour * scale**2))
    return found


# --- the way of light ------------------------------------------------------------------------------------------------------


def whole_scene(data, dtype):
    mesh, scale, shift = data.draw(meshes(dtype))
    vertices = mesh.vertices.clone().requires_grad_()
    mesh = mesh.replace(vertices=vertices)
    eye, camera = data.draw(cameras(mesh.detach(), scale, shift, dtype))
    try:
        seen = camera(eye)
    except ValueError as error:
        if "look_at" not in str(error):
            raise
        reject()  # an eye on its target is no legal camera
    g = tb.GBuffer.from_mesh(mesh, seen)
    material = data.draw(materials(g, dtype))
    sources = data.draw(lights(g, mesh, eye, scale, shift, dtype))
    leaves = {"vertices": vertices, "eye": eye, **dict(material.named_parameters())}
    made = []
    for k, (kind, where, colour) in enumerate(sources):
        leaves[f"place {k}"], leaves[f"colour {k}"] = where.clone().requires_grad_(), colour.clone().requires_grad_()
        made.append(kind(leaves[f"place {k}"], leaves[f"colour {k}"]))
    note(f"{mesh.vertices.tolist()}, {mesh.faces.tolist()}, {material}, {sources}")
    shadows = data.draw(st.booleans())
    plan = tb.plan(g, material(g), made, mesh=mesh if shadows else None)
    each = plan(g, material(g), made, mesh=mesh if shadows else None, per_light=True)
    image = plan(g, material(g), made, mesh=mesh if shadows else None)
    check(image, each, g, leaves, sum(map(len, made)))


def check(image, each, g, leaves, count):
    assert each.shape == (count, *g.batch_shape, 3) or each.shape == (count, *g.batch_shape, 1)
    assert bool(torch.isfinite(image).all())
    assert bool((each >= 0).all())
    exact = image.dtype != torch.bfloat16
    torch.testing.assert_close(each.sum(0), image, rtol=1e-4 if exact else 0.05, atol=0.0)  # the sum is taken in another order
    assert not bool(image[~g.valid.squeeze(-1)].any()), "what is no surface is dark"
    slopes = torch.autograd.grad(image.sum(), list(leaves.values()), allow_unused=True) if image.requires_grad else ()
    for name, slope in zip(leaves, slopes, strict=False):
        assert slope is None or bool((torch.isfinite(slope) if exact else ~torch.isnan(slope)).all()), name


@pytest.mark.parametrize("dtype", [SINGLE, DOUBLE, torch.bfloat16], ids=["float32", "float64", "bfloat16"])
@settings(max_examples=60, **SETTINGS)
@given(st.data())
def test_a_scene_of_anything_legal(dtype, data):
    whole_scene(data, dtype)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [SINGLE, DOUBLE, torch.bfloat16], ids=["float32", "float64", "bfloat16"])
@settings(max_examples=300, **SETTINGS)
@given(st.data())
def test_many_scenes(dtype, data):
    whole_scene(data, dtype)


# --- points of no mesh: any batch shape, any dtype, normals and positions that are none ---------------------------------------

DTYPES = [torch.float64, torch.float32, torch.bfloat16, torch.float16]
TERMS = [
    None,
    tb.Schlick(0.04),
    tb.Schlick(1.0),
    *map(tb.Dielectric, (1 / 1.5, 1.0 + 1e-7, 4.0)),
    tb.Conductor(0.2, 3.0),
    tb.Conductor(1.5, 0.0),
]
wild = st.one_of(coordinates, st.sampled_from([math.nan, math.inf, -math.inf, 6e4, 6e-8]))


@st.composite
def points(draw, dtype):
    batch = draw(st.sampled_from([(), (3,), (2, 1), (2, 1, 2), (0,)]))

    def drawn(numbers):
        flat = [draw(numbers) for _ in range(3 * math.prod(batch))]
        return torch.tensor(flat, dtype=torch.float64).to(dtype).reshape(*batch, 3)

    found = {"position": drawn(wild), "normal": drawn(draw(st.sampled_from([coordinates, wild]))), "view": drawn(coordinates)}
    if draw(st.booleans()):
        found["tangent"] = drawn(wild)
    if draw(st.booleans()):
        found["mask"] = torch.tensor([draw(st.booleans()) for _ in range(math.prod(batch))], dtype=torch.bool).reshape(*batch, 1)
    return found, batch


@st.composite
def values(draw, batch, dtype):
    """Models of plain tensors, one for all points or one for each, of 1, 3 or 6 channels."""
    channels = draw(st.sampled_from([1, 3, 6]))

    def parameter(numbers, size):
        shape = (*draw(st.sampled_from([(), batch])), size)
        return torch.tensor([draw(numbers) for _ in range(math.prod(shape))], dtype=torch.float64).to(dtype).reshape(shape)

    found = tb.Lambert(parameter(unit, channels))
    for kind in draw(st.lists(st.sampled_from(["phong", "blinn", "mirror"]), max_size=2)):
        term = draw(st.sampled_from(TERMS))
        if kind == "mirror":
            found = found + tb.Mirror(parameter(unit, channels), term)
            continue
        strength, exponent = parameter(unit, channels), parameter(st.sampled_from([0.0, 1e-3, 1.0, 30.0, 2e3]), 1)
        norm = {"normalization": draw(st.sampled_from(["none", "bound", "modified"]))} if kind == "phong" else {}
        lobe = (tb.Phong if kind == "phong" else tb.BlinnPhong)(strength, exponent, term, **norm)
        found = found + draw(st.sampled_from([0.0, 0.5])) * lobe
    return found


@settings(max_examples=150, **SETTINGS)
@given(st.data(), st.sampled_from(DTYPES))
def test_points_of_anything(data, dtype):
    some_points(data, dtype)


@pytest.mark.slow
@settings(max_examples=900, **SETTINGS)
@given(st.data(), st.sampled_from(DTYPES))
def test_many_points(data, dtype):
    some_points(data, dtype)


def some_points(data, dtype):
    given_fields, batch = data.draw(points(dtype))
    bsdf = data.draw(values(batch, dtype)).map(lambda t: t.requires_grad_() if t.is_floating_point() else t)
    leaves = {n: t.requires_grad_() if t.is_floating_point() else t for n, t in given_fields.items()}
    g = tb.GBuffer(**leaves)
    sun = tb.DirectionalLight(torch.tensor(data.draw(vectors(3)), dtype=dtype), torch.ones(1, dtype=dtype))
    lamp = tb.PointLight(torch.tensor([0.3, 0.2, 2.0], dtype=dtype), torch.full((1,), data.draw(st.sampled_from([1.0, 1e3])), dtype=dtype))
    image = tb.shade(g, bsdf, [sun, lamp])
    mirrors = [t for t in getattr(bsdf, "terms", ()) if isinstance(t, tb.Mirror)]
    seen = [tb.shade(g, t, tb.EnvironmentMap(torch.rand(2, 4, 1).to(dtype))) for t in mirrors]
    for radiance in (image, *seen):
        assert (radiance.dtype, radiance.shape[:-1]) == (dtype, batch)
        assert bool(torch.isfinite(radiance).all()), "nothing here is beyond float16"
        assert bool((radiance >= 0).all())
        assert not bool(radiance[~g.valid.squeeze(-1)].any())
    floats = [t for t in (*leaves.values(), *_tensors(bsdf)) if t.requires_grad]
    for radiance in (image, *seen):  # apart: in a half type +inf of one and -inf of another would add up to NaN
        for slope in torch.autograd.grad(radiance.double().sum(), floats, allow_unused=True):
            assert slope is None or not bool(torch.isnan(slope).any())
            # A direction of length 6e-8 turns by 1e7 for a step of 1: slopes that overflow a half type are true.
            assert slope is None or dtype in DTYPES[2:] or bool(torch.isfinite(slope).all())


def _tensors(value):
    return torch.utils._pytree.tree_leaves(value)
