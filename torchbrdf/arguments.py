"""What a function asks of its arguments: one clear error that names the argument, what was found, and what to do.

Only kinds, dtypes and shapes are looked at, never values: these checks run inside graphs and transforms.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

FLOATS = (torch.float64, torch.float32, torch.bfloat16, torch.float16)


def floats(x: Any, name: str, size: int | None = None) -> Tensor:
    """``x`` if it is a dense tensor of floats, of shape ``[..., size]`` where a size is asked for."""
    if not isinstance(x, Tensor):
        raise TypeError(f"{name}: expected a tensor of floats, found {type(x).__name__}; make it one with torch.as_tensor(..., dtype=...)")
    if x.dtype not in FLOATS:
        raise TypeError(f"{name}: expected a tensor of floats, found {x.dtype}; convert it, for example with .to(torch.float32)")
    if x.layout != torch.strided:
        raise TypeError(f"{name}: expected a dense tensor, found one of layout {x.layout}; convert it with .to_dense()")
    if size is not None and x.shape[-1:] != (size,):
        raise ValueError(f"{name}: expected shape [..., {size}], found {list(x.shape)}")
    return x


def hidden(*tensors: Tensor) -> bool:
    """Whether values cannot be looked at: in graphs, in transforms that have wrapped them, on the meta device."""
    return torch.compiler.is_compiling() or any(t.is_meta or _is_wrapped(t) for t in tensors)


def _is_wrapped(t: Tensor) -> bool:
    """Whether a transform (vmap, grad, jvp) stands between ``t`` and its memory."""
    try:
        t.untyped_storage()
    except (NotImplementedError, RuntimeError):
        return True
    return False


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
