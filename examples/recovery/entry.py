"""What stands in a JSON file, asked for by name: whatever is missing or of the wrong kind is named with the place it belongs to."""

import json
import sys
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

KINDS = {dict: "an object {...}", list: "a list [...]", str: "a text", float: "a finite number"}


def read(path: Path) -> "Entry":
    """The object that a JSON file holds."""
    if not path.is_file():
        raise FileNotFoundError(f"--scene: no such file: {path}")
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} is no scene file, for it is not JSON ({error})") from None
    return Entry(found, str(path), path.parent)


class Entry:
    """An object of the file, and ``where`` it stands."""

    def __init__(self, found: Any, where: str, folder: Path) -> None:
        self.where, self.folder = where, folder
        self.found: dict[str, Any] = self.checked(found, dict)

    def wrong(self, error: Exception) -> ValueError:
        """An error about what stands here."""
        return ValueError(str(error) if str(error).startswith(self.where) else f"{self.where}: {error}")

    def checked(self, found: Any, kind: type, name: str = "") -> Any:
        """``found`` if it is of this kind (whole numbers are numbers, and numbers are finite)."""
        fits = isinstance(found, (int, float) if kind is float else kind) and not isinstance(found, bool)
        if not fits or (kind is float and not abs(found) <= sys.float_info.max):
            raise ValueError(f"{self.where}{f': {name}' if name else ''}: expected {KINDS[kind]}, found {_short(found)}")
        return found

    def __contains__(self, name: str) -> bool:
        return name in self.found

    def get(self, name: str, kind: type) -> Any:
        """What stands under a name."""
        if name not in self:
            raise ValueError(f"{self.where}: {name} is missing; there are {sorted(self.found)}")
        return self.checked(self.found[name], kind, name)

    def entry(self, name: str) -> "Entry":
        """The object under a name."""
        return Entry(self.get(name, dict), f"{self.where}: {name}", self.folder)

    def file(self, file: str, name: str) -> Path:
        """A file that is named here, beside the scene file or with its whole path."""
        path = self.folder / file
        if not path.is_file():
            raise FileNotFoundError(f"{self.where}: {name}: no such file: {path}")
        return path

    def texts(self, name: str) -> list[str]:
        """The list of texts under a name."""
        return [self.checked(text, str, f"{name}[{k}]") for k, text in enumerate(self.get(name, list))]

    def numbers(self, name: str, *shape: int) -> Tensor:
        """The finite numbers under a name, float64, of a shape (none given: any)."""
        if name not in self:
            self.get(name, list)
        try:
            t = torch.tensor(self.found[name], dtype=torch.float64)
        except (TypeError, ValueError, RuntimeError, OverflowError) as error:
            raise ValueError(f"{self.where}: {name}: expected numbers, found {_short(self.found[name])} ({error})") from None
        if (shape and t.shape != shape) or not bool(torch.isfinite(t).all()):
            expected = f"finite numbers of shape {list(shape)}" if shape else "finite numbers"
            raise ValueError(f"{self.where}: {name}: expected {expected}, found {_short(self.found[name])}")
        return t


def _short(found: Any) -> str:
    text = "nothing (null)" if found is None else json.dumps(found) if not isinstance(found, dict | list) else repr(found)
    return text if len(text) <= 60 else f"{text[:60]}..."
