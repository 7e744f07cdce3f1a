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

Sampled uniformly over the sphere.

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
from typing import NamedTuple, Self

import torch
from torch import Tensor

from .. import arguments, numerics, parameters, sampling, vector
from ..constraint import ROTATION
from ..geometry import Layout
from ..interval import NONNEGATIVE
from ..io.pictures import read_image
from ..lookup import lookup
from ..value import param, value
from ..vector import Vec
from .base import Light, LightKind, LightSample


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


UNIFORM = 0.25 / math.pi  # density of directions all over the sphere
HEADROOM = 2.0**32  # nearer to a pole, the slope 1/distance, times radiance and resolution, could overflow: that is the pole


@value
class EnvironmentMap(Light):
    """Distant light given by a lat-long map of radiance ``texels [Hm, Wm, C]`` in a named orientation."""

    texels: Tensor = param(NONNEGATIVE, ("Hm", "Wm", "C"), "radiance, W/(m² sr)")
    to_world: Tensor | None = param(ROTATION, (3, 3), "rotation that turns the map", default=None)
    convention: str = "mitsuba"
    kind = LightKind.INFINITE

    def check_shapes(self) -> None:
        if not isinstance(self.convention, str) or self.convention not in ORIENTATIONS:
            raise ValueError(f"EnvironmentMap.convention: found {self.convention!r}, legal are {sorted(ORIENTATIONS)}")
        arguments.picture(self.texels, "EnvironmentMap.texels", "[Hm, Wm, C]")
        if self.batch_shape:
            found = {n: list(t.shape) for n, t, _ in self.own_tensors()}
            raise ValueError(f"EnvironmentMap: expected texels [Hm, Wm, C] with pixels in them and to_world [3, 3], found {found}")

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

    def sample(self, points: Tensor, u: Tensor | None = None) -> LightSample:
        """Uniform over the sphere, whatever the points; ``u [..., 2]`` is needed."""
        if u is None:
            raise ValueError(
                "u: an environment map is sampled with uniform numbers [..., 2] in [0, 1), such as torch.rand(*points.shape[:-1], 2)"
            )
        parts = sampling.uniform_sphere(*numerics.widen(arguments.floats(u, "u", 2)).unbind(-1))
        shape = torch.broadcast_shapes(arguments.floats(points, "points", 3).shape[:-1], u.shape[:-1])
        wi = vector.stack([c.expand(shape) for c in parts]).to(points.dtype)
        distance, density = (torch.full((*shape, 1), x, dtype=points.dtype, device=points.device) for x in (math.inf, UNIFORM))
        return LightSample(*(x.unsqueeze(0) for x in (wi, distance, self.radiance(wi), density)))

    def pdf(self, wi: Tensor, points: Tensor | None = None) -> Tensor:
        """1 / (4 pi)."""
        return wi.new_full((1, *wi.shape[:-1], 1), UNIFORM)

    def radiance(self, wi: Tensor, points: Tensor | None = None) -> Tensor:
        """Radiance ``[..., C]``, W/(m² sr), arriving from ``wi [..., 3]``, which point to the sky and need not be unit."""
        parameters.check(self, arguments.floats(wi, "wi", 3), "wi", batched=False)
        d = vector.normalize_components(vector.components(numerics.widen(wi)))
        usable = vector.dot(d, d) > 0
        u, v = self.coordinates(d)
        texels = Layout.beside(wi).follow(self.texels, axes=3)
        height, width, _ = texels.shape
        found = lookup(texels, (v * height - 0.5, u * width - 0.5), ("clamp", "repeat"))
        return vector.stack([torch.where(usable, c, 0.0) for c in found]).to(wi.dtype)

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
