"""The shipped contract over every registered model, and over a model that is not ours."""

import importlib
import inspect
import math
import pkgutil

import pytest
import torch
from sampler_models import Ward
from torch import Tensor

import torchbrdf as tb
from torchbrdf import registry
from torchbrdf.bsdf.base import Bsdf
from torchbrdf.bsdf.lambert import Lambert
from torchbrdf.constraint import UNIT_DIRECTION
from torchbrdf.interval import UNIT
from torchbrdf.optics.fresnel import Fresnel
from torchbrdf.testing import PROPERTIES, instances, run
from torchbrdf.testing.borders import dark_outside_domain
from torchbrdf.testing.energy import energy_bound
from torchbrdf.testing.instances import of_class
from torchbrdf.testing.reciprocity import reciprocity
from torchbrdf.testing.report import compiles
from torchbrdf.value import COLOUR, VECTOR, value

FAST = [p for p in PROPERTIES if p is not compiles]
INSTANCES = list(instances())
THOROUGH = list(instances(thorough=True, seed=1))


@pytest.mark.parametrize("prop", FAST, ids=lambda p: p.__name__)
@pytest.mark.parametrize("subject", [v for _, v in INSTANCES], ids=[label for label, _ in INSTANCES])
def test_contract(subject, prop):
    outcome = run(prop, subject)
    assert outcome.ok is not False, outcome
    assert outcome.ok or prop is not energy_bound or not promises_energy(subject), f"it conserves energy, and that is measured: {outcome}"


def promises_energy(subject):
    return isinstance(subject, Bsdf) and subject.energy_bound is not None


@pytest.mark.slow
@pytest.mark.parametrize("prop", FAST, ids=lambda p: p.__name__)
@pytest.mark.parametrize("subject", [v for _, v in THOROUGH], ids=[label for label, _ in THOROUGH])
def test_contract_thoroughly(subject, prop):
    outcome = run(prop, subject, seed=1, thorough=True)
    assert outcome.ok is not False, outcome


# Of each class one: the fullest mixture of those that hold others, else the first. Inductor takes up to a minute for each; conductors
# and dielectrics in the lobes go through it in test_hard_scenes, formulas by themselves in test_stability.
COMPILED = {type(v): (label, v) for label, v in [*reversed(INSTANCES), *(i for i in INSTANCES if i[0].startswith("Sum"))]}.values()


@pytest.mark.parametrize("subject", [v for _, v in COMPILED], ids=[label for label, _ in COMPILED])
def test_traces_into_one_graph(subject):
    outcome = run(compiles, subject, backend="aot_eager")
    assert outcome.ok is True, outcome


@pytest.mark.slow
@pytest.mark.parametrize("subject", [v for _, v in COMPILED], ids=[label for label, _ in COMPILED])
def test_compiles(subject):
    outcome = run(compiles, subject)
    assert outcome.ok is not False, outcome


def test_check_compiles_when_asked():
    assert "compiles" not in f"{tb.testing.check(tb.Schlick(0.04))}"
    report = tb.testing.check(tb.Schlick(0.04), compiled="aot_eager")
    assert report.ok, f"\n{report}"
    assert "compiles               ok" in f"{report}"


def unregistered(base, package="torchbrdf"):
    """Concrete subclasses defined in the package that the registry does not name."""
    found = list(base.__subclasses__())
    for cls in found:
        found += cls.__subclasses__()
    named = set(registry.BSDFS) | set(registry.FRESNEL_TERMS)
    return {c.__name__ for c in found if c.__module__.split(".")[0] == package and not inspect.isabstract(c)} - named


def test_every_model_is_registered():
    for module in pkgutil.walk_packages(tb.__path__, "torchbrdf."):
        importlib.import_module(module.name)
    assert unregistered(Bsdf) == set()
    assert unregistered(Fresnel) == set()
    assert {"Retroreflector"} <= unregistered(Bsdf, __name__.split(".")[0]), "the search itself must find one"


