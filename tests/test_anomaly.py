"""The examples in anomaly mode: no backward anywhere gives a NaN, not even one that is thrown away, and nothing warns."""

import importlib
import json
import warnings
from pathlib import Path

import pytest
import torch
import trimesh

import torchbrdf as tb

pytest.importorskip("matplotlib", reason="the example draws its sheet with matplotlib (the extra [examples])")
EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


@pytest.fixture
def strict(monkeypatch, request):
    """Imports an example, and makes every NaN of a backward pass and every warning an error."""
    monkeypatch.syspath_prepend(str(EXAMPLES))
    with warnings.catch_warnings(), torch.autograd.set_detect_anomaly(True, check_nan=True):
        imported = [importlib.import_module(name) for name in ("shade_mesh", "recover_material")]
        importlib.import_module("matplotlib.pyplot")
        importlib.import_module("kornia.color")  # whose import warns of torch's own deprecations
        importlib.import_module("kornia.morphology")
        warnings.simplefilter("error")
        if not request.node.get_closest_marker("slow"):  # a step in anomaly mode costs ten others
            monkeypatch.setattr(importlib.import_module("recovery.builtin"), "TEXELS", 6)
            monkeypatch.setattr(importlib.import_module("recovery.confidence"), "STEPS", 2)
        yield {module.__name__: module for module in imported}


def test_anomaly_mode_is_on(strict):
    x = torch.zeros(1, requires_grad=True)
    with pytest.raises(RuntimeError, match="nan values"):
        (torch.sqrt(x) * 0.0).sum().backward()


@pytest.mark.parametrize("optimizer", ["gauss-newton", "lbfgs", "adam"])
def test_recovery_of_the_scene_it_makes(strict, tmp_path, optimizer):
    builtin = importlib.import_module("recovery.builtin")
    problem = builtin.build(seed=0, size=28)
    rows = strict["recover_material"].recover(problem, "glossy", builtin.TEXELS, 2, tmp_path, optimizer=optimizer)
    assert all(torch.isfinite(torch.tensor(row["recovered"])) and row["sigma"] > 0 for row in rows if "sigma" in row)


def test_a_scene_file_with_a_learned_light_and_shadows(strict, tmp_path):
    trimesh.creation.icosphere(subdivisions=3).export(tmp_path / "ball.obj")
    mesh = tb.load_mesh(tmp_path / "ball.obj")
    view = {"eye": [0.6, 1.2, 3.8], "target": [0, 0, 0], "up": [0, 1, 0], "fov_y_deg": 32.0, "size": [24, 24]}
    g = tb.GBuffer.from_mesh(mesh, tb.Camera.look_at(view["eye"], view["target"], view["up"], 32.0, (24, 24)))
    known, lamp = tb.DirectionalLight([-1.0, 0.5, 2.0], 2.0), tb.PointLight([0.5, -1.5, 4.0], 30.0)
    for k, light in enumerate((known, lamp)):
        tb.save_image(
            tmp_path / f"{k}.exr", tb.shade(g, tb.Lambert([0.6, 0.3, 0.1]) + tb.Phong(0.4, 30.0, tb.Dielectric(1.5)), light, mesh=mesh)
        )
    lights = [
        {"type": "directional", "direction": [-1.0, 0.5, 2.0], "irradiance": [2.0]},
        {"type": "point", "position": [0.45, -1.4, 4.1], "intensity": [25.0], "learn": ["intensity", "position"]},
    ]
    scene = {**view, "mesh": "ball.obj", "lights": lights, "images": {"glossy": ["0.exr", "1.exr"]}}
    (tmp_path / "scene.json").write_text(json.dumps(scene))
    rows = strict["recover_material"].main(
        ["--scene", str(tmp_path / "scene.json"), "--material", "glossy", "--iterations", "8", "--out", str(tmp_path / "out")]
    )
    found = {row["name"]: row["recovered"] for row in rows}
    assert found["light 1 intensity"] == pytest.approx(30.0, rel=0.02)


def test_shading_a_mesh(strict, tmp_path):
    strict["shade_mesh"].main(["--size", "48", "--out", str(tmp_path / "ring.png")])
    assert tb.read_image(tmp_path / "ring.png").std() > 0.05


@pytest.mark.slow
def test_the_whole_of_it(strict, tmp_path):
    rows = strict["recover_material"].main(["--seed", "0", "--out", str(tmp_path)])
    assert all(row["error"] < 0.02 for row in rows if row["error"] is not None)
    strict["shade_mesh"].main(["--size", "256", "--out", str(tmp_path / "ring.png")])


@pytest.mark.slow
def test_spot(strict, shared_data, tmp_path):
    strict["recover_material"].main(["--scene", str(shared_data / "spot/scene.json"), "--material", "lambert", "--out", str(tmp_path)])
    strict["shade_mesh"].main(["--mesh", str(shared_data / "spot/spot.obj"), "--texture", str(shared_data / "spot/spot_texture.png"), "--out", str(tmp_path / "spot.png"), "--size", "128"])  # fmt: skip
