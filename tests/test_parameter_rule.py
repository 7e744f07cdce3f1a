"""The one rule for parameters beside points: without batch axes they follow dtype and device, with batch axes they must match.

The meta device stands for a GPU: what torch refuses to mix there it refuses to mix on the other.
"""

import pytest
import torch
from torch.func import functional_call

import torchbrdf as tb
from torchbrdf import parameters
from torchbrdf.geometry import Layout
from torchbrdf.registry import BSDFS, FRESNEL_TERMS
from torchbrdf.testing.instances import instances
from torchbrdf.testing.subject import batched, generator

DTYPES = [torch.float16, torch.bfloat16, torch.float32, torch.float64]
HALF = DTYPES[:2]
ALL = dict(instances())
SIDES = ("TwoSided(Phong, -)", "TwoSided(Lambert + Mirror, BlinnPhong + 0.5 (Lambert + Mirror))")  # of the 20 combinations
MODELS = {label: v for label, v in ALL.items() if isinstance(v, tb.Bsdf) and (not isinstance(v, tb.TwoSided) or label in SIDES)}
OF_CLASS = [[label for label, v in MODELS.items() if type(v) is cls] for cls in {type(v): None for v in MODELS.values()}]
FIRST_AND_LAST = {label: MODELS[label] for labels in OF_CLASS for label in (labels[0], labels[-1])}
TERMS = {label: v for label, v in ALL.items() if isinstance(v, tb.Fresnel)}
WIDE = tb.Lambert([0.1] * 7) + 0.5 * tb.Phong([0.2] * 7, 5.0, fresnel=tb.Schlick([0.3] * 7)) + tb.Mirror([0.2] * 7)
UP = torch.tensor([0.0, 0.0, 1.0])
VERBS = {
    "evaluate": lambda f, w, u: f.evaluate(w, w, w, w),
    "evaluate locally": lambda f, w, u: f.evaluate(w, w),
    "pdf": lambda f, w, u: f.pdf(w, w, w),
    "sample": lambda f, w, u: f.sample(w, u, w),
    "directional_albedo": lambda f, w, u: f.directional_albedo(w, w, order=4),
}


def results(found):
    """Tensors of floats that a verb gave."""
    return [t for t in (found if isinstance(found, tuple) else (found,)) if t.is_floating_point()]


def elsewhere(dtype, *shape):
    return torch.empty(*shape, dtype=dtype, device="meta")


def kinds(found):
    return {(t.device.type, t.dtype) for t in results(found)}


# --- without batch axes: follow --------------------------------------------------------------------------------------------


def test_every_model_is_here():
    assert {type(v).__name__ for v in (*MODELS.values(), *TERMS.values())} == set(BSDFS) | set(FRESNEL_TERMS)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("verb", VERBS)
def test_models_follow_points(verb, dtype):
    w, u = elsewhere(dtype, 5, 3), torch.empty(5, 3, device="meta")
    models = MODELS if dtype == torch.float16 else FIRST_AND_LAST  # what a variant forgets, it forgets in every dtype
    for label, model in [*models.items(), ("wide", WIDE)]:
        assert kinds(VERBS[verb](model, w, u)) == {("meta", dtype)}, label
    single = elsewhere(dtype, 3)
    assert kinds(VERBS[verb](WIDE, single, u[0])) == {("meta", dtype)}


@pytest.mark.parametrize("dtype", DTYPES)
def test_fresnel_terms_follow_cosines(dtype):
    for label, term in TERMS.items():
        assert kinds(term.reflectance(elsewhere(dtype, 5, 1))) == {("meta", dtype)}, label


