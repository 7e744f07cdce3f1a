"""What a function asks of its arguments: one clear error that names the argument, what was found, and what to do.

Only kinds, dtypes and shapes are looked at, never values: these checks run inside graphs and transforms.
"""

import sys
import warnings
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

MOST_OF_A_PICTURE = 4  # channels: red, green, blue and alpha
LEAST_PICTURE = 16  # pixels along a side; what is smaller may as well be a table of as many channels
FLOATS = (torch.float64, torch.float32, torch.bfloat16, torch.float16)


def floats(x: Any, name: str, size: int | None = None) -> Tensor:
    """``x`` if it is a dense tensor of floats, of shape ``[..., size]`` where a size is asked for."""
    if not isinstance(x, Tensor):
        raise TypeError(f"{name}: expected a tensor of floats, found {type(x).__name__}; make it one with torch.as_tensor(..., dtype=...)")
    if x.dtype not in FLOATS:
        raise TypeError(f"{name}: expected a tensor of floats, found {x.dtype}; {as_floats(x.dtype)}")
    if x.layout != torch.strided:
        raise TypeError(f"{name}: expected a dense tensor, found one of layout {x.layout}; convert it with .to_dense()")
    if size is not None and x.shape[-1:] != (size,):
        raise ValueError(f"{name}: expected shape [..., {size}], found {list(x.shape)}{moved(x.shape, (size,))}")
    return x


def as_floats(found: torch.dtype) -> str:
    """How to make floats of a tensor of another kind; bytes are nearly always those of a picture."""
    if found == torch.uint8:
        return "bytes of a picture become x / 255 (colours are sRGB-encoded then: tb.read_image(path) decodes them)"
    return "convert it, for example with .to(torch.float32)"


def moved(shape: Sequence[int], event: Sequence[int | str]) -> str:
    """How a tensor gets the last axes ``event`` that it lacks, where that can be guessed."""
    if event[-1] == 1 or (event[-1] == "C" and len(shape) == len(event) - 1):
        return f"; did you mean x.unsqueeze(-1) -> {[*shape, 1]}?"
    if len(event) == 1 and len(shape) > 2 and shape[-3] == event[0]:
        return f"; did you mean x.movedim(-3, -1) -> {[*shape[:-3], *shape[-2:], shape[-3]]}?"
    return ""


def channels_first(shape: Sequence[int]) -> bool:
    """Whether a picture, or each of a batch, has its channels before height and width rather than behind them, by sizes alone."""
    return len(shape) > 2 and shape[-3] in (3, MOST_OF_A_PICTURE) and min(shape[-2:]) >= LEAST_PICTURE


def picture(x: Tensor, name: str, what: str) -> None:
    """Raise ``ValueError`` if ``x`` is no picture ``[H, W, C]`` with pixels in it; ``what`` names its axes."""
    shape = list(x.shape)
    if len(shape) == 2:
        remedy = f"; a map without channels is x[..., None] -> {[*shape, 1]}"
    elif len(shape) > 3:
        remedy = "; take one picture of the batch, such as x[0]"
    elif channels_first(shape):
        remedy = f"; channels first? x.permute(1, 2, 0) -> {[*shape[1:], shape[0]]}"
    elif len(shape) == 3 and x.numel():
        return
    else:
        remedy = ""
    raise ValueError(f"{name}: expected shape {what} with pixels in it, found {shape}{remedy}")


def one_count(counts: Mapping[str, int], what: str) -> None:
    """Raise ``ValueError`` if numbers of channels disagree; 1 serves all."""
    several = set(counts.values()) - {1}
    if len(several) > 1:
        alpha = " (alpha is no colour: x[..., :3])" if several == {3, 4} else ""
        first = " (channels come last: x.permute(1, 2, 0))" if min(several) <= MOST_OF_A_PICTURE < max(several) else ""
        raise ValueError(f"{what}: {dict(counts)}; use one C, or 1{alpha}{first}")


def values_hidden(*tensors: Tensor) -> bool:
    """Whether values cannot be looked at: in graphs, in transforms that have wrapped them, on the meta device."""
    return torch.compiler.is_compiling() or any(t.is_meta or _is_wrapped(t) for t in tensors)


def _is_wrapped(t: Tensor) -> bool:
    """Whether a transform (vmap, grad, jvp) stands between ``t`` and its memory."""
    try:
        t.untyped_storage()
    except (NotImplementedError, RuntimeError):
        return True
    return False


def warn(message: str) -> None:
    """A warning that points to the first line outside of this package (and of torch's decorators)."""
    level, frame = 1, sys._getframe()
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] in (__package__, "torch"):
        level, frame = level + 1, frame.f_back
    warnings.warn(message, stacklevel=level)


def placement(
    *args: Any, device: Any = None, dtype: Any = None, non_blocking: bool = False, copy: bool = False, memory_format: Any = None
) -> tuple[torch.device | None, torch.dtype | None, bool, bool]:
    """Device, dtype (None: as it is), ``non_blocking`` and ``copy`` of the arguments of ``Tensor.to``, in whatever form it takes them."""
    flags = [arg for arg in args if isinstance(arg, bool)]
    for arg in args[: len(args) - len(flags)]:
        if isinstance(arg, Tensor):
            device, dtype = arg.device, arg.dtype
        elif isinstance(arg, torch.dtype):
            dtype = arg
        elif arg is not None:
            device = arg
    non_blocking, copy = (*flags, *(non_blocking, copy)[len(flags) :])
    return None if device is None else torch.device(device), dtype, non_blocking, copy


def of_kind(x: Any, name: str, kind: type[Any], example: str) -> Any:
    """``x`` if it is an instance of ``kind``; ``example`` says how to make one."""
    if not isinstance(x, kind):
        hint = "; call the module to get what it stands for: module(g)" if isinstance(x, torch.nn.Module) else ""
        raise TypeError(f"{name}: expected {_article(kind.__name__)} such as {example}, found {type(x).__name__}{hint}")
    return x


def _article(name: str) -> str:
    return f"{'an' if name[0] in 'AEIOU' else 'a'} {name}"


def broadcast(shapes: Mapping[str, Sequence[int]], what: str) -> Any:
    """The shape that all of ``shapes`` broadcast to, a ``torch.Size`` if they are. (``torch.broadcast_shapes`` imports sympy.)"""
    batched = [s for s in shapes.values() if len(s)]
    if all(s == batched[0] for s in batched):
        return batched[0] if batched else torch.Size()
    try:
        return torch.broadcast_shapes(*batched)
    except RuntimeError:
        raise ValueError(f"{what} do not broadcast: {shapes}; make them equal, or 1") from None


def one_of(x: Any, name: str, legal: Iterable[str]) -> Any:
    """``x`` if it is one of the legal names."""
    names = list(legal)
    if not isinstance(x, str) or x not in names:
        raise ValueError(f"{name}: found {x!r}, legal are {names}")
    return x


def leads(first: Sequence[int], shape: Sequence[int]) -> bool:
    """Whether axes broadcast to the first axes of ``shape`` without changing them."""
    return len(first) <= len(shape) and not [a for a, b in zip(first, shape, strict=False) if a not in (1, b)]
