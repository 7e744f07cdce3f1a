"""What a call does beside arithmetic: how many operations it dispatches, that it looks at no values, and that few points change nothing."""

import pytest
import torch
from test_shade import glossy, sheet, three_lights
from torch.utils._python_dispatch import TorchDispatchMode

import torchbrdf as tb
from torchbrdf import kinds, numerics
from torchbrdf.effects.base import Contribution
from torchbrdf.effects.direct import Direct

CALL, STEP = 112, 177  # of this scene; the limit of a planned call is 120. (Textbook code that normalises as much: 63, and 128.)
LOOKS = ("_local_scalar_dense", "item", "aminmax", "all", "any", "equal", "nonzero", "is_nonzero", "isfinite")
POINT = tb.PointLight([1.5, 2.0, 3.0], [20.0, 18.0, 16.0])
MODEL = tb.Lambert([0.5, 0.4, 0.3]) + tb.Phong([0.5, 0.4, 0.3], 12.0, fresnel=tb.Schlick([0.1, 0.05, 0.04]))


class Names(TorchDispatchMode):
    """The names of the operations that torch dispatches."""

    def __init__(self):
        super().__init__()
        self.found = []

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        self.found.append(func._schema.name.removeprefix("aten::"))
        return func(*args, **(kwargs or {}))


def dispatched(fn):
    fn()  # what is found of a kind once is not looked for again
    with Names() as names:
        fn()
    return names.found


def masked():
    g = sheet(8)
    return g.replace(mask=torch.rand(8, 8, 1) > 0.2)


def learned(g):
    gloss = tb.nn.Material(
        tb.Phong, specular=tb.nn.Learned([0.5, 0.4, 0.3]), exponent=tb.nn.Learned([12.0]), fresnel=tb.nn.Material(tb.Schlick, f0=0.04)
    )
    made = tb.nn.Material(tb.Lambert, albedo=tb.nn.Learned([0.5, 0.4, 0.3])) + gloss
    return tb.nn.Shader(made, tb.plan(g, made(g), POINT))


@pytest.mark.parametrize("model", [MODEL, MODEL.to(torch.float32)], ids=["numbers", "tensors"])
def test_a_planned_call_dispatches_few_operations(model):
    g = masked()
    plan = tb.plan(g, model, POINT)
    found = dispatched(lambda: plan(g, model, POINT))
    assert len(found) <= CALL, sorted(found)


def test_a_step_of_learning_dispatches_few_operations_and_looks_at_no_values():
    g = masked()
    shader = learned(g)
    found = dispatched(lambda: shader(g, POINT).square().mean().backward())
    assert len(found) <= STEP, sorted(found)
    assert not set(LOOKS) & set(found)
    assert set(LOOKS) & set(dispatched(lambda: tb.plan(g, shader.material(g), POINT))), "a plan does look"


def with_gradients(fn, *values):
    mine = [v.map(lambda t: t.detach().clone().requires_grad_(t.is_floating_point())) for v in values]
    image = fn(*mine)
    image.square().sum().backward()
    return image.detach(), [t.grad for v in mine for _, t in v.named_tensors() if t.grad is not None]


class Glow(Direct):
    """An effect that gives its channels one by one, and the last grey."""

    def run(self, bsdf, surface, lights, prepared):
        one = surface.viewer.cos_o
        return [Contribution(slice(0, 1), (one, 2 * one, one)), Contribution(slice(0, 1), (one,))]


@pytest.mark.parametrize("per_light", [False, True])
@pytest.mark.parametrize("lights", [1, 3])
@pytest.mark.parametrize(
    "material",
    [
        glossy(3),
        glossy(3, 6, 6),
        glossy(1) + tb.Lambert([0.1, 0.2, 0.3]),
        tb.TwoSided(glossy(3), tb.Lambert(0.5)),
        0.5 * tb.BlinnPhong([0.1, 0.2, 0.3], 9.0, tb.Dielectric([1.5, 1.6, 1.7])),
        tb.Phong(torch.rand(6, 3), torch.rand(6, 6, 1) * 9, tb.Conductor.named("Cu")),
    ],
    ids=["colours", "maps", "grey and coloured", "two sides", "dielectric", "conductor"],
)
def test_few_points_are_shaded_as_many_are(monkeypatch, material, lights, per_light):
    """Eagerly and up to some number of points, colours lie as one tensor."""
    found, visibility = [], torch.rand(lights, 6, 6, 1)

    def image(g, material, *lights):
        return tb.shade(g, material, lights, visibility=visibility, per_light=per_light)

    for few in (numerics.FEW, 0):
        monkeypatch.setattr(numerics, "FEW", few)
        found.append(with_gradients(image, sheet(6), material, *([POINT] if lights == 1 else three_lights())))
    (few, gradients), (many, wanted) = found
    assert all(map(tb.is_planar, few if per_light else [few]))
    torch.testing.assert_close(few, many)
    for a, b in zip(gradients, wanted, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-5 * float(b.abs().max()))


