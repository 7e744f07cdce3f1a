"""What this scene calls for: which effects exist, and why. The plan is static; it holds no tensor, no ray caster, no file.

``shade`` is plan-and-run in one call. Deciding happens at construction, from the kinds of lobes, lights and geometry alone and
never from data inside a graph, so a planned shader compiles to one full graph. A lobe that no effect serves (a mirror under
point lights) is left out, and its parameters get no gradient.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from . import arguments
from .bsdf.base import Bsdf, Channels
from .effects import base, check, direct, mirror, shadow
from .geometry import each
from .light.base import Light, LocalLight
from .light.environment import EnvironmentMap
from .scene.gbuffer import GBuffer
from .scene.mesh import Mesh
from .value import validate

Lights = Light | Sequence[Light]
NOTHING_CASTS = "no mesh to cast them; pass mesh= or visibility="
EFFECTS = {"direct": (direct.direct, direct.LOBES), "mirror": (mirror.mirror, mirror.LOBES)}


@dataclass(frozen=True)
class Decision:
    """One line of a plan."""

    effect: str
    on: bool
    why: str

    def __str__(self) -> str:
        return f"  {self.effect:<12} {'on ' if self.on else 'off'}  {self.why}"


@dataclass(frozen=True)
class Plan:
    """The effects that a scene calls for. Call it with the scene; print it to read why."""

    decisions: tuple[Decision, ...]

    def calls_for(self, effect: str) -> bool:
        """Whether an effect is on."""
        return any(d.on for d in self.decisions if d.effect == effect)

    def __str__(self) -> str:
        return "\n".join(["plan", *map(str, self.decisions)])

    def __call__(
        self, g: GBuffer, bsdf: Bsdf, lights: Lights, *, mesh: Mesh | None = None, visibility: Tensor | None = None, per_light: bool = False
    ) -> Tensor:
        """Radiance ``[..., H, W, C]`` towards the viewer, planar; ``per_light=True``: ``[L, ..., H, W, C]``, not summed.

        Shadows come from ``visibility [L, ..., H, W, 1]`` where it is given, else from ``mesh``.
        """
        sources = check.as_list(lights)
        channels = check.check_scene(g, bsdf, sources)
        shadows = self._shadows(g, sources, mesh, visibility)
        surface = base.Surface.of(g, bsdf.is_wide)
        rows: list[Channels | None] = [None] * sum(map(len, sources))
        for name, (effect, lobes) in EFFECTS.items():
            part = bsdf.select(lobes) if self.calls_for(name) else None
            if part is not None:
                for row, radiance in effect(part, surface, sources, shadows):
                    before = rows[row]
                    rows[row] = radiance if before is None else each(torch.add, before, radiance)
        return base.assemble(rows, surface, channels, per_light).to(g.position.dtype)

    def _shadows(self, g: GBuffer, lights: Sequence[Light], mesh: Mesh | None, visibility: Tensor | None) -> Tensor | None:
        if not self.calls_for("shadow"):
            self._check_lost_shadows(mesh, visibility)
            return None
        if visibility is not None:
            return check.check_visibility(visibility, lights, g)
        if mesh is None:
            raise ValueError(
                "mesh: the plan casts shadows; pass mesh=... or visibility=tb.visibility(g, lights, mesh), or plan with shadow='off'"
            )
        return shadow.cast(g, lights, mesh)

    def _check_lost_shadows(self, mesh: Mesh | None, visibility: Tensor | None) -> None:
        """A visibility that would be dropped without a word is an error; a mesh is worth a warning."""
        if not any(d.why == NOTHING_CASTS for d in self.decisions):
            return
        remedy = "this plan was made without shadows; make it with tb.plan(..., mesh=...) or visibility=..., or with shadow='off'"
        if visibility is not None:
            raise ValueError(f"visibility: {remedy}")
        if mesh is not None:
            warnings.warn(f"mesh: {remedy}", stacklevel=4)


def plan(
    g: GBuffer,
    bsdf: Bsdf,
    lights: Lights,
    mesh: Mesh | None = None,
    tolerance: float | None = None,
    *,
    visibility: Tensor | None = None,
    shadow: str = "auto",
) -> Plan:
    """Decide which effects this scene calls for, after checking every parameter's range.

    ``shadow="off"`` leaves cast shadows out even where a mesh is given. ``tolerance``: every law of this version is exact, so
    None is the only legal value.
    """
    if tolerance is not None:
        raise ValueError(f"tolerance: found {tolerance!r}; every law of this version is computed exactly, so leave it None")
    if shadow not in ("auto", "off"):
        raise ValueError(f"shadow: found {shadow!r}, legal are 'auto' and 'off'")
    sources = check.as_list(lights)
    check.check_scene(g, bsdf, sources)
    check.check_mesh(mesh)
    if not arguments.hidden():
        for checked in (bsdf, *sources):
            validate(checked)
        if isinstance(visibility, Tensor):
            check.check_visible_share(visibility)
    local = sum(len(s) for s in sources if isinstance(s, LocalLight))
    environments = sum(isinstance(s, EnvironmentMap) for s in sources)
    _refuse_integrals(bsdf, environments)
    casts = mesh is not None or visibility is not None
    return Plan((_direct(bsdf, local), _shadow(bsdf, local, casts, shadow), _mirror(bsdf, environments)))


def shade(
    g: GBuffer,
    bsdf: Bsdf,
    lights: Lights,
    *,
    mesh: Mesh | None = None,
    visibility: Tensor | None = None,
    shadow: str = "auto",
    per_light: bool = False,
) -> Tensor:
    """Radiance ``[..., H, W, C]`` of a G-buffer: :func:`plan` and run in one call. ``mesh=`` lets that mesh cast shadows."""
    sources = check.as_list(lights)
    found = plan(g, bsdf, sources, mesh, visibility=visibility, shadow=shadow)
    return found(g, bsdf, sources, mesh=mesh, visibility=visibility, per_light=per_light)


def _names(bsdf: Bsdf, delta: bool) -> str:
    return ", ".join(sorted({lobe.value for lobe in bsdf.lobes if lobe.is_delta == delta}))


def _direct(bsdf: Bsdf, local: int) -> Decision:
    lobes = _names(bsdf, delta=False)
    if not lobes:
        return Decision("direct", False, "the material has delta lobes alone, and those never meet a point or a direction")
    if not local:
        return Decision("direct", False, "no point or directional light")
    return Decision("direct", True, f"{lobes} under {local} point or directional light{'s' * (local > 1)}: a sum, exact")


def _shadow(bsdf: Bsdf, local: int, possible: bool, wish: str) -> Decision:
    if not (local and _names(bsdf, delta=False)):
        return Decision("shadow", False, "no direct light to be blocked")
    if wish == "off":
        return Decision("shadow", False, "switched off by shadow='off'")
    if not possible:
        return Decision("shadow", False, NOTHING_CASTS)
    return Decision("shadow", True, "a mesh (or a visibility) is given: one ray per pixel and light, outside the graph, no gradient")


def _mirror(bsdf: Bsdf, environments: int) -> Decision:
    if not _names(bsdf, delta=True):
        return Decision("mirror", False, "no mirror lobe")
    if not environments:
        return Decision("mirror", False, "no environment to be seen in the mirror; points and directions are met with probability 0")
    return Decision("mirror", True, "mirror reflection of the environment map: one look-up, exact; the mesh itself is not reflected")


def _refuse_integrals(bsdf: Bsdf, environments: int) -> None:
    lobes = _names(bsdf, delta=False)
    if environments and lobes:
        raise ValueError(
            f"lights: in this version an EnvironmentMap lights mirror lobes alone, and the material has {lobes}; shade the parts "
            "apart: tb.shade(g, mirror_part, environment) + tb.shade(g, other_part, point_or_directional_lights)"
        )
