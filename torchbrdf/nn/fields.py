"""Fields: modules that answer with a parameter ``[..., C]`` at every pixel of a G-buffer.

A learned field stores *unconstrained* numbers and maps them through the constraint of the parameter it serves (a sigmoid for
[0, 1], an exponential for [0, inf)), so that no optimiser step leaves the legal range. The constraint arrives when a
:class:`~torchbrdf.nn.Material` binds the field; a field on its own is unconstrained.
"""

from abc import abstractmethod
from typing import Any

import torch
from torch import Tensor, nn

from .. import vector
from ..scene.gbuffer import GBuffer
from ..value import REAL, Interval


class Field(nn.Module):
    """Interface: ``field(g) -> [..., C]``."""

    @abstractmethod
    def forward(self, g: GBuffer) -> Tensor:
        """The parameter at every pixel of ``g``."""

    @abstractmethod
    def bind(self, constraint: Interval, where: str) -> None:
        """Take over the constraint of the parameter ``where`` that this field serves."""


class Stored(Field):
    """Base of fields that hold numbers: ``raw`` is a parameter where learned, a buffer where not."""

    raw: Tensor

    def __init__(self, init: Any, learned: bool) -> None:
        super().__init__()
        start = torch.as_tensor(init, dtype=getattr(init, "dtype", torch.get_default_dtype())).detach().clone()
        start = start.reshape(1) if start.dim() == 0 else start
        self.constraint, self.learned, self._bound = REAL, learned, ""
        if learned:
            self.raw = nn.Parameter(start)
        else:
            self.register_buffer("raw", start)

    def bind(self, constraint: Interval, where: str) -> None:
        if self._bound and constraint != self.constraint:
            raise ValueError(f"{where}: this field already serves {self._bound} with another range {self.constraint}; give each its own field")
        if not bool(constraint.contains(self.raw.detach()).all()) and not self._bound:
            raise ValueError(f"{where}: the field starts outside the legal range {constraint} (min {self.raw.min():g}, max {self.raw.max():g})")
        if self.learned and not self._bound:
            with torch.no_grad():
                self.raw.copy_(constraint.to_unconstrained(self.raw))
        self.constraint, self._bound = constraint, where

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


class Learned(Stored):
    """A learned value ``[C]`` (or one per pixel, ``[H, W, C]``), started at ``init``."""

    def __init__(self, init: Any) -> None:
        super().__init__(init, learned=True)

    def forward(self, g: GBuffer) -> Tensor:
        return self.value


class PerMaterial(Stored):
    """One value per material id: ``table [M, C]``, looked up by ``g.material``; background reads row 0."""

    def __init__(self, table: Any, learned: bool = True) -> None:
        super().__init__(table, learned)
        if self.raw.dim() != 2:
            raise ValueError(f"table: expected shape [M, C], found {list(self.raw.shape)}")

    def forward(self, g: GBuffer) -> Tensor:
        if g.material is None:
            raise ValueError("PerMaterial: this G-buffer has no material ids; load a mesh with material= per face, or use tb.nn.Learned")
        return vector.stack([column[g.material.squeeze(-1).clamp_min(0)] for column in self.value.unbind(-1)])


class Texture(Stored):
    """Texels ``[Ht, Wt, C]`` looked up bilinearly at ``g.uv``.

    Texel centres at (i + 1/2)/n; row 0 is the top of the picture, v = 0 its bottom edge; ``wrap`` is "repeat" or "clamp";
    no mip levels. ``srgb=True`` decodes the texels, which are then sRGB-encoded values in [0, 1]. Gradients reach the
    texels and ``g.uv`` (not smooth where uv crosses a texel centre).
    """

    def __init__(self, texels: Any, learned: bool = True, srgb: bool = False, wrap: str = "repeat") -> None:
        super().__init__(texels, learned)
        if self.raw.dim() != 3:
            raise ValueError(f"texels: expected shape [Ht, Wt, C], found {list(self.raw.shape)}")
        if wrap not in ("repeat", "clamp"):
            raise ValueError(f"wrap: found {wrap!r}, legal are 'repeat' and 'clamp'")
        self.srgb, self.wrap = srgb, wrap

    def forward(self, g: GBuffer) -> Tensor:
        if g.uv is None:
            raise ValueError("Texture: this G-buffer has no uv; give the mesh texture coordinates, or use tb.nn.Learned")
        return self.at(g.uv)

    def at(self, uv: Tensor) -> Tensor:
        """Bilinear look-up ``[..., C]`` at ``uv [..., 2]``."""
        height, width, _ = self.raw.shape
        u, v = uv.unbind(-1)
        x0, x1, fx = self._neighbours(u * width - 0.5, width)
        y0, y1, fy = self._neighbours((1.0 - v) * height - 0.5, height)
        rows = [c.reshape(-1) for c in self.texels.unbind(-1)]

        def blend(c: Tensor) -> Tensor:
            top = torch.lerp(c[y0 * width + x0], c[y0 * width + x1], fx)
            bottom = torch.lerp(c[y1 * width + x0], c[y1 * width + x1], fx)
            return torch.lerp(top, bottom, fy)

        return vector.stack([blend(c) for c in rows])

    @property
    def texels(self) -> Tensor:
        """Linear texels ``[Ht, Wt, C]``."""
        if not self.srgb:
            return self.value
        from kornia.color import rgb_to_linear_rgb

        return rgb_to_linear_rgb(self.value.movedim(-1, 0)).movedim(0, -1)

    def _neighbours(self, x: Tensor, n: int) -> tuple[Tensor, Tensor, Tensor]:
        x = torch.where(torch.isfinite(x), x, 0.0)
        low = torch.floor(x).detach()
        first = low.long()
        if self.wrap == "repeat":
            return first % n, (first + 1) % n, x - low
        return first.clamp(0, n - 1), (first + 1).clamp(0, n - 1), x - low


class Channel(Field):
    """Channel ``i`` of another field: one texture may hold roughness, metalness and more."""

    def __init__(self, field: Field, i: int) -> None:
        super().__init__()
        self.field, self.i = field, i

    def bind(self, constraint: Interval, where: str) -> None:
        self.field.bind(constraint, where)

    def forward(self, g: GBuffer) -> Tensor:
        return self.field(g).narrow(-1, self.i, 1)