def test_registered_models_have_instances():
    assert {label.split("(")[0] for label, _ in INSTANCES} == set(registry.BSDFS) | set(registry.FRESNEL_TERMS)


@value
class Retroreflector(Bsdf):
    """A user's own model: 2 albedo (wi.wo)^2 / pi ... of no physical merit, but reciprocal and bounded."""

    albedo: Tensor = tb.param(UNIT, COLOUR, "strength")

    lobes = (tb.Lobe.GLOSSY_REFLECTION,)

    def formula(self, g):
        cos = g.wi_h * g.wi_h  # (1 + wi.wo) / 2
        return tuple(a * cos * (1.0 / math.pi) for a in g.colour(self.albedo))

    def density(self, g):
        return Lambert(self.albedo).density(g)

    def draw(self, viewer, u):
        return Lambert(self.albedo).draw(viewer, u)

    @property
    def energy_bound(self):
        return self.albedo


def test_a_users_model_signs_too():
    report = tb.testing.check(Retroreflector([0.8, 0.5, 0.3]))
    assert report.ok, f"\n{report}"


def test_a_users_faulty_model_is_refused():
    class Bright(Retroreflector):
        def formula(self, g):
            return tuple(f * (1.0 + g.cos_i) * 3.0 for f in super().formula(g))

    assert set(tb.testing.check(Bright([0.8, 0.5, 0.3])).failed) >= {"energy_bound", "reciprocity"}


def energy(model, thorough=False):
    return run(energy_bound, model, thorough=thorough)


@pytest.mark.parametrize("thorough", [False, True])
def test_energy_means_energy(thorough):
    both = energy(tb.Lambert(0.9) + tb.Phong(3.0, 20.0), thorough)
    assert both.ok is False
    assert both.figure == pytest.approx(3.9, abs=1e-3)
    assert both.detail == "largest directional albedo, at 0°: above 1"
    assert energy(1.5 * tb.Lambert(0.9), thorough).ok is False
    assert energy(1.5 * tb.Lambert(0.6), thorough).ok, "a factor above 1 makes no light by itself"
    dim = tb.Lambert(0.5) + tb.Phong(0.6, 30.0, fresnel=tb.Schlick(0.04))
    assert energy(dim, thorough).ok, "its bound of 1.1 is loose"
    glazed = tb.Lambert(0.9) + tb.Mirror(1.0, fresnel=tb.Dielectric(1.5))
    outcome = energy(glazed, thorough)
    assert outcome.ok is False
    assert outcome.figure == pytest.approx(1.9, abs=1e-3)
    assert "at 90° - " in outcome.detail


@pytest.mark.parametrize("thorough", [False, True])
@pytest.mark.parametrize("alpha", [0.02, 0.15, 0.6])
def test_wards_albedo_has_no_bound(alpha, thorough):
    outcome = energy(Ward(0.5, alpha), thorough)
    assert outcome.ok is False
    assert outcome.figure > 20.0
    assert "at 90° - " in outcome.detail
    assert "above 1" in outcome.detail


def test_none_promises_nothing_and_is_reported():
    for model in (tb.Phong(3.0, 2.0, normalization="none"), tb.Lambert(0.5) + 2.0 * tb.Phong(3.0, 2.0, normalization="none")):
        outcome = energy(model)
        assert outcome.ok is None
        assert outcome.figure > 1.0
        assert "the model promises nothing" in outcome.detail


def test_energy_is_sought_below_the_surface_and_in_every_azimuth():
    outcome = energy(tb.TwoSided(tb.Phong(1.2, 5.0), tb.Lambert(0.5)))
    assert outcome.ok is False
    assert "at 180°" in outcome.detail

    class Striped(tb.BlinnPhong):
        def formula(self, g):
            across = (g.wi_local.y * g.viewer.local.wo.y) ** 2
            return tuple(f * (0.5 + 12.0 * across) for f in super().formula(g))

    assert energy(Striped(0.3, 0.0)).ok is False
    along = torch.tensor([[0.8, 0.0, 0.6]], dtype=torch.float64)
    assert Striped(0.3, 0.0).directional_albedo(along) < 0.3


