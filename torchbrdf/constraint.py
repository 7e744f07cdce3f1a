"""What a parameter may be: the interface of intervals (``interval.py``), and the two constraints that tie several numbers together.

One declaration serves validation, the draws of tests and learning: a constraint says what is legal, draws legal values, and maps
unconstrained numbers of the same shape onto them, so that no optimiser step leaves them.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from . import numerics, vector
from .vector import Vec


class Constraint(ABC):
    """Interface. ``typical`` is the range that tests draw from, where it is one of numbers."""

    typical: tuple[float, float] | None = None
    remedy: ClassVar[str]

    @abstractmethod
    def contains(self, x: Tensor) -> Tensor:
        """Where x is finite and legal (bool), one answer for each parameter."""

    @abstractmethod
    def complaint(self, x: Tensor) -> str:
        """What is legal and what was found; empty if everything is legal. Looks at values."""

    def extremes(self) -> tuple[float, ...]:
        """Numbers at which values and gradients must still be finite; none, unless a constraint is one of numbers."""
        return ()

    @abstractmethod
    def from_unconstrained(self, u: Tensor) -> Tensor:
        """Any numbers -> legal ones of the same shape."""

    @abstractmethod
    def to_unconstrained(self, x: Tensor) -> Tensor:
        """A u with ``from_unconstrained(u) = x``."""

    @abstractmethod
    def draw(self, shape: tuple[int, ...], generator: torch.Generator, dtype: torch.dtype = torch.float64) -> Tensor:
        """Random legal values of a shape, the axes of the parameter included."""


@dataclass(frozen=True)
class UnitDirection(Constraint):
    """Unit vectors ``[..., 3]``. Learned by their direction: the length of the unconstrained vector is divided out.

    Not smooth where that vector is 0, which counts as the z axis (gradient 0).
    """

    remedy = "normalise them with tb.normalize"

    def __str__(self) -> str:
        return "unit vectors"

    def contains(self, x: Tensor) -> Tensor:
        d = vector.components(x.double())
        return (vector.dot(d, d) - 1.0).abs() < _slack(x)

    def complaint(self, x: Tensor) -> str:
        bad = int((~self.contains(x)).sum())
        return f"expected unit vectors, found {bad} of another length" if bad else ""

    def from_unconstrained(self, u: Tensor) -> Tensor:
        d = vector.normalize_components(vector.components(u))
        none = vector.dot(d, d) == 0
        return vector.stack([d.x, d.y, torch.where(none, 1.0, d.z)])

    def to_unconstrained(self, x: Tensor) -> Tensor:
        return x

    def draw(self, shape: tuple[int, ...], generator: torch.Generator, dtype: torch.dtype = torch.float64) -> Tensor:
        return self.from_unconstrained(torch.randn(shape, generator=generator, dtype=dtype))


@dataclass(frozen=True)
class Rotation(Constraint):
    """Rotation matrices ``[..., 3, 3]``. Learned by their first two rows, made orthonormal; the third is their vector product.

    Source: Gram & Schmidt's method as in Zhou et al. 2019, *On the continuity of rotation representations*. Not smooth where the
    first row is 0 (it counts as the z axis) or the second is parallel to it (any orthogonal one is taken); the gradient is 0 there.
    """

    remedy = "take the scale, or the mirroring, out of it"

    def __str__(self) -> str:
        return "rotations"

    def contains(self, x: Tensor) -> Tensor:
        turn = x.double()
        off = turn @ turn.transpose(-1, -2) - torch.eye(3, dtype=turn.dtype, device=turn.device)
        unit = (off.abs() < _slack(x)).all(-1).all(-1)
        first, second, third = (vector.components(row) for row in turn.unbind(-2))
        return unit & (vector.dot(vector.cross(first, second), third) > 0)

    def complaint(self, x: Tensor) -> str:
        return "" if bool(self.contains(x).all()) else "not a rotation"

    def from_unconstrained(self, u: Tensor) -> Tensor:
        first, second, _ = u.unbind(-2)
        x = Vec(*vector.components(UNIT_DIRECTION.from_unconstrained(first)))
        y, z, _ = vector.frame_components(x, vector.components(second))
        return torch.stack([vector.stack(row) for row in (x, y, z)], -2)

    def to_unconstrained(self, x: Tensor) -> Tensor:
        return x

    def draw(self, shape: tuple[int, ...], generator: torch.Generator, dtype: torch.dtype = torch.float64) -> Tensor:
        return self.from_unconstrained(torch.randn(shape, generator=generator, dtype=dtype))


def _slack(x: Tensor) -> float:
    """How far products of unit vectors may be from 0 or 1: numbers come from text files, or have few digits themselves."""
    return max(numerics.TEXT_DIGITS, 4.0 * torch.finfo(x.dtype).eps)


UNIT_DIRECTION, ROTATION = UnitDirection(), Rotation()
