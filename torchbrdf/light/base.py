"""What every light answers: which kind it is, how to sample it, how bright it is along a direction.

=============  ==============================================  ===================================================
kind           reaches a point                                 its ``radiance`` in a :class:`LightSample`
=============  ==============================================  ===================================================
``DELTA``      from one direction: points, directions          irradiance on a plane facing the light; ``pdf`` is 1
``AREA``       from the directions of a surface nearby         radiance, W/(m² sr)
``INFINITE``   from every direction: environments              radiance, W/(m² sr)
=============  ==============================================  ===================================================
"""

import enum
from abc import abstractmethod
from collections.abc import Iterator, Sequence
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from .. import arguments, numerics, parameters, vector
from ..geometry import Channels, Layout
from ..value import Value
from ..vector import Vec


class LightKind(enum.Enum):
    """Over how much of the directions a light is spread; a plan chooses effects by it."""

    DELTA = "point or directional"
    AREA = "area"
    INFINITE = "environment"


class LightSample(NamedTuple):
    """Light that arrives at points ``[...]``, one row for each of the L sources."""

    wi: Tensor  # [L, ..., 3] unit, to the light
    distance: Tensor  # [L, ..., 1] to where it comes from, infinite for INFINITE lights and directions
    radiance: Tensor  # [L, ..., C]; of a DELTA light the irradiance on a plane facing it
    pdf: Tensor  # [L, ..., 1] per steradian of wi at the points; 1 for DELTA lights


class Light(Value):
    """Interface of the lights. ``len(light)`` is L, the number of sources it stands for."""

    kind: ClassVar[LightKind]

    def __len__(self) -> int:
        return 1

    @property
    def channels(self) -> int:
        """C, the number of colour channels."""
        return self.own_channels

    @abstractmethod
    def sample(self, points: Tensor, u: Tensor | None = None) -> LightSample:
        """Light that arrives at ``points [..., 3]``, from uniform numbers ``u [..., 2]`` in [0, 1) where the light is no delta."""

    @abstractmethod
    def pdf(self, wi: Tensor, points: Tensor | None = None) -> Tensor:
        """Density ``[L, ..., 1]`` per steradian with which :meth:`sample` gives ``wi [..., 3]``; 0 for DELTA lights."""

    @abstractmethod
    def radiance(self, wi: Tensor, points: Tensor | None = None) -> Tensor:
        """Radiance ``[..., C]`` arriving from ``wi [..., 3]`` at ``points [..., 3]``; 0 for DELTA lights, which no ray meets."""


class Arrival(NamedTuple):
    """Light of a :class:`DeltaLight` in components; each with a leading axis of L where there is more than one source."""

    wi: Vec  # unit, to the light; without the axes of the points where it is the same at all of them
    falloff: Tensor | None  # factor of the colour; None where it is 1
    colour: Channels


