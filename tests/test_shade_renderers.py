"""Radiance against independent renderers: Spot with cast shadows by Mitsuba, and spheres by Mitsuba and Blender."""

import math

import pytest
import torch
from renders import about, cropped, spot, whole_view, within
from test_scene_visibility import away_from_edges

import torchbrdf as tb
from torchbrdf.io.exr import read_exr


def test_spot_with_shadows_as_mitsuba_renders_it(spot_renders):
    """Which pixels count is decided on the whole image: of a window's neighbours, too, and beside the brightest of all."""
    mesh, view, scene = spot(spot_renders)
    g, whole = (tb.GBuffer.from_mesh(mesh, camera) for camera in (view, whole_view(scene)))
    material = tb.Lambert(scene["materials"]["lambert"]["albedo"])
    for position, file in zip(scene["lights"], scene["images"]["lambert"], strict=True):
        light = tb.PointLight(position, scene["intensity"])
        bright = tb.shade(whole, material, light).amax(-1)
        counted = within(away_from_edges(whole) & (bright > 0.02 * bright.max()), scene)
        theirs = tb.read_image(spot_renders / file)
        ours, unshadowed = tb.shade(g, material, light, mesh=mesh), tb.shade(g, material, light)
        seen_by_them, seen_by_us = ((image > 0.5 * unshadowed).all(-1) for image in (theirs, ours))
        assert counted.float().mean() > 0.1
        assert (~seen_by_them & counted).sum() > 50 or not scene.get("shadows", True), "there are shadows to agree on"
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


def blender_sphere(real_data):
    path = real_data / "blender/bl50_lambert.exr"
    said = about(path)
    pose = rotation(torch.tensor(said["camera_to_world"], dtype=torch.float64))
    sun = [row[2] for row in said["sun_to_world"][:3]]
    channels = read_exr(path)["ViewLayer.Combined"]
    image = torch.stack([torch.from_numpy(channels[f"ViewLayer.Combined.{c}"]) for c in "RGB"], -1)
    return pose, "blender", sun, said["sun_energy_W_m2"], said, image


def mitsuba_sphere(real_data):
    path = real_data / "mitsuba/diffuse.exr"
    said = about(path)
    pose = torch.tensor(said["camera_to_world_mitsuba(+z forward,+x left)"], dtype=torch.float64)
    pose = pose * torch.tensor([-1.0, -1.0, 1.0, 1.0])  # x left, y up -> OpenCV's right, down
    sun = [-x for x in said["light_propagation"]]
    return pose, "opencv", sun, said["irradiance"], said, tb.read_image(path)


@pytest.mark.parametrize("scene", [blender_sphere, mitsuba_sphere])
def test_lambert_sphere_as_others_render_it(real_data, scene):
    pose, convention, sun, irradiance, said, theirs = scene(real_data)
    width, height = said["resolution"]
    focal = 0.5 * width / math.tan(math.radians(said["fov_x_deg"]) / 2)
    k = [[focal, 0.0, 0.5 * width], [0.0, focal, 0.5 * height], [0.0, 0.0, 1.0]]
    g, inside = unit_sphere(cropped(tb.Camera.from_matrix(k, torch.linalg.inv(pose), (height, width), convention), said))
    ours = tb.shade(g, tb.Lambert([0.6, 0.3, 0.1]), tb.DirectionalLight(sun, irradiance))
    counted = (inside > 0.05) & (ours[..., 0] > 0.02 * ours.max())
    assert counted.float().mean() > 0.4
    relative = ((ours - theirs) / theirs).abs()[counted]
    # They average over the pixel, and their spheres are tessellated; measured 0.02 % and 0.07 % (median), 0.3 % and 0.5 % (p90).
    assert relative.median() <= 0.001
    assert relative.quantile(0.9) <= 0.007
    dark = (inside > 0.05) & (ours[..., 0] == 0)
    assert dark.sum() > 50
    assert theirs[dark].max() < 0.01 * theirs.max()
