"""Pinhole cameras, batched and differentiable in pose and intrinsics.

Pixel centres lie at +1/2, (0, 0) is the top left corner of the image, x runs right and y down. A camera holds its axes in
the world, so that no convention is left to guess once it is made:

==============  ==============================================================
convention      camera axes of ``world_to_camera``
==============  ==============================================================
``"opencv"``    x right, y down, looks along +z (also COLMAP)
``"opengl"``    x right, y up, looks along -z
``"blender"``   the axes of Blender's camera objects, which are OpenGL's
``"mitsuba"``   x left, y up, looks along +z, as Mitsuba's sensors
==============  ==============================================================

>>> import torchbrdf as tb
>>> tb.Camera.look_at([0.0, 0.0, 3.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], fov_y=35.0, size=(4, 6)).rays()[1].shape
torch.Size([4, 6, 3])
"""

import functools
import math
import warnings
from typing import Any, Self

import torch
from torch import Tensor

from .. import arguments, numerics, vector
from ..constraint import ROTATION
from ..interval import REAL, Interval
from ..value import PAIR, VECTOR, Value, param, value
from ..vector import Vec, components, cross, dot, stack

FOCAL = Interval(0.0, open_low=True, typical=(10.0, 1000.0))
MOST_PIXELS = 1 << 28  # a G-buffer of so many takes some 50 GB; a file may claim any size
# Signs of the camera's x, y and z axes beside (right, down, forward).
CONVENTIONS = {"opencv": (1.0, 1.0, 1.0), "opengl": (1.0, -1.0, -1.0), "blender": (1.0, -1.0, -1.0), "mitsuba": (-1.0, -1.0, 1.0)}
NARROW = math.pi  # degrees; a smaller angle is a telescope's, or was meant in radians


