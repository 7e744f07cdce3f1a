"""Legal ranges: what a parameter may be, what tests draw, and how learning stays inside."""

import dataclasses
import math

import torch
from torch import Tensor


@dataclasses.dataclass(frozen=True)
class Interval:
    """The legal range of a parameter.

    ``typical`` is the sub-range that tests draw from and learning starts in; at the ``hard`` values, the closed ends of the
    range always among them, values and gradients must still be finite. At the ``flat`` values every derivative by the parameter
    is 0 by symmetry (F ~ (eta - 1)^2), so that learning starts beside them.
    """

    low: float = -math.inf
    high: float = math.inf
    open_low: bool = False
    typical: tuple[float, float] | None = None
    hard: tuple[float, ...] = ()
    flat: tuple[float, ...] = ()

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
        """All reals -> the range: ``sin^2(u/2)`` between two ends, ``sinh^2(u/2)`` above one (``|sinh(u/2)|`` above a flat one, from
        which a parameter acts by its square), ``exp(u)`` above an open one, else the identity.

        The first two reach their ends, and their slopes there are only as small as the root of the distance, sqrt(x (1 -+ x)); a
        sigmoid's is the distance itself, and a long step leaves it where no gradient is. Far up, sinh^2 is an exponential. Legal
        and finite for every u but NaN: u is held where the result neither overflows nor is lost beside ``low`` (gradient 0 beyond).
        """
        info = torch.finfo(u.dtype)
        if math.isfinite(self.low) and math.isfinite(self.high):
            return self.low + (self.high - self.low) * torch.sin(0.5 * u.clamp(info.min, info.max)).square()
        if not math.isfinite(self.low):
            return u
        most = -math.log(info.tiny)
        if not self.open_low:
            root = torch.sinh(0.5 * u.clamp(-most, most))
            return self.low + (root.abs() if self.low in self.flat else root.square())
        return self.low + torch.exp(u.clamp(math.log(max(info.tiny, 2.0 * info.eps * abs(self.low))), most))

    def to_unconstrained(self, x: Tensor) -> Tensor:
        """A u >= 0 (any, above an open end) with ``from_unconstrained(u) = x``; where no gradient is, one beside it.

        Ends have no slope: a start on one begins sqrt(eps) inside. ``flat`` values neither: there eps^(1/4) above, sqrt(eps) in what
        the parameter does, which grows as the square.
        """
        margin = math.sqrt(torch.finfo(x.dtype).eps)
        for value in self.flat:
            x = torch.where(x == value, value + math.sqrt(margin), x)
        if math.isfinite(self.low) and math.isfinite(self.high):
            part = (x - self.low) / (self.high - self.low)
            return 2.0 * torch.asin(torch.sqrt(torch.where(part <= 0, margin, torch.where(part >= 1, 1.0 - margin, part))))
        if not math.isfinite(self.low):
            return x
        above = torch.where(x <= self.low, margin, x - self.low)
        if self.open_low:
            return torch.log(above)
        return 2.0 * torch.asinh(above if self.low in self.flat else torch.sqrt(above))

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
