"""What a formula brings along to be measured: its truth, its hard grid, and what is claimed of it."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

POINTS = 10_000  # of a grid at least, beside what is listed by hand: what is published, and the slow tests
FEWER = 2_000  # the same with a smaller bulk, for the tests that a person waits for: every special point is kept


class Columns(dict[str, np.ndarray]):
    """A grid by the names of the inputs, and the dtype that it is a grid of."""

    dtype = torch.float32

    @property
    def working(self) -> torch.finfo:
        """Of the dtype that is computed in."""
        return torch.finfo(torch.float64 if self.dtype == torch.float64 else torch.float32)


def everywhere(x: Columns) -> Any:
    """No restriction."""
    return np.ones(len(next(iter(x.values()))), dtype=bool)


def nowhere(x: Columns) -> Any:
    """No point."""
    return ~everywhere(x)


@dataclasses.dataclass(frozen=True, eq=False)
class Case:
    """One formula. ``inputs`` are scalars; ``call`` maps tensors ``[N]`` to a tuple of tensors ``[N]``, ``truth`` the same on duals.

    ``error`` is the unit of its error: ``"ulp"`` of each result; ``"length"``, ulp of the length of the vector of results;
    ``"scale"``, ulp of the larger of the result and ``scale`` (for sums of products whose terms are of that size);
    ``"exp"``, (4 + 2 |ln(f/f_peak)|) eps, ``peak`` giving f_peak; ``"backward"``, what rounding every input once may change,
    eps (|f| + sum |x| |df/dx|), a vector counting as one x. Masks of points take the columns by name.
    """

    name: str
    inputs: tuple[str, ...]
    call: Callable[..., Sequence[Tensor]]
    truth: Callable[..., Sequence[Any]]
    grid: Callable[["Draw"], np.ndarray]
    everyday: Callable[[Columns], Any]
    covers: tuple[str, ...]
    error: str = "ulp"
    scale: float = 1.0
    peak: Callable[[Columns], Any] | None = None
    kinks: dict[str, Callable[[Columns], Any]] = dataclasses.field(default_factory=dict)  # reason: where slopes are not claimed
    outside: dict[str, Callable[[Columns], Any]] = dataclasses.field(default_factory=dict)  # reason: where nothing but finiteness is
    outside_twice: dict[str, Callable[[Columns], Any]] = dataclasses.field(default_factory=dict)  # reason: where no second ones are
    at_most_one: bool = False
    signed: bool = False
    vectors: bool = False
    points: int = POINTS
    source: str = ""  # text of a truth that stands in the package; a kept one is made anew when it changes

    def on(self, points: int) -> "Case":
        """The same formula on a grid of another size."""
        return dataclasses.replace(self, points=points)

    def drawn(self, dtype: torch.dtype) -> np.ndarray:
        """The grid in one dtype ``[N, n]``, N at least ``points``."""
        return self.grid(Draw(dtype, self.points))

    def columns(self, points: np.ndarray, dtype: torch.dtype) -> Columns:
        """The grid by the names of the inputs."""
        found = Columns(zip(self.inputs, points.T, strict=True))
        found.dtype = dtype
        return found


class Draw:
    """Random and special numbers of one dtype, the same everywhere. Arrays of float64 that the dtype represents exactly.

    ``points`` is how many a grid draws at random; what it lists by hand does not depend on it.
    """

    def __init__(self, dtype: torch.dtype, points: int = POINTS, seed: int = 0) -> None:
        self.dtype, self.info, self.points = dtype, torch.finfo(dtype), points
        self.rng = np.random.default_rng(seed)
        self.half = dtype in (torch.float16, torch.bfloat16)
        self.denormal = self.info.smallest_normal * self.info.eps

    def rounded(self, x: Any) -> np.ndarray:
        """To the dtype and back."""
        return torch.as_tensor(np.asarray(x, dtype=np.float64)).to(self.dtype).double().numpy()

    def near(self, x: float, steps: int = 2) -> list[float]:
        """``x`` and its neighbours, ``steps`` to each side."""
        below = above = torch.tensor(x, dtype=torch.float64).to(self.dtype)
        found = [below.item()]
        for _ in range(steps):
            below = torch.nextafter(below, torch.tensor(-torch.inf, dtype=self.dtype))
            above = torch.nextafter(above, torch.tensor(torch.inf, dtype=self.dtype))
            found += [below.item(), above.item()]
        return found

    def cosines(self) -> list[float]:
        """The ends of [0, 1] and their neighbours to the ulp, denormal and tiny ones."""
        return [-self.denormal, -0.0, 0.0, self.denormal, self.info.tiny, self.info.eps, 1e-3, 0.5, *self.near(1.0)]

    def uniform(self, count: int, low: float = 0.0, high: float = 1.0) -> np.ndarray:
        """Evenly."""
        return self.rng.uniform(low, high, count)

    def spread(self, count: int, low: float, high: float) -> np.ndarray:
        """Evenly in the logarithm."""
        return np.exp(self.rng.uniform(np.log(low), np.log(high), count))

    def cosine_bulk(self, count: int) -> np.ndarray:
        """Half evenly, a quarter towards grazing, a quarter towards the normal, to four digits."""
        t = self.spread(count, 1e-4, 1.0)
        which = self.rng.integers(0, 4, count)
        return np.select([which < 2, which == 2], [self.uniform(count), t], 1.0 - t)

    def product(self, *lists: Sequence[float]) -> np.ndarray:
        """Every combination of special values ``[M, n]``."""
        return np.stack([m.ravel() for m in np.meshgrid(*[self.rounded(v) for v in lists], indexing="ij")], 1)

    def fill(self, special: np.ndarray, *bulk: Callable[[int], np.ndarray]) -> np.ndarray:
        """The special points and a bulk, together at least ``points`` and the bulk at least three quarters."""
        count = max(self.points - len(special), 3 * len(special))
        return np.concatenate([special, self.rounded(np.stack([b(count) for b in bulk], 1))])
