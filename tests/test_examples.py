"""`examples/recover_material.py`: what it recovers, from what, and that it writes what it says."""

import importlib
import json
import math
import types
from pathlib import Path

import pytest
import torch
import trimesh
from renders import CARRIED, spot

import torchbrdf as tb

pytest.importorskip("matplotlib", reason="the example draws its sheet with matplotlib (the extra [examples])")
EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


@pytest.fixture
def example(monkeypatch):
    monkeypatch.syspath_prepend(str(EXAMPLES))
    return importlib.import_module("recover_material")


def part(name):
    return importlib.import_module(f"recovery.{name}")


def by_name(rows):
    return {row["name"]: row for row in rows}


def assert_written(folder, textures=()):
    """The sheet, the textures and the numbers, readable and equal to the report."""
    assert tb.read_image(folder / "sheet.png").std() > 0.05
    record = json.loads((folder / "material.json").read_text())
    for name in textures:
        assert tb.read_image(folder / record["parameters"][name]).dim() == 3
    return record


def test_a_quick_run_writes_its_files(example, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(part("builtin"), "TEXELS", 6)
    problem = part("builtin").build(seed=1, size=28)
    rows = example.recover(problem, "glossy", part("builtin").TEXELS, 3, tmp_path / "out")
    record = assert_written(tmp_path / "out", ["terms.0.albedo"])
    assert record["report"] == json.loads(json.dumps(rows))
    assert set(by_name(rows)) >= {"albedo R", "albedo G", "albedo B", "specular", "exponent", "eta"}
    assert all(math.isfinite(row["recovered"]) and row["sigma"] > 0 for row in rows if "recovered" in row)
    printed = capsys.readouterr().out
    assert "direct       on " in printed
    assert "truth" in printed
    assert "confidence" in printed


def test_a_truth_of_zero_has_an_absolute_error(example, capsys):
    recovered = {name: torch.tensor(x) for name, x in {"albedo": 0.25, "specular": 0.125, "eta": 1.25, "exponent": 9.0}.items()}
    rest = dict.fromkeys(recovered, 1.0)
    rows = by_name(example.report({"albedo": 0.5, "specular": 0.0, "eta": 1.0}, rest, recovered, rest))
    assert {name: row["error"] for name, row in rows.items()} == {"albedo": 0.5, "specular": 0.125, "eta": 0.25, "exponent": None}
    shown = {
        line.split()[0]: line.split()[4] for line in capsys.readouterr().out.splitlines() if line.split()[:1] and line.split()[0] in rows
    }
    assert shown == {"albedo": "50.00%", "specular": "0.1250", "eta": "0.2500", "exponent": "-"}


def test_black_texels_have_no_relative_error(example):
    material = torch.nn.ModuleDict({"albedo": tb.nn.Texture(torch.full((2, 2, 3), 0.5))})
    truth = torch.tensor([[0.0, 0.4], [0.5, 0.25]]).unsqueeze(-1).expand(2, 2, 3)
    everywhere = torch.ones(2, 2, dtype=torch.bool)

    def texels(truth):
        return example._texel_error(material, types.SimpleNamespace(truth={"albedo": truth}), everywhere)

    assert texels(truth)[0]["error"] == pytest.approx((0.25 + 0.0 + 1.0) / 3)
    assert texels(0 * truth) == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5))
def test_the_scene_it_makes(example, tmp_path, seed):
    builtin = part("builtin")
    problem = builtin.build(seed)
    view = problem.views[0]
    assert len(view.images) >= 6
    assert builtin.largest_half_angle(problem) >= 60.0
    clean = view.images[:, view.g.valid.squeeze(-1)]
    assert problem.noise >= 0.0099 * clean.mean()  # 1 % of the mean before noise was added
    background = view.images[:, ~view.g.valid.squeeze(-1)].std()  # nothing but noise lies in the background
    assert background == pytest.approx(problem.noise, rel=0.05)

    rows = by_name(example.main(["--seed", str(seed), "--out", str(tmp_path)]))
    assert_written(tmp_path, ["terms.0.albedo"])
    for name in ("albedo R", "albedo G", "albedo B", "specular", "exponent", "eta", "albedo texels"):
        assert rows[name]["error"] <= 0.02, name
    ratio = rows["exponent"]["start"] / rows["exponent"]["truth"]
    assert max(ratio, 1 / ratio) >= 4
    assert abs(rows["eta"]["start"] - rows["eta"]["truth"]) >= 0.3 - 1e-6  # stored in float32
    assert all(rows[f"albedo {c}"]["start"] == pytest.approx(0.5) for c in "RGB")
    # The confidence is of the size of the errors. It speaks of noise alone: the mean of a texture, which L-BFGS approaches
    # slowly, is still up to 6.3 sigma (0.1 %) from the truth when its steps are used up.
    for name in ("specular", "exponent", "eta"):
        assert abs(rows[name]["recovered"] - rows[name]["truth"]) < 5 * rows[name]["sigma"], name


