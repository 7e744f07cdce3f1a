"""Cameras: where the pixels lie, what the conventions mean, and that poses have gradients."""

import math

import pytest
import torch

import torchbrdf as tb

EYE, TARGET, UP = [1.0, 2.0, 5.0], [0.2, -0.1, 0.3], [0.0, 1.0, 0.0]


def look(size=(6, 8)):
    return tb.Camera.look_at(EYE, TARGET, UP, 35.0, size)


def test_pixel_centres_and_field_of_view():
    """A camera at the origin that looks along -z: x to the right, y down, pixel centres at +1/2, the vertical angle across the height."""
    camera = tb.Camera.look_at([0.0, 0.0, 0.0], [0.0, 0.0, -1.0], UP, 90.0, (2, 4))
    origin, direction = camera.rays()
    assert origin.shape == (1, 1, 3)
    assert direction.shape == (2, 4, 3)
    assert tb.is_planar(direction)
    first = torch.tensor([-1.5, 0.5, -1.0], dtype=torch.float64)
    assert torch.allclose(direction[0, 0], first / first.norm())
    last = torch.tensor([1.5, -0.5, -1.0], dtype=torch.float64)
    assert torch.allclose(direction[1, 3], last / last.norm())


def test_project_undoes_rays():
    camera = look()
    origin, direction = camera.rays()
    pixel, depth = camera.project(origin + 3.7 * direction)
    x, y = torch.meshgrid(torch.arange(8.0) + 0.5, torch.arange(6.0) + 0.5, indexing="xy")
    assert torch.allclose(pixel, torch.stack([x, y], -1).double())
    assert torch.allclose(depth[..., 0], 3.7 * (direction * camera.forward).sum(-1))


def test_cameras_batch():
    eyes = torch.tensor([EYE, [-2.0, 1.0, 4.0]], dtype=torch.float64)
    both = tb.Camera.look_at(eyes, TARGET, UP, torch.tensor([[35.0], [50.0]]), (6, 8))
    origin, direction = both.rays()
    assert origin.shape == (2, 1, 1, 3)
    assert direction.shape == (2, 6, 8, 3)
    assert torch.allclose(direction[0], look().rays()[1])
    assert torch.allclose(both[0].rays()[1], look().rays()[1])
    pixel, _ = both.project(origin + direction)
    assert torch.allclose(pixel[0], look().project(look().rays()[0] + look().rays()[1])[0])


AXES = {"opencv": (1, 1, 1), "opengl": (1, -1, -1), "blender": (1, -1, -1), "mitsuba": (-1, -1, 1)}


@pytest.mark.parametrize("convention", AXES)
@pytest.mark.parametrize("rows", [3, 4])
@pytest.mark.parametrize("inverse", [False, True], ids=["world to camera", "camera to world"])
def test_conventions_name_the_same_camera(convention, rows, inverse):
    camera = look()
    axes = torch.stack([s * a for s, a in zip(AXES[convention], (camera.right, camera.down, camera.forward), strict=True)])
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3], pose[:3, 3] = axes, -axes @ camera.origin
    focal = 3.0 / math.tan(math.radians(17.5))
    K = [[focal, 0.0, 4.0], [0.0, focal, 3.0], [0.0, 0.0, 1.0]]
    pose[3] += torch.tensor([0.0, -3e-17, 0.0, -1e-16])  # as a matrix inverse leaves it
    given = {"camera_to_world": torch.linalg.inv(pose)[:rows]} if inverse else {"world_to_camera": pose[:rows]}
    same = tb.Camera.from_matrix(K, size=(6, 8), convention=convention, **given)
    for name, tensor, _ in camera.own_tensors():
        assert torch.allclose(getattr(same, name), tensor, atol=1e-14), name  # float64


def test_focal_lengths_and_principal_points_of_their_own():
    """fx is of x and of the columns, fy of y and of the rows; both ways."""
    camera = tb.Camera.from_matrix([[50.0, 0.0, 3.5], [0.0, 80.0, 1.5], [0.0, 0.0, 1.0]], torch.eye(4).double(), (4, 8))
    _, direction = camera.rays()
    at = direction[1, 6] / direction[1, 6, 2]
    torch.testing.assert_close(at, torch.tensor([(6.5 - 3.5) / 50, (1.5 - 1.5) / 80, 1.0], dtype=torch.float64))
    at = direction[3, 0] / direction[3, 0, 2]
    torch.testing.assert_close(at, torch.tensor([(0.5 - 3.5) / 50, (3.5 - 1.5) / 80, 1.0], dtype=torch.float64))
    pixel, depth = camera.project(torch.tensor([[0.2, -0.1, 4.0]], dtype=torch.float64))
    torch.testing.assert_close(pixel, torch.tensor([[3.5 + 50 * 0.05, 1.5 - 80 * 0.025]], dtype=torch.float64))
    assert depth.item() == 4.0


def test_the_horizontal_field_of_view():
    camera = tb.Camera.look_at(EYE, TARGET, UP, fov_x=60.0, size=(6, 8))
    torch.testing.assert_close(camera.focal, torch.full((2,), 4.0 / math.tan(math.radians(30.0)), dtype=torch.float64))
    edge, _ = camera.project(camera.origin + camera.forward + math.tan(math.radians(30.0)) * camera.right)
    torch.testing.assert_close(edge, torch.tensor([8.0, 3.0], dtype=torch.float64))
    with pytest.raises(ValueError, match=r"fov_x is the full angle in degrees and lies in \(0, 180\), found \[200.0\]"):
        tb.Camera.look_at(EYE, TARGET, UP, fov_x=200.0)


