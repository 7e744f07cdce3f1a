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
from torch.utils import _pytree as pytree

from . import arguments
from .constraint import Constraint
from .io import files, saved

T = TypeVar("T")
VALUES: dict[str, type["Value"]] = {}
DEEPEST = 64  # of values in values in a file: far more than any needs; a few hundred would exhaust Python's stack wherever it is used


@dataclasses.dataclass(frozen=True)
class Param:
    """What :func:`param` declares. ``event`` is the shape of one parameter, the axes behind the batch axes."""

    constraint: Constraint
    event: tuple[int | str, ...]
    doc: str = ""
    kind: str = "float"  # "float", "int" or "bool"

    @property
    def is_colour(self) -> bool:
        """Whether the last axis is one of colour channels."""
        return self.event[-1] == "C"

    @property
    def shape(self) -> str:
        """In words, such as ``"[..., 3]"``."""
        return f"[..., {', '.join(map(str, self.event))}]"

    def batch(self, t: Tensor) -> torch.Size:
        """The batch axes of a tensor of this parameter."""
        return t.shape[: t.dim() - len(self.event)]

    def fits(self, t: Tensor) -> bool:
        """Whether a tensor has the event axes, each of its size, a named one of any size but 0 where it counts colours."""
        sizes = t.shape[t.dim() - len(self.event) :]
        return len(sizes) == len(self.event) and all(isinstance(e, str) or e == n for e, n in zip(self.event, sizes, strict=True))


SCALAR, PAIR, VECTOR, COLOUR = (1,), (2,), (3,), ("C",)  # the usual shapes of one parameter


