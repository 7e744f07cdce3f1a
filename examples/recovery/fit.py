"""The fit: least squares by L-BFGS (torch.optim), and how sure it is, from the inverse of its Gauss-Newton Hessian."""

from collections.abc import Callable

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
        """Residuals, 0 where a pixel does not count."""
        radiance = self.shader(p.g, self.lights(p.g), visibility=p.visibility, per_light=True)
        return torch.where(p.weights, radiance - p.images, 0.0)


def fit(model: Model, points: list[Points], iterations: int, label: str = "fit") -> list[float]:
    """Minimise the mean squared residual; returns the loss at every evaluation."""
    optimiser = torch.optim.LBFGS(
        model.parameters(), max_iter=iterations, history_size=30, line_search_fn="strong_wolfe", tolerance_grad=0.0, tolerance_change=0.0
    )
    count = sum(int(p.weights.sum()) * p.images.shape[-1] for p in points)
    scale = sum(float(torch.where(p.weights, p.images, 0).square().sum()) for p in points)
    history: list[float] = []
    with tqdm(total=iterations, desc=label, unit="step", leave=False) as bar:

        def closure() -> Tensor:
            optimiser.zero_grad()
            loss = sum((model(p).square().sum() for p in points), torch.zeros(())) / scale
            loss.backward()
            history.append(float(loss) * scale / count)
            steps = optimiser.state[optimiser._params[0]].get("n_iter", 0)
            bar.update(steps - bar.n)
            bar.set_postfix(rms=f"{history[-1] ** 0.5:.5f}")
            return loss

        optimiser.step(closure)
    return history


def standard_error(model: Model, points: list[Points], quantity: Callable[[dict[str, Tensor]], Tensor], steps: int = 60) -> float:
    """One standard deviation of a scalar of the parameters: sqrt(c' H^-1 c), H = J'J / sigma^2 (Gauss-Newton), by CG.

    ``sigma`` is the root mean square of the residual. Nothing of H is stored: J v by forward mode, J' r by reverse mode.
    """
    parameters = {k: v.detach() for k, v in model.named_parameters()}
    residual = [model(p).detach() for p in points]
    variance = sum(float(r.square().sum()) for r in residual) / sum(int(p.weights.sum()) * p.images.shape[-1] for p in points)
    names = list(parameters)

    def product(v: dict[str, Tensor]) -> dict[str, Tensor]:
        total = {k: torch.zeros_like(x) for k, x in parameters.items()}
        for p in points:
            predict = lambda q, p=p: torch.func.functional_call(model, q, (p,))  # noqa: E731
            _, forward = torch.func.jvp(predict, (parameters,), (v,))
            (back,) = torch.func.vjp(predict, parameters)[1](forward)
            total = {k: total[k] + back[k] for k in names}
        return total

    c = torch.func.grad(lambda q: quantity(q))(parameters)
    return float((variance * max(_dot(c, _solve(product, c, steps)), 0.0)) ** 0.5)


def _dot(a: dict[str, Tensor], b: dict[str, Tensor]) -> float:
    return sum(float((a[k] * b[k]).sum()) for k in a)


def _solve(product: Callable[[dict[str, Tensor]], dict[str, Tensor]], c: dict[str, Tensor], steps: int) -> dict[str, Tensor]:
    """Conjugate gradients on H x = c (Hestenes & Stiefel 1952)."""
    x = {k: torch.zeros_like(v) for k, v in c.items()}
    r, d, rr = dict(c), dict(c), _dot(c, c)
    first = rr
    for _ in range(steps):
        hd = product(d)
        curvature = _dot(d, hd)
        if curvature <= 0 or rr <= first * torch.finfo(torch.float64).eps:
            break
        step = rr / curvature
        x = {k: x[k] + step * d[k] for k in x}
        r = {k: r[k] - step * hd[k] for k in r}
        rr, before = _dot(r, r), rr
        d = {k: r[k] + (rr / before) * d[k] for k in d}
    return x
