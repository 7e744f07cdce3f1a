"""Gauss-Newton with the damping of Levenberg & Marquardt, without a matrix: conjugate gradients solve for each step.

The step d minimises |y + J d|^2 + damping d'D d, where D is the diagonal of J'J (Marquardt 1963: no step depends on the units of a
parameter). It is taken if the loss falls; how well the fall was foretold steers the damping. D also preconditions the solver.
Where a parameter has a range, its field stores an angle or a logarithm: a step of 1, a third of the way or a factor of e, is as far
as a linear model of the highlights can be trusted, and longer ones are cut there.
"""

import itertools

import torch
from torch import Tensor, nn
from torch.func import functional_call

from torchbrdf.interval import REAL
from torchbrdf.nn.fields import Stored

from .linear import Linear, Parts, conjugate_gradients, dot, usable
from .problem import Points

PROBES = 4  # for D: rough, but the mean goes on over the steps
SOLVED = 0.1  # the residual of each solve: exact ones are wasted far from the end (Dembo, Eisenstat & Steihaug 1982)
SOLVER_STEPS = 50
STRONGEST = 1e12  # damping: no step is shorter
DONE = 1e-3  # fall of the loss in units of the mean square of one residual: that of the noise in one number, if it is a good fit
LONGEST = 1.0


class GaussNewton:
    """``step()`` until it says that there is nothing left to gain. ``products`` counts those with J'J."""

    def __init__(self, model: nn.Module, points: list[Points]) -> None:
        self.model, self.points = model, points
        self.damping, self.products = 1.0, 0
        self.enough = DONE / sum(p.image.numel() for p in points)
        self.scale: Parts | None = None
        self.generator = torch.Generator().manual_seed(0)
        ranged = {id(m.raw) for m in model.modules() if isinstance(m, Stored) and m.constraint is not REAL}
        self.longest = [LONGEST if id(p) in ranged else float("inf") for p in model.parameters()]
        self.loss = self._loss_at(dict(model.named_parameters()))

    def step(self) -> bool:
        """One accepted step; False where no step lowers the loss, or one only by ``DONE``."""
        here = Linear(self.model, self.points)
        gradient, scale = here.gradient(), self._scales(here)
        while self.damping < STRONGEST:
            move = [d.clamp(-most, most) for d, most in zip(self._solve(here, gradient, scale), self.longest, strict=True)]
            foretold = -2.0 * dot(gradient, move) - dot(move, here.product(move))
            moved = {name: p.detach() + d for (name, p), d in zip(self.model.named_parameters(), move, strict=True)}
            loss = self._loss_at(moved)
            fall = self.loss - loss
            if foretold <= 0 or not fall >= 0:  # a loss that is not finite fails this, too
                if 0 <= foretold <= self.enough * self.loss:
                    return False
                self.damping *= 10.0
                continue
            self._take(moved, loss)
            self.damping *= 0.1 if fall > 0.75 * foretold else 1.0 if fall > 0.25 * foretold else 4.0
            return fall > self.enough * loss
        return False

    def _loss_at(self, values: dict[str, Tensor]) -> float:
        with torch.no_grad():
            return sum(float(functional_call(self.model, values, (p,)).square().sum()) for p in self.points)

    def _take(self, moved: dict[str, Tensor], loss: float) -> None:
        self.loss = loss
        with torch.no_grad():
            for name, p in self.model.named_parameters():
                p.copy_(moved[name])

    def _scales(self, here: Linear) -> Parts:
        """D, a running mean."""
        new = here.diagonal(self.generator, PROBES)
        self.scale = new if self.scale is None else [0.5 * (a + b) for a, b in zip(self.scale, new, strict=True)]
        return usable(self.scale)

    def _solve(self, here: Linear, gradient: Parts, scale: Parts) -> Parts:
        """(J'J + damping D) x = -gradient, roughly."""

        def damped(v: Parts) -> Parts:
            self.products += 1
            return [h + self.damping * d * x for h, d, x in zip(here.product(v), scale, v, strict=True)]

        move = [torch.zeros_like(g) for g in gradient]
        enough = SOLVED**2 * sum(float((g * g / d).sum()) for g, d in zip(gradient, scale, strict=True))
        steps = conjugate_gradients(damped, [-g for g in gradient], scale)
        for found, left, _ in itertools.islice(steps, SOLVER_STEPS):
            move = found
            if left <= enough:
                break
        return move
