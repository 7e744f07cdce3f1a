"""Proof of the walls: what is still to come fits in, each in one class of a user's own, without touching another file.

A model that transmits (diffuse and clear), a rough model of two lobes with a tangent, a model that is not reciprocal, an area light,
and an effect that needs random numbers; each signs the contract or is compared with a closed form.
"""

import math
from dataclasses import dataclass

import pytest
import torch
from torch import Tensor

import torchbrdf as tb
from torchbrdf import fresnel, microfacet, sampling, vector
from torchbrdf.bsdf.lobe import Delta, Draw
from torchbrdf.geometry import each
from torchbrdf.interval import UNIT, Interval
from torchbrdf.light.base import Light, LightKind, LightSample
from torchbrdf.value import COLOUR, SCALAR, VECTOR, Value, param, value
from torchbrdf.vector import Vec

UP = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64)
DOWN = -UP


# --- transmission --------------------------------------------------------------------------------------------------------


@value
class Paper(tb.Bsdf):
    """A thin sheet: diffuse reflection, and diffuse transmission to the other side. Seen from both."""

    reflectance: Tensor = param(Interval(0.0, 0.5, typical=(0.1, 0.4)), COLOUR, "share that is reflected")
    transmittance: Tensor = param(Interval(0.0, 0.5, typical=(0.1, 0.4)), COLOUR, "share that passes")

    lobes = (tb.Lobe.DIFFUSE_REFLECTION, tb.Lobe.DIFFUSE_TRANSMISSION)

    def domain(self, g):
        return g.same_side | g.across

    def formula(self, g):
        back = g.same_side.to(g.cos_i.dtype)
        return each(lambda r, t: (r * back + t * (1 - back)) / math.pi, g.colour(self.reflectance), g.colour(self.transmittance))

    def _through(self, viewer):
        r, t = (viewer.layout.average(x) for x in (self.reflectance, self.transmittance))
        return (t / (r + t)).detach()

    def density(self, g):
        through = self._through(g.viewer)
        return g.cos_i.abs() / math.pi * torch.where(g.same_side, 1 - through, through)

    def draw(self, viewer, u):
        w, passes = sampling.cosine_hemisphere(u.x, u.y), u.z < self._through(viewer)
        return Draw(Vec(w.x, w.y, w.z * torch.where(passes, -1.0, 1.0) * viewer.side), passes.to(torch.int64))

    @property
    def energy_bound(self):
        return self.reflectance + self.transmittance


@value
class Glass(tb.Bsdf):
    """A smooth interface: reflection and refraction, two delta lobes. Radiance grows by eta^2 on its way into the denser side."""

    eta: Tensor = param(Interval(0.0, open_low=True, typical=(1.2, 2.0)), SCALAR, "inside over outside")

    lobes = (tb.Lobe.DELTA_REFLECTION, tb.Lobe.DELTA_TRANSMISSION)

    def domain(self, g):
        return g.same_side | g.across

    def formula(self, g):
        return (torch.zeros_like(g.cos_i + g.cos_o),)

    def density(self, g):
        return torch.zeros_like(g.cos_i + g.cos_o)

    def draw(self, viewer, u):
        return Draw(viewer.mirror)

    def deltas(self, viewer):
        inside = viewer.scalar(self.eta)
        eta = torch.where(viewer.side > 0, inside, 1 / inside)  # far side over the viewer's
        cos = viewer.cos_o.abs()
        r, cos_t = fresnel.dielectric(cos, eta), fresnel.refraction_cosine(cos, eta)
        bent = vector.subtract(vector.scale(viewer.n, (cos / eta - cos_t) * viewer.side), vector.scale(viewer.wo, 1 / eta))
        passed = Delta(bent, -cos_t * viewer.side, ((1 - r) / (eta * eta),), 1, eta)
        return [Delta(viewer.mirror, viewer.cos_o, (r,), 0), passed]

    @property
    def energy_bound(self):
        return torch.ones_like(self.eta)


