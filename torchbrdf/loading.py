"""Saved values, read back: nothing but registered values is made, and each is checked."""

import importlib
from pathlib import Path
from typing import Any

from .io import files, saved
from .value import VALUES, Value

DEEPEST = 64  # of values in values in a file: far more than any needs; a few hundred would exhaust Python's stack wherever it is used


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
