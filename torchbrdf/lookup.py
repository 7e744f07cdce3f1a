"""n-linear look-up in a table: one for textures, environment maps and measured tables.

Entries lie at whole numbers of a coordinate. Between them the result is linear along each axis (by ``lerp``, which never leaves the
range of the entries, not even by a rounding), and not smooth at the entries. Beyond the ends an axis is held (``"clamp"``) or begins
again (``"repeat"``). Gradients reach the entries and the coordinates. A coordinate that is not finite counts as 0, with gradient 0.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from . import arguments, numerics, parameters, vector

WRAPS = ("repeat", "clamp")


def lookup(table: Tensor, coordinates: Sequence[Tensor], wraps: Sequence[str]) -> tuple[Tensor, ...]:
    """Channels ``[...]`` of ``table [N1, ..., Nn, C]`` at n coordinates ``[...]``, in entries.

    Channel by channel: gathers from planes are 1.5 to 3 times faster than gathers of whole entries, gradient included.
    """
    coordinates = torch.broadcast_tensors(*coordinates)
    sizes = table.shape[:-1]
    axes = [neighbours(x.reshape(-1), n, wrap) for x, n, wrap in zip(coordinates, sizes, wraps, strict=True)]
    corners = [torch.zeros_like(axes[0][0])]
    for (low, high, _), n in zip(axes, sizes, strict=True):
        corners = [corner * n + index for corner in corners for index in (low, high)]
    fractions = [fraction for _, _, fraction in axes]
    planes = table.reshape(-1, table.shape[-1]).unbind(-1)
    return tuple(_blend([p.index_select(0, i) for i in corners], fractions).reshape(coordinates[0].shape) for p in planes)


def neighbours(x: Tensor, n: int, wrap: str) -> tuple[Tensor, Tensor, Tensor]:
    """The entries on either side of coordinate ``x`` on an axis of ``n``, and how far x is on the way, in [0, 1)."""
    x = torch.nan_to_num(x, 0.0, 0.0, 0.0)
    below = torch.floor(x.detach())
    first = below.long()
    if wrap == "repeat":
        return first % n, (first + 1) % n, x - below
    return first.clamp(0, n - 1), (first + 1).clamp(0, n - 1), x - below


def _blend(corners: list[Tensor], fractions: list[Tensor]) -> Tensor:
    """Linear along the last axis first, whose neighbours stand side by side."""
    for fraction in reversed(fractions):
        corners = [torch.lerp(a, b, fraction) for a, b in zip(corners[::2], corners[1::2], strict=True)]
    return corners[0]


def bilinear(texels: Tensor, uv: Tensor, wrap: str = "repeat") -> Tensor:
    """A picture ``texels [Ht, Wt, C]`` at texture coordinates ``uv [..., 2]``, as ``[..., C]`` in their dtype (float32 for half types).

    Row 0 is the top of the picture and v = 0 its bottom edge; u runs to the right; texel centres lie at (i + 1/2)/n.
    """
    arguments.floats(texels, "texels")
    arguments.floats(uv, "uv", 2)
    arguments.picture(texels, "texels", "[Ht, Wt, C]")
    if wrap not in WRAPS:
        raise ValueError(f"wrap: found {wrap!r}, legal are {WRAPS}")
    height, width, _ = texels.shape
    u, v = (numerics.widen(c) for c in uv.unbind(-1))
    beside = parameters.follow(texels, u.dtype, uv.device, axes=3)
    return vector.stack(lookup(beside, ((1.0 - v) * height - 0.5, u * width - 0.5), (wrap, wrap)))
