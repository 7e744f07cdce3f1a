"""The fit: least squares by L-BFGS (torch.optim), and how sure it is, from the inverse of its Gauss-Newton Hessian."""

import torch
from torch import Tensor, nn
from tqdm import tqdm

import torchbrdf as tb

from .problem import Points, Problem


class Model(nn.Module):
    """Material and lights together: everything that the fit may change."""

    def __init__(self, material: nn.Module, problem: Problem, plan: tb.Plan) -> None:
        super().__init__()
        self.shader = tb.nn.Shader(material, plan)
        self.lights = problem.lights

    def forward(self, p: Points) -> Tensor:
        """Residuals [N, C] of one photograph. Its points are those that the light reaches, so nothing is left to shadow."""
        return self.shader(p.g, self.lights.one(p.g, p.light)) - p.image


def fit(model: Model, points: list[Points], iterations: int, label: str = "fit") -> list[float]:
    """Minimise the mean squared residual; returns the loss at every evaluation."""
    optimiser = torch.optim.LBFGS(
        model.parameters(), max_iter=iterations, history_size=30, line_search_fn="strong_wolfe", tolerance_grad=0.0, tolerance_change=0.0
    )
    count = sum(p.image.numel() for p in points)
    scale = sum(float(p.image.square().sum()) for p in points)
    history: list[float] = []
    with tqdm(total=iterations, desc=label, unit="step", leave=False) as bar:

        def closure() -> Tensor:
            optimiser.zero_grad()
            loss = sum((model(p).square().sum() for p in points), torch.zeros(())) / scale
            loss.backward()
            history.append(float(loss.detach()) * scale / count)
            steps = optimiser.state[optimiser._params[0]].get("n_iter", 0)
            bar.update(steps - bar.n)
            bar.set_postfix(rms=f"{history[-1] ** 0.5:.5f}")
            return loss

        optimiser.step(closure)
    return history


class Confidence:
    """How sure a fit is: standard deviations from the inverse of its Gauss-Newton Hessian H = J'J / sigma^2.

    ``sigma`` is the root mean square of the residual. Nothing of H is stored: the graph of the residuals y and of u -> J'u is
    built once; J v is the derivative of <J'u, v> by u (Pearlmutter's trick, in reverse mode twice), and H v = J'(J v).
    """

    def __init__(self, model: Model, points: list[Points]) -> None:
        self.parameters = list(model.parameters())
        self.residuals = [model(p) for p in points]
        self.duals = [torch.zeros_like(y, requires_grad=True) for y in self.residuals]
        # None for the parameters that a photograph does not depend on: those of another one's light
        self.backs = [
            torch.autograd.grad(y, self.parameters, u, create_graph=True, allow_unused=True)
            for y, u in zip(self.residuals, self.duals, strict=True)
        ]
        count = sum(p.image.numel() for p in points)
        self.variance = sum(float(y.detach().square().sum()) for y in self.residuals) / count

    def product(self, v: list[Tensor]) -> list[Tensor]:
        """J'J v."""
        total = [torch.zeros_like(x) for x in v]
        for y, u, back in zip(self.residuals, self.duals, self.backs, strict=True):
            used = [(b, x) for b, x in zip(back, v, strict=True) if b is not None]
            (forward,) = torch.autograd.grad([b for b, _ in used], u, [x for _, x in used], retain_graph=True)
            parts = torch.autograd.grad(y, self.parameters, forward, retain_graph=True, allow_unused=True, materialize_grads=True)
            total = [t + p for t, p in zip(total, parts, strict=True)]
        return total

    def of(self, quantity: Tensor, steps: int = 150) -> float:
        """One standard deviation of a scalar of the parameters: sqrt(c' H^-1 c) with c its gradient."""
        found = torch.autograd.grad(quantity, self.parameters, allow_unused=True, retain_graph=True)
        c = [torch.zeros_like(p) if g is None else g for g, p in zip(found, self.parameters, strict=True)]
        return (self.variance * self._inverse_form(c, steps)) ** 0.5

    def _inverse_form(self, c: list[Tensor], steps: int) -> float:
        """c' (J'J)^-1 c by conjugate gradients (Hestenes & Stiefel 1952), whose every step adds (r'r)^2 / d'Hd to it.

        Ends when ten steps together add less than a hundredth.
        """
        r, d, rr = c, c, _dot(c, c)
        sums = [0.0]
        for k in range(steps):
            hd = self.product(d)
            curvature = _dot(d, hd)
            if curvature <= 0 or (k > 10 and sums[-1] - sums[-11] < 0.01 * sums[-1]):
                break
            step = rr / curvature
            sums.append(sums[-1] + step * rr)
            r = [a - step * b for a, b in zip(r, hd, strict=True)]
            rr, before = _dot(r, r), rr
            d = [a + (rr / before) * b for a, b in zip(r, d, strict=True)]
        return sums[-1]


def _dot(a: list[Tensor], b: list[Tensor]) -> float:
    return sum(float((x * y).sum()) for x, y in zip(a, b, strict=True))
