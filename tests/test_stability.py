"""Every formula holds its bounds on its hard grid; every formula has one; and the measure sees what is wrong."""

import re

import gmpy2
import numpy as np
import oracle
import pytest
import torch
from stability import bounds, curvature, dual, kept, measure, report, rivals, truth
from stability.case import FEWER, POINTS
from stability.case import Draw as Grid
from stability.cases import CASES, derived, fresnel, lobes, microfacet

import torchbrdf as tb
from torchbrdf import numerics, registry, sampling
from torchbrdf.bsdf.lobe import Draw
from torchbrdf.interval import UNIT, Interval
from torchbrdf.registry import BSDFS, FRESNEL_TERMS
from torchbrdf.value import COLOUR, SCALAR, param, value

BY_NAME = {case.name: case.on(FEWER) for case in CASES}
WHOLE = {case.name: case for case in CASES}
HARD = ("normalize", "reflect", "refract", "Frame", "Geometry", "EnvironmentMap", "PointLight", "DirectionalLight")


@pytest.fixture(autouse=True)
def _forget():
    """What is on disk is read again in no time; held in memory, whole grids in four dtypes would be gigabytes."""
    yield
    kept.forget()


@pytest.mark.parametrize("name", BY_NAME)
def test_single_precision(name):
    case = BY_NAME[name]
    assert bounds.violations(measure.run(case, torch.float32), case.error, case.vectors, torch.float32) == []


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=report.name_of)
@pytest.mark.parametrize("name", WHOLE)
def test_whole_grids(name, dtype):
    case = WHOLE[name]
    assert bounds.violations(measure.run(case, dtype), case.error, case.vectors, dtype) == []


@pytest.mark.slow
@pytest.mark.parametrize("dtype", bounds.HALVES, ids=report.name_of)
@pytest.mark.parametrize("name", BY_NAME)
def test_halves(name, dtype):
    """Computed in float32, whose whole grids are above, and rounded once: the special points, and fewer others than run.py stability."""
    case = BY_NAME[name]
    assert bounds.violations(measure.run(case, dtype), case.error, case.vectors, dtype) == []


# Compiling takes a minute for eight formulas; run.py stability does it in all four dtypes.
ONE_A_ROOM = ("fresnel.dielectric", "fresnel.conductor", "Phong lobe (modified)", "microfacet.ggx_d", "microfacet.beckmann_g1", "refract")
IN_HALF = (*ONE_A_ROOM, "RoughConductor, ggx, anisotropic", "Geometry")
FUSED = [pytest.param(batch, torch.float32, id=f"{batch[0].name}-float32") for batch in report.batches(CASES)]
FUSED += [pytest.param([BY_NAME[name] for name in IN_HALF], torch.float16, id="one a room-float16")]


@pytest.mark.slow
@pytest.mark.parametrize(("batch", "dtype"), FUSED)
def test_fusion_undoes_nothing(batch, dtype):
    batch = [case.on(FEWER) for case in batch]
    for case, fused in zip(batch, measure.run_compiled(batch, dtype), strict=True):
        eager = measure.run(case, dtype, second=False)
        assert bounds.undone(fused, eager, case.error) == [], case.name
        assert bounds.violations(fused, case.error, case.vectors, dtype) == [], case.name


@pytest.mark.slow
def test_fusion_keeps_second_derivatives():
    """Of one formula a room; run.py stability does it for all of them, which takes a quarter of an hour."""
    batch = [BY_NAME[name] for name in ONE_A_ROOM]
    pairs = zip(batch, *(curvature.run(batch, torch.float32, compiled=c) for c in (True, False)), strict=True)
    assert {case.name: bounds.bent(fused, eager, torch.float32) for case, fused, eager in pairs} == {case.name: [] for case in batch}


@pytest.mark.parametrize("name", ["Phong", "BlinnPhong"])
def test_lobes_from_vectors(name):
    assert measure.run(BY_NAME[name], torch.float32, second=False).value_everyday <= bounds.PHONG_FROM_VECTORS


def test_every_formula_is_measured():
    covered = {name for case in CASES for name in case.covers}
    functions = [f"{module}.{name}" for module in ("fresnel", "microfacet") for name in getattr(tb, module).__all__]
    methods = [f"{name} by {m.name}" for name in ("dielectric", "conductor") for m in registry.laws()[name].methods if m.exact]
    assert {*functions, *BSDFS, *FRESNEL_TERMS, *HARD, *methods} <= covered, (
        "a formula joins with its oracle and its hard cases: a model with its textbook formula, others in tests/stability/cases"
    )


