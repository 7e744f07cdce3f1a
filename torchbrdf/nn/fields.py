"""Fields: modules that answer with a parameter ``[..., C]`` at every pixel of a G-buffer.

A learned field stores *unconstrained* numbers and maps them through the constraint of the parameter it serves (see
:meth:`~torchbrdf.interval.Interval.from_unconstrained`), so that no optimiser step leaves the legal range. The constraint arrives
when a :class:`~torchbrdf.nn.Material` binds the field; a field on its own is unconstrained.
"""

from abc import abstractmethod
from typing import Any

import torch
from torch import Tensor, nn

from .. import arguments, vector
from ..constraint import Constraint
from ..geometry import Layout
from ..interval import REAL
from ..scene.gbuffer import GBuffer


class Field(nn.Module):
    """Interface: ``field(g) -> [..., C]``."""

    @abstractmethod
    def forward(self, g: GBuffer) -> Tensor:
        """The parameter at every pixel of ``g``."""

    @abstractmethod
    def bind(self, constraint: Constraint, where: str) -> None:
        """Take over the constraint of the parameter ``where`` that this field serves."""


class Stored(Field):
    """Base of fields that hold numbers: ``raw`` is a parameter where learned, a buffer where not."""

    raw: Tensor

    def __init__(self, init: Any, learned: bool) -> None:
        super().__init__()
        try:
            start = torch.as_tensor(init).detach()
        except (TypeError, ValueError, RuntimeError) as error:
            kind, found = type(self).__name__, type(init).__name__
            raise TypeError(f"{kind}: expected a number, list, array or tensor, found {found} ({error})") from None
        if isinstance(init, Tensor) and init.requires_grad:
            kind = type(self).__name__
            raise TypeError(
                f"{kind}: expected a start, found a tensor that requires a gradient, which a copy of it could not give; "
                "pass x.detach(), or give x itself to tb.nn.Material (a texture by tb.bilinear)"
            )
        if start.dtype == torch.uint8:
            raise TypeError(f"{type(self).__name__}: found torch.uint8; {arguments.as_floats(start.dtype)}")
        if not start.numel() or start.is_complex():
            raise ValueError(f"{type(self).__name__}: expected real numbers, one at least, found {start.dtype} {list(start.shape)}")
        keeps = isinstance(init, Tensor) and init.is_floating_point()  # numbers, lists and arrays take torch's default dtype
        start = start.to(start.dtype if keeps else torch.get_default_dtype(), copy=True)
        start = start.reshape(1) if start.dim() == 0 else start
        self.constraint: Constraint = REAL
        self.learned, self._serves = learned, ""
        if learned:
            self.raw = nn.Parameter(start)
        else:
            self.register_buffer("raw", start)

    def bind(self, constraint: Constraint, where: str) -> None:
        """Check the start against the range and, where learned, store it unconstrained. May be shared by parameters of one range."""
        if self._serves:
            if str(constraint) != str(self.constraint):
                served = f"{self._serves}, whose range is {self.constraint}"
                raise ValueError(f"{where}: its range is {constraint}, but this field already serves {served}; give each its own field")
            return
        wrong = "" if self.raw.is_meta else constraint.complaint(self.raw.detach())
        if wrong:
            raise ValueError(f"{where}: the field starts outside: {wrong}; start it inside")
        if self.learned:
            with torch.no_grad():
                self.raw.copy_(constraint.to_unconstrained(self.raw))
        self.constraint, self._serves = constraint, where

    @property
    def value(self) -> Tensor:
        """The stored numbers as the parameter sees them, inside its range."""
        return self.constraint.from_unconstrained(self.raw) if self.learned else self.raw

    def extra_repr(self) -> str:
        return f"{list(self.raw.shape)}, range {self.constraint}" + ("" if self.learned else ", fixed")


class Constant(Stored):
    """The same fixed value ``[C]`` (or one per pixel, ``[H, W, C]``) at every pixel."""

    def __init__(self, init: Any) -> None:
        super().__init__(init, learned=False)

    def forward(self, g: GBuffer) -> Tensor:
        return self.value


class Given(Field):
    """A tensor that somebody else differentiates by, used as it is; an ``nn.Parameter`` is registered. Its owner keeps it legal."""

    def __init__(self, tensor: Tensor) -> None:
        super().__init__()
        self.tensor = tensor

    def bind(self, constraint: Constraint, where: str) -> None:
        """Check the start against the range."""
        wrong = "" if self.tensor.is_meta else constraint.complaint(self.tensor.detach())
        if wrong:
            raise ValueError(f"{where}: {wrong}; {constraint.remedy}")

    def forward(self, g: GBuffer) -> Tensor:
        return self.tensor


class Learned(Stored):
    """A learned value ``[C]`` (or one per pixel, ``[H, W, C]``), started at ``init`` (to rounding; beside it, where it has no slope)."""

    def __init__(self, init: Any) -> None:
        super().__init__(init, learned=True)

    def forward(self, g: GBuffer) -> Tensor:
        return self.value


class PerMaterial(Stored):
    """One value per material id: ``table [M, C]``, looked up by ``g.material`` (0 to M - 1); background reads row 0."""

    def __init__(self, table: Any, learned: bool = True) -> None:
        super().__init__(table, learned)
        if self.raw.dim() != 2:
            raise ValueError(f"PerMaterial.table: expected shape [M, C], a row for each material id, found {list(self.raw.shape)}")

    def forward(self, g: GBuffer) -> Tensor:
        arguments.of_kind(g, "g", GBuffer, "tb.GBuffer.from_mesh(mesh, camera)")
        if g.material is None:
            raise ValueError("PerMaterial: this G-buffer has no material ids; load a mesh with material= per face, or use tb.nn.Learned")
        ids = g.material.squeeze(-1).clamp_min(0)
        self._check_ids(ids)
        table = Layout.beside(g.position).follow(self.value, axes=2)
        found = [column.index_select(0, ids.reshape(-1)).reshape(ids.shape) for column in table.unbind(-1)]
        return vector.stack(found).to(g.position.dtype)

    def _check_ids(self, ids: Tensor) -> None:
        """Where values can be looked at; elsewhere an id beyond the table ends in an index error of torch."""
        if not arguments.values_hidden(ids) and ids.numel() and int(ids.amax()) >= self.raw.shape[0]:
            rows = self.raw.shape[0]
            raise ValueError(f"PerMaterial.table: {rows} rows serve the ids 0 to {rows - 1}, found id {int(ids.amax())}; give it more rows")


class Channel(Field):
    """Channel ``i`` of another field, ``[..., 1]``: one texture may hold roughness, metalness and more."""

    def __init__(self, field: Field, i: int) -> None:
        super().__init__()
        if not isinstance(field, nn.Module) or not isinstance(i, int):
            raise TypeError(f"Channel: expected a field and the number of a channel, found {type(field).__name__} and {i!r}")
        self.field, self.i = field, i

    def bind(self, constraint: Constraint, where: str) -> None:
        """Binds the whole field: all channels in use must share one range."""
        self.field.bind(constraint, where)

    def forward(self, g: GBuffer) -> Tensor:
        whole = self.field(g)
        if not 0 <= self.i < whole.shape[-1]:
            raise IndexError(f"Channel.i: found {self.i}, legal are 0 to {whole.shape[-1] - 1}, the channels of its field")
        return whole.narrow(-1, self.i, 1)

    def extra_repr(self) -> str:
        return f"i={self.i}"