def test_a_sheet_of_paper_signs():
    report = tb.testing.check(Paper([0.4, 0.1], [0.2, 0.3]))
    assert report.ok, f"\n{report}"
    assert tb.testing.check(tb.Phong(0.3, 20.0) + Paper(0.4, 0.2)).ok
    assert tb.testing.check(tb.TwoSided(tb.Lambert(0.2)) + 0.5 * Paper(0.4, 0.2)).ok


def test_glass_signs():
    report = tb.testing.check(Glass(1.5))
    assert report.ok, f"\n{report}"
    albedo = Glass(1.5).directional_albedo(torch.cat([UP, DOWN, tb.normalize(UP + 0.5 * UP.roll(1, -1))]))
    torch.testing.assert_close(albedo, torch.ones_like(albedo))  # power, not radiance


def test_glass_samples_follow_snell():
    wo = tb.normalize(torch.tensor([[0.4, 0.2, 0.7]], dtype=torch.float64)).expand(1000, 3)
    for view, eta in ((wo, 1.5), (wo * torch.tensor([1.0, 1.0, -1.0]), 1 / 1.5)):
        s = Glass(1.5).sample(view, torch.rand(1000, 3, dtype=torch.float64))
        passed = s.lobe.squeeze(-1) == 1
        assert passed.any()
        n = UP.expand(1000, 3) * torch.sign(view[:, 2:])
        expected, _ = tb.refract(view, n, torch.tensor([eta], dtype=torch.float64))
        torch.testing.assert_close(s.wi[passed], expected[passed])
        torch.testing.assert_close(s.eta, torch.where(passed, eta, 1.0).unsqueeze(-1).double())


def plate(n, wo):
    return tb.GBuffer(torch.zeros(n, n, 3), torch.tensor([0.0, 0.0, 1.0]).expand(n, n, 3), tb.normalize(torch.tensor(wo)).expand(n, n, 3))


def test_light_from_behind_passes_through_paper_in_shade():
    behind = tb.DirectionalLight([0.0, 0.6, -0.8], 2.0)
    image = tb.shade(plate(2, [0.3, 0.0, 1.0]), Paper([0.4], [0.25]), behind)
    torch.testing.assert_close(image, torch.full_like(image, 0.25 / math.pi * 2.0 * 0.8))
    assert not tb.shade(plate(2, [0.3, 0.0, 1.0]), tb.Lambert(0.4), behind).any()


def test_a_two_sided_surface_is_lit_from_behind_for_a_viewer_behind():
    behind, sides = tb.DirectionalLight([0.0, 0.6, -0.8], 2.0), tb.TwoSided(tb.Lambert(0.5), tb.Lambert(0.2))
    image = tb.shade(plate(2, [0.3, 0.0, -1.0]), sides, behind)
    torch.testing.assert_close(image, torch.full_like(image, 0.5 / math.pi * 2.0 * 0.8))
    assert not tb.shade(plate(2, [0.3, 0.0, 1.0]), sides, behind).any()
    with pytest.raises(ValueError, match=r"TwoSided.inside: Paper sends light through the surface; it has two sides already"):
        tb.TwoSided(Paper(0.1, 0.1))


def test_an_environment_is_seen_through_glass():
    texels = torch.ones(8, 16, 1)
    texels[4:] = 3.0  # below the horizon of the map
    sky = tb.EnvironmentMap(texels, convention="blender")  # Z up
    image = tb.shade(plate(1, [0.0, 0.0, 1.0]), Glass(1.5), sky)
    torch.testing.assert_close(image, torch.full_like(image, 0.04 * 1.0 + 0.96 / 1.5**2 * 3.0), rtol=1e-5, atol=0)


# --- two lobes and a tangent ---------------------------------------------------------------------------------------------


