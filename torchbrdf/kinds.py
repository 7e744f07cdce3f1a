"""The kind of a value: its class, the shapes, dtypes and devices of its tensors, and what else it holds. What follows from it is kept.

Checks of kinds and shapes take as long as the arithmetic of a few thousand pixels, and each step of learning asks the same of the same
kinds. So what was found of a kind once is looked up. Eagerly alone: in graphs all this costs nothing.
"""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from torch import Tensor

T = TypeVar("T")
PLAIN = (str, int, float, bool)
MOST = 1 << 12  # kinds that are kept; more of them are no loop that repeats itself
_found: dict[Any, Any] = {}


def of(x: Any, anew: bool = False) -> Any:
    """The kind of a value or of what one holds, to be compared and hashed; None where it cannot be told.

    ``anew``: of the tensors as they are now. Else values inside answer with what :func:`held` keeps.
    """
    if isinstance(x, Tensor):
        return (x.shape, x.dtype, x.device, x.layout)
    if isinstance(x, PLAIN):
        return (type(x), x)
    if isinstance(x, (tuple, list)):
        return _whole(x, x, anew)
    return _whole(x, [getattr(x, name) for name in x._fields], anew) if hasattr(type(x), "_params") else None


def _whole(x: Any, inside: Sequence[Any], anew: bool) -> Any:
    """One loop, and no call for what is most common: this is what a lookup costs."""
    parts: list[Any] = [type(x)]
    for v in inside:
        if v is None:
            parts.append(v)
        elif isinstance(v, Tensor):
            parts.append((v.shape, v.dtype, v.device, v.layout))
        else:
            part = of(v, anew) if anew or not hasattr(type(v), "_params") else held(v)
            if part is None:
                return None
            parts.append(part)
    return tuple(parts)


def held(v: Any) -> Any:
    """The kind of a value when it was first asked for. (A module's ``double()`` may put other numbers into a Parameter later.)"""
    if "_kind" not in v.__dict__:
        object.__setattr__(v, "_kind", of(v))
    return v.__dict__["_kind"]


def known(key: tuple[Any, ...]) -> bool:
    """Whether something is kept under a key, which ends in a kind."""
    return _look_up(key) is not _found


def recall(key: tuple[Any, ...], find: Callable[[], T]) -> T:
    """What is kept under a key, which ends in a kind; else what ``find`` finds. Where it raises, nothing is kept."""
    kept: Any = _look_up(key)
    if kept is not _found:
        found: T = kept
        return found
    found = find()
    if len(_found) >= MOST:
        _found.clear()
    _keep(key, found)
    return found


def _look_up(key: tuple[Any, ...]) -> Any:
    """What is kept, or the store itself for nothing."""
    try:
        return _found if key[-1] is None else _found.get(key, _found)
    except TypeError:  # sizes that are symbols, of torch's tracers, have no hash
        return _found


def _keep(key: tuple[Any, ...], found: Any) -> None:
    try:
        if key[-1] is not None:
            _found[key] = found
    except TypeError:
        pass
