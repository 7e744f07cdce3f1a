"""Kinds of light transport, and what samplers hand around."""

import enum
from typing import NamedTuple

from torch import Tensor

from ..geometry import Channels, Geometry, Viewer
from ..vector import Vec


class Lobe(enum.Flag):
    """What a lobe does with light: how sharply (one of DIFFUSE, GLOSSY, DELTA) and to which side (REFLECTION, TRANSMISSION).

    A plan chooses effects by it. ``Lobe.DELTA`` alone, without a side, asks for both sides; ``Lobe.REFLECTION`` for any sharpness.
    """

    DIFFUSE = 1
    GLOSSY = 2
    DELTA = 4
    REFLECTION = 8
    TRANSMISSION = 16
    DIFFUSE_REFLECTION = DIFFUSE | REFLECTION
    DIFFUSE_TRANSMISSION = DIFFUSE | TRANSMISSION
    GLOSSY_REFLECTION = GLOSSY | REFLECTION
    GLOSSY_TRANSMISSION = GLOSSY | TRANSMISSION
    DELTA_REFLECTION = DELTA | REFLECTION
    DELTA_TRANSMISSION = DELTA | TRANSMISSION
    SPREAD = DIFFUSE | GLOSSY

    def serves(self, wanted: "Lobe") -> bool:
        """Whether a lobe of this kind is among those ``wanted``."""
        # By numbers: graphs know the value of an enum member, not its operators.
        mine, asked = self.value, wanted.value
        return all(not asked & group or bool(mine & asked & group) for group in (_SHARPNESS, _SIDES))

    @property
    def is_delta(self) -> bool:
        """Whether the lobe sends light into a single direction."""
        return bool(self.value & 4)

    @property
    def transmits(self) -> bool:
        """Whether the lobe sends light to the other side."""
        return bool(self.value & 16)

    @property
    def label(self) -> str:
        """In words, such as ``"glossy reflection"``."""
        return " ".join(word for bit, word in _WORDS.items() if self.value & bit)


_SHARPNESS, _SIDES = 7, 24
_WORDS = {1: "diffuse", 2: "glossy", 4: "delta", 8: "reflection", 16: "transmission"}


class BSDFSample(NamedTuple):
    """What ``sample`` returns. Where ``lobe`` is a delta, ``pdf`` is the discrete probability of choosing it, elsewhere ``bsdf.pdf``."""

    wi: Tensor  # [..., 3] unit, in the frame of wo
    weight: Tensor  # [..., C] f |cos| / pdf; 0 outside the model's domain
    pdf: Tensor  # [..., 1] per steradian of wi given wo, of a delta a probability; 0 outside the model's domain
    lobe: Tensor  # [..., 1] index into bsdf.lobes
    eta: Tensor  # [..., 1] n(side of wi) / n(side of wo): 1 for reflection


class Draw(NamedTuple):
    """A direction drawn in the local frame."""

    wi: Vec
    lobe: Tensor | int = 0  # index into the model's lobes
    eta: Tensor | float = 1.0  # n(side of wi) / n(side of wo)


class Delta(NamedTuple):
    """What one delta lobe does for a viewer: from ``wi`` (in the viewer's space) it takes ``weight`` of the radiance."""

    wi: Vec
    cos_i: Tensor  # n.wi, which keeps the sign at grazing that rounding takes from wi
    weight: Channels
    lobe: int = 0  # index into the model's lobes
    eta: Tensor | float = 1.0  # n(side of wi) / n(side of wo)

    def geometry(self, viewer: Viewer) -> Geometry:
        """The pair of directions that the lobe joins."""
        return Geometry(viewer, self.wi, self.cos_i)
