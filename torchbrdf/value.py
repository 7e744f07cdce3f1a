"""Values: frozen dataclasses of tensors that autograd, ``torch.compile``, ``vmap`` and ``functional_call`` see through.

Fields are declared with :func:`~torchbrdf.declaration.param`, which the decorator ``value`` reads. Numbers and lists become CPU float64
tensors; taken apart inside a formula they are 0-dimensional, and torch lets those follow the dtype and device of the
shading points. Parameters with batch axes must match the points themselves.
"""

import dataclasses
import functools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar, dataclass_transform

import torch
from torch import Tensor

from . import arguments, kinds, synonyms, torch_compat
from .declaration import COLOUR, PAIR, SCALAR, VECTOR, Param, param
from .io import files, saved

__all__ = ["COLOUR", "PAIR", "SCALAR", "VALUES", "VECTOR", "Param", "Value", "param", "validate", "value"]

T = TypeVar("T")
VALUES: dict[str, type["Value"]] = {}


def has_tensors(x: Any) -> bool:
    """Whether x is, or holds, tensors: such fields are pytree children, all others are static context."""
    return isinstance(x, (Tensor, Value)) or (isinstance(x, (tuple, list)) and any(has_tensors(v) for v in x))


def once(compute: Callable[[Any], T]) -> Any:
    """A property of kinds and shapes, found once for all values of a kind. Inside graphs, where it costs nothing, it is found anew."""
    name = f"_{compute.__name__}"

    def get(self: Any) -> T:
        if torch.compiler.is_compiling():
            return compute(self)
        if name not in self.__dict__:
            object.__setattr__(self, name, kinds.recall((name, kinds.held(self)), lambda: compute(self)))
        found: T = self.__dict__[name]
        return found

    return property(get, doc=compute.__doc__)


class Value:
    """Base of everything made with :func:`value`: everyday handling of a frozen bundle of tensors."""

    # Filled in by @value: torch.compile cannot trace dataclasses.fields on a class.
    _params: ClassVar[dict[str, Param]] = {}
    _fields: ClassVar[tuple[str, ...]] = ()
    _optional: ClassVar[frozenset[str]] = frozenset()
    _unsaid: ClassVar[tuple[str, str]] = ("method", "standard")  # a choice that repr leaves out

    def __post_init__(self) -> None:
        """Turn numbers into tensors and check shapes and dtypes (never tensor values: this runs inside graphs).

        What was right once is right for every value of that kind: of another like it, as in each step of learning, nothing is looked at.
        """
        if torch.compiler.is_compiling():
            return self._check_fields()
        if not kinds.known(("right", kinds.of(self))):
            self._check_fields()
            kinds.recall(("right", kinds.of(self)), lambda: True)

    def _check_fields(self) -> None:
        for name, spec in self.params().items():
            raw = getattr(self, name)
            where = f"{type(self).__name__}.{name}"
            if raw is None and name not in self._optional:
                raise TypeError(f"{where}: expected a number, list, array or tensor, found None")
            if raw is None:
                continue
            object.__setattr__(self, name, spec.tensor(raw, where))
        self.check_shapes()

    def check_shapes(self) -> None:
        """Channels must agree (or be 1), axes of one name must have one size, and batch axes must broadcast."""
        channels = {n: t.shape[-1] for n, t, s in self.own_tensors() if s.is_colour and t.shape[-1] != 1}
        arguments.one_count(channels, f"{type(self).__name__}: colour parameters have different numbers of channels")
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

    @classmethod
    def decides(cls, name: str, given: Any) -> bool:
        """Whether a number given for a parameter decides what a value is made of, so that a material keeps it as it is; never, unless a
        value says otherwise."""
        return False

    def own_tensors(self) -> Iterator[tuple[str, Tensor, Param]]:
        """(name, tensor, declaration) of every parameter that is present."""
        for name, spec in self.params().items():
            if isinstance(getattr(self, name), Tensor):
                yield name, getattr(self, name), spec

    @once
    def own_channels(self) -> int:
        """C of the value's own colours, nested ones apart; 1 if it has none."""
        return max([1, *(t.shape[-1] for _, t, s in self.own_tensors() if s.is_colour)])

    def nested(self) -> Iterator["Value"]:
        """The values that this value holds."""
        for held in [getattr(self, name) for name in self._fields]:
            yield from (v for v in (held if isinstance(held, (tuple, list)) else (held,)) if isinstance(v, Value))

    @once
    def batch_shape(self) -> torch.Size:
        """Broadcast shape of all batch axes, those before the shape of one parameter."""
        shapes = {n: s.batch(t) for n, t, s in self.own_tensors()}
        nested = {f"{k} {type(v).__name__}": v.batch_shape for k, v in enumerate(self.nested())}
        return arguments.broadcast({**shapes, **nested}, f"{type(self).__name__}: batch shapes")

    def replace(self, **changes: Any) -> Self:
        """A copy with some fields changed."""
        return dataclasses.replace(self, **changes)  # type: ignore[type-var]

    def named_tensors(self) -> Iterator[tuple[str, Tensor]]:
        """(path, tensor) of every tensor here and in what this value holds, such as ``terms[0].albedo``."""
        for name in self._fields:
            yield from _tensors_in(getattr(self, name), name)

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
        batch, where = self.batch_shape, index if isinstance(index, tuple) else (index,)
        if not batch and any(i is not Ellipsis for i in where):
            raise TypeError(f"{type(self).__name__}: has no batch axes to index or to go through one by one")
        return self._index(where, batch)

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
        named = ", ".join(f"{n}={_brief(v)}" for n, v in shown if v is not None and (n, v if isinstance(v, str) else "") != self._unsaid)
        return f"{type(self).__name__}({named})"

    def state(self) -> dict[str, Any]:
        """Plain dictionaries and tensors, from which ``load_value`` makes the value again."""

        def plain(x: Any) -> Any:
            if isinstance(x, dict):
                raise TypeError(f"{type(self).__name__}: a dictionary cannot be saved; make it a value")
            return x.state() if isinstance(x, Value) else [plain(v) for v in x] if isinstance(x, (tuple, list)) else x

        return {"value": _name(type(self)), "fields": {n: plain(getattr(self, n)) for n in self._fields}}

    def save(self, path: str | Path) -> None:
        """Write a safetensors file that ``load_value`` reads: tensors and plain data, by whatever name ``path`` gives it."""
        files.folder_of(path, "save")
        saved.write(path, self)


