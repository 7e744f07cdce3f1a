"""The shipped contract over every registered model, and over a model that is not ours."""

import importlib
import inspect
import math
import pkgutil

import pytest
import torch
from torch import Tensor

import torchbrdf as tb
from torchbrdf import registry
from torchbrdf.bsdf.base import Bsdf
from torchbrdf.bsdf.lambert import Lambert
from torchbrdf.interval import UNIT
from torchbrdf.optics.fresnel import Fresnel
from torchbrdf.testing import PROPERTIES, instances, run
from torchbrdf.testing.report import compiles
from torchbrdf.value import COLOUR, value

FAST = [p for p in PROPERTIES if p is not compiles]
INSTANCES = list(instances())
THOROUGH = list(instances(thorough=True, seed=1))


@pytest.mark.parametrize("prop", FAST, ids=lambda p: p.__name__)
@pytest.mark.parametrize("subject", [v for _, v in INSTANCES], ids=[label for label, _ in INSTANCES])
def test_contract(subject, prop):
    outcome = run(prop, subject)
    assert outcome.ok is not False, outcome


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


def test_report(tmp_path):
    report = tb.testing.check(tb.Lambert(torch.rand(5, 4, 3)) + tb.Mirror(0.2))
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
