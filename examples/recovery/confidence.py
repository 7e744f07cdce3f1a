"""How sure a fit is."""

import itertools

import torch
from torch import Tensor, nn

from .linear import Linear, conjugate_gradients, usable
from .problem import Points

STEPS, PROBES = 150, 16
SETTLED = 0.01  # ten steps together add less than this fraction


class Confidence:
    """Standard deviations from the inverse of the Gauss-Newton Hessian H = J'J / sigma^2.

    ``sigma`` is the root mean square of the residual.
    """

    def __init__(self, model: nn.Module, points: list[Points]) -> None:
        self.linear = Linear(model, points)
        self.scale = usable(self.linear.diagonal(torch.Generator().manual_seed(0), PROBES))
        self.variance = self.linear.loss / sum(p.image.numel() for p in points)

    def of(self, quantity: Tensor) -> float:
        """One standard deviation of a scalar of the parameters: sqrt(c' H^-1 c) with c its gradient, from below."""
        c = torch.autograd.grad(quantity, self.linear.parameters, allow_unused=True, materialize_grads=True, retain_graph=True)
        sums = [0.0]
        for _, _, gain in itertools.islice(conjugate_gradients(self.linear.product, list(c), self.scale), STEPS):
            sums.append(sums[-1] + gain)
            if len(sums) > 11 and sums[-1] - sums[-11] < SETTLED * sums[-1]:
                break
        return (self.variance * sums[-1]) ** 0.5
