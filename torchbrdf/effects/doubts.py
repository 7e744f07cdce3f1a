"""What is legal in a scene and nearly always meant otherwise: warned of where a plan is made and values can be seen."""

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from .. import arguments, vector
from ..bsdf.base import Bsdf
from ..declaration import Param
from ..geometry import Geometry
from ..light.base import Light
from ..optics.distribution import AXES
from ..scene import orientation
from ..scene.gbuffer import GBuffer
from ..value import Value
from .base import Surface

BYTE = 1.0 / 512.0  # half a step of 8 bits


@torch.no_grad()
def warn(g: GBuffer, bsdf: Bsdf, lights: Sequence[Light]) -> None:
    """Look for colours with an alpha channel, one number a point read as channels, surfaces that all face away, and missing tangents."""
    for held in (bsdf, *lights):
        for name, t, spec in _colours(held):
            wrong = "" if arguments.values_hidden(t) else _of_colour(t, spec, g.batch_shape)
            if wrong:
                arguments.warn(f"{name}: {wrong}")
    for name in _along_tangents(bsdf):
        if _no_tangent(g):
            arguments.warn(
                f"{name}: alpha of two numbers needs tangents; this GBuffer has none, and a frame made from the normals alone jumps: give "
                "GBuffer(..., tangent=), or the mesh uv, along which they lie, or make alpha one number [..., 1]"
            )
    if _faces_away(g, bsdf):
        arguments.warn(
            f"GBuffer: none of its {int(g.valid.sum())} valid pixels faces the viewer (n . view <= 0), and this material is black from "
            "behind; normals point outwards, view from the surface to the viewer: turn what is reversed, or take tb.TwoSided(bsdf)"
        )


def _colours(held: Value) -> Iterator[tuple[str, Tensor, Param]]:
    yield from ((f"{type(held).__name__}.{n}", t, spec) for n, t, spec in held.own_tensors() if spec.is_colour)
    for inner in held.nested():
        yield from _colours(inner)


def _along_tangents(held: Value) -> Iterator[str]:
    """The parameters of two numbers, along tangent and bitangent."""
    yield from (f"{type(held).__name__}.{n}" for n, t, spec in held.own_tensors() if spec.event == AXES and t.shape[-1] == 2)
    for inner in held.nested():
        yield from _along_tangents(inner)


def _no_tangent(g: GBuffer) -> bool:
    """Whether the points that are shaded have no tangents, as far as can be seen."""
    if g.tangent is None or arguments.values_hidden(g.tangent, g.valid):
        return g.tangent is None
    return bool(g.valid.any()) and not bool(((g.tangent != 0).any(-1, keepdim=True) & g.valid).any())


def _of_colour(t: Tensor, spec: Param, points: torch.Size) -> str:
    if t.dim() == 1 and t.shape == points and len(t) > arguments.MOST_OF_A_PICTURE:
        return f"{len(t)} channels beside a list of {len(t)} points; one number for each point is x[:, None]"
    if t.dim() > 2 and t.shape[-1] == arguments.MOST_OF_A_PICTURE:
        alpha = t.detach().select(-1, -1)
        if bool((alpha > 1.0 - BYTE).any()) and bool((((alpha - 1.0).abs() < BYTE) | (alpha.abs() < BYTE)).all()):
            return f"the last of {t.shape[-1]} channels is 0 or 1 everywhere; if it is alpha, take x[..., :3]"
    return ""


def _faces_away(g: GBuffer, bsdf: Bsdf) -> bool:
    """Whether there are valid pixels, and the model sends light of neither side of any of them to the viewer."""
    if not orientation.has_values(g) or _any_faces(orientation.few(g)):
        return False
    surface = Surface.of(g.detach(), bsdf.is_wide)
    n, lift = surface.viewer.n, surface.viewer.layout.lift
    sides = (Geometry(surface.viewer, wi) for wi in (n, vector.scale(n, -1.0)))
    valid = lift(g.valid.squeeze(-1))
    return bool(valid.any()) and not any(bool((bsdf.domain(side) & valid).any()) for side in sides)


def _any_faces(g: GBuffer) -> bool:
    cosine = vector.dot(vector.components(g.normal.detach()), vector.components(g.require_view().detach()))
    return bool((g.valid.squeeze(-1) & ~(cosine <= 0)).any())  # NaN is for others to judge
