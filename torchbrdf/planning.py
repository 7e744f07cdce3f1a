"""What this scene calls for: which effects exist, and why. The plan is static; it holds no tensor, no ray caster, no file.

``shade`` is plan, prepare and run in one call. Deciding happens at construction, from the kinds of lobes, lights and geometry alone and
never from data inside a graph, so a planned shader compiles to one full graph. A lobe that no effect serves (a mirror under
point lights) is left out, and its parameters get gradient 0.
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import torch
from torch import Tensor

from .bsdf.base import Bsdf
from .bsdf.lobe import Lobe
from .effects import check, doubts, rows, single
from .effects.base import AUTO, Contribution, Decision, Effect, Prepared, Scene, Surface
from .effects.direct import Direct
from .effects.mirror import Mirror
from .effects.shadow import NOTHING_CASTS, Shadow
from .light.base import Light, LightKind
from .scene.gbuffer import GBuffer
from .scene.mesh import Mesh
from .value import validate

Lights = Light | Sequence[Light]
EFFECTS: tuple[Effect, ...] = (Direct(), Shadow(), Mirror())


@dataclass(frozen=True)
class Plan:
    """The effects that a scene calls for. Call it with the scene; print it to read why."""

    decisions: tuple[Decision, ...]
    effects: tuple[Effect, ...]  # those that are on
    lobes: tuple[Lobe, ...]  # the kinds that the plan was made for
    lights: tuple[LightKind, ...]

    def calls_for(self, effect: str) -> bool:
        """Whether an effect is on."""
        return any(d.on for d in self.decisions if d.effect == effect)

    def __str__(self) -> str:
        return "\n".join(["plan", *map(str, self.decisions)])

    def prepare(
        self,
        g: GBuffer,
        lights: Lights,
        mesh: Mesh | None = None,
        visibility: Tensor | None = None,
        generator: torch.Generator | None = None,
    ) -> Prepared:
        """What the effects need and no graph can compute (shadow rays, random numbers, tables), without gradient: one value for the call.

        ``mesh`` casts shadows, or ``visibility [L, ..., H, W, 1]`` says what they are; ``generator`` makes random numbers repeatable.
        """
        sources = check.as_list(lights)
        check.check_mesh(mesh)
        self._check_lost_shadows(mesh, visibility)
        if all(type(e).prepare is Effect.prepare for e in self.effects):
            return Prepared()
        scene = Scene(g, None, sources, mesh, visibility)  # type: ignore[arg-type]
        with torch.no_grad():
            found = {e.name: e.prepare(scene, generator) for e in self.effects}
        kept = {name: v for name, v in found.items() if v is not None}
        return Prepared(tuple(kept), tuple(kept.values()))

    def __call__(
        self,
        g: GBuffer,
        bsdf: Bsdf,
        lights: Lights,
        prepared: Prepared | Tensor | None = None,
        *,
        mesh: Mesh | None = None,
        visibility: Tensor | None = None,
        per_light: bool = False,
    ) -> Tensor:
        """Radiance ``[..., H, W, C]`` towards the viewer, planar; ``per_light=True``: ``[L, ..., H, W, C]``, not summed.

        ``prepared`` is what :meth:`prepare` gave, or a visibility ``[L, ..., H, W, 1]``; without it, it is made here from ``mesh`` or
        ``visibility``.
        """
        sources = check.as_list(lights)
        channels = check.check_scene(g, bsdf, sources)
        self._check_kinds(bsdf, sources)
        if not isinstance(prepared, Prepared):
            prepared = self.prepare(g, sources, mesh, visibility if prepared is None else prepared)
        surface = Surface.of(g, bsdf.is_wide, rows.rank(g, bsdf, sources))
        parts: list[Contribution] = []
        for effect in self.effects:
            part = bsdf.select(effect.lobes)
            if part is not None:
                parts += effect.run(part, surface, rows.rows_of(sources, effect.lights), prepared)
        count = sum(map(len, sources))
        image = rows.apart(parts, surface, channels, count) if per_light else rows.summed(parts, surface, channels)
        return self._with_unserved(image, bsdf).to(g.position.dtype)

    def compiled_with(self, make: Callable[[Any], Any]) -> Callable[..., Tensor]:
        """What ``tb.compile`` gives, by a compiler ``make``: a graph for one light, called again for each of several."""
        graph = make(self)

        def compiled(
            g: GBuffer,
            bsdf: Bsdf,
            lights: Lights,
            prepared: Prepared | Tensor | None = None,
            *,
            mesh: Mesh | None = None,
            visibility: Tensor | None = None,
            per_light: bool = False,
        ) -> Tensor:
            sources = check.as_list(lights)
            ready = self.ready(g, sources, prepared, mesh, visibility)  # outside of the graph, for all lights at once
            render = partial(graph, g, bsdf, per_light=per_light)
            return single.one_by_one(render, sources, ready, per_light) if self.takes_apart() else render(sources, ready)

        return compiled

    def ready(
        self, g: GBuffer, lights: Lights, prepared: Prepared | Tensor | None, mesh: Mesh | None = None, visibility: Tensor | None = None
    ) -> Prepared:
        """What a call is given as ``prepared``, prepared if it is not yet."""
        return prepared if isinstance(prepared, Prepared) else self.prepare(g, lights, mesh, visibility if prepared is None else prepared)

    def takes_apart(self) -> bool:
        """Whether one compiled graph serves light after light: not within a graph, nor where an effect of one's own wants them all."""
        own = [type(e) for e in EFFECTS]
        return not torch.compiler.is_compiling() and all(type(e) in own for e in self.effects)

    def _with_unserved(self, image: Tensor, bsdf: Bsdf) -> Tensor:
        """The same image, with gradient 0 by parameters of lobes that no effect serves: DistributedDataParallel asks for every gradient."""
        unserved = [lobe for lobe in self.lobes if not any(e.serves(lobe, kind) for e in self.effects for kind in self.lights)]
        for part in [p for lobe in unserved if (p := bsdf.select(lobe)) is not None]:
            for _, t in part.named_tensors():
                if t.requires_grad:
                    image = image + t.reshape(-1)[:0].sum()  # of no numbers: exactly 0, whatever t holds
        return image

    def _check_kinds(self, bsdf: Bsdf, lights: Sequence[Light]) -> None:
        """A plan answers for the kinds it was made for; others would be left out without a word."""
        for lobe in bsdf.lobes:
            if all(lobe.value != known.value for known in self.lobes):
                raise ValueError(f"bsdf: this plan was made without {lobe.label}; make one for this material with tb.plan(g, bsdf, lights)")
        for k, light in enumerate(lights):
            if light.kind not in self.lights:
                what = f"{type(light).__name__} ({light.kind.value})"
                raise ValueError(f"lights[{k}]: this plan was made without {what}; make one for these lights with tb.plan(g, bsdf, lights)")

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
    effects: Sequence[Effect] = (),
    **settings: str,
) -> Plan:
    """Decide which effects this scene calls for, after checking every parameter's range.

    ``effects`` are further ones of your own, beside the built-in ones; one of the same name takes its place. A setting is given by an
    effect's name: ``shadow="off"`` leaves cast shadows out even where a mesh is given. ``tolerance``: every law of this version is
    exact, so None is the only legal value.
    """
    if tolerance is not None:
        raise ValueError(f"tolerance: found {tolerance!r}; every law of this version is computed exactly, so leave it None")
    own = {e.name: e for e in (*EFFECTS, *effects)}
    unknown = sorted(set(settings) - set(own))
    if unknown:
        raise TypeError(f"{unknown[0]}: found {settings[unknown[0]]!r}, but no effect has that name; effects are {sorted(own)}")
    sources = check.as_list(lights)
    check.check_scene(g, bsdf, sources)
    check.check_mesh(mesh)
    if not torch.compiler.is_compiling():
        for checked in (bsdf, *sources):
            validate(checked)
        g.check()
        doubts.warn(g, bsdf, sources)
        if isinstance(visibility, Tensor):
            check.check_visible_share(visibility)
    scene = Scene(g, bsdf, sources, mesh, visibility)
    decisions = tuple(e.decide(scene, settings.get(e.name, AUTO)) for e in own.values())
    on = tuple(e for e, d in zip(own.values(), decisions, strict=True) if d.on)
    lobes, kinds = _each_once(bsdf.lobes), _each_once([light.kind for light in sources])
    _refuse_unserved(lobes, kinds, on)
    return Plan(decisions, on, lobes, kinds)


