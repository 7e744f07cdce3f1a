"""`examples/height_field.py`: the law of Beckmann and Smith is what rays find on a Gaussian surface of mirrors."""

import importlib
import math
from pathlib import Path

import pytest
import torch

import torchbrdf as tb

pytest.importorskip("matplotlib", reason="the example draws its picture with matplotlib (the extra [examples])")
EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
UNCORRELATED = 1.5  # percent: what Smith's law is off by at alpha = 0.5 (docs/rough-surfaces.md), and what 10 steps of the mesh cost


@pytest.fixture
def example(monkeypatch):
    monkeypatch.syspath_prepend(str(EXAMPLES))
    return importlib.import_module("height_field")


def excess(rows):
    """How far the sums are off in terms of what is allowed, at the worst angle: four standard errors, and what the law neglects."""
    return max(abs(row["once"][0]) / (4.0 * row["once"][1] + UNCORRELATED) for row in rows)


@pytest.mark.slow
def test_rays_find_the_law_and_see_a_wrong_alpha(example, tmp_path):
    results = example.measure(0.5, [10], 4, 20, 50_000)
    rows = example.table(results)
    assert excess(rows) < 1.0
    assert excess(example.table(results, alpha=0.55)) > 1.5
    assert excess(example.table(results, alpha=0.45)) > 1.5
    for row in rows:
        again, error, lost = row["again"]
        assert abs(again - lost) < 4.0 * error + 1.0  # what bounces again is what one bounce loses
    example.picture(results, tmp_path / "field.png")
    assert tb.read_image(tmp_path / "field.png").std() > 0.05


def test_the_facets_have_the_alpha_asked_for(example):
    side, steps, alpha = 8, 10, 0.3
    mesh = example.surface(example.heights(side, steps, torch.Generator().manual_seed(0)), steps, alpha)
    a, b, c = mesh.vertices[mesh.faces].unbind(1)
    inside = ((a + b + c)[:, :2] / 3).sub(0.5 * side).abs().amax(-1) < 0.5 * side  # one period
    normal = torch.linalg.cross(b - a, c - a)[inside]
    assert int(inside.sum()) == 2 * (side * steps) ** 2
    assert (normal[:, 2] > 0).all()
    slope2 = (normal[:, :2] / normal[:, 2:]).square().sum(-1).mean()
    assert math.sqrt(float(slope2)) == pytest.approx(alpha, rel=1e-12)


def test_a_smooth_surface_is_a_mirror(example):
    mesh = example.surface(example.heights(4, 10, torch.Generator().manual_seed(0)), 10, 1e-9)
    wo, bounces = example.trace(mesh, *(at := example.arriving(mesh, 4, 0.5, 100, torch.Generator().manual_seed(1))))
    assert (bounces == 1).all()
    torch.testing.assert_close(wo, at[1] * torch.tensor([-1.0, -1.0, 1.0], dtype=wo.dtype), rtol=0, atol=1e-7)


def test_the_bins_hold_the_albedo(example):
    law, _ = example.laws(0.5)
    wi = torch.tensor([math.sin(0.5), 0.0, math.cos(0.5)], dtype=torch.float64)
    assert float(example.predicted(law, 0.5).sum()) == pytest.approx(float(law.directional_albedo(wi)), rel=1e-4)
