"""What effects rely on, checked once and statically: kinds, shapes, dtypes and devices of the parts of a scene."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from .. import arguments, kinds, parameters
from ..bsdf.base import Bsdf
from ..light.base import DeltaLight, Light, LightKind
from ..scene.gbuffer import GBuffer
from ..scene.mesh import Mesh


def as_list(lights: Light | Sequence[Light]) -> list[Light]:
    """One light or a list of them, as a list."""
    try:
        found = [lights] if isinstance(lights, Light) else list(lights)
    except TypeError:
        raise TypeError(f"lights: {_expected(lights, 'a light or a list of lights', 'tb.PointLight(position, intensity)')}") from None
    for k, light in enumerate(found):
        if not isinstance(light, Light):
            raise TypeError(f"lights[{k}]: {_expected(light, 'a light', 'tb.PointLight(position, intensity)')}")
    if not found:
        raise ValueError("lights: found none; pass at least one, such as tb.DirectionalLight([0, 0, 1], 1.0)")
    return found


def check_scene(g: GBuffer, bsdf: Bsdf, lights: Sequence[Light]) -> int:
    """Check kinds, shapes, dtypes and devices against each other; returns C, the number of channels of the radiance.

    What was right once is looked up (:mod:`~torchbrdf.kinds`).
    """
    if torch.compiler.is_compiling() or not isinstance(g, GBuffer):
        return _check_scene(g, bsdf, lights)
    scene = kinds.of((g, bsdf, *lights), anew=True)
    return kinds.recall(("scene", parameters.autocast(g.position.device.type), scene), lambda: _check_scene(g, bsdf, lights))


def _check_scene(g: GBuffer, bsdf: Bsdf, lights: Sequence[Light]) -> int:
    if not isinstance(g, GBuffer):
        raise TypeError(f"g: {_expected(g, 'a G-buffer', 'tb.GBuffer.from_mesh(mesh, camera)')}")
    if not isinstance(bsdf, Bsdf):
        raise TypeError(f"bsdf: {_expected(bsdf, 'a BSDF', 'tb.Lambert(albedo)')}")
    _check_kinds(g, bsdf, lights)
    if not expands_to(bsdf.batch_shape, g.batch_shape):
        raise ValueError(
            f"bsdf: parameters of batch shape {list(bsdf.batch_shape)} do not fit a G-buffer of {list(g.batch_shape)}; give parameters [C] "
            "or [H, W, C], look textures up with tb.nn.Texture, or shade many materials: torch.vmap(lambda b: tb.shade(g, b, lights))(bsdf)"
        )
    counts = {"bsdf": bsdf.channels, **{f"lights[{k}]": light.channels for k, light in enumerate(lights)}}
    arguments.one_count(counts, "bsdf and lights have different numbers of colour channels")
    return max(list(counts.values()))


def check_mesh(mesh: Mesh | None) -> None:
    """What casts shadows must be a mesh (its values are looked at when the first ray is cast)."""
    if mesh is not None and not isinstance(mesh, Mesh):
        raise TypeError(f"mesh: {_expected(mesh, 'a mesh', 'tb.load_mesh(path)')}")


def _check_kinds(g: GBuffer, bsdf: Bsdf, lights: Sequence[Light]) -> None:
    """The rule for parameters; the G-buffer's own fields match its positions."""
    at = g.position
    g.require_view()
    for name, t, _ in g.own_tensors():
        if t.device != at.device or (name in ("normal", "view", "tangent") and t.dtype != at.dtype):
            raise TypeError(f"GBuffer.{name}: {parameters.kind(t)} beside position: {parameters.kind(at)}; convert one with .to(...)")
    parameters.check(bsdf, at, "the G-buffer's position")
    for k, light in enumerate(lights):
        _check_axes(light, k)
        parameters.check(light, at, "the G-buffer's position", batched=False)
        if isinstance(light, DeltaLight):
            light.check_views(g.batch_shape, "a G-buffer")


def _check_axes(light: Light, k: int) -> None:
    """Lights that are no points or directions are one each; stacked ones have an axis."""
    if light.batch_shape and light.kind is not LightKind.DELTA:
        found = f"{type(light).__name__} of batch shape {list(light.batch_shape)}"
        raise ValueError(
            f"lights[{k}]: {found} is several lights; take one, light[i], or shade each view under its own: "
            "torch.vmap(lambda g, light: tb.shade(g, bsdf, light))(g, light)"
        )


def _expected(found: Any, what: str, example: str) -> str:
    hint = "; call the module to get what it stands for: module(g)" if isinstance(found, torch.nn.Module) else ""
    return f"expected {what} such as {example}, found {type(found).__name__}{hint}"


def check_visibility(shadows: Tensor, lights: Sequence[Light], g: GBuffer) -> Tensor:
    """A visibility that was passed in must have one row per local light and broadcast over the pixels."""
    if not isinstance(shadows, Tensor):
        raise TypeError(f"visibility: {_expected(shadows, 'a tensor', 'tb.visibility(g, lights, mesh)')}")
    count = sum(len(light) for light in lights if light.kind is LightKind.DELTA)
    pixels = g.batch_shape
    if shadows.dim() < 2 or shadows.shape[0] != count or shadows.shape[-1] != 1 or not expands_to(shadows.shape[1:-1], pixels):
        raise ValueError(
            f"visibility: expected shape {[count, *pixels, 1]}, a row for each point and directional light, found {list(shadows.shape)}; "
            "compute it with tb.visibility(g, lights, mesh)"
        )
    if shadows.is_complex():
        raise TypeError(f"visibility: expected floats or bools, found {shadows.dtype}; convert it with .to(torch.float32)")
    if shadows.device != g.position.device:
        raise TypeError(f"visibility: on {shadows.device} beside a G-buffer on {g.position.device}; convert it with .to(...)")
    return shadows.to(g.position.dtype)


def check_visible_share(shadows: Tensor) -> None:
    """Visibility is the share of a light that arrives. Looks at values: not for graphs or transforms."""
    if arguments.values_hidden(shadows) or not shadows.numel() or shadows.dtype == torch.bool or shadows.is_complex():
        return
    low, high = (float(x) for x in torch.aminmax(shadows.detach()))
    if not (low >= 0 and high <= 1):
        raise ValueError(f"visibility: legal range [0, 1], found min {low:g}, max {high:g}; compute it with tb.visibility(g, lights, mesh)")


def expands_to(shape: torch.Size, full: torch.Size) -> bool:
    """Whether a shape broadcasts to ``full`` without changing it."""
    extra = len(full) - len(shape)
    return extra >= 0 and not [a for a, b in zip(shape, full[extra:], strict=True) if a not in (1, b)]