@pytest.mark.parametrize("position", [torch.rand(2, 1, 3) + 2, torch.rand(2, 4, 3) + 2], ids=["one a view", "four a view"])
def test_lights_by_view_too(monkeypatch, position):
    views = tb.stack([sheet(6, gen=k) for k in range(2)])
    lights = tb.PointLight(position, torch.rand(position.shape[-2], 3))
    found = []
    for few in (numerics.FEW, 0):
        monkeypatch.setattr(numerics, "FEW", few)
        found.append([tb.shade(views, glossy(3), [lights, POINT], per_light=p) for p in (False, True)])
    torch.testing.assert_close(found[0], found[1])


@pytest.mark.parametrize("lights", [POINT, three_lights()])
def test_channels_of_an_effect_of_ones_own(monkeypatch, lights):
    found, g = [], sheet(6)
    for few in (numerics.FEW, 0):
        monkeypatch.setattr(numerics, "FEW", few)
        found.append([tb.shade(g, glossy(3), lights, effects=[Glow()], per_light=p) for p in (False, True)])
    torch.testing.assert_close(found[0], found[1])


@pytest.mark.parametrize("others", [0, 2])
def test_a_mirror_of_few_points(monkeypatch, others):
    g, sky, found = sheet(6), tb.EnvironmentMap(torch.rand(4, 8, 3)), []
    for few in (numerics.FEW, 0):
        monkeypatch.setattr(numerics, "FEW", few)
        found.append(tb.shade(g, tb.Mirror(0.9) + tb.Mirror([0.1, 0.2, 0.3], tb.Dielectric(1.5)), [sky, *three_lights()[:others], sky]))
    torch.testing.assert_close(found[0], found[1])


def test_more_channels_of_light_than_of_matter(monkeypatch):
    found = []
    for few in (numerics.FEW, 0):
        monkeypatch.setattr(numerics, "FEW", few)
        found.append(tb.shade(sheet(6), tb.Lambert(0.5), tb.PointLight([0.0, 1.0, 3.0], torch.arange(1.0, 9.0))))
    assert found[0].shape == (6, 6, 8)
    torch.testing.assert_close(found[0], found[1])


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_edge_of_a_lobe_of_few_points(monkeypatch, dtype):
    half_ulp = 0.5 * torch.finfo(dtype).eps
    m = torch.tensor([0.0, 0.5, 1.0 - half_ulp, 1.0, 1.0 + 2 * half_ulp, 1.5], dtype=dtype)
    s, found = torch.tensor([[0.0], [1e-3], [1.0], [50.0]], dtype=dtype), []
    for few in (numerics.FEW, 0):
        monkeypatch.setattr(numerics, "FEW", few)
        found.append(numerics.log1p_power(m, s))
    assert torch.equal(*found)
    assert found[0][:, 3].tolist() == [1.0, 0.0, 0.0, 0.0], "0 ** 0 is 1"


def test_what_was_wrong_is_wrong_again():
    for _ in range(2):
        with pytest.raises(ValueError, match=r"Phong.exponent: expected shape \[\.\.\., 1\], found \[4, 3\]"):
            tb.Phong(torch.rand(4, 3), torch.rand(4, 3))
        with pytest.raises(TypeError, match=r"Lambert.albedo: expected a tensor of floats, found torch.int64"):
            tb.Lambert(torch.ones(3, dtype=torch.int64))
    tb.Phong(torch.rand(4, 3), torch.rand(4, 1))


def test_a_scene_that_fitted_may_fit_no_more():
    """The same kinds are not checked again; a tensor that a module has replaced since is of another kind."""
    g, albedo = sheet(6), torch.nn.Parameter(torch.rand(6, 6, 3))
    brdf = tb.Lambert(albedo)
    plan = tb.plan(g, brdf, POINT)
    plan(g, brdf, POINT)
    albedo.data = albedo.data.double()
    for _ in range(2):
        with pytest.raises(TypeError, match=r"Lambert.albedo: float64 on cpu beside the G-buffer's position: float32"):
            plan(g, brdf, POINT)
    half = tb.Lambert(torch.rand(6, 6, 3).bfloat16())
    with torch.autocast("cpu", torch.bfloat16):
        plan(g, half, POINT)
    with pytest.raises(TypeError, match=r"Lambert.albedo: bfloat16 on cpu"):
        plan(g, half, POINT)


def test_kinds():
    a, b = tb.Lambert(torch.rand(2, 3)), tb.Lambert(torch.rand(2, 3))
    assert kinds.of(a) == kinds.of(b) != kinds.of(tb.Lambert(torch.rand(2, 1)))
    assert kinds.of(tb.Phong(0.5, 2.0)) != kinds.of(tb.Phong(0.5, 2.0, normalization="bound"))
    assert kinds.of((a, object())) is None, "what it does not know, it does not tell apart"
    assert kinds.of(tb.Sum((a, b))) != kinds.of(tb.Sum((a, b, b)))


def test_what_is_kept_of_kinds_is_bounded(monkeypatch):
    monkeypatch.setattr(kinds, "_found", {})
    monkeypatch.setattr(kinds, "MOST", 8)
    for n in range(1, 40):
        assert tb.Lambert(torch.rand(n)).channels == n
    assert len(kinds._found) <= 8
    assert kinds.recall(("x", None), lambda: 1) == 1
    assert not kinds.known(("x", None))
