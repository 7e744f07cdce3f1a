"""Radiance against independent renderers: Spot with cast shadows by Mitsuba, and spheres by Mitsuba and Blender."""

import json
import math

import pytest
import torch
from test_scene_gbuffer import spot
from test_scene_visibility import away_from_edges

import torchbrdf as tb
from torchbrdf.io.exr import read_exr


@pytest.mark.parametrize("number", range(4))
def test_spot_with_shadows_as_mitsuba_renders_it(shared_data, number):
    mesh, view, scene = spot(shared_data)
    g = tb.GBuffer.from_mesh(mesh, view)
    light = tb.PointLight(scene["lights"][number], scene["intensity"])
    material = tb.Lambert(scene["materials"]["lambert"]["albedo"])
    theirs = tb.read_image(shared_data / f"spot/lambert_{number}.exr")
    ours, unshadowed = tb.shade(g, material, light, mesh=mesh), tb.shade(g, material, light)
    bright = unshadowed.amax(-1)
    counted = away_from_edges(g) & (bright > 0.02 * bright.max())
    seen_by_them, seen_by_us = ((image > 0.5 * unshadowed).all(-1) for image in (theirs, ours))
    assert counted.sum() > 5000
    assert (~seen_by_them & counted).sum() > 50  # there are shadows to agree on
    assert (seen_by_them == seen_by_us)[counted].float().mean() >= 0.997
    both = counted & seen_by_them & seen_by_us
    relative = ((ours - theirs) / theirs).abs()[both]
    assert relative.median() <= 0.002
    assert relative.quantile(0.9) <= 0.01


def unit_sphere(camera):
    """The exact sphere behind each pixel centre, and how far inside its outline the pixel lies (1 at the centre)."""
    origin, direction = camera.rays()
    along = (origin * direction).sum(-1, keepdim=True)
    inside = along * along - (origin * origin).sum(-1, keepdim=True) + 1
    point = origin + (-along - inside.clamp_min(0).sqrt()) * direction
    return tb.GBuffer(point, point, -direction, mask=inside > 0), inside[..., 0]


def rotation(pose):
    """The nearest rotation (the file's entries are rounded), and the origin."""
    u, _, vt = torch.linalg.svd(pose[:3, :3])
    pose = pose.clone()
    pose[:3, :3] = u @ vt
    return pose


def blender_sphere(shared_data):
    about = json.loads((shared_data / "blender/bl50_lambert.json").read_text())
    pose = rotation(torch.tensor(about["camera_to_world"], dtype=torch.float64))
    sun = [row[2] for row in about["sun_to_world"][:3]]
    channels = read_exr(shared_data / "blender/bl50_lambert.exr")["ViewLayer.Combined"]
    image = torch.stack([torch.from_numpy(channels[f"ViewLayer.Combined.{c}"]) for c in "RGB"], -1)
    return pose, "blender", sun, about["sun_energy_W_m2"], about["fov_x_deg"], image


def mitsuba_sphere(shared_data):
    about = json.loads((shared_data / "mitsuba/diffuse.json").read_text())
    pose = torch.tensor(about["camera_to_world_mitsuba(+z forward,+x left)"], dtype=torch.float64)
    pose = pose * torch.tensor([-1.0, -1.0, 1.0, 1.0])  # x left, y up -> OpenCV's right, down
    sun = [-x for x in about["light_propagation"]]
    image = tb.read_image(shared_data / "mitsuba/diffuse.exr")
    return pose, "opencv", sun, about["irradiance"], about["fov_x_deg"], image


@pytest.mark.parametrize("scene", [blender_sphere, mitsuba_sphere])
def test_lambert_sphere_as_others_render_it(shared_data, scene):
    pose, convention, sun, irradiance, fov_x, theirs = scene(shared_data)
    height, width = theirs.shape[:2]
    focal = 0.5 * width / math.tan(math.radians(fov_x) / 2)
    k = [[focal, 0.0, 0.5 * width], [0.0, focal, 0.5 * height], [0.0, 0.0, 1.0]]
    g, inside = unit_sphere(tb.Camera.from_matrix(k, torch.linalg.inv(pose), (height, width), convention))
    ours = tb.shade(g, tb.Lambert([0.6, 0.3, 0.1]), tb.DirectionalLight(sun, irradiance))
    counted = (inside > 0.05) & (ours[..., 0] > 0.02 * ours.max())
    assert counted.sum() > 3000
    relative = ((ours - theirs) / theirs).abs()[counted]
    # They average over the pixel, and their spheres are tessellated; measured 0.02 % and 0.07 % (median), 0.3 % and 0.5 % (p90).
    assert relative.median() <= 0.001
    assert relative.quantile(0.9) <= 0.007
    dark = (inside > 0.05) & (ours[..., 0] == 0)
    assert dark.sum() > 50
    assert theirs[dark].max() < 0.01 * theirs.max()