def shade(
    g: GBuffer,
    bsdf: Bsdf,
    lights: Lights,
    *,
    mesh: Mesh | None = None,
    visibility: Tensor | None = None,
    per_light: bool = False,
    generator: torch.Generator | None = None,
    tolerance: float | None = None,
    effects: Sequence[Effect] = (),
    **settings: str,
) -> Tensor:
    """Radiance ``[..., H, W, C]`` of a G-buffer: :func:`plan`, prepare and run in one call. ``mesh=`` lets that mesh cast shadows."""
    sources = check.as_list(lights)
    found = plan(g, bsdf, sources, mesh, tolerance, visibility=visibility, effects=effects, **settings)
    prepared = found.prepare(g, sources, mesh, visibility, generator)
    return Plan.__call__(found, g, bsdf, sources, prepared, per_light=per_light)  # torch to 2.9 hashes what it calls, before it is whole


def _each_once(found: Sequence[Any]) -> tuple[Any, ...]:
    """Enum members in the order of their first appearance."""
    once: list[Any] = []
    for one in found:
        if all(one is not other for other in once):
            once.append(one)
    return tuple(once)


def _refuse_unserved(lobes: Sequence[Lobe], kinds: Sequence[LightKind], effects: Sequence[Effect]) -> None:
    """A lobe under a light that no effect brings together would be dark without a word. (Deltas meet deltas with probability 0.)"""
    for kind in kinds:
        missed = [m.label for m in lobes if not (m.is_delta and kind is LightKind.DELTA) and not any(e.serves(m, kind) for e in effects)]
        if missed and kind is LightKind.INFINITE:
            raise ValueError(
                f"lights: in this version an EnvironmentMap lights mirror lobes alone, and the material has {', '.join(missed)}; shade the "
                "parts apart: tb.shade(g, mirror_part, environment) + tb.shade(g, other_part, point_or_directional_lights)"
            )
        if missed:
            raise ValueError(
                f"lights: no effect brings light of kind {kind.value!r} to the material's {', '.join(missed)}; pass one with effects=[...]"
            )
