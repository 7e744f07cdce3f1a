"""Values: frozen dataclasses of tensors that autograd, ``torch.compile``, ``vmap`` and ``functional_call`` see through.

A field declared with :func:`param` states once what it is: its legal range and its trailing size. That one declaration
serves validation, draws in tests, unconstrained optimisation and the docs table. Numbers and lists become CPU float64
tensors; taken apart inside a formula they are 0-dimensional, and torch lets those follow the dtype and device of the
shading points. Parameters with batch axes must match the points themselves.
"""

import dataclasses
import importlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar, dataclass_transform

import torch
from torch import Tensor

from . import arguments, files, saved, torch_compat
from .interval import Interval

T = TypeVar("T")
VALUES: dict[str, type["Value"]] = {}


@dataclasses.dataclass(frozen=True)
class Param:
    """What :func:`param` declares. ``event`` is the shape of one parameter, the axes behind the batch axes."""

    constraint: Interval
    event: tuple[int | str, ...]
    doc: str = ""
    kind: str = "float"  # "float", "int" or "bool"

    @property
    def size(self) -> int | None:
        """The trailing size; None for a colour ``C``."""
        return None if isinstance(self.event[-1], str) else self.event[-1]


SCALAR, PAIR, VECTOR, COLOUR = (1,), (2,), (3,), ("C",)  # the usual shapes of one parameter


def param(
    constraint: Interval, event: tuple[int | str, ...], doc: str = "", default: Any = dataclasses.MISSING, kind: str = "float"
) -> Any:
    """A tensor field ``[..., *event]`` that must lie in ``constraint``; a name in ``event`` stands for any size, ``COLOUR`` is ``("C",)``."""
    return dataclasses.field(default=default, metadata={"param": Param(constraint, event, doc, kind)})


def _to_tensor(x: Any, where: str, kind: str) -> Tensor:
    try:
        t = x if isinstance(x, Tensor) else torch.as_tensor(x, dtype=None if hasattr(x, "dtype") or kind != "float" else torch.float64)
    except (TypeError, ValueError, RuntimeError) as error:
        raise TypeError(f"{where}: expected a number, list, array or tensor, found {type(x).__name__} ({error})") from None
    if t.dtype not in _LEGAL[kind]:
        raise TypeError(f"{where}: expected a tensor of {kind}s, found {t.dtype}; convert it, for example with .to({_EXAMPLE[kind]})")
    if t.layout != torch.strided:
        raise TypeError(f"{where}: expected a dense tensor, found one of layout {t.layout}; convert it with .to_dense()")
    return t.reshape(1) if t.dim() == 0 else t


_LEGAL = {
    "float": arguments.FLOATS,
    "int": (torch.int64, torch.int32, torch.int16, torch.int8, torch.uint8),
    "bool": (torch.bool,),
}
_EXAMPLE = {"float": "torch.float32", "int": "torch.int64", "bool": "torch.bool"}


def has_tensors(x: Any) -> bool:
    """Whether x is, or holds, tensors: such fields are pytree children, all others are static context."""
    return isinstance(x, (Tensor, Value)) or (isinstance(x, (tuple, list)) and any(has_tensors(v) for v in x))


