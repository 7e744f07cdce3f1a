r"""Light straight from point and directional lights to the eye, by way of the lobes that are not deltas.

.. math:: L(\omega_o) = \sum_l f(\omega_l, \omega_o)\; E_l\; |\cos\theta_l|\; V_l

with E_l the irradiance on a plane facing light l and V_l its visibility. Exact for such lights: the integral of the
reflection equation is a sum. Strict horizon: 0 outside the model's domain.

Lights are an axis: a group of them is computed at once. Eagerly a group has as many as keep the caches warm. A compiled plan or shader
takes one light after the other (:mod:`~torchbrdf.effects.single`); a function of one's own, compiled, has all of them in one group, in
loops of its kernels, so that compiling takes as long for 64 lights as for one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from ..bsdf.base import Bsdf
from ..bsdf.lobe import Lobe
from ..geometry import Geometry, each
from ..light.base import DeltaLight, Light, LightKind
from .base import Contribution, Decision, Effect, Prepared, Scene, Surface

GROUP = 1 << 15  # points times lights computed at once, measured: from 2^14 to 2^16 within noise, slower beside


@dataclass(frozen=True)
class Direct(Effect):
    """Radiance of every point and directional light."""

    name = "direct"
    lobes = Lobe.SPREAD
    lights = (LightKind.DELTA,)

    def decide(self, scene: Scene, setting: str) -> Decision:
        lobes, count = scene.lobe_names(self.lobes), scene.count(*self.lights)
        if not lobes:
            return Decision(self.name, False, "the material has delta lobes alone, and those never meet a point or a direction")
        if not count:
            return Decision(self.name, False, "no point or directional light")
        why = f"{lobes} under {count} point or directional light{'s' * (count > 1)}: a sum, exact"
        return Decision(self.name, True, why, scene.methods(self.lobes) or "exact")

    def run(self, bsdf: Bsdf, surface: Surface, lights: Sequence[tuple[int, Light]], prepared: Prepared) -> list[Contribution]:
        shadow = prepared.of("shadow")
        visibility = None if shadow is None else shadow.share
        found, before = [], 0  # a visibility counts these lights alone
        for first, light in lights:
            assert isinstance(light, DeltaLight)
            for rows, group in light.groups(group_size(surface, len(light))):
                mine = slice(before + rows.start, before + rows.stop)
                found.append(_group(bsdf, surface, group, first + rows.start, None if visibility is None else visibility[mine]))
            before += len(light)
        return found


def group_size(surface: Surface, count: int) -> int:
    """How many of ``count`` lights are computed at once."""
    return count if torch.compiler.is_compiling() else max(1, GROUP // max(1, surface.shape.numel()))


def _group(bsdf: Bsdf, surface: Surface, lights: DeltaLight, first: int, visibility: Tensor | None) -> Contribution:
    layout, count = surface.viewer.layout, len(lights)
    arrival = lights.arrive(surface.position, layout)
    g = Geometry(surface.viewer, arrival.wi)
    strength = surface.cosine(bsdf, g)
    if arrival.falloff is not None:
        strength = strength * arrival.falloff
    if visibility is not None:
        free = layout.lift(visibility.squeeze(-1))
        strength = strength * (free if count > 1 else free[0])
    irradiance = tuple(e * strength for e in arrival.colour)
    return Contribution(slice(first, first + count), each(torch.mul, bsdf.formula(g), irradiance))
