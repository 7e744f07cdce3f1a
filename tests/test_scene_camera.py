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


@pytest.mark.parametrize(("convention", "sign"), [("opencv", 1.0), ("opengl", -1.0), ("blender", -1.0)])
@pytest.mark.parametrize("rows", [3, 4])
def test_conventions_name_the_same_camera(convention, sign, rows):
    camera = look()
    axes = torch.stack([camera.right, sign * camera.down, sign * camera.forward])
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3], pose[:3, 3] = axes, -axes @ camera.origin
    focal = 3.0 / math.tan(math.radians(17.5))
    K = [[focal, 0.0, 4.0], [0.0, focal, 3.0], [0.0, 0.0, 1.0]]
    same = tb.Camera.from_matrix(K, pose[:rows], (6, 8), convention)
    for name, tensor, _ in camera.own_tensors():
        assert torch.allclose(getattr(same, name), tensor, atol=1e-14), name  # float64


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
MIRROR = torch.diag(torch.tensor([1.0, 1.0, -1.0, 1.0]))


@pytest.mark.parametrize(
    ("k", "pose", "convention", "message"),
    [
        (K, torch.eye(4), "unity", "unknown convention 'unity', legal are"),
        (K[:2], torch.eye(4), "opencv", r"K: expected shape \[..., 3, 3\]"),
        (K, torch.eye(3), "opencv", r"world_to_camera: expected shape \[..., 4, 4\]"),
        (K + SKEW, torch.eye(4), "opencv", "K has skew"),
        (K, 2.0 * torch.eye(4), "opencv", "not a rotation"),
        (K, MIRROR, "opencv", "not a rotation"),
    ],
)
def test_from_matrix_says_what_is_wrong(k, pose, convention, message):
    with pytest.raises(ValueError, match=message):
        tb.Camera.from_matrix(k, pose, (6, 8), convention)
