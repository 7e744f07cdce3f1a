"""Cast shadows: which lights a shading point sees past the mesh.

The ray caster works on the CPU, outside every graph, and has no gradient (the true derivative lives on the shadow's edge
alone); its result multiplies the direct light.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from ..bsdf.base import Bsdf
from ..bsdf.lobe import Lobe
from ..interval import UNIT
from ..light.base import Light, LightKind
from ..scene.visibility import visibility
from ..value import SCALAR, Value, param, value
from .base import AUTO, OFF, Contribution, Decision, Effect, Prepared, Scene, Surface
from .check import check_visibility

NOTHING_CASTS = "no mesh to cast them; pass mesh= or visibility="


@value
class Visibility(Value):
    """The share of each point and directional light that arrives, ``[L, ..., 1]``."""

    share: Tensor = param(UNIT, SCALAR, "0 in shadow, 1 in the light")


@dataclass(frozen=True)
class Shadow(Effect):
    """Serves no cell of its own: :class:`~torchbrdf.effects.direct.Direct` takes what it prepares."""

    name = "shadow"
    lobes = Lobe.SPREAD
    lights = ()
    transmission: bool = False  # whether light from behind the surface counts, too

    def decide(self, scene: Scene, setting: str) -> Decision:
        if setting not in (AUTO, OFF):
            raise ValueError(f"shadow: found {setting!r}, legal are 'auto' and 'off'")
        if not (scene.count(LightKind.DELTA) and scene.lobe_names(self.lobes)):
            return Decision(self.name, False, "no direct light to be blocked")
        if setting == OFF:
            return Decision(self.name, False, "switched off by shadow='off'")
        if scene.mesh is None and scene.visibility is None:
            return Decision(self.name, False, NOTHING_CASTS)
        return Decision(self.name, True, "a mesh (or a visibility) is given: one ray per pixel and light, outside the graph, no gradient")

    def prepare(self, scene: Scene, generator: torch.Generator | None) -> Value | None:
        if scene.visibility is not None:
            return Visibility(check_visibility(scene.visibility, scene.lights, scene.g))
        if scene.mesh is None:
            raise ValueError(
                "mesh: the plan casts shadows; pass mesh=... or visibility=tb.visibility(g, lights, mesh), or plan with shadow='off'"
            )
        return Visibility(visibility(scene.g, [light for light in scene.lights if light.kind is LightKind.DELTA], scene.mesh))

    def run(self, bsdf: Bsdf, surface: Surface, lights: Sequence[tuple[int, Light]], prepared: Prepared) -> list[Contribution]:
        return []
