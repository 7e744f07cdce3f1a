"""Which pass of an EXR file is which: layers by name, for the files of renderers that each name them in their own way."""

from collections.abc import Collection, Mapping
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from .. import vector
from ..io.exr import Layers

# The last part of a layer's name, in lower case. Mitsuba's user chooses it freely; these are the usual choices, the names of
# Mitsuba's own AOVs, and those of Blender's passes.
USUAL = {
    "position": ("pos", "position", "p"),
    "normal": ("nn", "sh_normal", "shading_normal", "normal", "normals", "n", "ns"),
    "geometric_normal": ("gn", "geo_normal", "geometric_normal", "ng"),
    "depth": ("dd", "depth", "distance", "z"),
    "uv": ("uv",),
    "tangent": ("tangent", "dp_du"),
    "triangle": ("id", "prim_index", "triangle"),
    "material": ("material", "material index", "material_index", "indexma"),
}
_LETTERS = {3: ("XYZ", "RGB"), 2: ("UV", "XY", "RG")}
_SIZE = {"depth": 1, "triangle": 1, "material": 1, "uv": 2}
_BLENDER = {"Combined", "Position", "Normal", "Depth", "UV", "IndexMA", "Material Index"}


class Pass(NamedTuple):
    """One recognised pass."""

    layer: str  # its name in the file
    letters: str  # the channels it was made from
    pixels: Tensor  # [H, W, size] float32, planar


Groups = dict[str, dict[str, np.ndarray]]


def group(layers: Layers) -> Groups:
    """Channels by layer: ``groups["ViewLayer.Normal"]["X"]``, whether the layer is named by the channel, by its part, or by both."""
    groups: Groups = {}
    for part, channels in layers.items():
        for name, pixels in channels.items():
            prefix, _, last = name.rpartition(".")
            if not prefix and (len(last) > 1 or last == "Z") and not part:
                prefix, last = last, ""
            label = part if not prefix or part == prefix or part.endswith(f".{prefix}") else prefix
            groups.setdefault(label, {})[last] = pixels
    return groups


def is_blender(groups: Groups) -> bool:
    """Whether the layers are capitalised as Blender's passes are."""
    return bool(_BLENDER & {label.rpartition(".")[2] for label in groups})


def check_fields(names: Mapping[str, str], legal: Collection[str]) -> None:
    """Whether ``names`` speaks of fields that can be read."""
    unknown = sorted(set(names) - set(legal))
    if unknown:
        raise ValueError(f"names: unknown fields {unknown}, legal are {sorted(legal)}")


def recognise(groups: Groups, names: Mapping[str, str] | None) -> dict[str, Pass]:
    """The passes of a G-buffer among the layers; ``names`` (field -> layer) goes before the usual names."""
    chosen = dict(names or {})
    check_fields(chosen, USUAL)
    found = {}
    for field in USUAL:
        labels = _named(groups, field, chosen[field]) if field in chosen else _usual(groups, field)
        if len(labels) > 1:
            raise ValueError(f"several layers could be the {field}: {labels}; say which with names={{{field!r}: {labels[0]!r}}}")
        if labels:
            found[field] = _take(field, labels[0], groups[labels[0]])
    return found


def _usual(groups: Groups, field: str) -> list[str]:
    return [label for label in groups if label.rpartition(".")[2].lower() in USUAL[field]]


def _named(groups: Groups, field: str, wanted: str) -> list[str]:
    labels = [wanted] if wanted in groups else [label for label in groups if label.rpartition(".")[2] == wanted]
    if not labels:
        raise ValueError(f"names: no layer {wanted!r} for the {field}; the file has {sorted(groups)}")
    return labels


def _take(field: str, label: str, channels: Mapping[str, np.ndarray]) -> Pass:
    size = _SIZE.get(field, 3)
    if size == 1:
        options: list[tuple[str, ...]] = [(c,) for c in ("T", "Z", "I", "V", "X", "R", "Y", "") if c in channels]
    else:
        options = [tuple(letters) for letters in _LETTERS[size] if set(letters) <= set(channels)]
    if not options:
        raise ValueError(f"layer {label!r} cannot be the {field}: it has channels {sorted(channels)}, not {size} that fit")
    pixels = vector.stack([torch.from_numpy(channels[c]) for c in options[0]])
    return Pass(label, "".join(options[0]), pixels)