class Value:
    """Base of everything made with :func:`value`: everyday handling of a frozen bundle of tensors."""

    # Filled in by @value: torch.compile cannot trace dataclasses.fields on a class.
    _params: ClassVar[dict[str, Param]] = {}
    _fields: ClassVar[tuple[str, ...]] = ()
    _optional: ClassVar[frozenset[str]] = frozenset()

    def __post_init__(self) -> None:
        """Turn numbers into tensors and check shapes and dtypes (never tensor values: this runs inside graphs)."""
        for name, spec in self.params().items():
            raw = getattr(self, name)
            where = f"{type(self).__name__}.{name}"
            if raw is None and name not in self._optional:
                raise TypeError(f"{where}: expected a number, list, array or tensor, found None")
            if raw is None:
                continue
            tensor = _to_tensor(raw, where, spec.kind)
            if spec.size is not None and tensor.shape[-1] != spec.size:
                raise ValueError(f"{where}: expected shape [..., {spec.size}], found {list(tensor.shape)}{_shape_hint(tensor, spec)}")
            if not tensor.shape[-1]:
                raise ValueError(f"{where}: expected shape [..., C] with one channel at least, found {list(tensor.shape)}")
            object.__setattr__(self, name, tensor)
        self.check_shapes()

    def check_shapes(self) -> None:
        """Channels must agree (or be 1), and batch axes must broadcast."""
        channels = {n: t.shape[-1] for n, t, s in self.own_tensors() if s.size is None and t.shape[-1] != 1}
        if len(set(channels.values())) > 1:
            raise ValueError(f"{type(self).__name__}: colour parameters have different numbers of channels: {channels}; use one C, or 1")
        arguments.broadcast({n: tuple(t.shape[:-1]) for n, t, _ in self.own_tensors()}, f"{type(self).__name__}: batch shapes")

    def check(self) -> None:
        """Look at values that no range describes, such as a mesh's indices; nothing, unless a value says otherwise."""

    @classmethod
    def params(cls) -> dict[str, Param]:
        """The declared parameters, in order."""
        return cls._params

    def own_tensors(self) -> Iterator[tuple[str, Tensor, Param]]:
        """(name, tensor, declaration) of every parameter that is present."""
        for name, spec in self.params().items():
            if isinstance(getattr(self, name), Tensor):
                yield name, getattr(self, name), spec

    def nested(self) -> Iterator["Value"]:
        """The values that this value holds."""
        for held in [getattr(self, name) for name in self._fields]:
            yield from (v for v in (held if isinstance(held, (tuple, list)) else (held,)) if isinstance(v, Value))

    @property
    def batch_shape(self) -> torch.Size:
        """Broadcast shape of all batch axes (everything but the trailing axis)."""
        shapes = {n: t.shape[:-1] for n, t, _ in self.own_tensors()}
        nested = {f"{k} {type(v).__name__}": v.batch_shape for k, v in enumerate(self.nested())}
        return arguments.broadcast(shapes | nested, f"{type(self).__name__}: batch shapes")

    def replace(self, **changes: Any) -> Self:
        """A copy with some fields changed."""
        return dataclasses.replace(self, **changes)  # type: ignore[type-var]

    def map(self, fn: Callable[[Tensor], Tensor]) -> Self:
        """A copy with ``fn`` applied to every tensor."""

        def mapped(x: Any) -> Any:
            if isinstance(x, Tensor):
                return fn(x)
            return x.map(fn) if isinstance(x, Value) else type(x)(map(mapped, x)) if isinstance(x, (tuple, list)) else x

        return _rebuild(type(self), {n: mapped(getattr(self, n)) for n in self._fields})

    def to(self, *args: Any, **kwargs: Any) -> Self:
        """Like ``Tensor.to``; a floating dtype is applied to floating tensors only."""
        device, dtype, non_blocking, copy = arguments.placement(*args, **kwargs)
        if dtype not in (None, *arguments.FLOATS):
            raise TypeError(f"to: expected a floating dtype such as torch.float32, found {dtype}")
        return self.map(lambda t: t.to(device, dtype if t.is_floating_point() else None, non_blocking, copy))

    def detach(self) -> Self:
        """A copy without gradient history."""
        return self.map(Tensor.detach)

    def __getitem__(self, index: Any) -> Self:
        """Index the batch axes, those of nested values along with them; what has no batch axes stays."""
        return self._index(index, self.batch_shape)

    def _index(self, index: Any, batch: torch.Size) -> Self:
        where = index if isinstance(index, tuple) else (index,)
        where = (*where, slice(None)) if any(i is Ellipsis for i in where) else (*where, ..., slice(None))

        def pick(x: Any) -> Any:
            if isinstance(x, Tensor):
                return x.expand(*batch, x.shape[-1])[where] if x.dim() > 1 else x
            return x._index(index, batch) if isinstance(x, Value) else tuple(map(pick, x)) if isinstance(x, tuple) else x

        return _rebuild(type(self), {n: pick(getattr(self, n)) for n in self._fields})

    def __repr__(self) -> str:
        shown = ((n, getattr(self, n)) for n in self._fields)
        return f"{type(self).__name__}({', '.join(f'{n}={_brief(v)}' for n, v in shown if v is not None)})"

    def state(self) -> dict[str, Any]:
        """Plain dictionaries and tensors, from which :func:`from_state` makes the value again."""

        def plain(x: Any) -> Any:
            return x.state() if isinstance(x, Value) else [plain(v) for v in x] if isinstance(x, tuple) else x

        return {"value": type(self).__name__, "fields": {n: plain(getattr(self, n)) for n in self._fields}}

    def save(self, path: str | Path) -> None:
        """Write to a file that :func:`load_value` reads (tensors and plain data only; no code)."""
        files.folder_of(path, "save")
        torch.save(self.detach().state(), path)


def _shape_hint(t: Tensor, spec: Param) -> str:
    return f"; did you mean x.unsqueeze(-1) -> {[*t.shape, 1]}?" if spec.size == 1 else ""


def _brief(v: Any) -> str:
    if isinstance(v, Tensor):
        small = v.numel() <= 4 and v.dim() == 1 and not arguments.hidden(v)
        kind = str(v.dtype).removeprefix("torch.")
        return str([round(x, 6) for x in v.tolist()]) if small else f"{kind}{list(v.shape)}"
    return f"({', '.join(map(_brief, v))})" if isinstance(v, tuple) else repr(v)