@value
class Camera(Value):
    """A pinhole camera: ``origin``, ``rotation`` (its rows are right, down and forward), ``focal`` and ``principal`` in pixels (x, y)."""

    origin: Tensor = param(REAL, VECTOR, "centre of projection, world units")
    rotation: Tensor = param(ROTATION, (3, 3), "world to camera; rows are the axes +x and +y of the image, and into the scene")
    focal: Tensor = param(FOCAL, PAIR, "focal lengths (x, y), pixels")
    principal: Tensor = param(REAL, PAIR, "principal point (x, y), pixels from the top left corner")
    size: tuple[int, int] = (256, 256)

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "size", _image_size(self.size))

    @property
    def right(self) -> Tensor:
        """Unit ``[..., 3]``, along +x of the image."""
        return self.rotation.unbind(-2)[0]

    @property
    def down(self) -> Tensor:
        """Unit ``[..., 3]``, along +y of the image."""
        return self.rotation.unbind(-2)[1]

    @property
    def forward(self) -> Tensor:
        """Unit ``[..., 3]``, into the scene."""
        return self.rotation.unbind(-2)[2]

    @staticmethod
    def look_at(eye: Any, target: Any, up: Any, fov_y: Any = 35.0, size: tuple[int, int] = (256, 256), *, fov_x: Any = None) -> "Camera":
        """Camera at ``eye [..., 3]`` that looks at ``target [..., 3]`` with ``up [..., 3]`` upwards in the image.

        ``fov_y`` is the full vertical field of view in degrees, a number or ``[..., 1]``, in (0, 180); ``fov_x``, where given, the
        horizontal one in its place (Mitsuba's ``fov``, Blender's of a wide image). ``size`` is (height, width); pixels are square. The
        camera has the dtype of the tensors among eye, target and up (float32 for half types); numbers and lists follow, and are float64
        alone. Not smooth (an error where values can be seen) for ``eye == target`` and for ``up`` along the view.
        """
        named = {"eye": eye, "target": target, "up": up}
        dtype = _common_dtype(*named.values())
        eye, target, up = (_floats(x, name).to(dtype) for name, x in named.items())
        arguments.broadcast({n: x.shape[:-1] for n, x in (("eye", eye), ("target", target), ("up", up))}, "look_at: batch shapes")
        forward = vector.normalize_components(vector.subtract(components(target), components(eye)))
        right = vector.normalize_components(cross(forward, components(up)))
        _check_look_at(stack(forward), stack(right))
        height, width = _image_size(size)
        angle = _angle(fov_y, "fov_y") if fov_x is None else _angle(fov_x, "fov_x")
        focal = (0.5 * (height if fov_x is None else width)) / torch.tan(angle.to(eye) * (math.pi / 360.0))
        centre = torch.tensor([0.5 * width, 0.5 * height], dtype=eye.dtype, device=eye.device)
        axes = torch.stack([stack(axis) for axis in (right, cross(forward, right), forward)], -2)
        return Camera(eye, axes, focal.expand(*focal.shape[:-1], 2), centre, (height, width))

    @staticmethod
    def from_matrix(
        K: Any,
        world_to_camera: Any = None,
        size: tuple[int, int] = (256, 256),
        convention: str = "opencv",
        *,
        camera_to_world: Any = None,
    ) -> "Camera":
        """Camera from intrinsics ``K [..., 3, 3]`` (pixels, no skew) and extrinsics ``world_to_camera [..., 4, 4]`` or ``[..., 3, 4]``.

        ``camera_to_world`` in its place is the inverse: Blender's ``matrix_world``, Mitsuba's ``to_world``, the poses of NeRF data sets.
        Matrices multiply column vectors: the translation is the last *column*. ``convention`` names the camera axes: "opencv", "opengl",
        "blender" or "mitsuba" (above). K always counts pixels from the top left *corner*; a calibration that puts (0, 0) at the centre
        of the first pixel, as OpenCV's does, needs +0.5 on cx and cy.
        """
        if not isinstance(convention, str) or convention not in CONVENTIONS:
            raise ValueError(f"from_matrix: unknown convention {convention!r}, legal are {sorted(CONVENTIONS)}")
        given = {"world_to_camera": world_to_camera, "camera_to_world": camera_to_world}
        if sum(m is not None for m in given.values()) != 1:
            raise TypeError("from_matrix: give world_to_camera or camera_to_world, one of them")
        ((name, matrix),) = ((n, m) for n, m in given.items() if m is not None)
        k, pose = _floats(K, "K"), _floats(matrix, name)
        _check_matrices(k, pose, name)
        turn, offset = pose[..., :3, :3], pose[..., :3, 3]
        if name == "camera_to_world":
            turn, origin = turn.transpose(-1, -2), offset
        else:
            origin = stack(vector.combine(tuple(components(-a) for a in turn.unbind(-2)), components(offset)))
        axes = torch.stack([sign * a for sign, a in zip(CONVENTIONS[convention], turn.unbind(-2), strict=True)], -2)
        kx, ky = k[..., 0, :].unbind(-1), k[..., 1, :].unbind(-1)
        return Camera(origin, axes, stack((kx[0], ky[1])), stack((kx[2], ky[2])), size)

    def rays(self) -> tuple[Tensor, Tensor]:
        """Origin ``[..., 1, 1, 3]`` and unit directions ``[..., H, W, 3]`` (planar) through the pixel centres."""
        height, width = self.size
        dtype, device = self.forward.dtype, self.forward.device
        fx, fy = (c[..., None, None] for c in self.focal.unbind(-1))
        cx, cy = (c[..., None, None] for c in self.principal.unbind(-1))
        x = (torch.arange(width, dtype=dtype, device=device) + 0.5 - cx) / fx
        y = ((torch.arange(height, dtype=dtype, device=device) + 0.5).unsqueeze(-1) - cy) / fy
        right, down, forward = (Vec(*(c[..., None, None] for c in components(a))) for a in (self.right, self.down, self.forward))
        towards = vector.add(forward, vector.add(vector.scale(right, x), vector.scale(down, y)))
        direction = stack(vector.normalize_components(towards))
        return self.origin[..., None, None, :], direction

    def project(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """``points [..., 3]`` -> pixel coordinates ``[..., 2]`` (x, y) and depth ``[..., 1]`` along ``forward``.

        The batch axes of the camera are the leading ones of ``points``. Points with depth <= 0 lie behind the camera; at
        depth 0 the pixel is not finite.
        """
        arguments.floats(points, "points", 3)
        batch = len(self.batch_shape)
        extra = max(points.dim() - 1 - batch, 0)

        def widen(t: Tensor) -> Vec | tuple[Tensor, ...]:
            return tuple(c.reshape(c.shape + (1,) * extra) if c.dim() else c for c in t.unbind(-1))

        offset = vector.subtract(components(points), Vec(*widen(self.origin)))
        x, y, z = (dot(Vec(*widen(a)), offset) for a in (self.right, self.down, self.forward))
        (fx, fy), (cx, cy) = widen(self.focal), widen(self.principal)
        return stack((cx + fx * x / z, cy + fy * y / z)), z.unsqueeze(-1)

    def to_double(self, device: torch.device) -> Self:
        """The same camera in float64 on ``device``."""
        return self.to(device, torch.float64)


def _image_size(size: Any) -> tuple[int, int]:
    try:
        sides = tuple(int(s) for s in size)
        whole = all(a == b for a, b in zip(sides, size, strict=True))
    except (TypeError, ValueError, OverflowError):
        sides, whole = (), False
    if len(sides) != 2 or not whole or min(sides) < 1:
        raise ValueError(f"Camera.size: expected (height, width), two positive whole numbers, found {size!r}")
    if sides[0] * sides[1] > MOST_PIXELS:
        raise ValueError(f"Camera.size: found {size!r}, more than {MOST_PIXELS} pixels; take tiles, by moving the principal point")
    return sides


def _common_dtype(*given: Any) -> torch.dtype:
    """That of the tensors and arrays given, wide enough to compute in."""
    kinds = [torch.as_tensor(x).dtype for x in given if hasattr(x, "dtype")]
    kinds = [k for k in kinds if k in arguments.FLOATS]
    return numerics.working_dtype(functools.reduce(torch.promote_types, kinds)) if kinds else torch.float64


def _floats(x: Any, name: str) -> Tensor:
    try:
        t = x if isinstance(x, Tensor) else torch.as_tensor(x, dtype=None if hasattr(x, "dtype") else torch.float64)
    except (TypeError, ValueError, RuntimeError) as error:
        raise TypeError(f"{name}: expected numbers, an array or a tensor, found {type(x).__name__} ({error})") from None
    t = arguments.floats(t if t.is_floating_point() or t.is_complex() else t.to(torch.float64), name)
    if name in ("eye", "target", "up") and t.shape[-1:] != (3,):
        raise ValueError(f"look_at: {name}: expected shape [..., 3], found {list(t.shape)}")
    return t.reshape(1) if t.dim() == 0 else t


def _all(condition: Tensor) -> bool:
    """Whether a condition holds everywhere; True where values cannot be looked at (inside transforms and graphs)."""
    return arguments.values_hidden(condition) or bool(condition.all())


def _angle(degrees: Any, name: str) -> Tensor:
    angle = _floats(degrees, name)
    if angle.shape[-1:] != (1,):
        raise ValueError(f"look_at: {name}: expected a number or shape [..., 1], found {list(angle.shape)}")
    found = [] if arguments.values_hidden(angle) else angle.detach().flatten()[:4].tolist()
    if not _all((angle > 0) & (angle < 180)):
        raise ValueError(f"look_at: {name} is the full angle in degrees and lies in (0, 180), found {found}")
    if found and not _all(angle > NARROW):
        warnings.warn(f"look_at: {name}: found {found}, in degrees a very narrow view; radians? pass math.degrees(...)", stacklevel=4)
    return angle


def _check_look_at(forward: Tensor, right: Tensor) -> None:
    if not _all(forward.ne(0).any(-1)):
        raise ValueError(
            "look_at: eye and target are the same point (or not finite), so there is no direction to look in; move one of them"
        )
    if not _all(right.ne(0).any(-1)):
        raise ValueError("look_at: up is zero or points along the view, so the image has no upright; choose another up")


def _check_matrices(k: Tensor, pose: Tensor, name: str) -> None:
    if k.shape[-2:] != (3, 3):
        raise ValueError(f"from_matrix: K: expected shape [..., 3, 3], found {list(k.shape)}")
    if pose.shape[-2:] not in ((4, 4), (3, 4)):
        raise ValueError(f"from_matrix: {name}: expected shape [..., 4, 4] or [..., 3, 4], found {list(pose.shape)}")
    if not _all(torch.isfinite(k).all(-1).all(-1)) or not _all(torch.isfinite(pose).all(-1).all(-1)):
        raise ValueError(f"from_matrix: K or {name} holds numbers that are not finite")
    if pose.shape[-2] == 4 and not _all((pose[..., 3, :] - pose.new_tensor([0.0, 0.0, 0.0, 1.0])).abs() < numerics.TEXT_DIGITS):
        found = pose.detach()[..., 3, :].reshape(-1, 4)[0].tolist()
        raise ValueError(f"from_matrix: {name}: expected the last row [0, 0, 0, 1], found {found}; transpose a matrix for row vectors")
    if not _all((k[..., 0, 0] > 0) & (k[..., 1, 1] > 0)):
        found = [k.detach()[..., i, i].flatten()[0].item() for i in (0, 1)]
        raise ValueError(f"from_matrix: K: the focal lengths K[0, 0] and K[1, 1] are pixels > 0, found {found}; turn the axes instead")
    if not _all(k[..., 0, 1] == 0):
        raise ValueError("from_matrix: K has skew (K[0, 1] is not 0), which this camera lacks; undistort the images to square axes")
    if not _all(ROTATION.contains(pose[..., :3, :3].detach())):
        raise ValueError(
            f"from_matrix: the upper 3x3 of {name} is not a rotation; take the scale (or the mirroring) out of it, "
            "and pass the pose alone, not K @ [R|t]"
        )
