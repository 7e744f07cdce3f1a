"""The fit: least squares by Gauss-Newton (here), L-BFGS or Adam (torch.optim)."""

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from tqdm import tqdm

import torchbrdf as tb

from .gauss_newton import GaussNewton
from .problem import Points, Problem

ITERATIONS = {"gauss-newton": 50, "lbfgs": 500, "adam": 2000}  # at most


class Model(nn.Module):
    """Material and lights together: everything that the fit may change."""

    def __init__(self, material: nn.Module, problem: Problem, plan: tb.Plan) -> None:
        super().__init__()
        self.shader = tb.nn.Shader(material, plan)
        self.lights = problem.lights

    def forward(self, p: Points) -> Tensor:
        """Residuals [N, C] of one photograph. Its points are those that the light reaches, so nothing is left to shadow."""
        return self.shader(p.g, self.lights.one(p.g, p.light)) - p.image


class Step(NamedTuple):
    """The mean squared residual after an iteration, and the seconds since the start."""

    loss: float
    seconds: float


class History:
    """The steps of a fit as they come, on a progress bar; the first is the start."""

    def __init__(self, count: int, bar: Any, clock: Callable[[], float]) -> None:
        self.steps: list[Step] = []
        self.count, self.bar, self.clock, self.began = count, bar, clock, clock()

    def note(self, loss: float, iteration: int) -> None:
        """The sum of squared residuals somewhere in an iteration; the least one stays."""
        found = Step(loss / self.count, self.clock() - self.began)
        if iteration == len(self.steps):
            self.steps.append(found)
        elif found.loss < self.steps[iteration].loss:
            self.steps[iteration] = found
        self.bar.update(iteration - self.bar.n)
        self.bar.set_postfix(rms=f"{self.steps[-1].loss ** 0.5:.5f}")


def fit(
    model: Model,
    points: list[Points],
    iterations: int | None = None,
    optimizer: str = "gauss-newton",
    rate: float = 0.03,
    clock: Callable[[], float] = time.perf_counter,
) -> list[Step]:
    """Minimise the mean squared residual; returns it after every iteration. ``rate`` is Adam's."""
    most = ITERATIONS[optimizer] if iterations is None else iterations
    with tqdm(total=most, desc="fit", unit="step", leave=False) as bar:
        history = History(sum(p.image.numel() for p in points), bar, clock)
        if optimizer == "gauss-newton":
            _gauss_newton(model, points, most, history)
        elif optimizer == "lbfgs":
            _lbfgs(model, points, most, history)
        else:
            _adam(model, points, most, history, rate)
    return history.steps


def squares(model: Model, points: list[Points]) -> Tensor:
    """The loss: the sum of the squared residuals."""
    return torch.stack([model(p).square().sum() for p in points]).sum()


def _gauss_newton(model: Model, points: list[Points], iterations: int, history: History) -> None:
    solver = GaussNewton(model, points)
    history.note(solver.loss, 0)
    for k in range(iterations):
        going = solver.step()
        history.note(solver.loss, k + 1)
        if not going:
            return


def _lbfgs(model: Model, points: list[Points], iterations: int, history: History) -> None:
    optimiser = torch.optim.LBFGS(
        model.parameters(), max_iter=iterations, history_size=30, line_search_fn="strong_wolfe", tolerance_grad=0.0, tolerance_change=0.0
    )
    scale = sum(float(p.image.square().sum()) for p in points)

    def closure() -> Tensor:
        optimiser.zero_grad()
        loss = squares(model, points) / scale
        loss.backward()
        history.note(float(loss.detach()) * scale, optimiser.state[optimiser._params[0]].get("n_iter", 0))
        return loss

    optimiser.step(closure)


def _adam(model: Model, points: list[Points], iterations: int, history: History, rate: float) -> None:
    optimiser = torch.optim.Adam(model.parameters(), lr=rate)
    for k in range(iterations + 1):
        optimiser.zero_grad()
        loss = squares(model, points)
        loss.backward()
        history.note(float(loss.detach()), k)
        if k < iterations:
            optimiser.step()
