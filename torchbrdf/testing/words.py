"""Where something was found, in words."""

import math

from torch import Tensor

from ..vector import Frame, normalize


def degrees(w: Tensor) -> str:
    """The angle of a local direction ``[3]`` from the normal, in words; grazing ones by what is missing from 90."""
    x, y, z = w.tolist()
    angle = math.degrees(math.atan2(math.hypot(x, y), z))
    missing = abs(math.degrees(math.atan2(z, math.hypot(x, y))))
    return f"{angle:.3g}°" if missing >= 0.5 or z == 0.0 else f"90° {'-' if z > 0 else '+'} {missing:.1g}°"


def angles(w: Tensor) -> str:
    """A local direction ``[3]`` in words."""
    x, y, _ = w.tolist()
    return f"{degrees(w)} (azimuth {math.degrees(math.atan2(y, x)):.0f}°)"


def pair(wi: Tensor, wo: Tensor, n: Tensor | None = None) -> str:
    """Two directions ``[3]`` in words: their angles from the normal, and from one another."""
    if n is not None:
        frame = Frame.from_normal(n)
        wi, wo = frame.to_local(wi), frame.to_local(wo)
    between = math.degrees(math.acos(max(-1.0, min(1.0, float((normalize(wi) * normalize(wo)).sum())))))
    return f"wi at {degrees(wi)}, wo at {degrees(wo)}, {between:.0f}° apart"