def param(
    constraint: Constraint, event: tuple[int | str, ...], doc: str = "", default: Any = dataclasses.MISSING, kind: str = "float"
) -> Any:
    """A tensor field ``[..., *event]`` that must lie in ``constraint``.

    A name in ``event`` stands for any size, the same wherever a value says it; but ``"C"``, the channels of a colour, may also be 1.
    """
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
    return isinstance(x, Tensor | Value) or (isinstance(x, tuple | list) and any(has_tensors(v) for v in x))


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
            if not spec.fits(tensor):
                raise ValueError(f"{where}: expected shape {spec.shape}, found {list(tensor.shape)}{_shape_hint(tensor, spec)}")
            if spec.is_colour and not tensor.shape[-1]:
                raise ValueError(f"{where}: expected shape {spec.shape} with one channel at least, found {list(tensor.shape)}")
            object.__setattr__(self, name, tensor)
        self.check_shapes()

    def check_shapes(self) -> None:
        """Channels must agree (or be 1), axes of one name must have one size, and batch axes must broadcast."""
        channels = {n: t.shape[-1] for n, t, s in self.own_tensors() if s.is_colour and t.shape[-1] != 1}
        if len(set(channels.values())) > 1:
            raise ValueError(f"{type(self).__name__}: colour parameters have different numbers of channels: {channels}; use one C, or 1")
        self._check_named_axes()
        arguments.broadcast({n: tuple(s.batch(t)) for n, t, s in self.own_tensors()}, f"{type(self).__name__}: batch shapes")

    def _check_named_axes(self) -> None:
        first: dict[str, tuple[int, str]] = {}
        for name, t, spec in self.own_tensors():
            for axis, size in zip(spec.event, t.shape[-len(spec.event) :], strict=True):
                if isinstance(axis, str) and axis != "C" and first.setdefault(axis, (size, name))[0] != size:
                    expected, other = first[axis]
                    where = f"{type(self).__name__}.{name}"
                    raise ValueError(f"{where}: expected shape {spec.shape} with {axis} = {expected} as in {other}, found {list(t.shape)}")

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

    @property
    def own_channels(self) -> int:
        """C of the value's own colours, nested ones apart; 1 if it has none."""
        return max((t.shape[-1] for _, t, s in self.own_tensors() if s.is_colour), default=1)

    def nested(self) -> Iterator["Value"]:
        """The values that this value holds."""
        for held in map(self.__getattribute__, self._fields):
            yield from (v for v in (held if isinstance(held, tuple | list) else (held,)) if isinstance(v, Value))

    @property
    def batch_shape(self) -> torch.Size:
        """Broadcast shape of all batch axes, those before the shape of one parameter."""
        shapes = {n: s.batch(t) for n, t, s in self.own_tensors()}
        nested = {f"{k} {type(v).__name__}": v.batch_shape for k, v in enumerate(self.nested())}
        return arguments.broadcast(shapes | nested, f"{type(self).__name__}: batch shapes")

    def replace(self, **changes: Any) -> Self:
        """A copy with some fields changed."""
        return dataclasses.replace(self, **changes)  # type: ignore[type-var]

    def map(self, fn: Callable[[Tensor], Tensor]) -> Self:
        """A copy with ``fn`` applied to every tensor."""
        return pytree.tree_map_only(Tensor, fn, self)

    def to(self, *args: Any, **kwargs: Any) -> Self:
        """Like ``Tensor.to``; a floating dtype is applied to floating tensors only."""
        device, dtype, non_blocking, _ = torch._C._nn._parse_to(*args, **kwargs)
        if dtype not in (None, *arguments.FLOATS):
            raise TypeError(f"to: expected a floating dtype such as torch.float32, found {dtype}")
        return self.map(lambda t: t.to(device, dtype if t.is_floating_point() else None, non_blocking))

    def detach(self) -> Self:
        """A copy without gradient history."""
        return self.map(Tensor.detach)

    def __getitem__(self, index: Any) -> Self:
        """Index the batch axes, those of nested values along with them; what has no batch axes stays."""
        batch = self.batch_shape
        if not batch:
            raise TypeError(f"{type(self).__name__}: has no batch axes to index or to go through one by one")
        return self._index(index if isinstance(index, tuple) else (index,), batch)

    def _index(self, index: tuple[Any, ...], batch: torch.Size) -> Self:
        rest = () if any(i is Ellipsis for i in index) else (...,)

        def pick(x: Any, event: int = 1) -> Any:
            if isinstance(x, Tensor):
                own = x.shape[x.dim() - event :]
                return x.expand(*batch, *own)[(*index, *rest, *[slice(None)] * event)] if x.dim() > event else x
            return x._index(index, batch) if isinstance(x, Value) else tuple(map(pick, x)) if isinstance(x, tuple) else x

        specs = self.params()
        return _rebuild(type(self), {n: pick(getattr(self, n), len(specs[n].event) if n in specs else 1) for n in self._fields})

    def __repr__(self) -> str:
        shown = ((n, getattr(self, n)) for n in self._fields)
        return f"{type(self).__name__}({', '.join(f'{n}={_brief(v)}' for n, v in shown if v is not None)})"

    def state(self) -> dict[str, Any]:
        """Plain dictionaries and tensors, from which :func:`from_state` makes the value again."""

        def plain(x: Any) -> Any:
            if isinstance(x, dict):
                raise TypeError(f"{type(self).__name__}: a dictionary cannot be saved; make it a value")
            return x.state() if isinstance(x, Value) else [plain(v) for v in x] if isinstance(x, tuple | list) else x

        return {"value": _name(type(self)), "fields": {n: plain(getattr(self, n)) for n in self._fields}}

    def save(self, path: str | Path) -> None:
        """Write a safetensors file that :func:`load_value` reads: tensors and plain data, by whatever name ``path`` gives it."""
        files.folder_of(path, "save")
        saved.write(path, self)


def _shape_hint(t: Tensor, spec: Param) -> str:
    return f"; did you mean x.unsqueeze(-1) -> {[*t.shape, 1]}?" if spec.event == SCALAR else ""


