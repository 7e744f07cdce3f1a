"""What an effect is: a value with three verbs, that owns its cells of the table lobe × light kind.

=============  ===============================================================  ==================================================
verb           when                                                             what it may do
=============  ===============================================================  ==================================================
``decide``     once, from kinds alone: lobes, lights, what is given             say on or off, why, and by which method
``prepare``    outside every graph, without gradient, when the scene moved      cast rays, draw random numbers, tabulate, gather
``run``        in the graph, every time                                         compute radiance, differentiably
=============  ===============================================================  ==================================================
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor

from .. import numerics, vector
from ..bsdf.base import Bsdf
from ..bsdf.lobe import Lobe
from ..geometry import Channels, Geometry, Layout, Viewer
from ..light.base import Light, LightKind
from ..scene.gbuffer import GBuffer
from ..scene.mesh import Mesh
from ..value import Value, value
from ..vector import Vec

AUTO, OFF = "auto", "off"


class Scene(NamedTuple):
    """What a plan is made for. Effects look at kinds and at what is there, never at the values of tensors."""

    g: GBuffer
    bsdf: Bsdf
    lights: Sequence[Light]
    mesh: Mesh | None = None
    visibility: Tensor | None = None

    def count(self, *kinds: LightKind) -> int:
        """How many sources of these kinds there are."""
        return sum(len(light) for light in self.lights if light.kind in kinds)

    def lobe_names(self, wanted: Lobe) -> str:
        """The lobes of the wanted kinds in words; empty if there are none."""
        return ", ".join(sorted({lobe.label for lobe in self.bsdf.lobes if lobe.serves(wanted)}))

    def methods(self, wanted: Lobe) -> str:
        """By which methods the laws behind these lobes are computed, such as ``"Dielectric: standard"``; empty if they have one each."""
        part = self.bsdf.select(wanted)
        return ", ".join(dict.fromkeys(_methods(part))) if part is not None else ""


def _methods(held: Value) -> Iterator[str]:
    found = [getattr(held, name) for name in held._fields if name in ("method", "smith")]
    if found:
        yield f"{type(held).__name__}: {', '.join(found)}"
    for inner in held.nested():
        yield from _methods(inner)


@dataclass(frozen=True)
class Decision:
    """One line of a plan."""

    effect: str
    on: bool
    why: str
    method: str = "exact"

    def __str__(self) -> str:
        by = "" if self.method == "exact" else f" ({self.method})"
        return f"  {self.effect:<12} {'on ' if self.on else 'off'}  {self.why}{by}"


@value
class Prepared(Value):
    """What the effects of a plan prepared: one value for each that prepares something, by name. ``None`` stands for nothing."""

    names: tuple[str, ...] = ()
    values: tuple[Any, ...] = ()

    def of(self, name: str) -> Any:
        """What an effect prepared; None if nothing."""
        return dict(zip(self.names, self.values, strict=True)).get(name)


class Surface(NamedTuple):
    """The shading points of a G-buffer, taken apart once."""

    position: Vec
    viewer: Viewer
    mask: Tensor | None  # where there is a surface (bool number); None: everywhere
    shape: torch.Size  # of the points

    @staticmethod
    def of(g: GBuffer, wide: bool, rank: int | None = None) -> "Surface":
        """Directions are normalised here, once; zero and non-finite ones become 0, which no domain contains."""
        layout = Layout.beside(g.position, wide, rank)

        def lifted(v: Vec) -> Vec:
            return Vec(*map(layout.lift, v)) if wide else v

        normal, view = (numerics.widen(v) for v in (g.normal, g.require_view()))
        together = rank is not None and normal.shape == view.shape and normal.requires_grad == view.requires_grad
        pair = vector.unit_pair(normal, view) if together else map(vector.unit_components, (normal, view))
        n, wo = map(lifted, pair)
        tangent = None if g.tangent is None else lifted(vector.components(numerics.widen(g.tangent)))
        handedness = None if g.handedness is None else layout.lift(g.handedness.squeeze(-1))
        mask = None if g.mask is None else layout.lift(g.mask.squeeze(-1))
        missing = (None,) * (len(g.batch_shape) + 1 - g.position.dim())  # lights stand before the axes of all points
        position = lifted(vector.finite_components(numerics.widen(g.position[missing] if missing else g.position)))
        return Surface(position, Viewer(wo, n, tangent, handedness, layout), mask, g.batch_shape)

    def cosine(self, bsdf: Bsdf, g: Geometry) -> Tensor:
        """``|cos_i|`` where ``bsdf`` sends light from ``g.wi`` to the viewer of a surface that is there; exactly 0 elsewhere.

        What must not contribute is put below a horizon, where even an infinite slope ends; times 0 it would be NaN. (Not by ``where``:
        on eager CPUs a ``where`` on a mask that changes from pixel to pixel costs as much as thirty products.)
        """
        inside = bsdf.domain(g)
        if self.mask is not None:
            inside = inside & self.mask
        return numerics.positive(torch.add(g.cos_i.abs(), ~inside, alpha=-2))


class Contribution(NamedTuple):
    """Radiance of some rows of lights: with a leading axis where there are several rows, without where there is one.

    Formulas of a layout with a ``rank`` give one tensor ``[C, ...]``, its second axis that of the rows where any light has several.
    """

    rows: slice
    radiance: Channels


class Effect(ABC):
    """One way in which light reaches the eye. Subclasses are frozen dataclasses of plain data: the choices of a method."""

    name: ClassVar[str]
    lobes: ClassVar[Lobe]  # the cells that the effect serves: these lobes ...
    lights: ClassVar[tuple[LightKind, ...]]  # ... under these kinds of light

    @abstractmethod
    def decide(self, scene: Scene, setting: str) -> Decision:
        """Whether this scene calls for the effect; ``setting`` is what the caller asked for by the effect's name, or ``"auto"``."""

    def prepare(self, scene: Scene, generator: torch.Generator | None) -> Value | None:
        """What :meth:`run` needs and no graph can compute; nothing, unless an effect says otherwise. Without gradient.

        ``scene.bsdf`` is not to be asked for: what is prepared serves every step of an optimisation.
        """
        return None

    @abstractmethod
    def run(self, bsdf: Bsdf, surface: Surface, lights: Sequence[tuple[int, Light]], prepared: Prepared) -> list[Contribution]:
        """Radiance of the ``lights`` of the effect's kinds, each given with its first row. ``bsdf`` has lobes of the effect's kinds."""

    def serves(self, lobe: Lobe, kind: LightKind) -> bool:
        """Whether a cell of the table lobe × light kind belongs to this effect."""
        return lobe.serves(self.lobes) and kind in self.lights
