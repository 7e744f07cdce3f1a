r"""Environment maps: radiance from every direction, stored by longitude and latitude.

.. math:: u = \tfrac12 + \mathrm{atan2}(d \cdot right,\; d \cdot forward) / 2\pi, \qquad
          v = \mathrm{atan2}(\mathrm{hypot}(d \cdot right, d \cdot forward),\; d \cdot up) / \pi

u runs to the right and v down from the top row. ``forward`` is what the centre of the picture shows. All three orientations
are seen from inside, none is mirrored; they differ by a rotation:

===============  =======  =====  ====  =================================================
convention       forward  right  up    used by
===============  =======  =====  ====  =================================================
``"mitsuba"``    +Z       -X     +Y    Mitsuba's ``envmap`` untransformed, OpenEXR
``"blender"``    +X       -Y     +Z    Cycles' equirectangular environment texture
``"nvdiffrec"``  -Z       +X     +Y    NVIDIA nvdiffrec, and latlong maps of nvdiffrast
===============  =======  =====  ====  =================================================

=========  ==========================  =============================================================
parameter  unit, range                 meaning
=========  ==========================  =============================================================
texels     [Hm, Wm, C] >= 0            radiance, W/(m² sr), top row first
to_world   [3, 3], a rotation, None    turns the map: world direction = to_world @ map direction
=========  ==========================  =============================================================

Texel centres lie at (i + 1/2)/n; bilinear between them, wrapping in u, constant beyond the first and last row. (Mitsuba puts
the centres of the first and last row *on* the poles; the two differ by up to half a texel in v.) Not smooth where the four
texels change. At the poles, where u has no direction, the gradient with respect to u is 0; a zero or non-finite direction
gives 0 with gradient 0. Source: Blinn & Newell 1976.

>>> import torch, torchbrdf as tb
>>> sky = tb.EnvironmentMap(torch.rand(8, 16, 3))
>>> sky.radiance(torch.tensor([[0.0, 1.0, 0.0]])).shape
torch.Size([1, 3])
"""

import math
from pathlib import Path
from typing import Any, NamedTuple, Self

import torch
from torch import Tensor

from .. import arguments, numerics, parameters, vector
from ..geometry import Layout
from ..interval import NONNEGATIVE, REAL
from ..pictures import read_image
from ..value import COLOUR, VECTOR, param, value
from ..vector import Vec
from .base import Light, LightKind


class Orientation(NamedTuple):
    """Axes of a lat-long map as (component of the direction, sign)."""

    right: tuple[int, float]
    up: tuple[int, float]
    forward: tuple[int, float]


ORIENTATIONS = {
    "mitsuba": Orientation(right=(0, -1.0), up=(1, 1.0), forward=(2, 1.0)),
    "blender": Orientation(right=(1, -1.0), up=(2, 1.0), forward=(0, 1.0)),
    "nvdiffrec": Orientation(right=(0, 1.0), up=(1, 1.0), forward=(2, -1.0)),
}


HEADROOM = 2.0**32  # nearer to a pole, the slope 1/distance, times radiance and resolution, could overflow: that is the pole


