"""Values put side by side along a new batch axis: :func:`stack`, which is also what a ``DataLoader`` needs to collate them."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from . import arguments, parameters
from .declaration import Param
from .value import Value, _rebuild


def stack(values: Iterable[Any], dim: int = 0) -> Any:
    """One value of several of the same kind, with a new batch axis ``dim``: ``stack(vs)[i]`` behaves as ``vs[i]``.

    Every tensor gets the new axis, so that ``torch.vmap(f)(stack(vs))`` is ``f`` of each. Batch axes of different shapes broadcast, and
    parameters without them get axes of size 1 and the dtype and device of those with; what is no tensor must be equal. Gradients reach
    every value. Values of lights become ``[N, L, ...]``, which is for ``vmap`` and indexing. ``dim`` counts batch axes, from the end if
    negative. Tuples, lists and dictionaries of values are stacked entry by entry, tensors by ``torch.stack``, and everything else
    (numbers, strings, arrays) as ``torch.utils.data.default_collate`` does: ``DataLoader(..., collate_fn=tb.stack)``.

    >>> import torch, torchbrdf as tb
    >>> tb.stack([tb.Lambert(torch.rand(4, 5, 3)), tb.Lambert([0.5, 0.4, 0.3])])
    Lambert(albedo=float32[2, 4, 5, 3])
    """
    if isinstance(values, (Tensor, Value, Mapping, str)) or not isinstance(values, Iterable):
        raise TypeError(f"stack: values: expected a list of values, found {type(values).__name__}; pass [a, b]")
    if not isinstance(dim, int):
        raise TypeError(f"stack: dim: expected a whole number, found {dim!r}")
    found = list(values)
    if not found:
        raise ValueError("stack: values: found none; pass at least one")
    return _stack(found, dim, "")


def _stack(held: list[Any], dim: int, path: str) -> Any:
    """Items of a container, or of the list itself; ``path`` is what follows ``values[k]`` in errors."""
    first = held[0]
    _same([_kind(x) for x in held], path, "make them of one kind", TypeError)
    if isinstance(first, Value):
        return _merge(held, _place(held, dim, path), path)
    if isinstance(first, Tensor):
        _same([list(t.shape) for t in held], path, "make them of one shape")
        return torch.stack(held, dim)
    if isinstance(first, Mapping):
        _same([sorted(map(str, x)) for x in held], path, "give each the same keys")
        return {key: _stack([x[key] for x in held], dim, f"{path}[{key!r}]") for key in first}
    if isinstance(first, (tuple, list)):
        _same([len(x) for x in held], path, "give each as many entries")
        return _like(first, [_stack(list(entries), dim, f"{path}[{j}]") for j, entries in enumerate(zip(*held, strict=True))])
    return None if first is None else _collated(held, path)


def _collated(held: list[Any], path: str) -> Any:
    try:
        return torch.utils.data.default_collate(held)
    except (TypeError, RuntimeError):
        what, module = type(held[0]).__name__, isinstance(held[0], torch.nn.Module)
        remedy = "call the module first: module(g)" if module else "leave it out, or collate it yourself"
        raise TypeError(f"stack: values[0]{path}: expected values, tensors, numbers, strings or arrays, found {what}; {remedy}") from None


class Place(NamedTuple):
    """Where the new axis goes: before the axis ``at`` of ``rank`` batch axes; ``like`` is a tensor that has some."""

    at: int
    rank: int
    like: Tensor | None


def _place(held: list[Value], dim: int, path: str) -> Place:
    rank = len(arguments.broadcast({f"values[{k}]{path}": tuple(v.batch_shape) for k, v in enumerate(held)}, "stack: batch shapes"))
    if not -rank - 1 <= dim <= rank:
        raise IndexError(f"stack: dim: found {dim}, legal are {-rank - 1} to {rank}, the places among {rank} batch axes")
    return Place(dim % (rank + 1), rank, next((t for v in held for t in _batched(v)), None))


def _batched(v: Value) -> Iterable[Tensor]:
    """The floating parameters that have batch axes."""
    yield from (t for _, t, spec in v.own_tensors() if spec.batch(t) and t.is_floating_point())
    for inner in v.nested():
        yield from _batched(inner)


def _merge(held: Sequence[Value], place: Place, path: str) -> Value:
    """Values of one class, field by field; without the checks of construction, as indexing makes values."""
    first, specs = held[0], held[0].params()
    fields = {n: _field([getattr(v, n) for v in held], specs.get(n), place, f"{path}.{n}") for n in first._fields}
    return _rebuild(type(first), fields)


def _field(held: list[Any], spec: Param | None, place: Place, path: str) -> Any:
    first = held[0]
    _same([_kind(x) for x in held], path, "make them of one kind", TypeError)
    if isinstance(first, Tensor):
        return _tensors(held, spec, place, path)
    if isinstance(first, Value):
        return _merge(held, place, path)
    if isinstance(first, (tuple, list)):
        _same([len(x) for x in held], path, "give each as many parts")
        return _like(first, [_field(list(parts), None, place, f"{path}[{j}]") for j, parts in enumerate(zip(*held, strict=True))])
    _same(held, path, "what is no tensor must be equal")
    return first


def _tensors(held: list[Tensor], spec: Param | None, place: Place, path: str) -> Tensor:
    """One field: events must agree (a single channel becomes C), batch axes broadcast. Planar, as everything that is computed."""
    axes = min(len(spec.event) if spec else 1, *(t.dim() for t in held))
    held = [_following(t, axes, place.like) for t in held]
    _same([parameters.kind(t) for t in held], path, "convert one with .to(...)", TypeError)
    events = [list(t.shape[t.dim() - axes :]) for t in held]
    if spec is not None and spec.is_colour:
        channels = max(e[-1] for e in events)
        events = [[*e[:-1], channels if e[-1] == 1 else e[-1]] for e in events]
    _same(events, path, "make the sizes of one parameter equal")
    batch = arguments.broadcast({f"values[{k}]{path}": tuple(t.shape[: t.dim() - axes]) for k, t in enumerate(held)}, "stack: batch shapes")
    ones = (1,) * (place.rank - len(batch))
    wide = [t.expand(*ones, *batch, *events[0]) for t in held]
    if axes != 1:
        return torch.stack(wide, place.at)
    return torch.stack([t.movedim(-1, 0) for t in wide], place.at + 1).movedim(0, -1)


def _following(t: Tensor, axes: int, like: Tensor | None) -> Tensor:
    """What has no batch axes followed the points; with axes it must match them, as ``like``, a tensor that has some, does."""
    if like is None or t.dim() > axes:
        return t
    return t.to(like.device, like.dtype if t.is_floating_point() else None)


def _kind(x: Any) -> str:
    return "a tensor" if isinstance(x, Tensor) else "None" if x is None else type(x).__name__


def _like(first: Any, entries: list[Any]) -> Any:
    """A tuple, a named tuple or a list of other entries."""
    return type(first)(*entries) if hasattr(first, "_fields") else type(first)(entries)


def _same(found: Sequence[Any], path: str, remedy: str, error: type[Exception] = ValueError) -> None:
    for k, one in enumerate(found):
        if one is not found[0] and one != found[0]:
            raise error(f"stack: values[{k}]{path}: found {_shown(one)}, but values[0]{path} has {_shown(found[0])}; {remedy}")


def _shown(x: Any) -> str:
    text = str(x)
    return text if len(text) <= 60 else f"{text[:60]}..."