def _tensors_in(held: Any, path: str) -> Iterator[tuple[str, Tensor]]:
    if isinstance(held, Tensor):
        yield path, held
    elif isinstance(held, Value):
        yield from ((f"{path}.{inner}", t) for inner, t in held.named_tensors())
    elif isinstance(held, (tuple, list)):
        for k, one in enumerate(held):
            yield from _tensors_in(one, f"{path}[{k}]")


def _brief(v: Any) -> str:
    if isinstance(v, Tensor):
        small = v.numel() <= 4 and v.dim() == 1 and not arguments.values_hidden(v)
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
    own_init = "__init__" in cls.__dict__
    made: Any = dataclasses.dataclass(frozen=True, eq=False, repr=False)(cls)
    made._fields = tuple(f.name for f in dataclasses.fields(made))
    made._optional = frozenset(f.name for f in dataclasses.fields(made) if f.default is None)
    made._params = {f.name: f.metadata["param"] for f in dataclasses.fields(made) if "param" in f.metadata}
    torch_compat.register_node(
        made,
        _flatten,
        lambda children, context: _rebuild(made, {**dict(zip(context[0], children, strict=True)), **dict(context[1])}),
        names=lambda v: _flatten(v)[1][0],
        saved_as=_name(made),
    )
    VALUES[_name(made)] = made
    if not own_init:
        made.__init__ = _with_hints(made)
    return made


def _with_hints(made: Any) -> Callable[..., None]:
    """The ``__init__`` of a dataclass, with an error that says what an unknown argument may have meant."""
    init, legal = made.__init__, made._fields

    @functools.wraps(init)
    def __init__(self: Any, *args: Any, **named: Any) -> None:
        for name in named:
            if name not in legal:
                raise TypeError(synonyms.unknown_argument(type(self), name))
        init(self, *args, **named)

    return __init__


def _name(cls: type) -> str:
    """What a saved value is known by: ``torchbrdf.Phong``, wherever ours stands in the package; others with their module."""
    ours = cls.__module__.partition(".")[0] == __package__
    return f"{__package__ if ours else cls.__module__}.{cls.__qualname__}"


def validate(v: Value, _path: str = "") -> None:
    """Raise ``ValueError`` if any parameter of ``v``, or of a value inside it, is not finite or leaves its legal range."""
    arguments.of_kind(v, "validate", Value, "tb.Lambert(albedo)")
    path = _path or type(v).__name__
    v.check()
    for name, tensor, spec in v.own_tensors():
        if tensor.numel() and spec.kind == "float" and not arguments.values_hidden(tensor):
            wrong = spec.constraint.complaint(tensor.detach())
            if wrong:
                raise ValueError(f"{path}.{name} {list(tensor.shape)}: {wrong}; {spec.constraint.remedy}")
    for inner in v.nested():
        validate(inner, f"{path} > {type(inner).__name__}")