@value
class Brushed(tb.Bsdf):
    """A diffuse base under an anisotropic GGX lobe (Torrance & Sparrow's form, V = 1/4): needs the frame."""

    albedo: Tensor = param(UNIT, COLOUR, "of the base")
    along: Tensor = param(Interval(0.0, 1.0, open_low=True, typical=(0.3, 0.8), hard=(0.05,)), SCALAR, "alpha along the tangent")
    across: Tensor = param(Interval(0.0, 1.0, open_low=True, typical=(0.3, 0.8), hard=(0.05,)), SCALAR, "alpha across it")

    lobes = (tb.Lobe.DIFFUSE_REFLECTION, tb.Lobe.GLOSSY_REFLECTION)

    def _d(self, g):
        h = vector.scale(g.viewer.to_local(g.half), g.inverse_half)
        ax, ay = g.scalar(self.along), g.scalar(self.across)
        q = (h.x / ax) ** 2 + (h.y / ay) ** 2 + h.z**2
        return torch.where(q > 0, 1 / (math.pi * ax * ay * torch.where(q > 0, q, 1.0) ** 2), 0.0)

    def formula(self, g):
        lobe = 0.25 * self._d(g)
        return tuple(a / math.pi + lobe for a in g.colour(self.albedo))

    def density(self, g):
        return 0.5 * (torch.relu(g.cos_i) / math.pi + self._d(g) * g.cos_h.abs() * 0.5 * g.inverse_half)

    def draw(self, viewer, u):
        diffuse = sampling.cosine_hemisphere(u.x, u.y)
        r, phi = torch.sqrt(u.x / (1 - u.x)), 2 * math.pi * u.y
        slope = Vec(viewer.scalar(self.along) * r * torch.cos(phi), viewer.scalar(self.across) * r * torch.sin(phi), torch.ones_like(u.x))
        glossy = vector.reflect_components(viewer.wo, vector.normalize_components(slope))
        second = u.z >= 0.5
        return Draw(Vec(*(torch.where(second, g, d) for g, d in zip(glossy, diffuse, strict=True))), second.to(torch.int64))

    def kink_distance(self, g):
        return torch.minimum(super().kink_distance(g), g.wi_h)


def test_a_brushed_metal_signs():
    report = tb.testing.check(Brushed([0.4, 0.2], 0.6, 0.35))
    assert report.ok, f"\n{report}"


def test_the_tangent_turns_the_lobe():
    brushed, gen = Brushed(0.2, 0.1, 0.4), torch.Generator().manual_seed(0)
    n, t, wi, wo = (tb.normalize(torch.randn(200, 3, generator=gen, dtype=torch.float64)) for _ in range(4))
    frame = tb.Frame.from_normal(n, t)
    expected = brushed.evaluate(frame.to_local(wi), frame.to_local(wo))
    for tangent in (t, 7.0 * t, t + 3.0 * n):  # made unit and orthogonal inside
        torch.testing.assert_close(brushed.evaluate(wi, wo, n, tangent), expected)
    d = microfacet.ggx_d_anisotropic(torch.tensor(0.3), torch.tensor(0.2), torch.tensor(0.93), 0.1, 0.4)
    assert d > 0  # the same distribution, under test elsewhere
    u = torch.rand(200, 3, generator=gen, dtype=torch.float64)
    s = brushed.sample(frame.to_world(wo.abs()), u, n, t)
    torch.testing.assert_close(s.pdf, brushed.pdf(s.wi, frame.to_world(wo.abs()), n, t))
    torch.testing.assert_close(frame.to_local(s.wi), brushed.sample(wo.abs(), u).wi)


@value
class Skewed(tb.Bsdf):
    """f = albedo (2 + sin phi_h) / (3 pi): tells the bitangent from its opposite."""

    albedo: Tensor = param(UNIT, COLOUR, "of the whole")
    lobes = (tb.Lobe.DIFFUSE_REFLECTION,)

    def formula(self, g):
        y = g.viewer.to_local(g.half).y * g.inverse_half
        return tuple(a * (2 + y) / (3 * math.pi) for a in g.colour(self.albedo))

    def density(self, g):
        return torch.relu(g.cos_i) / math.pi

    def draw(self, viewer, u):
        return Draw(sampling.cosine_hemisphere(u.x, u.y))


