"""Legal ranges: what a parameter may be, what tests draw, and how learning stays inside."""

import dataclasses
import math

import torch
from torch import Tensor


@dataclasses.dataclass(frozen=True)
class Interval:
    """The legal range of a parameter.

    ``typical`` is the sub-range that tests draw from and learning starts in; at the ``hard`` values, the closed ends of the
    range always among them, values and gradients must still be finite.
    """

    low: float = -math.inf
    high: float = math.inf
    open_low: bool = False
    typical: tuple[float, float] | None = None
    hard: tuple[float, ...] = ()

    def __str__(self) -> str:
        left = "(" if self.open_low or math.isinf(self.low) else "["
        return f"{left}{self.low:g}, {self.high:g}{')' if math.isinf(self.high) else ']'}"

    def contains(self, x: Tensor) -> Tensor:
        """Where x is finite and legal (bool)."""
        above = x > self.low if self.open_low else x >= self.low
        return torch.isfinite(x) & above & (x <= self.high)

    def extremes(self) -> tuple[float, ...]:
        """The closed ends, and the values declared hard."""
        ends = (self.low,) * (not self.open_low) + (self.high,)
        return (*(x for x in ends if math.isfinite(x)), *self.hard)

    def from_unconstrained(self, u: Tensor) -> Tensor:
        """All reals -> the interior: sigmoid for two finite ends, exp for one, the identity for none.

        Legal and finite for every u: the argument of exp is held where its result neither overflows nor is lost beside ``low``
        (gradient 0 beyond).
        """
        if math.isfinite(self.low) and math.isfinite(self.high):
            return self.low + (self.high - self.low) * torch.sigmoid(u)
        if not math.isfinite(self.low):
            return u
        info = torch.finfo(u.dtype)
        least = max(info.tiny, 2.0 * info.eps * abs(self.low)) if self.open_low else info.tiny
        return self.low + torch.exp(u.clamp(math.log(least), -math.log(info.tiny)))

    def to_unconstrained(self, x: Tensor) -> Tensor:
        """Inverse of :meth:`from_unconstrained`. A start on the bound, infinitely far out, begins sqrt(eps) inside instead."""
        margin = math.sqrt(torch.finfo(x.dtype).eps)
        if math.isfinite(self.low) and math.isfinite(self.high):
            part = (x - self.low) / (self.high - self.low)
            return torch.logit(torch.where(part <= 0, margin, torch.where(part >= 1, 1.0 - margin, part)))
        return torch.log(torch.where(x <= self.low, margin, x - self.low)) if math.isfinite(self.low) else x

    def draw(self, shape: tuple[int, ...], generator: torch.Generator, dtype: torch.dtype = torch.float64) -> Tensor:
        """Random legal values: log-uniform over a positive typical range of more than one decade, uniform otherwise."""
        low, high = self.typical or self._span()
        u = 1.0 - torch.rand(shape, generator=generator, dtype=dtype)  # in (0, 1]: a low end may be open
        return low * (high / low) ** u if low > 0 and high / low > 10 else low + (high - low) * u

    def _span(self) -> tuple[float, float]:
        """Some finite part: all of it, or a unit length from its one end, or [-1, 1]."""
        if math.isfinite(self.low):
            return self.low, self.high if math.isfinite(self.high) else self.low + 1.0
        return (self.high - 1.0, self.high) if math.isfinite(self.high) else (-1.0, 1.0)


REAL = Interval()
UNIT = Interval(0.0, 1.0, typical=(0.1, 0.9))
NONNEGATIVE = Interval(0.0, math.inf, typical=(0.1, 2.0))
