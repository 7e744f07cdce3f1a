"""How sure a fit is."""

import torch
from torch import Tensor, nn

from .linear import Linear, Parts, dot, plus
from .problem import Points

STEPS = 150
SETTLED = 0.01  # ten steps together add less than this fraction


class Confidence:
    """Standard deviations from the inverse of the Gauss-Newton Hessian H = J'J / sigma^2.

    ``sigma`` is the root mean square of the residual.
    """

    def __init__(self, model: nn.Module, points: list[Points]) -> None:
        self.linear = Linear(model, points)
        self.variance = self.linear.loss / sum(p.image.numel() for p in points)

    def of(self, quantity: Tensor) -> float:
        """One standard deviation of a scalar of the parameters: sqrt(c' H^-1 c) with c its gradient."""
        c = torch.autograd.grad(quantity, self.linear.parameters, allow_unused=True, materialize_grads=True, retain_graph=True)
        return (self.variance * self._inverse_form(list(c))) ** 0.5

    def _inverse_form(self, c: Parts) -> float:
        """c' (J'J)^-1 c by conjugate gradients (Hestenes & Stiefel 1952), whose every step adds (r'r)^2 / d'Hd to it."""
        r, d, rr = c, c, dot(c, c)
        sums = [0.0]
        for k in range(STEPS):
            hd = self.linear.product(d)
            curvature = dot(d, hd)
            if curvature <= 0 or (k > 10 and sums[-1] - sums[-11] < SETTLED * sums[-1]):
                break
            step = rr / curvature
            sums.append(sums[-1] + step * rr)
            r = plus(r, -step, hd)
            rr, before = dot(r, r), rr
            d = plus(r, rr / before, d)
        return sums[-1]
