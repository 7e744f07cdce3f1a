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

import torch
from torch import Tensor

from .. import numerics
from ..geometry import Geometry
from ..interval import UNIT
from ..value import COLOUR, param, value
from ..vector import Vec
from .base import Bsdf, Channels, Draw, Lobe, draw_from, join


@value
class Lambert(Bsdf):
    """Ideal diffuse reflection ``albedo / pi``."""

    albedo: Tensor = param(UNIT, COLOUR, "fraction of the incident power that is reflected")

    lobes = (Lobe.DIFFUSE,)

    def formula(self, g: Geometry) -> Channels:
        return tuple(a * (1.0 / math.pi) for a in g.colour(self.albedo))

    def density(self, g: Geometry) -> Tensor:
        return numerics.positive(g.cos_i) * (1.0 / math.pi)

    def draw(self, wo: Vec, u: Vec, wide: bool) -> Draw:
        """Cosine-weighted: a uniform point of the disk, lifted to the hemisphere (Malley 1988)."""
        r, phi = torch.sqrt(u.x), 2.0 * math.pi * u.y
        x, y = torch.broadcast_tensors(r * torch.cos(phi), wo.z)[0], torch.broadcast_tensors(r * torch.sin(phi), wo.z)[0]
        z = torch.sqrt(torch.broadcast_tensors(1.0 - u.x, wo.z)[0])
        return draw_from(self, Vec(x, y, z), wo, wide)

    def directional_albedo(self, wo: Tensor, n: Tensor | None = None, *, order: int = 48) -> Tensor:
        """``albedo`` above the horizon, exactly."""
        g = self.view_geometry(wo, n)
        up = (g.cos_o > 0).to(g.cos_o.dtype)
        return join([a * up for a in g.colour(self.albedo)], g.wide).to(wo.dtype)

    @property
    def energy_bound(self) -> Tensor:
        return self.albedo