@pytest.mark.slow
def test_spot_with_shadows_without_and_without_the_truth(example, shared_data, tmp_path):
    path = shared_data / "spot/scene.json"
    rows = by_name(example.main(["--scene", str(path), "--material", "lambert", "--out", str(tmp_path / "a")]))
    assert_written(tmp_path / "a")
    truth = dict(zip(("albedo R", "albedo G", "albedo B"), (0.62, 0.34, 0.18), strict=True))
    for name, value in truth.items():
        assert rows[name]["start"] == pytest.approx(0.5)
        assert abs(rows[name]["recovered"] / value - 1) <= 0.002
    blind = by_name(example.main(["--scene", str(path), "--shadow", "off", "--out", str(tmp_path / "b")]))
    for name in truth:
        assert blind[name]["error"] >= 3 * rows[name]["error"]
    scene = json.loads(path.read_text())
    del scene["materials"]
    scene["mesh"] = str(path.parent / scene["mesh"])
    scene["images"] = {k: [str(path.parent / f) for f in v] for k, v in scene["images"].items()}
    (tmp_path / "bare.json").write_text(json.dumps(scene))
    bare = by_name(example.main(["--scene", str(tmp_path / "bare.json"), "--material", "lambert", "--out", str(tmp_path / "c")]))
    for name in truth:
        assert bare[name]["recovered"] == rows[name]["recovered"]
        assert bare[name]["truth"] is None
        assert bare[name]["error"] is None


def window_scene(folder, material):
    """The scene file of a window of Mitsuba's images: two lights, 64 x 64 pixels."""
    _, view, scene = spot(folder)
    (fx, fy), (cx, cy) = view.focal.tolist(), view.principal.tolist()
    pose = torch.cat([view.rotation, -(view.rotation @ view.origin).unsqueeze(-1)], -1)
    camera = {"K": [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]], "world_to_camera": pose.tolist(), "size": [64, 64]}
    images = {material: [str(folder / f) for f in scene["images"][material]]}
    kept = {k: scene[k] for k in ("lights", "intensity", "materials")}
    return {**kept, **camera, "mesh": str(folder / scene["mesh"]), "images": images}


def test_spot_through_a_window(example, tmp_path):
    """What the repository carries of Mitsuba's images (all of them: above): a shadow between the legs."""
    (tmp_path / "scene.json").write_text(json.dumps(window_scene(CARRIED / "spot" / "tail", "lambert")))
    call = ["--scene", str(tmp_path / "scene.json"), "--material", "lambert", "--iterations", "20", "--out", str(tmp_path / "out")]
    rows, blind = by_name(example.main(call)), by_name(example.main([*call, "--shadow", "off"]))
    for name, value in zip(("albedo R", "albedo G", "albedo B"), ALBEDO, strict=True):
        assert abs(rows[name]["recovered"] / value - 1) <= 0.002
        assert blind[name]["error"] >= 3 * rows[name]["error"]


ALBEDO = (0.62, 0.34, 0.18)
PAINT = -0.3  # left of this the object is painted black, which the masks leave out


