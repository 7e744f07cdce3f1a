"""Saved states: what ``torch.save`` wrote of plain data and tensors, read from a file that nobody vouches for.

The file is a zip archive with a pickle in it, and three things in it may lie: the pickle may name code (``weights_only`` lets
through torch's own constructors alone), a record may unpack to more than the file (torch never packs), and a tensor of stride 0
may claim any shape. Lists and dictionaries that hold each other, or hold one another twice, would be followed for ever.
"""

import math
import pickle
import re
import zipfile
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from . import files

DEEPEST = 64  # far more than any value needs; a few hundred would exhaust Python's stack wherever the value is used


def read(path: Path) -> Any:
    """The state in ``path``; any error says why it is none. Runs no code from the file."""
    size = path.stat().st_size
    with zipfile.ZipFile(path) as archive:
        unpacked = sum(record.file_size for record in archive.infolist())
    if unpacked > size:
        raise ValueError(f"its records unpack to {unpacked} bytes, more than its {size}, but what torch.save writes is not packed")
    try:
        state = torch.load(path, weights_only=True)
    except pickle.UnpicklingError as error:  # torch's own text advises to read it without the safeguard
        names = re.findall(r"GLOBAL (\S+)", str(error))
        raise ValueError(f"it names code, {names[0]}, which is never run" if names else "its pickle is damaged") from None
    _check(state, size)
    return state


def _check(state: Any, size: int) -> None:
    left, seen = [(state, 0)], set()
    while left:
        one, depth = left.pop()
        if depth > DEEPEST:
            raise ValueError(f"its lists and dictionaries are more than {DEEPEST} deep")
        if isinstance(one, Tensor):
            _check_tensor(one, size)
        elif isinstance(one, dict | list | tuple) and one:
            if id(one) in seen:
                raise ValueError("its lists or dictionaries hold each other, or one of them twice")
            seen.add(id(one))
            left.extend((inner, depth + 1) for inner in (one.values() if isinstance(one, dict) else one))


def _check_tensor(t: Tensor, size: int) -> None:
    if t.layout != torch.strided or t.is_quantized:
        raise ValueError(f"it holds a {'quantised' if t.is_quantized else str(t.layout).removeprefix('torch.')} tensor; save dense ones")
    files.check_claim(math.prod(t.shape) * t.element_size(), size, f"a tensor in it claims the shape {list(t.shape)}")