LIGHTS = {
    "a point": tb.PointLight([0.0, 0.0, 1.0], 1.0),
    "points": tb.PointLight(torch.rand(4, 3), torch.rand(4, 3).half()),
    "a sun": tb.DirectionalLight([0.0, 0.0, 1.0], [1.0, 0.5, 0.2]),
    "suns": tb.DirectionalLight(torch.rand(4, 3).bfloat16(), torch.rand(4, 3)),
}
SKY = tb.EnvironmentMap(torch.rand(4, 8, 3), to_world=torch.eye(3))


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("light", LIGHTS)
def test_lights_follow_points(light, dtype):
    p = elsewhere(dtype, 5, 3)
    for found in (LIGHTS[light].sample(p), LIGHTS[light].pdf(p), LIGHTS[light].radiance(p)):
        assert kinds(found) == {("meta", dtype)}
    g = tb.GBuffer(p, p, p)
    for material in (tb.Lambert([0.5, 0.4, 0.3]) + tb.Phong(0.2, 9.0), tb.TwoSided(tb.Lambert(0.5))):
        assert kinds(tb.shade(g, material, LIGHTS[light])) == {("meta", dtype)}


@pytest.mark.parametrize("dtype", DTYPES)
def test_environment_maps_follow_directions(dtype):
    p = elsewhere(dtype, 5, 3)
    assert kinds(SKY.radiance(p)) == {("meta", dtype)}
    assert kinds(tb.shade(tb.GBuffer(p, p, p), tb.Mirror([0.5, 0.4, 0.3], tb.Dielectric(1.5)), SKY)) == {("meta", dtype)}


@pytest.mark.parametrize("dtype", DTYPES)
def test_textures_and_tables_follow_points(dtype):
    p, ids = elsewhere(dtype, 5, 3), torch.empty(5, 1, dtype=torch.int64, device="meta")
    g = tb.GBuffer(p, p, p, uv=torch.empty(5, 2, device="meta"), material=ids)
    for field in (
        tb.nn.Texture(torch.rand(4, 8, 3)),
        tb.nn.Texture(torch.rand(4, 8, 3).double(), srgb=True),
        tb.nn.PerMaterial(torch.rand(2, 3)),
    ):
        assert kinds(field(g)) == {("meta", dtype)}
        material = tb.nn.Material(tb.Lambert, albedo=field)
        assert kinds(tb.shade(g, material(g), LIGHTS["suns"])) == {("meta", dtype)}


def test_a_learned_number_keeps_its_gradient_on_the_way():
    material = tb.nn.Material(tb.Phong, specular=tb.nn.Learned(0.5), exponent=tb.nn.Learned(torch.tensor([9.0], dtype=torch.float64)))
    points = torch.rand(4, 3).half()
    image = tb.shade(tb.GBuffer(points, UP.half().expand(4, 3), UP.half().expand(4, 3)), material(None), LIGHTS["a point"])
    grads = torch.autograd.grad(image.sum(), list(material.parameters()))
    assert [g.dtype for g in grads] == [torch.float32, torch.float64]
    assert all(bool(g.abs() > 0) for g in grads)


def test_numbers_stay_as_precise_as_they_are_beside_half_types():
    found = tb.Phong(0.1, 7e4).evaluate(UP.half(), UP.half())  # 7e4 is no float16
    assert torch.equal(found, torch.tensor([0.1 * 70002 / (2 * torch.pi)]).half())


@pytest.mark.parametrize(("wide", "kept"), [(False, "cpu"), (True, "meta")])
def test_numbers_taken_apart_stay_where_kernels_take_them_from(wide, kept):
    """No copy to the device for a colour that is taken apart into numbers."""
    colour = Layout(wide, torch.float32, torch.device("meta")).colour(torch.rand(3, dtype=torch.float64))
    assert {(c.device.type, c.dtype) for c in colour} == {(kept, torch.float32)}
    assert len(colour) == (1 if wide else 3)


# --- with batch axes: match ------------------------------------------------------------------------------------------------


def first_parameter(v):
    """The name in an error about a model: that of the first value that has parameters of its own."""
    own = [f"{type(v).__name__}.{name}" for name, _, _ in v.own_tensors()]
    return own[0] if own else first_parameter(next(iter(v.nested())))


@pytest.mark.parametrize("verb", VERBS)
@pytest.mark.parametrize("why", ["device", "dtype"])
def test_a_parameter_at_each_point_must_match(verb, why):
    """Never promoted, never moved, in no verb and no slot."""
    w = elsewhere(torch.float64, 5, 3) if why == "device" else torch.rand(5, 3)
    u = torch.rand(5, 3).to(w.device)
    for label, model in MODELS.items():
        many = batched(model, 5, generator(0))
        with pytest.raises(TypeError, match=r"float64 on cpu beside w[io]?: float\d\d on (cpu|meta); convert one with .to\(...\)") as error:
            VERBS[verb](many, w, u)
        assert str(error.value).split(":")[0] == first_parameter(many), label