def _rebuild(cls: type[T], fields: dict[str, Any]) -> T:
    """Make a value without its checks: transforms put index trees and placeholders where tensors stand."""
    made = object.__new__(cls)
    for name, held in fields.items():
        object.__setattr__(made, name, held)
    return made


def _is_child(v: Value, name: str, held: Any) -> bool:
    """Parameters are children whatever stands in them: transforms put axis numbers where tensors stood."""
    return (name in v._params and held is not None) or has_tensors(held)


def _flatten(v: Value) -> tuple[list[Any], tuple[tuple[str, ...], tuple[tuple[str, Any], ...]]]:
    fields = [(n, getattr(v, n)) for n in v._fields]
    children = [(n, x) for n, x in fields if _is_child(v, n, x)]
    static = tuple((n, x) for n, x in fields if not _is_child(v, n, x))
    return [x for _, x in children], (tuple(n for n, _ in children), static)


@dataclass_transform(frozen_default=True, eq_default=False, field_specifiers=(param, dataclasses.field))
def value(cls: type[T]) -> type[T]:
    """Class decorator: a frozen dataclass that is its own pytree node, known by name for saving and loading."""
    made: Any = dataclasses.dataclass(frozen=True, eq=False, repr=False)(cls)
    made._fields = tuple(f.name for f in dataclasses.fields(made))
    made._optional = frozenset(f.name for f in dataclasses.fields(made) if f.default is None)
    made._params = {f.name: f.metadata["param"] for f in dataclasses.fields(made) if "param" in f.metadata}
    torch_compat.register_node(
        made,
        _flatten,
        lambda children, context: _rebuild(made, {**dict(zip(context[0], children, strict=True)), **dict(context[1])}),
        names=lambda v: _flatten(v)[1][0],
    )
    VALUES[cls.__name__] = made
    return made


def _known(name: Any) -> type[Value] | None:
    """The value of that name; those of the public face are imported when a file first speaks of them."""
    if isinstance(name, str) and name not in VALUES:
        getattr(importlib.import_module(__package__), name, None)
    return VALUES.get(name) if isinstance(name, str) else None


def from_state(state: Any) -> Value:
    """The value that :meth:`Value.state` described."""
    kind = _known(state.get("value")) if isinstance(state, dict) and isinstance(state.get("fields"), dict) else None
    if kind is None:
        found = state.get("value") if isinstance(state, dict) else type(state).__name__
        raise ValueError(f"found {_short(found)} for a value; import the module that defines it first, if it is your own")

    def build(x: Any) -> Any:
        return from_state(x) if isinstance(x, dict) else tuple(build(v) for v in x) if isinstance(x, list) else x

    try:
        return kind(**{str(n): build(x) for n, x in state["fields"].items()})
    except TypeError as error:
        raise ValueError(f"saved {state['value']} does not fit this version: {error}") from None


def _short(x: Any) -> str:
    shown = repr(x) if isinstance(x, str | int | None) else type(x).__name__
    return shown if len(shown) <= 60 else f"{shown[:60]}..."


def load_value(path: str | Path) -> Value:
    """Read a value that :meth:`Value.save` wrote. Runs no code from the file, and makes nothing but registered values.

    A missing file raises ``FileNotFoundError``, anything else that is wrong with it ``ValueError``, each naming the file.
    Shapes and dtypes are checked, ranges are not (:func:`validate` does that).
    """
    path = files.existing(path, "load_value")
    try:
        loaded = from_state(saved.read(path))
        loaded.check()
        return loaded
    except Exception as error:
        raise ValueError(f"load_value: {path} is not a saved torchbrdf value: {files.reason(error)}") from None


def validate(v: Value, _path: str = "") -> None:
    """Raise ``ValueError`` if any parameter of ``v``, or of a value inside it, is not finite or leaves its legal range."""
    arguments.of_kind(v, "validate", Value, "tb.Lambert(albedo)")
    path = _path or type(v).__name__
    v.check()
    for name, tensor, spec in v.own_tensors():
        if tensor.numel() and spec.kind == "float" and not arguments.hidden(tensor):
            _check_range(f"{path}.{name}", tensor.detach(), spec.constraint)
    for inner in v.nested():
        validate(inner, f"{path} > {type(inner).__name__}")


def _check_range(where: str, t: Tensor, legal: Interval) -> None:
    low, high = (float(x) for x in torch.aminmax(t))
    ends = torch.tensor([low, high], dtype=torch.float64)
    if bool(legal.contains(ends).all()):
        return
    bad = ~legal.contains(t)
    count, first = int(bad.sum()), float(t[bad][0])
    raise ValueError(
        f"{where} {list(t.shape)}: legal range {legal}, found {first:g}"
        + (f" and {count - 1} more" if count > 1 else "")
        + f" (min {low:g}, max {high:g}); clamp or re-parametrise it (tb.nn.Learned keeps a learned parameter legal)"
    )