def _brief(v: Any) -> str:
    if isinstance(v, Tensor):
        small = v.numel() <= 4 and v.dim() == 1 and not torch._C._functorch.is_functorch_wrapped_tensor(v) and v.device.type != "meta"
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
    pytree.register_pytree_node(
        made,
        _flatten,
        lambda children, context: _rebuild(made, {**dict(zip(context[0], children, strict=True)), **dict(context[1])}),
        flatten_with_keys_fn=lambda v: (
            [(pytree.GetAttrKey(n), getattr(v, n)) for n in _flatten(v)[1][0]],
            _flatten(v)[1],
        ),
        serialized_type_name=_name(made),
    )
    VALUES[_name(made)] = made
    return made


def _name(cls: type) -> str:
    """What a saved value is known by: ``torchbrdf.Phong``, wherever ours stands in the package; others with their module."""
    ours = cls.__module__.partition(".")[0] == __package__
    return f"{__package__ if ours else cls.__module__}.{cls.__qualname__}"


def _known(name: Any) -> type[Value] | None:
    """The value of that name. Those of the public face are imported when a file first speaks of them; a class that was saved by
    the script that defined it is found in the module that the script now is, if there is but one of its name."""
    package, _, last = name.partition(".") if isinstance(name, str) else ("", "", "")
    if package == __package__ and name not in VALUES:
        getattr(importlib.import_module(__package__), last, None)
    if package == "__main__" and name not in VALUES:
        same = [n for n in VALUES if n.endswith(f".{last}") and not n.startswith(f"{__package__}.")]
        name = same[0] if len(same) == 1 else name
    return VALUES.get(name) if package else None


def from_state(state: Any, depth: int = 0) -> Value:
    """The value that :meth:`Value.state` described, each value in it checked (:meth:`Value.check`)."""
    kind = _known(state.get("value")) if isinstance(state, dict) and isinstance(state.get("fields"), dict) else None
    if kind is None:
        found = state.get("value") if isinstance(state, dict) else type(state).__name__
        raise ValueError(f"found {_short(found)} for a value; import the module that defines it first, if it is your own")

    def build(x: Any, depth: int) -> Any:
        if depth > DEEPEST:
            raise ValueError(f"its values and lists are more than {DEEPEST} deep")
        return from_state(x, depth) if isinstance(x, dict) else tuple(build(v, depth + 1) for v in x) if isinstance(x, list) else x

    try:
        made = kind(**{n: build(x, depth + 1) for n, x in state["fields"].items()})
    except TypeError as error:
        raise ValueError(f"saved {state['value']} does not fit this version: {error}") from None
    made.check()
    return made


def _short(x: Any) -> str:
    shown = repr(x) if isinstance(x, str | int | None) else type(x).__name__
    return shown if len(shown) <= 60 else f"{shown[:60]}..."


def load_value(path: str | Path) -> Value:
    """Read a value that :meth:`Value.save` wrote, onto the CPU. The file holds no code, and makes nothing but registered values.

    A missing file raises ``FileNotFoundError``, anything else that is wrong with it ``ValueError``, each naming the file.
    Shapes and dtypes are checked, ranges are not (:func:`validate` does that).
    """
    path = files.existing(path, "load_value")
    try:
        return from_state(saved.read(path))
    except Exception as error:
        raise ValueError(f"load_value: {path} is not a saved torchbrdf value: {files.reason(error)}") from None


def validate(v: Value, _path: str = "") -> None:
    """Raise ``ValueError`` if any parameter of ``v``, or of a value inside it, is not finite or leaves its legal range."""
    arguments.of_kind(v, "validate", Value, "tb.Lambert(albedo)")
    path = _path or type(v).__name__
    v.check()
    for name, tensor, spec in v.own_tensors():
        if tensor.numel() and spec.kind == "float" and tensor.device.type != "meta":
            wrong = spec.constraint.complaint(tensor.detach())
            if wrong:
                raise ValueError(f"{path}.{name} {list(tensor.shape)}: {wrong}; {spec.constraint.remedy}")
    for inner in v.nested():
        validate(inner, f"{path} > {type(inner).__name__}")