@pytest.mark.parametrize(
    ("given", "found"), [(torch.float32, torch.float32), (torch.float64, torch.float64), (torch.bfloat16, torch.float32)]
)
def test_a_camera_has_the_dtype_of_the_tensors_it_was_made_of(given, found):
    for arguments in ((torch.tensor(EYE, dtype=given), TARGET), (EYE, torch.tensor(TARGET, dtype=given))):
        camera = tb.Camera.look_at(*arguments, UP, 35.0, (3, 4))
        assert {t.dtype for _, t, _ in camera.own_tensors()} == {found}
        assert camera.rays()[1].dtype == found
        off = camera.rotation @ camera.rotation.T - torch.eye(3, dtype=found)
        assert off.abs().max() < 8 * torch.finfo(found).eps
    assert look().rotation.dtype == torch.float64, "numbers alone"


def test_an_angle_in_radians_is_noticed():
    with pytest.warns(UserWarning, match=r"fov_y: found \[0.61\], in degrees a very narrow view; radians\? pass math.degrees"):
        tb.Camera.look_at(EYE, TARGET, UP, 0.61)


def test_mitsuba_sees_along_the_same_rays():
    """Its sensor, from the same to_world and fov, aims each film position where our ray goes."""
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    to_world = mi.ScalarTransform4f().look_at(origin=EYE, target=TARGET, up=UP)
    film = {"type": "hdrfilm", "width": 8, "height": 6}
    sensor = mi.load_dict({"type": "perspective", "fov": 50.0, "fov_axis": "x", "to_world": to_world, "film": film})
    pose = torch.tensor([[to_world.matrix[i, j] for j in range(4)] for i in range(4)], dtype=torch.float64)
    focal = 4.0 / math.tan(math.radians(25.0))
    K = [[focal, 0.0, 4.0], [0.0, focal, 3.0], [0.0, 0.0, 1.0]]
    ours = tb.Camera.from_matrix(K, camera_to_world=pose, size=(6, 8), convention="mitsuba")
    torch.testing.assert_close(ours.focal, tb.Camera.look_at(EYE, TARGET, UP, fov_x=50.0, size=(6, 8)).focal)
    for i, j in ((0, 0), (2, 7), (5, 3)):
        ray, _ = sensor.sample_ray(0.0, 0.5, [(j + 0.5) / 8, (i + 0.5) / 6], [0.5, 0.5])
        torch.testing.assert_close(ours.rays()[1][i, j], torch.tensor(list(ray.d), dtype=torch.float64), atol=2e-6, rtol=0)  # float32


def test_one_pose_is_needed():
    for pose in ({}, {"world_to_camera": torch.eye(4), "camera_to_world": torch.eye(4)}):
        with pytest.raises(TypeError, match="give world_to_camera or camera_to_world, one of them"):
            tb.Camera.from_matrix(K, size=(4, 6), **pose)


def test_poses_have_gradients():
    def rays(eye, target, up, fov):
        origin, direction = tb.Camera.look_at(eye, target, up, fov, (2, 3)).rays()
        return origin + direction

    start = [torch.tensor(x, dtype=torch.float64, requires_grad=True) for x in (EYE, TARGET, UP, [35.0])]
    assert torch.autograd.gradcheck(rays, start)
    assert torch.vmap(lambda e: tb.Camera.look_at(e, TARGET, UP, 35.0, (2, 3)).rays()[1])(torch.rand(4, 3)).shape == (4, 2, 3, 3)


@pytest.mark.parametrize("size", [(0, 4), (4,), (4, 4, 3), 4, (4.5, 4), ("a", 4), None])
def test_sizes_that_are_none(size):
    with pytest.raises(ValueError, match=r"Camera.size: expected \(height, width\)"):
        tb.Camera.look_at(EYE, TARGET, UP, 35.0, size)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"eye": TARGET}, "same point"),
        ({"up": [0.0, 0.0, 0.0]}, "up is zero or points along the view"),
        ({"up": [0.0, 0.0]}, r"look_at: up: expected shape \[..., 3\], found \[2\]"),
        ({"fov_y": 180.0}, r"lies in \(0, 180\)"),
        ({"eye": "here"}, "eye: expected numbers"),
    ],
)
def test_look_at_says_what_is_wrong(change, message):
    with pytest.raises((ValueError, TypeError), match=message):
        tb.Camera.look_at(**{"eye": EYE, "target": TARGET, "up": UP, **change})


K = torch.tensor([[100.0, 0.0, 4.0], [0.0, 100.0, 3.0], [0.0, 0.0, 1.0]])
SKEW = torch.tensor([[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
ROW_VECTORS = torch.tensor([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [1, 2, 3, 1]])
MIRROR = torch.diag(torch.tensor([1.0, 1.0, -1.0, 1.0]))


@pytest.mark.parametrize(
    ("k", "pose", "convention", "message"),
    [
        (K, torch.eye(4), "unity", "unknown convention 'unity', legal are"),
        (K[:2], torch.eye(4), "opencv", r"K: expected shape \[..., 3, 3\]"),
        (K, torch.eye(3), "opencv", r"world_to_camera: expected shape \[..., 4, 4\]"),
        (K + SKEW, torch.eye(4), "opencv", "K has skew"),
        (K, 2.0 * torch.eye(4)[:3], "opencv", "not a rotation"),
        (K, MIRROR, "opencv", "not a rotation"),
        (K, ROW_VECTORS, "opencv", r"world_to_camera: expected the last row \[0, 0, 0, 1\], found \[1.0, 2.0, 3.0, 1.0\]; transpose"),
    ],
)
def test_from_matrix_says_what_is_wrong(k, pose, convention, message):
    with pytest.raises(ValueError, match=message):
        tb.Camera.from_matrix(k, pose, (6, 8), convention)