def test_a_surface_turned_to_the_viewer_keeps_its_bitangent():
    """In world space as in the local frame, from both sides."""
    gen = torch.Generator().manual_seed(0)
    n, t, wi, wo = (tb.normalize(torch.randn(200, 3, generator=gen, dtype=torch.float64)) for _ in range(4))
    frame, both = tb.Frame.from_normal(n, t), tb.TwoSided(Skewed(0.5))
    found = both.evaluate(wi, wo, n, t)
    torch.testing.assert_close(found, both.evaluate(frame.to_local(wi), frame.to_local(wo)))
    assert (found > 0).sum() > 60


def test_a_tangent_that_is_none_does_not_poison():
    brushed, wi = Brushed(0.2, 0.1, 0.4), tb.normalize(torch.tensor([[0.3, 0.2, 0.9]]))
    n = torch.tensor([[0.0, 0.0, 1.0]])
    expected = brushed.evaluate(wi, n, n)
    for bad in ((math.nan, 0.0, 0.0), (0.0, 0.0, 0.0), (math.inf, 1.0, 0.0), (0.0, 0.0, 2.0)):
        tangent = torch.tensor([bad], requires_grad=True)
        f = brushed.evaluate(wi, n, n, tangent)
        torch.testing.assert_close(f, expected)
        (gradient,) = torch.autograd.grad(f.sum(), tangent)
        assert (gradient == 0).all()


# --- albedo by transport -------------------------------------------------------------------------------------------------


@value
class OneWay(tb.Bsdf):
    """f = cos_i / pi: not reciprocal. Light arriving at cosine c leaves with albedo c."""

    strength_: Tensor = param(UNIT, SCALAR, "factor")
    lobes = (tb.Lobe.DIFFUSE_REFLECTION,)
    reciprocal = False

    def formula(self, g):
        return (g.scalar(self.strength_) * g.cos_i / math.pi,)

    def density(self, g):
        return torch.relu(g.cos_i) / math.pi

    def draw(self, viewer, u):
        return Draw(sampling.cosine_hemisphere(u.x, u.y))


def test_the_albedo_is_that_of_light_arriving():
    w = tb.normalize(torch.tensor([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.0, 0.95, 0.2]], dtype=torch.float64))
    torch.testing.assert_close(OneWay(1.0).directional_albedo(w), w[:, 2:], rtol=1e-6, atol=0)
    as_if_reciprocal = OneWay(1.0)
    object.__setattr__(as_if_reciprocal, "reciprocal", True)
    assert (as_if_reciprocal.directional_albedo(w) - w[:, 2:]).abs().max() > 0.1, "the test must tell the two apart"


def test_the_albedo_takes_a_tangent_and_keeps_its_memory_bounded(monkeypatch):
    from torchbrdf.bsdf import albedo

    brushed = Brushed(torch.rand(30, 2, dtype=torch.float64), 0.1, 0.6)
    brushed = brushed.replace(along=brushed.along.clone().requires_grad_())
    wo = tb.normalize(torch.randn(30, 3, dtype=torch.float64) + 2 * UP)
    t = torch.tensor([1.0, 1.0, 0.0], dtype=torch.float64)

    def found():
        a = brushed.directional_albedo(wo, UP[0], t, order=12)
        return a, torch.autograd.grad(a.sum(), brushed.along)[0]

    whole = found()
    turned = brushed.directional_albedo(tb.Frame.from_normal(UP[0], t).to_local(wo), order=12)
    torch.testing.assert_close(whole[0], turned)
    monkeypatch.setattr(albedo, "CHUNK", 100)
    most = []
    original = Brushed.formula
    monkeypatch.setattr(Brushed, "formula", lambda self, g: (most.append(g.cos_i.numel()), original(self, g))[1])
    for a, b in zip(whole, found(), strict=True):
        torch.testing.assert_close(a, b)
    assert max(most) <= 100


