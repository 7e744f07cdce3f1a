"""The one rule for parameters beside points: without batch axes they follow dtype and device; with batch axes they must match.

What belongs to no point has no batch axes: a number or a colour, lights, the texels of a map, a table. It follows from every device
that holds numbers (the meta device does not). A parameter at each point is looked at once, where the points come in (:func:`check`),
and an error names it; formulas then read every parameter through :func:`follow`. Under ``torch.autocast``, where networks answer in a
half type, such an answer at each point is taken to the dtype of the points.
"""

from typing import Any, Protocol

import torch
from torch import Tensor

from . import arguments, numerics


class Declared(Protocol):
    """What holds parameters: a :class:`~torchbrdf.value.Value`."""

    def own_tensors(self) -> Any:
        """(name, tensor, declaration) of each."""

    def nested(self) -> Any:
        """Those inside."""


def follow(parameter: Tensor, dtype: torch.dtype, device: torch.device, axes: int = 1, apart: bool = False) -> Tensor:
    """``parameter`` in the working dtype of the points and on their device; ``axes`` is the number of axes of one parameter.

    One with batch axes was checked, and is only widened if of a half type. One that will be taken ``apart`` into 0-dimensional tensors
    stays on the CPU: kernels on other devices take such numbers from there, which saves a copy.
    """
    if parameter.dtype == dtype and parameter.device == device:
        return parameter
    if parameter.dim() > axes:
        return parameter.to(dtype) if parameter.dtype in numerics.HALF_TYPES else parameter
    stays = apart and parameter.device.type == "cpu"
    return parameter.to(dtype) if stays else parameter.to(device, dtype)


def alike(*parameters: Tensor) -> list[Tensor]:
    """Parameters among themselves, without points: those without batch axes follow the first that has some, if any has."""
    batched = [p for p in parameters if p.dim() > 1]
    return [p if p.dim() > 1 else p.to(batched[0]) for p in parameters] if batched else list(parameters)


def check(held: Declared, points: Tensor, name: str, batched: bool = True) -> None:
    """Raise ``TypeError`` if a parameter of ``held``, or of what is inside it, neither follows nor matches ``points``, called ``name``.

    ``batched=False``: none has batch axes, as of lights.
    """
    for field, t, spec in held.own_tensors():
        has_batch = batched and len(spec.batch(t)) > 0
        fits = _matches(t, points) if has_batch else points.is_meta or not t.is_meta
        if not fits:
            raise TypeError(f"{type(held).__name__}.{field}: {kind(t)} beside {name}: {kind(points)}; {_remedy(t, points)}")
        meant = _picture(t.shape, points.shape[:-1]) if has_batch and spec.event == ("C",) else ""
        if meant:
            raise ValueError(f"{type(held).__name__}.{field}: expected shape [..., C], found {list(t.shape)} beside {name}; {meant}")
    for inner in held.nested():
        check(inner, points, name, batched)


def _picture(shape: torch.Size, points: torch.Size) -> str:
    """What a colour most likely is whose last axis is not that of its channels: one the size of the points' own ``[..., H, W]``.

    Pictures are square often enough for such colours to broadcast, and then they would be as many channels as the picture is wide.
    """
    if shape[-1] <= arguments.MOST_OF_A_PICTURE:
        return ""
    if shape == points[-len(shape) :]:
        return f"a map without channels is x[..., None] -> {[*shape, 1]}"
    if len(shape) > 2 and shape[-3] in (1, 3, 4) and shape[-2:] == points[-2:]:
        return f"channels come last: x.movedim(-3, -1) -> {[*shape[:-3], *shape[-2:], shape[-3]]}"
    return ""


def _matches(t: Tensor, points: Tensor) -> bool:
    return t.device == points.device and (t.dtype == points.dtype or (_is_narrower(t, points) and autocast(points.device.type)))


def _is_narrower(t: Tensor, points: Tensor) -> bool:
    return t.dtype in numerics.HALF_TYPES and points.dtype not in numerics.HALF_TYPES


def autocast(device: str) -> bool:
    """Whether ``torch.autocast`` is on for a type of device."""
    return device != "meta" and torch.is_autocast_enabled(device)


def _remedy(t: Tensor, points: Tensor) -> str:
    if t.device == points.device and _is_narrower(t, points):
        return f"convert it with .{'float' if points.dtype == torch.float32 else 'double'}()"
    return "convert one with .to(...)"


def kind(t: Tensor) -> str:
    """Dtype and device in words."""
    return f"{str(t.dtype).removeprefix('torch.')} on {t.device}"
