"""Saved values: one safetensors file, whose tensors bear their paths (``terms[0].albedo``); what holds them is JSON in its header.

Neither can hold code, and safetensors refuses a file that its tensors do not fill exactly, so that none claims more than there
is. Planar tensors stay planar, and one tensor in two places is stored once.
"""

import json
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from .. import vector

ENTRY = "torchbrdf"  # of the header's metadata, which holds the structure
_TENSOR = "$tensor"  # no field of a value can bear this name


def write(path: str | Path, value: Any) -> None:
    """Write ``value``, which answers ``named_tensors()``, and whose ``state()`` is otherwise plain data."""
    from safetensors.torch import save_file

    names = {id(t): where for where, t in value.named_tensors()}
    tensors: dict[str, Tensor] = {}

    def store(t: Any) -> dict[str, Any]:
        if not isinstance(t, Tensor):
            raise TypeError(f"save: {path}: expected tensors, values, tuples, numbers and strings in a value, found {type(t).__name__}")
        planar, name = vector.is_planar(t) and not t.is_contiguous(), names[id(t)]
        plain = (t.movedim(-1, 0) if planar else t).detach().cpu()
        tensors[name] = plain.clone(memory_format=torch.contiguous_format)  # of which no two share memory
        return {_TENSOR: name, "planar": planar}

    structure = json.dumps(value.state(), default=store)
    save_file(tensors, path, {ENTRY: structure})


def read(path: Path) -> Any:
    """The state in ``path``, on the CPU; any error says why it is none."""
    from safetensors import safe_open

    with path.open("rb") as file:
        head = file.read(9)
    if head.startswith((b"PK", b"\x80")) and head[8:] != b"{":
        raise ValueError("it is a pickle, as torch.save writes them, which could run code and is never read")
    with safe_open(path, framework="pt") as file:
        structure = (file.metadata() or {}).get(ENTRY)
        tensors = {name: file.get_tensor(name).clone() for name in file.offset_keys()}  # or they would be windows on the file

    if structure is None:
        raise ValueError("it holds tensors alone, such as the weights of a module; read them with safetensors.torch.load_file")

    def fetch(found: dict[str, Any]) -> Any:
        if _TENSOR not in found:
            return found
        tensor = tensors[found[_TENSOR]]
        return tensor.movedim(0, -1) if found["planar"] else tensor

    return json.loads(structure, object_hook=fetch)