# --- an area light and an effect with random numbers ---------------------------------------------------------------------


@value
class Square(Light):
    """A square of side 2 a that radiates to one side, sampled uniformly by area."""

    centre: Tensor = param(Interval(), VECTOR, "where it is")
    half_side: Tensor = param(Interval(0.0, open_low=True), SCALAR, "a")
    emitted: Tensor = param(Interval(0.0), COLOUR, "radiance, downwards")

    kind = LightKind.AREA

    def sample(self, points, u=None):
        offset = torch.cat([(2 * u - 1) * self.half_side, torch.zeros_like(u[..., :1])], -1)
        towards = self.centre.to(points) + offset - points
        distance = towards.norm(dim=-1, keepdim=True)
        wi = towards / distance
        pdf = distance**2 / (wi[..., 2:].clamp_min(1e-6) * 4 * self.half_side**2)
        return LightSample(*(x[None] for x in (wi, distance, self.radiance(wi, points), pdf)))

    def pdf(self, wi, points=None):
        raise NotImplementedError("not needed here")

    def radiance(self, wi, points=None):
        return self.emitted.to(wi) * (wi[..., 2:] > 0)


@value
class Numbers(Value):
    """The random numbers of :class:`AreaSampling`."""

    u: Tensor = param(UNIT, ("S", 2), "[..., S, 2]")


@dataclass(frozen=True)
class AreaSampling(tb.Effect):
    """Area lights by sampling them: the mean of f |cos| L / pdf."""

    samples: int = 16
    name = "area"
    lobes = tb.Lobe.SPREAD
    lights = (LightKind.AREA,)

    def decide(self, scene, wish):
        on = wish != "off" and bool(scene.count(LightKind.AREA))
        return tb.Decision(self.name, on, f"{self.samples} samples of each area light" if on else "no area light", "sampled")

    def prepare(self, scene, generator):
        at = scene.g.position
        return Numbers(torch.rand(*scene.g.batch_shape, self.samples, 2, generator=generator, dtype=at.dtype))

    def run(self, bsdf, surface, lights, prepared):
        layout, points = surface.viewer.layout, surface.viewer.layout.join_vector(surface.position)
        found = []
        for row, light in lights:
            total = None
            for u in prepared.of(self.name).u.unbind(-2):
                s = light.sample(points, u)
                g = tb.Geometry(surface.viewer, layout.vector(s.wi[0]))
                factor = surface.cosine(bsdf, g) / layout.scalar(s.pdf[0]) / self.samples
                one = each(lambda f, e, k=factor: f * e * k, bsdf.formula(g), layout.colour(s.radiance[0]))
                total = one if total is None else each(torch.add, total, one)
            found.append(tb.Contribution(slice(row, row + 1), total))
        return found


def test_an_area_light_and_an_effect_that_draws():
    g = plate(3, [0.0, 0.3, 1.0])
    lamp, sun = Square([0.0, 0.0, 2.0], 0.5, [3.0, 1.0]), tb.DirectionalLight([0.0, 0.0, 1.0], 0.5)
    material = tb.Lambert([0.5, 0.8])
    with pytest.raises(
        ValueError, match=r"no effect brings light of kind 'area' to the material's diffuse reflection; pass one with effects="
    ):
        tb.plan(g, material, [lamp, sun])
    plan = tb.plan(g, material, [lamp, sun], effects=[AreaSampling(256)])
    assert "area         on   256 samples of each area light" in str(plan)
    prepared = plan.prepare(g, [lamp, sun], generator=torch.Generator().manual_seed(1))
    rows = plan(g, material, [lamp, sun], prepared, per_light=True)
    # Irradiance on a facing plane below the centre of a square of half side a, at height h (its form factor, four quarters of it).
    x = 0.5 / 2.0
    factor = 4 / (2 * math.pi) * 2 * x / math.sqrt(1 + x * x) * math.atan(x / math.sqrt(1 + x * x))
    expected = torch.tensor([0.5, 0.8]) * torch.tensor([3.0, 1.0]) * factor
    torch.testing.assert_close(rows[0].mean((0, 1)), expected, rtol=0.02, atol=0)
    torch.testing.assert_close(rows[1], (torch.tensor([0.5, 0.8]) / math.pi * 0.5).expand(3, 3, 2))
    torch.testing.assert_close(plan(g, material, [lamp, sun], prepared), rows.sum(0))
    again = plan.prepare(g, [lamp, sun], generator=torch.Generator().manual_seed(1))
    assert torch.equal(plan(g, material, [lamp, sun], again), plan(g, material, [lamp, sun], prepared))
    for seed in (1, 2):  # shade draws by the generator that it is given
        other = tb.shade(g, material, [lamp, sun], effects=[AreaSampling(256)], generator=torch.Generator().manual_seed(seed))
        assert torch.equal(other, plan(g, material, [lamp, sun], prepared)) == (seed == 1)
    off = tb.plan(g, material, sun, effects=[AreaSampling()], area="off")
    assert not off.calls_for("area")


