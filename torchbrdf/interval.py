"""Legal ranges of numbers: what a parameter may be, what tests draw, and how learning stays inside."""

import dataclasses
import math

import torch
from torch import Tensor

from . import numerics
from .constraint import Constraint


@dataclasses.dataclass(frozen=True)
class Interval(Constraint):
    """The legal range of a parameter, its ends closed unless ``open_low`` or ``open_high`` says otherwise.

    ``typical`` is the sub-range that tests draw from and learning starts in; at the ``hard`` values, the closed ends of the
    range always among them, values and gradients must still be finite. At the ``flat`` values every derivative by the parameter
    is 0 by symmetry (F ~ (eta - 1)^2), so that learning starts beside them.
    """

    low: float = -math.inf
    high: float = math.inf
    open_low: bool = False
    open_high: bool = False
    typical: tuple[float, float] | None = None
    hard: tuple[float, ...] = ()
    flat: tuple[float, ...] = ()

    remedy = "clamp or re-parametrise it (tb.nn.Learned keeps a learned parameter legal)"

    def __str__(self) -> str:
        left = "(" if self.open_low or math.isinf(self.low) else "["
        return f"{left}{self.low:g}, {self.high:g}{')' if self.open_high or math.isinf(self.high) else ']'}"

    def contains(self, x: Tensor) -> Tensor:
        above = x > self.low if self.open_low else x >= self.low
        below = x < self.high if self.open_high else x <= self.high
        return torch.isfinite(x) & above & below

    def complaint(self, x: Tensor) -> str:
        low, high = (float(end) for end in torch.aminmax(x))
        if bool(self.contains(torch.tensor([low, high], dtype=x.dtype)).all()):
            return ""
        bad = x[~self.contains(x)]
        more = f" and {bad.numel() - 1} more" if bad.numel() > 1 else ""
        return f"legal range {self}, found {float(bad[0]):g}{more} (min {low:g}, max {high:g})"

    def extremes(self) -> tuple[float, ...]:
        """The closed ends, and the values declared hard."""
        ends = (self.low,) * (not self.open_low) + (self.high,) * (not self.open_high)
        return (*(x for x in ends if math.isfinite(x)), *self.hard)

    def from_unconstrained(self, u: Tensor) -> Tensor:
        """All reals -> the range, legal and finite for every u but NaN.

        ============================  =====================================  ==============================================
        range                         of u                                   slope at its ends
        ============================  =====================================  ==============================================
        [a, b]                        ``sin^2(u/2)``                         that of the root of the distance, sqrt(x(1-x))
        (a, b], [a, b)                ``sech^2(u/2)``, ``tanh^2(u/2)``       the same at the closed end; x at the open one
        (a, b)                        ``1 / (1 + exp(-u))``                  the distance itself
        [a, inf)                      ``sinh^2(u/2)``                        that of the root; ``|sinh|`` where a is flat
        (a, inf)                      ``exp(u)``                             the distance itself
        ============================  =====================================  ==============================================

        Closed ends are reached, and left again with sizeable slopes; open ones never, not by rounding either: u is held where the
        result neither overflows nor is lost beside an end (gradient 0 beyond). (-inf, b] is [-b, inf) mirrored.
        """
        if not math.isfinite(self.low):
            return u if not math.isfinite(self.high) else -self._mirrored().from_unconstrained(u)
        if not math.isfinite(self.high):
            return self._above(u)
        found = self._between(u)
        squared_sine = (self.low, self.high, self.open_low, self.open_high) == (0.0, 1.0, False, False)
        return found if squared_sine else numerics.at_most(found, self.high)  # a sine wrong by less than 2 ulp, as all are, is at most 1

    def _between(self, u: Tensor) -> Tensor:
        span, info = self.high - self.low, torch.finfo(u.dtype)
        if not (self.open_low or self.open_high):
            part = _squared(torch.sin(0.5 * numerics.between(u, info.min, info.max)))
            return part if (self.low, self.high) == (0.0, 1.0) else self.low + span * part
        # The least part of the span that does not vanish beside an end, twice over.
        least_low = max(info.tiny, 4.0 * info.eps * abs(self.low) / span)
        least_high = max(info.eps, 4.0 * info.eps * max(abs(self.high), abs(self.low)) / span)
        if self.open_low and self.open_high:
            return self.low + span * torch.sigmoid(numerics.between(u, math.log(least_low), -math.log(least_high)))
        if self.open_low:
            most = 2.0 * math.acosh(1.0 / math.sqrt(least_low))
            return self.low + span / torch.cosh(0.5 * numerics.between(u, -most, most)).square()
        most = 2.0 * math.atanh(math.sqrt(1.0 - 2.0 * least_high))
        return self.low + span * torch.tanh(0.5 * numerics.between(u, -most, most)).square()

    def _above(self, u: Tensor) -> Tensor:
        info = torch.finfo(u.dtype)
        most = -math.log(info.tiny)
        if self.open_low:
            return self.low + torch.exp(numerics.between(u, math.log(max(info.tiny, 2.0 * info.eps * abs(self.low))), most))
        root = torch.sinh(0.5 * numerics.between(u, -most, most))
        above = root.abs() if self.low in self.flat else _squared(root)
        return above if self.low == 0 else self.low + above

    def to_unconstrained(self, x: Tensor) -> Tensor:
        """A u >= 0 (any, above an open end) with ``from_unconstrained(u) = x``; where no gradient is, one beside it.

        Closed ends have no slope: a start on one begins sqrt(eps) inside. ``flat`` values neither: there eps^(1/4) above, sqrt(eps)
        in what the parameter does, which grows as the square.
        """
        margin = math.sqrt(torch.finfo(x.dtype).eps)
        for value in self.flat:
            x = torch.where(x == value, value + math.sqrt(margin), x)
        if not math.isfinite(self.low):
            return x if not math.isfinite(self.high) else self._mirrored().to_unconstrained(-x)
        if math.isfinite(self.high):
            return self._part_to_unconstrained((x - self.low) / (self.high - self.low), margin)
        above = torch.where(x <= self.low, margin, x - self.low)
        if self.open_low:
            return torch.log(above)
        return 2.0 * torch.asinh(above if self.low in self.flat else torch.sqrt(above))

    def _part_to_unconstrained(self, part: Tensor, margin: float) -> Tensor:
        part = torch.where(part <= 0, margin, torch.where(part >= 1, 1.0 - margin, part))
        if self.open_low and self.open_high:
            return torch.logit(part)
        if self.open_low:
            return 2.0 * torch.acosh(torch.rsqrt(part))
        return 2.0 * (torch.atanh if self.open_high else torch.asin)(torch.sqrt(part))

    def _mirrored(self) -> "Interval":
        return Interval(-self.high, -self.low, self.open_high, self.open_low, flat=tuple(-x for x in self.flat))

    def draw(self, shape: tuple[int, ...], generator: torch.Generator, dtype: torch.dtype = torch.float64) -> Tensor:
        """Random legal values: log-uniform over a positive typical range of more than one decade, uniform otherwise."""
        low, high = self.typical or self._span()
        u = 1.0 - torch.rand(shape, generator=generator, dtype=dtype)  # in (0, 1]: a low end may be open
        u = u.clamp_max(1.0 - torch.finfo(dtype).eps) if self.open_high else u
        return low * (high / low) ** u if low > 0 and high / low > 10 else low + (high - low) * u

    def _span(self) -> tuple[float, float]:
        """Some finite part: all of it, or a unit length from its one end, or [-1, 1]."""
        if math.isfinite(self.low):
            return self.low, self.high if math.isfinite(self.high) else self.low + 1.0
        return (self.high - 1.0, self.high) if math.isfinite(self.high) else (-1.0, 1.0)


def _squared(x: Tensor) -> Tensor:
    """As a product, whose derivative takes fewer operations than that of ``square``."""
    return x * x


REAL = Interval()
UNIT = Interval(0.0, 1.0, typical=(0.1, 0.9))
NONNEGATIVE = Interval(0.0, math.inf, typical=(0.1, 2.0))