def user_scene(folder):
    """Two views of a ball with a painted side, as PNG with burnt-out highlights, masks, and a lamp of unknown intensity."""
    trimesh.creation.icosphere(subdivisions=4).export(folder / "ball.obj")
    mesh = tb.load_mesh(folder / "ball.obj")
    lights = [
        tb.PointLight([2.0, 2.5, 3.0], [130.0]),
        tb.DirectionalLight([-1.0, 0.5, 2.0], [4.0]),
        tb.PointLight([0.5, -1.5, 4.0], [30.0]),
    ]
    k = [[110.0, 0.0, 42.0], [0.0, 110.0, 30.0], [0.0, 0.0, 1.0]]
    pose = [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 4], [0, 0, 0, 1]]  # OpenCV's axes, four units before the ball
    cameras = {
        "look": tb.Camera.look_at([0.6, 1.2, 3.8], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], 32.0, (64, 80)),
        "cv": tb.Camera.from_matrix(k, pose, (60, 84), "opencv"),
    }
    burnt = 0
    for name, camera in cameras.items():
        g = tb.GBuffer.from_mesh(mesh, camera)
        clean = (g.position[..., :1] > PAINT) & g.valid
        images = tb.shade(g, tb.Lambert(torch.where(clean, torch.tensor(ALBEDO), 0.02)), lights, mesh=mesh, per_light=True)
        burnt += int((images > 1).any(-1).sum())
        for n, image in enumerate(images):
            tb.save_image(folder / f"{name}_{n}.png", image)
        tb.save_image(folder / f"{name}_mask.png", clean.float())
    views = [
        {"eye": [0.6, 1.2, 3.8], "target": [0, 0, 0], "up": [0, 1, 0], "fov_y_deg": 32.0, "size": [64, 80]},
        {"K": k, "world_to_camera": pose, "size": [60, 84], "convention": "opencv"},
    ]
    for view, name in zip(views, cameras, strict=True):
        view |= {"images": {"painted": [f"{name}_{n}.png" for n in range(3)]}, "mask": f"{name}_mask.png"}
    scene = {
        "mesh": "ball.obj",
        "views": views,
        "lights": [
            {"type": "point", "position": [2.0, 2.5, 3.0], "intensity": [130.0]},
            {"type": "directional", "direction": [-1.0, 0.5, 2.0], "irradiance": [4.0]},
            {"type": "point", "position": [0.5, -1.5, 4.0], "intensity": [22.0], "learn": ["intensity"]},
        ],
        "materials": {"painted": {"albedo": list(ALBEDO)}},
    }
    (folder / "scene.json").write_text(json.dumps(scene))
    return folder / "scene.json", burnt


def recovered(example, path, out):
    rows = by_name(
        example.main(["--scene", str(path), "--material", "painted", "--model", "lambert", "--iterations", "40", "--out", str(out)])
    )
    lamp = next(row for name, row in rows.items() if "intensity" in name)
    return max(rows[f"albedo {c}"]["error"] for c in "RGB"), lamp


def test_a_scene_of_ones_own(example, tmp_path, monkeypatch):
    path, burnt = user_scene(tmp_path)
    assert burnt > 100  # pixels that a fit to 8-bit files must leave out
    error, lamp = recovered(example, path, tmp_path / "out")
    assert_written(tmp_path / "out")
    assert error < 0.001  # measured 1e-4: half a step of 8 bits is 2e-3 of white, and thousands of pixels average it out
    assert lamp["start"] == pytest.approx(22.0)
    assert lamp["recovered"] == pytest.approx(30.0, rel=0.005)
    # What each part of the file is good for.
    scene_file = part("scene_file")
    photograph = scene_file._photograph
    with monkeypatch.context() as patch:
        patch.setattr(scene_file, "_photograph", lambda p: (photograph(p)[0], torch.ones_like(photograph(p)[1])))
        assert recovered(example, path, tmp_path / "burnt")[0] > 5 * error
    scene = json.loads(path.read_text())
    for view in scene["views"]:
        del view["mask"]
    path.write_text(json.dumps(scene))
    assert recovered(example, path, tmp_path / "unmasked")[0] > 5 * error


WRONG = {
    "no scene": (None, FileNotFoundError, "--scene: no such file"),
    "unknown light": (lambda s: s["lights"][0].update(type="lamp"), ValueError, r"lights: unknown type 'lamp'; legal are \['directional', 'point'\]"),
    "too few images": (lambda s: s["views"][0]["images"]["painted"].pop(), ValueError, r"images: 2 in a view of a scene with 3 lights; give one image per light"),
    "no mesh": (lambda s: s.update(mesh="absent.obj"), FileNotFoundError, "no such file: .*absent.obj"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_wrong_scene_files(example, tmp_path, case):
    change, error, message = WRONG[case]
    path, _ = user_scene(tmp_path)
    scene = json.loads(path.read_text())
    if change is None:
        path = tmp_path / "absent.json"
    else:
        change(scene)
        path.write_text(json.dumps(scene))
    with pytest.raises(error, match=message):
        recovered(example, path, tmp_path / "out")
