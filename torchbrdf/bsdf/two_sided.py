r"""A surface that reflects on both sides.

.. math:: f = \begin{cases} f_{outside} & \cos\theta_i, \cos\theta_o > 0 \\ f_{inside} & \cos\theta_i, \cos\theta_o < 0 \end{cases}

=========  ==============  =======================================================
parameter  unit, range     meaning
=========  ==============  =======================================================
inside     a BSDF          behind the surface, where n.wo < 0
outside    a BSDF or None  on the side of the normal; None: the same model as inside
=========  ==============  =======================================================

Each model sees the surface turned to the viewer. ``TwoSided(model)`` looks the same from both sides. (A model without this is black
from behind.) Directional albedo: that of the model of the side. Smooth where the models are; nothing passes through the surface.
Source: the ``twosided`` adapter of Mitsuba (Jakob 2010).

>>> import torch, torchbrdf as tb
>>> down = torch.tensor([0.0, 0.0, -1.0])
>>> float(tb.Lambert(1.0).evaluate(down, down)), round(float(tb.TwoSided(tb.Lambert(1.0)).evaluate(down, down)) * torch.pi, 6)
(0.0, 1.0)
"""

import torch
from torch import Tensor

from .. import parameters
from ..geometry import Channels, Geometry, Viewer, each
from ..value import value
from ..vector import Vec
from .base import Bsdf
from .lobe import Delta, Draw, Lobe


@value
class TwoSided(Bsdf):
    """``inside`` behind the surface, ``outside`` (None: the same model) on the side of the normal."""

    inside: Bsdf
    outside: Bsdf | None = None

    def __post_init__(self) -> None:
        for name in ("inside", "outside"):
            held = getattr(self, name)
            if not (isinstance(held, Bsdf) or (held is None and name == "outside")):
                raise TypeError(f"TwoSided.{name}: expected a BSDF such as tb.Lambert(albedo), found {type(held).__name__}")
            if isinstance(held, Bsdf) and any(lobe.transmits for lobe in held.lobes):
                raise ValueError(f"TwoSided.{name}: {type(held).__name__} sends light through the surface; it has two sides already")
        super().__post_init__()

    @property
    def sides(self) -> tuple[Bsdf, ...]:
        """The models: of both sides, or inside and outside."""
        return (self.inside,) if self.outside is None else (self.inside, self.outside)

    @property
    def lobes(self) -> tuple[Lobe, ...]:  # type: ignore[override]
        return tuple(lobe for s in self.sides for lobe in s.lobes)

    @property
    def reciprocal(self) -> bool:  # type: ignore[override]
        return all(s.reciprocal for s in self.sides)

    @property
    def energy_bound(self) -> Tensor | None:
        bounds = [b for s in self.sides if (b := s.energy_bound) is not None]
        return None if len(bounds) < len(self.sides) else bounds[0] if len(bounds) == 1 else torch.maximum(*parameters.alike(*bounds))

    def select(self, wanted: Lobe) -> Bsdf | None:
        kept = [s.select(wanted) for s in self.sides]
        found = [k for k in kept if k is not None]
        if not found:
            return None
        return TwoSided(*(k if k is not None else 0.0 * found[0] for k in kept))  # a side without such lobes: the other's, black

    def domain(self, g: Geometry) -> Tensor:
        """Where the model of the viewer's side sends light, once the surface is turned to the viewer."""
        return self._by_side(g.viewer, [s.domain(g.facing) for s in self.sides])

    def kink_distance(self, g: Geometry) -> Tensor:
        return self._by_side(g.viewer, [s.kink_distance(g.facing) for s in self.sides])

    def formula(self, g: Geometry) -> Channels:
        found = [s.formula(g.facing) for s in self.sides]
        return found[0] if len(found) == 1 else each(lambda i, o: self._by_side(g.viewer, [i, o]), *found)

    def albedo_at(self, viewer: Viewer, order: int) -> Channels:
        """That of the model of the viewer's side."""
        found = [s.albedo_at(viewer.facing, order) for s in self.sides]
        return found[0] if len(found) == 1 else each(lambda i, o: self._by_side(viewer, [i, o]), *found)

    def strength(self, viewer: Viewer) -> Tensor:
        return self._by_side(viewer, [s.strength(viewer.facing) for s in self.sides])

    def density(self, g: Geometry) -> Tensor:
        return self._by_side(g.viewer, [s.density(g.facing) for s in self.sides])

    def draw(self, viewer: Viewer, u: Vec) -> Draw:
        """As the model of the viewer's side draws for the surface turned to it."""
        inside, *outside = (s.draw(viewer.facing, u) for s in self.sides)
        wi = inside.wi
        lobe: Tensor | int = inside.lobe
        for other in outside:
            wi = Vec(*(self._by_side(viewer, [a, b]) for a, b in zip(inside.wi, other.wi, strict=True)))
            lobe = self._by_side(viewer, [_index(x, viewer) for x in (inside.lobe, other.lobe + len(self.inside.lobes))])
        return Draw(Vec(wi.x, wi.y, wi.z * viewer.side), lobe)

    def deltas(self, viewer: Viewer) -> list[Delta]:
        found, first = [], 0
        for behind, model in zip((True, False), self.sides, strict=False):
            mine = 1.0 if len(self.sides) == 1 else (viewer.side < 0 if behind else viewer.side > 0).to(viewer.cos_o.dtype)
            for d in model.deltas(viewer.facing):
                wi = Vec(d.wi.x, d.wi.y, d.wi.z * viewer.side) if viewer.is_local else d.wi
                weight = tuple(w * mine for w in d.weight)
                found.append(d._replace(wi=wi, cos_i=d.cos_i * viewer.side, weight=weight, lobe=d.lobe + first))
            first += len(model.lobes)
        return found

    def _by_side(self, viewer: Viewer, found: list[Tensor]) -> Tensor:
        """What belongs to the viewer's side of what the models say."""
        return found[0] if len(found) == 1 else torch.where(viewer.side < 0, found[0], found[1])


def _index(lobe: Tensor | int, viewer: Viewer) -> Tensor:
    return torch.zeros_like(viewer.cos_o, dtype=torch.int64) + lobe