@value
class EnvironmentMap(Light):
    """Distant light given by a lat-long map of radiance ``texels [Hm, Wm, C]`` in a named orientation."""

    texels: Tensor = param(NONNEGATIVE, COLOUR, "radiance, W/(m² sr)")
    to_world: Tensor | None = param(REAL, VECTOR, "rotation that turns the map", default=None)
    convention: str = "mitsuba"
    kind = LightKind.INFINITE

    def check_shapes(self) -> None:
        if not isinstance(self.convention, str) or self.convention not in ORIENTATIONS:
            raise ValueError(f"EnvironmentMap.convention: found {self.convention!r}, legal are {sorted(ORIENTATIONS)}")
        if self.texels.dim() != 3 or not self.texels.numel():
            raise ValueError(f"EnvironmentMap.texels: expected shape [Hm, Wm, C] with pixels in it, found {list(self.texels.shape)}")
        if self.to_world is not None and self.to_world.shape != (3, 3):
            raise ValueError(f"EnvironmentMap.to_world: expected a rotation matrix [3, 3], found {list(self.to_world.shape)}")

    def check(self) -> None:
        """``to_world`` must be a rotation, to the digits that matrices have in text files."""
        if self.to_world is None or arguments.hidden(self.to_world):
            return
        turn = self.to_world.detach().double().cpu()
        away = (turn @ turn.T - torch.eye(3, dtype=turn.dtype)).abs().max()
        if not away < math.sqrt(torch.finfo(torch.float32).eps) or torch.linalg.det(turn) < 0:
            raise ValueError("EnvironmentMap.to_world: not a rotation; take the scale, or the mirroring, out of it")

    @classmethod
    def load(cls, path: str | Path, convention: str = "mitsuba", scale: float = 1.0, to_world: Tensor | None = None) -> Self:
        """Read a lat-long picture (EXR, Radiance HDR, or sRGB PNG/JPG, decoded), times ``scale``; alpha is dropped.

        Errors as for ``tb.read_image``; negative or non-finite pixels, which are no radiance, raise ``ValueError``.
        """
        if not (isinstance(scale, int | float) and 0 <= scale < math.inf):
            raise ValueError(f"EnvironmentMap.load: scale: expected a finite number >= 0, found {scale!r}")
        pixels = read_image(path)
        texels = pixels[..., :3] * scale
        bad = int((~NONNEGATIVE.contains(texels)).sum())
        if bad:
            raise ValueError(
                f"EnvironmentMap.load: {path}, scale {scale}: {bad} values are negative or not finite; mend them with read_image"
            )
        return cls(texels, to_world=to_world, convention=convention)

    @property
    def batch_shape(self) -> torch.Size:
        """None of a map's axes is a batch axis: it is one light for all shading points."""
        return torch.Size()

    def _index(self, index: Any, batch: torch.Size) -> Self:
        return self

    def radiance(self, directions: Tensor) -> Tensor:
        """Radiance ``[..., C]``, W/(m² sr), arriving from ``directions [..., 3]``, which point to the sky and need not be unit."""
        parameters.check(self, arguments.floats(directions, "directions", 3), "directions", batched=False)
        d = vector.normalize_components(vector.components(numerics.widen(directions)))
        usable = vector.dot(d, d) > 0
        u, v = self.coordinates(d)
        texels = Layout.beside(directions).follow(self.texels, axes=3)
        return vector.stack([torch.where(usable, c, 0.0) for c in bilinear(texels, u, v)]).to(directions.dtype)

    def coordinates(self, d: Vec) -> tuple[Tensor, Tensor]:
        """Picture coordinates (u to the right, v down, both in [0, 1]) of unit directions."""
        if self.to_world is not None:
            columns = self.to_world.to(d.x).unbind(1)
            d = Vec(*(vector.dot(Vec(*c.unbind(0)), d) for c in columns))
        right, up, forward = (sign * d[axis] for axis, sign in ORIENTATIONS[self.convention])
        # The angle about the axis by both components over the larger one: near a pole their squares vanish, and it does not.
        size = torch.maximum(right.detach().abs(), forward.detach().abs())
        off_pole = size > HEADROOM / torch.finfo(size.dtype).max
        grow = 1.0 / torch.where(off_pole, size, 1.0)
        longitude = torch.atan2(torch.where(off_pole, right * grow, 0.0), torch.where(off_pole, forward * grow, 1.0))
        r, f = (torch.where(off_pole, c * grow, 1.0) for c in (right, forward))
        across = torch.where(off_pole, size * torch.sqrt(r * r + f * f), 0.0)
        somewhere = off_pole | (up != 0)  # atan2(0, 0), of a zero direction, has no derivative
        colatitude = torch.atan2(across, torch.where(somewhere, up, 1.0))
        return 0.5 + longitude / (2.0 * math.pi), colatitude / math.pi


def bilinear(texels: Tensor, u: Tensor, v: Tensor) -> list[Tensor]:
    """Channels ``[...]`` of ``texels [Hm, Wm, C]`` at u (wrapping) and v (held at the first and last row), both in texture units.

    Channel by channel: gathers from planes are 1.5 to 3 times faster than gathers of whole pixels, gradient included.
    """
    height, width, _ = texels.shape
    x, y = u.reshape(-1) * width - 0.5, v.reshape(-1) * height - 0.5
    left, top = torch.floor(x.detach()), torch.floor(y.detach())
    fx, fy = x - left, y - top
    column, row = left.long(), top.long()
    columns = [(column % width, 1.0 - fx), ((column + 1) % width, fx)]
    rows = [(row.clamp(0, height - 1) * width, 1.0 - fy), ((row + 1).clamp(0, height - 1) * width, fy)]
    corners = [(i + j, a * b) for j, b in rows for i, a in columns]
    planes = texels.reshape(height * width, -1).unbind(-1)
    return [sum((p.index_select(0, i) * w for i, w in corners), torch.zeros_like(x)).reshape(u.shape) for p in planes]
