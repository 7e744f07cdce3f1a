r"""Light straight from point and directional lights to the eye, by way of the lobes that are not deltas.

.. math:: L(\omega_o) = \sum_l f(\omega_l, \omega_o)\; E_l\; \cos\theta_l\; V_l

with E_l the irradiance on a plane facing light l and V_l its visibility. Exact for such lights: the integral of the
reflection equation is a sum. Strict horizon: 0 unless both cosines are positive.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from .. import numerics
from ..bsdf.base import Bsdf, Lobe
from ..geometry import each
from ..light.base import Light, LocalLight
from .base import Contribution, Surface, rows_of

LOBES = tuple(lobe for lobe in Lobe if not lobe.is_delta)


def direct(bsdf: Bsdf, surface: Surface, lights: Sequence[Light], visibility: Tensor | None) -> list[Contribution]:
    """Radiance of every local light. ``visibility [L, ..., 1]`` counts the local lights alone."""
    unshadowed = iter(() if visibility is None else visibility.unbind(0))
    found: list[Contribution] = []
    # What is not seen is put below the horizon, where even an infinite slope ends; times 0 it would be NaN.
    hidden = 2.0 * (1.0 - surface.seen)
    for first, light in rows_of(lights, LocalLight):
        for k, arrival in enumerate(light.arrivals(surface.position, surface.wide)):
            g = surface.towards(arrival.wi)
            strength = numerics.positive(g.cos_i - hidden)
            if arrival.falloff is not None:
                strength = strength * arrival.falloff
            if visibility is not None:
                free = next(unshadowed)
                strength = strength * (free if surface.wide else free.squeeze(-1))
            irradiance = tuple(e * strength for e in arrival.colour)
            found.append((first + k, each(torch.mul, bsdf.formula(g), irradiance)))
    return found
