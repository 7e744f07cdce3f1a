r"""What delta lobes (mirrors, clear glass) show of the environment.

.. math:: L(\omega_o) = \sum_d w_d(\omega_o)\; L_{env}(\omega_d)

with the directions and weights of the model's ``deltas``. Exact: the reflection equation collapses to one look-up for each lobe; that of
refraction is in the refracted direction, as if the medium behind the surface had no other end. The mesh itself is not seen (no
interreflection), and point lights never are: a delta lobe meets a delta light with probability 0.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from ..bsdf.base import Bsdf
from ..bsdf.lobe import Lobe
from ..geometry import each
from ..light.base import Light, LightKind
from .base import Contribution, Decision, Effect, Prepared, Scene, Surface


@dataclass(frozen=True)
class Mirror(Effect):
    """Radiance that delta lobes take from every environment map."""

    name = "mirror"
    lobes = Lobe.DELTA
    lights = (LightKind.INFINITE,)

    def decide(self, scene: Scene, setting: str) -> Decision:
        lobes = scene.lobe_names(self.lobes)
        if not lobes:
            return Decision(self.name, False, "no mirror lobe")
        if not scene.count(*self.lights):
            return Decision(self.name, False, "no environment to be seen in the mirror; points and directions are met with probability 0")
        words = {"delta reflection": "mirror reflection", "delta transmission": "refraction (a single interface)"}
        what = " and ".join(words.get(lobe, lobe) for lobe in lobes.split(", "))
        return Decision(self.name, True, f"{what} of the environment map: one look-up, exact; the mesh itself is not reflected")

    def run(self, bsdf: Bsdf, surface: Surface, lights: Sequence[tuple[int, Light]], prepared: Prepared) -> list[Contribution]:
        layout, found = surface.viewer.layout, []
        for d in bsdf.deltas(surface.viewer):
            inside = bsdf.domain(d.geometry(surface.viewer))
            shown = (inside if surface.mask is None else inside & surface.mask).to(layout.dtype)
            weights = tuple(w * shown for w in d.weight)
            towards = layout.join_vector(d.wi)
            for row, light in lights:
                found.append(Contribution(slice(row, row + 1), each(torch.mul, weights, layout.colour(light.radiance(towards)))))
        return found