def test_a_nested_parameter_is_named():
    model = tb.Phong(0.5, 5.0, fresnel=tb.Schlick(torch.rand(5, 3).double()))
    with pytest.raises(TypeError, match=r"^Schlick.f0: float64 on cpu beside wo: float32 on cpu"):
        (tb.Lambert(0.5) + 0.5 * model).sample(torch.rand(5, 3), torch.rand(5, 3))
    with pytest.raises(TypeError, match=r"^Scaled.factor: float64 on cpu beside w: float32 on cpu"):
        (torch.rand(5, 3).double() * tb.Lambert(0.5)).directional_albedo(torch.rand(5, 3))


def test_a_fresnel_term_at_each_point_must_match():
    for term in (batched(t, 5, generator(0)) for t in TERMS.values()):
        name = first_parameter(term)
        for cosine in (torch.rand(5, 1), elsewhere(torch.float64, 5, 1)):
            with pytest.raises(TypeError, match=rf"^{name}: float64 on cpu beside cos_i: .*; convert one with .to"):
                term.reflectance(cosine)


def test_nothing_follows_from_where_there_are_no_numbers():
    w = torch.rand(5, 3)
    for call in (
        lambda: tb.Lambert(elsewhere(torch.float32, 3)).evaluate(w, w),
        lambda: tb.PointLight(elsewhere(torch.float32, 3), 1.0).sample(w),
        lambda: tb.DirectionalLight(elsewhere(torch.float32, 3), 1.0).sample(w),
        lambda: SKY.to("meta").radiance(w),
        lambda: tb.Schlick(elsewhere(torch.float32, 3)).reflectance(w[:, :1]),
        lambda: tb.shade(tb.GBuffer(w, w, w), tb.Mirror(), SKY.to("meta")),
        lambda: tb.shade(tb.GBuffer(w, w, w), tb.Lambert(0.5), LIGHTS["points"].to("meta", torch.float32)),
    ):
        with pytest.raises(TypeError, match=r"^\w+\.\w+: float32 on meta beside .*: float32 on cpu; convert one with .to"):
            call()


# --- half types ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", HALF)
@pytest.mark.parametrize("verb", VERBS)
def test_half_types_at_each_point_in_every_verb(verb, dtype):
    """One rounding from what float64 gives for the same, rounded numbers."""
    rng = generator(1)
    w = torch.rand(6, 3, generator=rng, dtype=torch.float64).to(dtype)
    u = (0.95 * torch.rand(6, 3, generator=rng, dtype=torch.float64)).to(dtype)  # not rounded up to 1
    for label, model in MODELS.items():
        many = batched(model, 6, rng).to(dtype)
        found = results(VERBS[verb](many, w, u))
        exact = results(VERBS[verb](many.to(torch.float64), w.double(), u.double()))
        for a, b in zip(found, exact, strict=True):
            assert a.dtype == dtype, label
            info = torch.finfo(dtype)
            eps, flushed = info.eps, info.smallest_normal * info.eps + 2.0**10 * torch.finfo(torch.float32).tiny
            torch.testing.assert_close(
                a.double(), b, rtol=2 * eps, atol=eps * float(b.abs().max()) + flushed, msg=lambda m, label=label: f"{label}: {m}"
            )


# --- autocast --------------------------------------------------------------------------------------------------------------


class Net(torch.nn.Module):
    """Answers with a colour at each point: in a half type under autocast."""

    def __init__(self):
        super().__init__()
        self.linear = torch.nn.Linear(3, 3)

    def forward(self, g):
        return torch.sigmoid(self.linear(g.position))


def scene(dtype=torch.float32):
    normal = UP.to(dtype).expand(6, 3)
    return tb.GBuffer(torch.rand(6, 3, generator=generator(0)).to(dtype), normal, normal)