def test_every_failure_says_where():
    report = tb.testing.check(Retroreflector([0.8, 0.5, 0.3]))
    assert "wi at " in report.outcomes[[o.name for o in report.outcomes].index("reciprocity")].detail

    @value
    class Wrong(Retroreflector):
        def formula(self, g):
            return tuple(f * torch.sqrt(g.cos_o - 0.2) for f in super().formula(g))

    details = {o.name: o.detail for o in tb.testing.check(Wrong([0.8, 0.5, 0.3])).outcomes if o.ok is False}
    assert "evaluate at wi = -wo in the horizon, as given and 29 more, float32" in details["hard_cases"]
    assert "wo at " in details["reciprocity"]
    assert all("\n" not in d for d in details.values())


def test_what_excluded_all_points_is_named():
    class Nowhere(Retroreflector):
        def domain(self, g):
            return g.cos_i > 2.0

    class Kinked(Retroreflector):
        def kink_distance(self, g):
            return torch.zeros_like(g.cos_i)

    assert "domain excludes all of " in run(reciprocity, Nowhere(0.5)).detail
    assert "kink_distance is below 0.05 at all of " in run(reciprocity, Kinked(0.5)).detail


@value
class Lobes(Retroreflector):
    """Parameters of several axes, and a direction."""

    weights: Tensor = tb.param(UNIT, ("K", 3, "C"), "of K lobes")
    axis: Tensor = tb.param(UNIT_DIRECTION, VECTOR, "of all of them")

    def formula(self, g):
        layout, total = g.viewer.layout, super().formula(g)
        x, y, z = self.axis.movedim(-1, 0).unbind(0)
        half = g.viewer.to_local(g.half)
        along = (x * half.x + y * half.y + z * half.z) ** 2
        for lobe in layout.rows(self.weights, 3):
            for row in layout.rows(lobe, 2):
                total = tuple(t + 0.02 * w * along for t, w in zip(total, layout.colour(row), strict=True))
        return total

    @property
    def energy_bound(self):
        return None


def test_parameters_of_several_axes_sign():
    ((_, lobes),) = of_class(Lobes)
    assert lobes.weights.shape == (2, 3, 3)
    report = tb.testing.check(lobes)
    assert report.ok, f"\n{report}"


def test_report(tmp_path):
    report = tb.testing.check(tb.Lambert(0.8 * torch.rand(5, 4, 3)) + tb.Mirror(0.2))
    assert report.ok
    table = str(report)
    assert "reciprocity" in table
    assert "The contract holds" in table
    report.save_picture(tmp_path / "report.png")
    assert (tmp_path / "report.png").stat().st_size > 10_000
    tb.testing.check(tb.Conductor.named("Au")).save_picture(tmp_path / "gold.png")
    assert (tmp_path / "gold.png").stat().st_size > 10_000


def test_check_refuses_what_is_no_material():
    with pytest.raises(TypeError, match="expected a BSDF or a Fresnel term, found Tensor"):
        tb.testing.check(torch.ones(3))
    with pytest.raises(ValueError, match=r"Lambert.albedo .* legal range \[0, 1\]"):
        tb.testing.check(tb.Lambert(1.2))


def test_what_crosses_without_a_transmission_lobe_is_refused(monkeypatch):
    """Whatever the model says of its domain."""
    monkeypatch.setattr(tb.Lambert, "domain", lambda self, g: torch.ones_like(g.above))
    outcome = run(dark_outside_domain, tb.Lambert(0.5))
    assert outcome.ok is False
    assert outcome.figure > 0
