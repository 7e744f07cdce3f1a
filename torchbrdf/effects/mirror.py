r"""What a mirror shows of the environment.

.. math:: L(\omega_o) = \mathrm{tint}\; F(\cos\theta_o)\; L_{env}(R(\omega_o))

Exact for delta reflection: the reflection equation collapses to one look-up. The mesh itself is not seen in the mirror (no
interreflection), and point lights never are: a delta lobe meets a delta light with probability 0.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from .. import vector
from ..bsdf.base import Bsdf, Lobe
from ..geometry import each
from ..light.base import Light
from ..light.environment import EnvironmentMap
from .base import Contribution, Surface, rows_of

LOBES = (Lobe.MIRROR,)


def mirror(bsdf: Bsdf, surface: Surface, lights: Sequence[Light], visibility: Tensor | None) -> list[Contribution]:
    """Radiance that the mirror lobes reflect from every environment map. ``visibility`` knows of local lights alone."""
    wi = vector.reflect_components(surface.wo, surface.n)
    g = surface.towards(wi)
    weights = tuple(w * surface.seen for w in bsdf.mirror_reflectance(g))
    towards = vector.stack([c.squeeze(-1) for c in wi] if surface.wide else wi)
    return [(row, each(torch.mul, weights, g.colour(light.radiance(towards)))) for row, light in rows_of(lights, EnvironmentMap)]
