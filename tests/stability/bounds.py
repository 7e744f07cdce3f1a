"""What must hold. Every number is from the requirement or from the decisions of docs/numerics.md; none is what came out.

Errors of values at p99.9 are in the unit of the case (``Case.error``); slopes and second derivatives, on everyday ranges, are
relative to the slope or to the value, whichever is larger.
"""

import torch

from .case import POINTS
from .curvature import Curvature
from .measure import Figures

SINGLE, DOUBLE, HALVES = torch.float32, torch.float64, (torch.bfloat16, torch.float16)

# ---- over the whole hard grid, in every dtype
VALUES_NOT_FINITE = SLOPES_NOT_FINITE = SECONDS_NOT_FINITE = NEGATIVE = ABOVE_ONE = 0
NO_NUMBERS = ("value overflows", "slope overflows")  # of the dtype: nothing is left out that could be claimed
EXCLUDED = 0.01  # of a whole grid, whatever the reasons; a smaller one holds the same special points, so they count as of a whole one

# ---- values at p99.9
ULP = 16.0  # algebraic formulas, in ulp of the result (of the vector's length; of 1 where terms of that size are added)
EXPONENTIAL = 1.0  # in (4 + 2 |ln(f / f_peak)|) eps
BACKWARD = 16.0  # formulas of several directions, in what one rounding of every input may change
HALF_ULP = 1.0  # bfloat16 and float16: computed in float32, rounded once
VALUE = {"ulp": ULP, "length": ULP, "scale": ULP, "exp": EXPONENTIAL, "backward": BACKWARD}

# ---- everyday ranges, relative
SLOPE_SCALAR, SLOPE_VECTOR = 1e-4, 1e-3  # float32
SECOND = {DOUBLE: 1e-9, SINGLE: 1e-3}
PHONG_FROM_VECTORS = 2e-5  # the value, float32, where f > 1e-3 of its peak and the exponent is at most 3e3 (here 200)

# ---- compiled beside eager
COMPILED = 2.0  # times the eager figure
NOISE = 1.0  # ulp below which a ratio says nothing


def value_bound(error: str, dtype: torch.dtype) -> float:
    """At p99.9."""
    return HALF_ULP if dtype in HALVES else VALUE[error]


def slope_bound(vectors: bool, dtype: torch.dtype) -> float:
    """On everyday ranges. Half types round the slope itself once."""
    return max(SLOPE_VECTOR if vectors else SLOPE_SCALAR, 2.0 * torch.finfo(dtype).eps)


def violations(figures: Figures, error: str, vectors: bool, dtype: torch.dtype) -> list[str]:
    """What does not hold, in words; empty if all does."""
    f = figures
    found = [
        f"{count} {what}"
        for count, what, allowed in (
            (f.values_not_finite, "values not finite", VALUES_NOT_FINITE),
            (f.slopes_not_finite, "slopes not finite", SLOPES_NOT_FINITE),
            (f.seconds_not_finite, "second derivatives not finite", SECONDS_NOT_FINITE),
            (f.negative, "values negative", NEGATIVE),
            (f.above_one, "reflectances above 1", ABOVE_ONE),
        )
        if count > allowed
    ]
    limits = [
        ("excluded points", sum(n for reason, n in f.excluded.items() if reason not in NO_NUMBERS) / max(f.points, POINTS), EXCLUDED),
        ("value at p99.9", f.p999, value_bound(error, dtype)),
        ("everyday slope", f.slope_everyday, slope_bound(vectors, dtype)),
        ("everyday second derivative", f.second_everyday, SECOND.get(dtype, 0.0)),
    ]
    return found + [f"{what}: {x:.3g} > {limit:.3g}" for what, x, limit in limits if x is not None and not x <= limit]


def undone(compiled: Figures, eager: Figures, error: str) -> list[str]:
    """What compiling made more than twice as bad, in words."""
    pairs = [
        ("value at p99.9", compiled.p999, eager.p999, NOISE if error == "ulp" else 0.0),
        ("worst value", compiled.worst, eager.worst, NOISE),
    ]
    if compiled.slope_everyday is not None and eager.slope_everyday is not None:
        pairs.append(("everyday slope", compiled.slope_everyday, eager.slope_everyday, 0.0))
    return [f"{what}: {c:.3g}, eagerly {e:.3g}" for what, c, e, noise in pairs if not c <= COMPILED * max(e, noise)]


def bent(compiled: Curvature, eager: Curvature, dtype: torch.dtype) -> list[str]:
    """The same of second derivatives, whose own bounds they must meet, too."""
    if compiled.worst is None or eager.worst is None:
        return []
    found = [f"{compiled.not_finite} second derivatives not finite"] if compiled.not_finite > eager.not_finite + SECONDS_NOT_FINITE else []
    if not compiled.worst <= min(SECOND[dtype], COMPILED * max(eager.worst, torch.finfo(dtype).eps)):
        found.append(f"everyday second derivative: {compiled.worst:.3g}, eagerly {eager.worst:.3g}")
    return found