class DeltaLight(Light):
    """Interface of lights that reach each point from one direction: each answers with irradiance on a plane facing it.

    Parameters are ``[L, k]``; ``[k]`` stands for one light, and ``[B, L, k]`` for L lights in each of B views: leading axes go with the
    leading axes of the points, ``[B, ..., 3]``, and never widen them.
    """

    kind = LightKind.DELTA

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, t, _ in list(self.own_tensors()):
            object.__setattr__(self, name, t.unsqueeze(0) if t.dim() == 1 else t)

    def check_shapes(self) -> None:
        """As every value, of one light at least."""
        for name, t, _ in self.own_tensors():
            if not t.numel():
                where = f"{type(self).__name__}.{name}: expected shape [L, {t.shape[-1]}]"
                raise ValueError(f"{where}, found {list(t.shape)}; leave out lights that there are none of")
        super().check_shapes()

    def __len__(self) -> int:
        batch = self.batch_shape  # empty for what indexing and vmap make: one light
        return int(batch[-1]) if batch else 1

    @property
    def views(self) -> torch.Size:
        """The leading axes ``B`` of lights that differ from view to view; none where all points share them."""
        return self.batch_shape[:-1]

    @abstractmethod
    def arrive(self, points: Vec, layout: Layout) -> Arrival:
        """The light at ``points`` (components ``[...]``), all L sources at once."""

    @abstractmethod
    def distance(self, points: Vec, wi: Vec, layout: Layout) -> Tensor:
        """How far the sources are from ``points`` along ``wi``, as :meth:`arrive` gave it."""

    def groups(self, size: int) -> Iterator[tuple[slice, "DeltaLight"]]:
        """The rows and the lights of groups of ``size`` sources at most."""
        count = len(self)
        for first in range(0, count, size):
            rows = slice(first, min(first + size, count))
            yield rows, self if rows == slice(0, count) else self[..., rows]

    def sample(self, points: Tensor, u: Tensor | None = None) -> LightSample:
        """``radiance`` is the irradiance on a plane facing the light; ``u`` is not needed."""
        layout = Layout.beside(arguments.floats(points, "points", 3))
        parameters.check(self, points, "points", batched=False)
        self.check_views(points.shape[:-1], "points")
        at = layout.vector(numerics.widen(points))
        found = self.arrive(at, layout)
        shape = (len(self), *points.shape[:-1])
        # A direction of length 0 is none: nothing comes from there.
        strength = numerics.step(vector.dot(found.wi, found.wi)) * (1.0 if found.falloff is None else found.falloff)
        parts = (found.wi, (self.distance(at, found.wi, layout),), [c * strength for c in found.colour], (torch.ones_like(at.x),))
        return LightSample(*(vector.stack([c.expand(shape) for c in part]).to(points.dtype) for part in parts))

    def pdf(self, wi: Tensor, points: Tensor | None = None) -> Tensor:
        """0: no sampled direction meets a delta light."""
        return wi.new_zeros(len(self), *wi.shape[:-1], 1)

    def radiance(self, wi: Tensor, points: Tensor | None = None) -> Tensor:
        """0: no ray meets a delta light."""
        return wi.new_zeros(*wi.shape[:-1], self.channels)

    def check_views(self, batch: Sequence[int], name: str) -> None:
        """Raise ``ValueError`` where the views of the lights are not those of points of shape ``batch``, called ``name``."""
        if not arguments.leads(self.views, batch):
            raise ValueError(
                f"{type(self).__name__}: batch shape {list(self.batch_shape)}, read as {list(self.views)} views with {len(self)} lights "
                f"each, does not fit {name} of {list(batch)}, whose leading axes are the views; give [L, 3] for all or [B, L, 3] by view"
            )

    def axis(self, parameter: Tensor, points: Vec, layout: Layout) -> tuple[Tensor, ...]:
        """The columns of a parameter ``[L, k]`` beside points ``[...]``: ``[L, 1, ...]``, or ``[]`` of a single light.

        Those of ``[B, L, k]`` are ``[L, B, 1, ...]``, or ``[B, 1, ...]`` of a single light in each view.
        """
        count, views = len(self), self.views
        rows = layout.follow(parameter, axes=parameter.dim())
        if count == 1 and not views:
            return rows.reshape(-1).unbind(0)
        columns = rows.expand(*views, count, rows.shape[-1]).unbind(-1)
        behind = (1,) * (points.x.dim() - len(views))
        if count > 1:
            return tuple(c.movedim(-1, 0).reshape(count, *views, *behind) for c in columns)
        return tuple(c.reshape(*views, *behind) for c in columns)

    def colour_axis(self, colour: Tensor, points: Vec, layout: Layout) -> Channels:
        """A colour ``[L, C]`` as channels beside points."""
        if layout.rank is not None:
            return (self._first(colour, points.x.dim(), layout.rank, layout),)
        columns = self.axis(colour, points, layout)
        if not layout.wide:
            return columns
        return (torch.cat([c if c.dim() else c.reshape(1) for c in columns], -1),)

    def _first(self, colour: Tensor, points: int, rank: int, layout: Layout) -> Tensor:
        """A colour ``[L, C]`` as ``[C, ...]``, with an axis of L where numbers may have more axes than ``points`` have."""
        rows, views = layout.follow(colour, axes=colour.dim()), self.views
        if len(self) == 1 and not views:
            return rows.reshape(-1, *(1,) * rank)
        if not views:
            each = (rows.shape[0] if rows.dim() > 1 else 1,) * (rank - points)
            return rows.movedim(-1, 0).reshape(-1, *each, *(1,) * points)
        whole = rows.expand(*views, len(self), rows.shape[-1]).movedim((-1, -2), (0, 1))
        return whole.reshape(-1, *(len(self),) * (rank - points), *views, *(1,) * (points - len(views)))