def test_a_visibility_counts_point_and_directional_lights_alone():
    g, lamp, suns = plate(3, [0.0, 0.3, 1.0]), Square([0.0, 0.0, 2.0], 0.5, 3.0), tb.DirectionalLight([[0.0, 0.0, 1.0]] * 2, 0.5)
    share = torch.tensor([0.5, 0.25]).reshape(2, 1, 1, 1)
    rows = tb.shade(g, tb.Lambert(0.5), [lamp, suns], visibility=share, effects=[AreaSampling(1)], per_light=True)
    torch.testing.assert_close(rows[1:], share * tb.shade(g, tb.Lambert(0.5), suns, per_light=True))


def test_the_shader_takes_what_was_prepared():
    g, lamp = plate(3, [0.0, 0.3, 1.0]), Square([0.0, 0.0, 2.0], 0.5, [3.0, 1.0])
    material = tb.nn.Material(tb.Lambert, albedo=tb.nn.Learned([0.5, 0.5]))
    plan = tb.plan(g, material(g), lamp, effects=[AreaSampling(4)])
    prepared = plan.prepare(g, lamp, generator=torch.Generator().manual_seed(1))
    shader = tb.nn.Shader(material, plan)
    eager = shader(g, lamp, prepared)
    compiled = torch.compile(shader, fullgraph=True, backend="aot_eager")
    torch.testing.assert_close(compiled(g, lamp, prepared), eager)
    assert (torch.autograd.grad(eager.sum(), list(material.parameters()))[0] != 0).all()
    assert torch.equal(prepared.to(torch.float64).of("area").u.float(), prepared.of("area").u)


# --- a plan answers for what it was made for -----------------------------------------------------------------------------


def test_a_plan_called_with_other_kinds_is_an_error():
    g, sun, sky = plate(2, [0.0, 0.3, 1.0]), tb.DirectionalLight([0.0, 0.0, 1.0], 0.5), tb.EnvironmentMap(torch.ones(4, 8, 3))
    plan = tb.plan(g, tb.Lambert(0.5), sun)
    with pytest.raises(ValueError, match=r"lights\[0\]: this plan was made without EnvironmentMap \(environment\); make one for these"):
        plan(g, tb.Lambert(0.5), sky)
    with pytest.raises(ValueError, match=r"bsdf: this plan was made without delta reflection; make one for this material with tb.plan"):
        plan(g, tb.Lambert(0.5) + tb.Mirror(0.5), sun)
    point = tb.PointLight([[0.0, 0.0, 2.0]] * 3, 1.0)
    assert plan(g, tb.Lambert([0.1, 0.2]), [sun, point]).shape == (2, 2, 2), "more lights of a known kind are welcome"
    with pytest.raises(TypeError, match=r"shadows: found 'off', but no effect has that name; effects are \['direct', 'mirror', 'shadow'\]"):
        tb.plan(g, tb.Lambert(0.5), sun, shadows="off")
