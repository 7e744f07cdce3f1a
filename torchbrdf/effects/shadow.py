"""Cast shadows: which lights a shading point sees past the mesh.

The ray caster works on the CPU, outside every graph, and has no gradient (the true derivative lives on the shadow's edge
alone); its result multiplies the direct light.
"""

from collections.abc import Sequence

from torch import Tensor

from ..light.base import Light, LocalLight
from ..scene.gbuffer import GBuffer
from ..scene.mesh import Mesh
from ..scene.visibility import visibility


def cast(g: GBuffer, lights: Sequence[Light], mesh: Mesh) -> Tensor:
    """Visibility ``[L, ..., 1]`` of the local lights, 0 or 1."""
    return visibility(g, [light for light in lights if isinstance(light, LocalLight)], mesh)
