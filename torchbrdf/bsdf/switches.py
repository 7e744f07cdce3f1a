"""What numbers, known where a material is made, take out of ``tb.Principled``."""

from collections.abc import Mapping
from typing import Any

from torch import Tensor
from torch.autograd import forward_ad

from .. import arguments

# What is off, and the parameter and the value that say so.
SWITCHES = {
    "metal": ("metallic", 0),
    "dielectric": ("metallic", 1),
    "specular": ("specular", 0),
    "partial": ("specular", 1),
    "anisotropy": ("anisotropy", 0),
    "coat": ("coat", 0),
    "sheen": ("sheen", 0),
}


def known_off(given: Mapping[str, Any]) -> tuple[str, ...]:
    """What is off by what is given for some parameters."""
    return tuple([name for name, (field, x) in SWITCHES.items() if field in given and is_known(given[field], x)])


def is_known(given: Any, x: int) -> bool:
    """Whether what is given for a parameter is one number that can be looked at, requires no derivative, and is ``x``."""
    if not isinstance(given, Tensor):
        return isinstance(given, (int, float)) and given == x
    if given.numel() != 1 or given.dim() > 1 or given.requires_grad or given.device.type != "cpu" or arguments.values_hidden(given):
        return False
    return forward_ad.unpack_dual(given).tangent is None and given.item() == x
