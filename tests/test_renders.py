"""The crops of renders that the repository carries: windows of the whole images, small, each with its source and its licence."""

import numpy as np
import OpenEXR
import pytest
import torch
from data import make_crops
from renders import CARRIED, about, spot, whole_view, within

import torchbrdf as tb

FILES = [p for p in CARRIED.rglob("*") if p.is_file() and "__pycache__" not in p.parts]
CUT = sorted(p for p in FILES if p.suffix == ".exr" and p.parent.name != "hdri")


def named(path):
    return str(path.relative_to(CARRIED))


def channels(path):
    return {(part.name(), n): c.pixels for part in OpenEXR.File(str(path), separate_channels=True).parts for n, c in part.channels.items()}


def test_they_are_small_and_have_their_sources():
    assert sum(p.stat().st_size for p in FILES) < 2e6
    sources = (CARRIED / "SOURCES.md").read_text()
    for path in FILES:
        if path.parent != CARRIED:
            folder = str(path.parent.relative_to(CARRIED))
            assert f"`{folder}`" in sources or f"`{folder}/" in sources, path


@pytest.mark.parametrize("path", CUT, ids=named)
def test_a_crop_is_a_window(path):
    assert {p.shape for p in channels(path).values()} == {(make_crops.SIDE, make_crops.SIDE)}
    said = about(path.parent / "scene.exr" if path.parent.parent.name == "spot" else path)
    assert said["window"][2:] == [make_crops.SIDE] * 2


@pytest.mark.parametrize("window", make_crops.SPOT)
def test_the_camera_of_a_crop_sees_its_window_of_the_scene(window):
    mesh, view, scene = spot(CARRIED / "spot" / window)
    part, whole = (tb.GBuffer.from_mesh(mesh, camera) for camera in (view, whole_view(scene)))
    same = within(whole.triangle, scene) == part.triangle
    assert same.float().mean() > 0.999  # rays that differ by a rounding may fall on either side of an edge
    torch.testing.assert_close(torch.where(same, part.position, 0.0), torch.where(same, within(whole.position, scene), 0.0))


@pytest.mark.parametrize("path", CUT, ids=named)
def test_a_crop_is_that_window_of_the_whole_image(shared_data, path):
    spot_window = path.parent.parent.name == "spot"
    original = shared_data / ("spot" if spot_window else path.parent.name) / path.name
    said = about(path.parent / "scene.exr" if spot_window else path)
    found, whole = channels(path), channels(original)
    assert found.keys() == whole.keys()
    for name, pixels in found.items():
        np.testing.assert_array_equal(pixels, within(whole[name], said), err_msg=str(name))


def test_what_is_carried_whole_is_the_same(shared_data):
    assert (CARRIED / "spot/spot.obj").read_bytes() == (shared_data / "spot/spot.obj").read_bytes()
    for metal in make_crops.METALS:
        assert (CARRIED / f"nk/{metal}.yml").read_bytes() == (shared_data / f"nk/{metal}.yml").read_bytes()


def test_the_lines_of_the_radiance_picture_are_its_lines(shared_data):
    lines = make_crops.LINES
    whole = tb.read_image(shared_data / "hdri/studio.hdr")
    assert torch.equal(tb.read_image(CARRIED / "hdri/studio.hdr"), whole[lines.start : lines.stop])