@pytest.mark.parametrize(
    ("dtype", "size"), [*((dtype, POINTS) for dtype in report.DTYPES), (torch.float32, FEWER)], ids=lambda x: str(x).removeprefix("torch.")
)
def test_grids_hold_what_is_hard(dtype, size):
    info = torch.finfo(dtype)
    denormal = info.smallest_normal * info.eps
    for case in CASES:
        case = case.on(size)
        points = case.drawn(dtype)
        assert len(points) >= size, case.name
        assert (torch.from_numpy(points).to(dtype).double().numpy() == points).all(), f"{case.name}: a point is not a number of the dtype"
        columns = case.columns(points, dtype)
        for name in ("cos_i", "cos_h", "cos"):
            if name in columns:
                held = {-denormal, 0.0, denormal, info.smallest_normal, 1.0 - info.eps / 2, 1.0, 1.0 + info.eps}
                assert held <= set(columns[name].tolist()), (case.name, name)
        if {"cos_i", "k"} <= set(columns):  # those of a law, not of a model that holds a conductor
            assert {0.0, denormal} <= set(columns["k"].tolist())


@pytest.mark.parametrize("name", WHOLE)
def test_a_smaller_grid_keeps_every_special_value(name):
    whole, small = (some[name].drawn(torch.float32) for some in (WHOLE, BY_NAME))
    assert len(small) < 0.5 * len(whole)
    draw = Grid(torch.float32)
    special = [*draw.cosines(), *fresnel.etas(draw), *lobes.exponents(draw), *microfacet.ROUGHNESS, draw.info.max, 1e3]
    special = {x * sign for x in draw.rounded(special).tolist() for sign in (1.0, -1.0)}
    for column, its, fewer in zip(WHOLE[name].inputs, whole.T, small.T, strict=True):
        values, counts = np.unique(its, return_counts=True)
        meant = special & set(values[counts >= 5].tolist())  # a few are met by accident
        assert meant <= set(fewer.tolist()), column


@value
class RetroLobe(tb.Bsdf):
    """A contributor's model: one file with its textbook formula, not smooth at wi = wo."""

    albedo: torch.Tensor = param(UNIT, COLOUR, "strength")
    width: torch.Tensor = param(Interval(0.0, 1.0, open_low=True, typical=(0.1, 0.9)), SCALAR, "of the lobe, as a chord")

    lobes = (tb.Lobe.GLOSSY_REFLECTION,)

    def formula(self, g):
        chord = 2.0 * numerics.safe_sqrt((1.0 - g.wi_h) * (1.0 + g.wi_h))  # |wi - wo|
        lobe = torch.exp(-chord / g.scalar(self.width))
        return tuple(a * lobe for a in g.colour(self.albedo))

    @staticmethod
    def textbook(m, p, albedo, width):
        apart = m.positive(1 - p.wi_wo)
        return albedo * m.where(apart, m.exp(-m.sqrt(m.where(apart, 2 - 2 * p.wi_wo, 1)) / width), 1)

    def density(self, g):
        return torch.relu(g.cos_i) / np.pi

    def draw(self, viewer, u):
        return Draw(sampling.cosine_hemisphere(u.x, u.y))

    def kink_distance(self, g):
        return torch.minimum(super().kink_distance(g), 1.0 - g.wi_h)


def test_the_case_of_a_contributors_model_is_derived(monkeypatch):
    """From its textbook formula, its declared ranges and its kinks, wi = wo among them; and the case sees a slip."""
    case = derived.case_of(RetroLobe, None, {}).on(FEWER)
    points = case.drawn(torch.float32)
    assert (points[:, :3] == points[:, 3:6]).all(1).any()
    assert bounds.violations(measure.run(case, torch.float32), case.error, case.vectors, torch.float32) == []
    right = RetroLobe.formula
    monkeypatch.setattr(RetroLobe, "formula", lambda self, g: tuple(1.0001 * f for f in right(self, g)))
    assert bounds.violations(measure.run(case, torch.float32, second=False), case.error, case.vectors, torch.float32)


def test_a_truth_is_kept_until_its_sources_change(tmp_path, monkeypatch):
    monkeypatch.setattr(kept, "FOLDER", tmp_path)
    calls = []
    truth = kept.kept(lambda case, dtype: calls.append(case.name) or np.full(3, gmpy2.mpfr(0.1)))
    case = BY_NAME["fresnel.schlick"]
    first = truth(case, torch.float32)
    for make_anew in (False, True):
        kept.forget()
        if make_anew:
            monkeypatch.setattr(kept, "version", lambda: "of other sources")
        assert (truth(case, torch.float32) == first).all()
        assert len(calls) == 1 + make_anew
    assert [folder.name for folder in tmp_path.iterdir()] == ["of other sources"]
    truth(WHOLE["fresnel.schlick"], torch.float32)
    truth(case, torch.float64)
    assert len(calls) == 4, "another grid, and another dtype"


