"""What views and normals of a G-buffer are not: a camera's position, and a normal map's numbers in [0, 1].

Both are finite vectors of a legal shape, and both give an image, a wrong one. They are looked for where values can be seen, on a thin
grid of pixels first; only what looks wrong there is looked at in full.
"""

import math

import torch
from torch import Tensor

from .. import arguments
from .gbuffer import GBuffer

FEW = 1024  # pixels of the thin grid, about
OFF_UNIT = 0.05  # lengths nearer to 1 than this are those of unit vectors, whatever rounded them
STEPS = 0.03  # how far 8 bits put the length of a decoded normal off 1 at most (three components, half a step of 2/255 each), doubled
MOST = 0.9  # of the pixels: the rest may be background, or the border of another view


@torch.no_grad()
def check(g: GBuffer) -> None:
    """Raise ``ValueError`` if ``view`` is a camera's position, or ``normal`` a normal map that was not decoded."""
    if not has_values(g):
        return
    for looked_at in (few(g), g):  # what the thin grid shows must hold on all pixels
        valid = looked_at.valid.expand(*looked_at.batch_shape, 1).squeeze(-1)
        error = _one_place(looked_at, valid)
        doubt, flat = _map_of_normals(looked_at.normal.detach().expand(*looked_at.batch_shape, 3)[valid])
        if not (error or doubt):
            return
    if error or not flat:
        raise ValueError(error or doubt)
    arguments.warn(doubt)  # one normal for all may have been meant as it is


def has_values(g: GBuffer) -> bool:
    """Whether there are pixels, with values that can be looked at."""
    return bool(g.batch_shape.numel()) and not arguments.values_hidden(*(t for _, t, _ in g.own_tensors()))


def few(g: GBuffer) -> GBuffer:
    """Every so-manieth pixel along each batch axis, :data:`FEW` in all or a few more."""
    batch = g.batch_shape
    step = math.ceil((batch.numel() / FEW) ** (1.0 / max(1, len(batch))))
    return g[(slice(None, None, step),) * len(batch)] if step > 1 else g


def _one_place(g: GBuffer, valid: Tensor) -> str:
    """Whether the views of neighbours at different positions are one vector that is no unit vector; in words."""
    if g.view is None or not valid.dim():
        return ""
    position, view = (t.detach().expand(*valid.shape, 3) for t in (g.position, g.view))
    length = _lengths(view.float())
    off = valid & ((length - 1.0).abs() > OFF_UNIT)
    if not bool(off.any()):
        return ""
    both = valid[..., 1:] & valid[..., :-1] & (position.diff(dim=-2) != 0).any(-1)
    same = off[..., 1:] & (view.diff(dim=-2) == 0).all(-1)
    if not bool(both.any()) or float(same[both].float().mean()) < MOST:
        return ""
    return (
        f"GBuffer.view: points at different positions have one view, of length {float(length[off][0]):.4g}; view is the unit direction "
        "from each point to the viewer: of a camera's position, tb.normalize(camera.origin - g.position); of parallel rays, "
        "tb.normalize(view)"
    )


def _map_of_normals(normal: Tensor) -> tuple[str, bool]:
    """Whether normals ``[N, 3]`` are (n + 1) / 2, or that times 255: none negative, and unit once decoded. In words, and if all are one."""
    if not len(normal):
        return "", True
    n = normal.float()
    low, high = (float(x) for x in torch.aminmax(n))
    most = 255.0 if high > 2.0 else 1.0
    if not (low >= 0.0 and high <= most * (1.0 + STEPS)):
        return "", True
    decoded = _lengths(2.0 / most * n - 1.0)
    there = decoded > STEPS  # a background of (1/2, 1/2, 1/2) is none
    if _share_of_units(decoded[there]) < MOST or _share_of_units(_lengths(n)) > 1.0 - MOST:
        return "", True
    stored, remedy = ("[0, 1]", "2 * normal - 1") if most == 1.0 else ("[0, 255]", "normal / 127.5 - 1")
    found = f"GBuffer.normal: no component is negative, and {remedy} has unit length: a normal map stored in {stored}"
    return f"{found}; decode it: tb.normalize({remedy})", bool((n == n[0]).all())


def _share_of_units(lengths: Tensor) -> float:
    return float(((lengths - 1.0).abs() < STEPS).float().mean()) if len(lengths) else 0.0


def _lengths(v: Tensor) -> Tensor:
    return torch.linalg.vector_norm(v, dim=-1)
