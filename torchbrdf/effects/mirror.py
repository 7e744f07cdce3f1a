r"""What a mirror shows of the environment.

.. math:: L(\omega_o) = \mathrm{tint}\; F(\cos\theta_o)\; L_{env}(R(\omega_o))

Exact for delta reflection: the reflection equation collapses to one look-up. The mesh itself is not seen in the mirror (no
interreflection), and point lights never are: a delta lobe meets a delta light with probability 0.
"""

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from .. import vector
from ..bsdf.base import Bsdf, Channels, Lobe
from ..light.base import Light
from ..light.environment import EnvironmentMap
from ..vector import each
from .base import Surface, rows_of

LOBES = (Lobe.MIRROR,)


def mirror(bsdf: Bsdf, surface: Surface, lights: Sequence[Light], visibility: Tensor | None) -> Iterator[tuple[int, Channels]]:
    """Radiance that the mirror lobes reflect from every environment map."""
    wi = vector.reflect_components(surface.wo, surface.n)
    g = surface.towards(wi)
    up = surface.valid & (surface.cos_o > 0)
    weights = tuple(torch.where(up, w, 0.0) for w in bsdf.mirror_reflectance(g))
    for row, light in rows_of(lights, EnvironmentMap):
        flat = vector.stack([c.squeeze(-1) for c in wi] if surface.wide else wi)
        seen = g.colour(light.radiance(flat))
        yield row, each(lambda w, e: w * e, weights, seen)