@pytest.mark.parametrize("name", ["RoughDielectric, refraction", "fresnel.conductor", "normalize"])
def test_fewer_bits_are_enough_where_nothing_is_huge_or_tiny(name, monkeypatch):
    """Of float64: every digit that is kept, of values and slopes."""
    case = WHOLE[name].on(100)
    points = case.drawn(torch.float64)[-100:]
    few = truth.by_bits(lambda p: truth.values_and_slopes(case, p), points, torch.float64)
    monkeypatch.setattr(truth, "TAME", 0)
    many = truth.by_bits(lambda p: truth.values_and_slopes(case, p), points, torch.float64)
    least = torch.finfo(torch.float64).tiny
    assert max(abs(a - b) / max(abs(b), least) for a, b in zip(few.ravel(), many.ravel(), strict=True) if gmpy2.is_finite(b)) < 2.0**-150


def test_derivatives_of_the_oracle():
    """Dual numbers against central differences of an independent formula, by complex amplitudes, in 320 bits."""
    dual.set_precision(torch.float32)
    points = np.array([[0.3, 1.5, 2.5], [0.9, 0.2, 3.0], [0.5, 1.5, 0.0], [1.0, 0.05, 0.5]])
    (r,) = BY_NAME["fresnel.conductor"].truth(*dual.inputs(points))
    for i, p in enumerate(points.tolist()):
        assert abs(float(r.value[i]) - float(oracle.reflectance(*p))) < 1e-16
        for j in range(3):
            assert float(r.parts[j][i]) == pytest.approx(float(oracle.derivative(j, *p)), rel=1e-12, abs=1e-30)


def test_second_derivatives_of_the_oracle():
    dual.set_precision(torch.float32)
    x, s = dual.inputs(np.array([[0.3, 2.5]]), along=0)
    f = dual.power(x, s) * dual.erf(x) / dual.sqrt(s)
    h = gmpy2.mpfr(10) ** -40

    def slope(x):
        x, s = dual.inputs(np.array([[x, gmpy2.mpfr(2.5)]], dtype=object))
        return (dual.power(x, s) * dual.erf(x) / dual.sqrt(s)).parts

    up, down = slope(gmpy2.mpfr(0.3) + h), slope(gmpy2.mpfr(0.3) - h)
    for j in range(2):
        assert abs(f.parts[j].parts[0][0] - (up[j][0] - down[j][0]) / (2 * h)) < 1e-60


@pytest.mark.parametrize(
    "name", [n for n in rivals.TEXTBOOK if n not in ("fresnel.schlick", "microfacet.beckmann_g1", "microfacet.ggx_g1")]
)
def test_the_bounds_refuse_the_textbook(name):
    """They are no formality: competent textbook code breaks them on the same points."""
    case = BY_NAME[name]
    assert bounds.violations(rivals.textbook(case, torch.float32), case.error, case.vectors, torch.float32)


FAULTS = {
    "g^2 without compensation": (
        numerics,
        "eta2_minus_sin2",
        lambda c, n, *_, **__: (n - 1) * (n + 1) + c * c,
        "fresnel.refraction_cosine",
    ),
    "g^2 in float32": (
        numerics,
        "eta2_minus_sin2_widened",
        lambda c, n, k=None: (n - 1) * (n + 1) + c * c - (0 if k is None else k * k),
        "fresnel.dielectric",
    ),
    "a square root capped": (numerics, "safe_sqrt", lambda x, least=0.0: torch.sqrt(x.clamp_min(1e-8)), "Geometry"),
    "a dot product rounded": (numerics, "sum_of_products", lambda *p: (sum(x * y for x, y in p), torch.zeros(())), "refract"),
    "a lobe not flushed but cut": (numerics, "flushed_exp", lambda x: torch.exp(x.clamp_min(-20)), "Phong lobe (modified)"),
    "a lobe by the cosine": (numerics, "log1p_power", lambda m, s: (1 - m).clamp_min(1e-6) ** s, "Phong lobe (none)"),
    "a value nudged": (numerics, "reciprocal_or_zero", lambda x, least=0.0: 1 / (x + 1e-5), "BlinnPhong"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_planted_fault_is_seen(fault, monkeypatch):
    module, attribute, faulty, name = FAULTS[fault]
    monkeypatch.setattr(module, attribute, faulty)
    case = BY_NAME[name]
    assert bounds.violations(measure.run(case, torch.float32, second=False), case.error, case.vectors, torch.float32)


def test_the_published_page_begins_as_the_report_does():
    """Its words, units and bounds; the figures are those of the last measurement."""
    page = report.PAGE.read_text(encoding="utf-8")
    (count,) = re.findall(r"^(\d+) formulas are measured", page, re.MULTILINE)
    assert page.startswith(report.HEAD.format(formulas=count))
    explained = {name for cell in re.findall(r"^\| (.*?) \|", page, re.MULTILINE) for name in cell.split(", ")}
    columns = {c.removesuffix(" (eager)") for c in (*report.EAGER_HEAD, *report.COMPILED_HEAD, *report.RIVAL_HEAD)} - {"formula", ""}
    assert [c for c in columns if not any(e.startswith(c) for e in explained)] == []
    assert all(f"| {unit} |" in page for unit in report.UNITS.values())
