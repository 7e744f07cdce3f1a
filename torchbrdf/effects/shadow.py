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


def check(shadows: Tensor, lights: Sequence[Light], g: GBuffer) -> Tensor:
    """A visibility that was passed in must have one row per local light and broadcast over the pixels."""
    count = sum(len(light) for light in lights if isinstance(light, LocalLight))
    if shadows.dim() < 2 or shadows.shape[-1] != 1 or shadows.shape[0] != count:
        raise ValueError(
            f"visibility: expected shape [L, ..., H, W, 1] with L = {count} point and directional lights, found {list(shadows.shape)}; "
            "compute it with tb.visibility(g, lights, mesh)"
        )
    if shadows.device != g.position.device:
        raise TypeError(f"visibility: on {shadows.device} beside a G-buffer on {g.position.device}; convert it with .to(...)")
    return shadows.to(g.position.dtype)