def test_under_autocast_the_answers_of_networks_are_promoted():
    g, material = scene(), tb.nn.Material(tb.Lambert, albedo=Net()) + tb.nn.Material(tb.Phong, specular=Net(), exponent=9.0)
    lights = [LIGHTS["points"], LIGHTS["a sun"]]
    with torch.autocast("cpu", torch.bfloat16):
        brdf = material(g)
        assert brdf.terms[0].albedo.dtype == torch.bfloat16
        image = tb.shade(g, brdf, lights)
        sampled = brdf.sample(UP.expand(6, 3), torch.full((6, 3), 0.3))
        albedo = brdf.directional_albedo(UP.expand(6, 3), order=4)
    exactly = brdf.to(torch.float32)
    assert torch.equal(image, tb.shade(g, exactly, lights))
    assert torch.equal(sampled.weight, exactly.sample(UP.expand(6, 3), torch.full((6, 3), 0.3)).weight)
    assert torch.equal(albedo, exactly.directional_albedo(UP.expand(6, 3), order=4))
    grads = torch.autograd.grad(image.sum(), list(material.parameters()))
    assert all(bool(torch.isfinite(g).all()) and bool(g.any()) for g in grads)


def test_under_autocast_promotion_is_to_the_dtype_of_the_points():
    g, albedo = scene(torch.float64), torch.rand(6, 3).half()
    with torch.autocast("cpu", torch.bfloat16):
        image = tb.shade(g, tb.Lambert(albedo), LIGHTS["points"])
    assert torch.equal(image, tb.shade(g, tb.Lambert(albedo.double()), LIGHTS["points"]))


def test_under_autocast_nothing_else_is_promoted():
    with torch.autocast("cpu", torch.bfloat16):
        for albedo, w in ((torch.rand(6, 3).double(), torch.rand(6, 3)), (torch.rand(6, 3), torch.rand(6, 3).half())):
            with pytest.raises(TypeError, match=r"convert one with .to"):
                tb.Lambert(albedo).evaluate(w, w)


@pytest.mark.parametrize(("dtype", "remedy"), [(torch.float32, "float"), (torch.float64, "double")])
@pytest.mark.parametrize("half", HALF)
def test_outside_autocast_the_error_says_how_to_widen(dtype, remedy, half):
    w = torch.rand(6, 3, dtype=dtype)
    with pytest.raises(TypeError, match=rf"^Lambert.albedo: b?float16 on cpu beside wi: .*; convert it with .{remedy}\(\)$"):
        tb.Lambert(torch.rand(6, 3).to(half)).evaluate(w, w)
    with pytest.raises(TypeError, match=r"convert one with \.to"):
        tb.Lambert(torch.rand(6, 3).to(half)).evaluate(w.to("meta"), w.to("meta"))


def test_a_shader_under_autocast_is_one_full_graph():
    g, material, lights = scene(), tb.nn.Material(tb.Lambert, albedo=Net()), LIGHTS["points"]
    shader = tb.nn.Shader(material, tb.plan(g, tb.Lambert(0.5), lights))
    compiled = torch.compile(shader, fullgraph=True, backend="aot_eager")
    with torch.autocast("cpu", torch.bfloat16):
        torch.testing.assert_close(compiled(g, lights), shader(g, lights))
        weights = dict(shader.named_parameters())
        torch.testing.assert_close(functional_call(shader, weights, (g, lights)), shader(g, lights))


# --- parameters among themselves -------------------------------------------------------------------------------------------


def test_bounds_of_parts_in_different_places():
    there = elsewhere(torch.float32, 5, 3)
    for model in (
        tb.Lambert([0.1, 0.2, 0.3]) + tb.Lambert(there),
        tb.Lambert(0.1) * there,
        tb.TwoSided(tb.Lambert(there), tb.Lambert(0.5)),
    ):
        assert (model.energy_bound.device.type, model.energy_bound.dtype) == ("meta", torch.float32)
        assert model.energy_bound.shape == (5, 3)


def test_alike_promotes_as_torch_does_where_nothing_has_batch_axes():
    a, b = torch.rand(3), torch.rand(3).double()
    assert [p.dtype for p in parameters.alike(a, b)] == [torch.float32, torch.float64]
    assert [p.dtype for p in parameters.alike(b, a.unsqueeze(0))] == [torch.float32, torch.float32]
