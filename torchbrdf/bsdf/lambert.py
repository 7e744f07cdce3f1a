r"""Ideal diffuse reflection.

.. math:: f = \rho / \pi

==========  ==================  ==========================================
parameter   unit, range         meaning
==========  ==================  ==========================================
albedo      [..., C] in [0, 1]  fraction of the incident power that leaves
==========  ==================  ==========================================

The directional albedo is ``albedo`` at every angle, and the radiosity of a surface is ``pi`` times its radiance. Smooth
everywhere above the horizon. Source: Lambert 1760, *Photometria*.

>>> import torch, torchbrdf as tb
>>> up = torch.tensor([0.0, 0.0, 1.0])
>>> round(float(tb.Lambert(0.5).evaluate(up, up)) * torch.pi, 6)
0.5
"""

import math
from typing import Any

from torch import Tensor

from .. import numerics, sampling
from ..geometry import Channels, Geometry, Viewer
from ..interval import UNIT
from ..value import COLOUR, param, value
from ..vector import Vec
from .base import Bsdf
from .lobe import Draw, Lobe


@value
class Lambert(Bsdf):
    """Ideal diffuse reflection ``albedo / pi``."""

    albedo: Tensor = param(UNIT, COLOUR, "fraction of the incident power that is reflected")

    lobes = (Lobe.DIFFUSE_REFLECTION,)

    def formula(self, g: Geometry) -> Channels:
        return tuple(a * (1.0 / math.pi) for a in g.colour(self.albedo))

    @staticmethod
    def textbook(m: Any, p: Any, albedo: Any) -> Any:
        return albedo / m.pi

    def density(self, g: Geometry) -> Tensor:
        return numerics.positive(g.cos_i) * (1.0 / math.pi)

    def draw(self, viewer: Viewer, u: Vec) -> Draw:
        return Draw(sampling.cosine_hemisphere(u.x, u.y))

    def albedo_at(self, viewer: Viewer, order: int) -> Channels:
        """``albedo`` above the horizon, exactly."""
        above = (viewer.cos_o > 0).to(viewer.cos_o.dtype)
        return tuple(a * above for a in viewer.colour(self.albedo))

    @property
    def energy_bound(self) -> Tensor:
        return self.albedo

    @property
    def lambertian(self) -> Tensor | None:
        return self.albedo if type(self).formula is Lambert.formula else None
