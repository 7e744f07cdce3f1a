"""The model about its present parameters: products with the derivative J of all residuals, of which nothing is ever stored."""

from collections.abc import Callable, Iterator

import torch
from torch import Tensor, nn

from .problem import Points

WEAKEST = 1e-12
Parts = list[Tensor]  # one tensor per parameter, or per photograph


class Linear:
    """Residuals y and their derivative J where the parameters stand now; good until these are changed in place.

    The graphs of y and of u -> J'u are built once; J v is the derivative of <J'u, v> by u (reverse mode twice: Pearlmutter 1994).
    """

    def __init__(self, model: nn.Module, points: list[Points]) -> None:
        self.parameters = list(model.parameters())
        self.residuals = [model(p) for p in points]
        self.duals = [torch.zeros_like(y, requires_grad=True) for y in self.residuals]
        # None for the parameters that a photograph does not depend on: those of another one's light
        self.backs = [
            torch.autograd.grad(y, self.parameters, u, create_graph=True, allow_unused=True)
            for y, u in zip(self.residuals, self.duals, strict=True)
        ]

    @property
    def loss(self) -> float:
        """The sum of the squared residuals."""
        return sum(float(y.detach().square().sum()) for y in self.residuals)

    def transposed(self, u: Parts) -> Parts:
        """J'u."""
        return list(torch.autograd.grad(self.residuals, self.parameters, u, retain_graph=True, allow_unused=True, materialize_grads=True))

    def forward(self, v: Parts) -> Parts:
        """J v."""
        found = []
        for u, back in zip(self.duals, self.backs, strict=True):
            used = [(b, x) for b, x in zip(back, v, strict=True) if b is not None]
            found += torch.autograd.grad([b for b, _ in used], u, [x for _, x in used], retain_graph=True)
        return found

    def product(self, v: Parts) -> Parts:
        """J'J v, the product with half the Gauss-Newton Hessian of the loss."""
        return self.transposed(self.forward(v))

    def gradient(self) -> Parts:
        """J'y, half the gradient of the loss."""
        return self.transposed([y.detach() for y in self.residuals])

    def diagonal(self, generator: torch.Generator, probes: int) -> Parts:
        """The diagonal of J'J, estimated: the mean of (J'z)^2 over random signs z (Bekas, Kokiopoulou & Saad 2007)."""

        def signs(y: Tensor) -> Tensor:
            return torch.randint(0, 2, y.shape, generator=generator).to(y) * 2.0 - 1.0

        draws = [self.transposed([signs(y) for y in self.residuals]) for _ in range(probes)]
        return [torch.stack(d).square().mean(0) for d in zip(*draws, strict=True)]


def usable(diagonal: Parts) -> Parts:
    """The diagonal as a scale: what no photograph shows gets a tiny part of the largest, not 0."""
    largest = max(float(d.max()) for d in diagonal)
    return [d.clamp_min(WEAKEST * largest if largest > 0 else 1.0) for d in diagonal]


def hessian_product(model: nn.Module, points: list[Points], v: Parts) -> Parts:
    """H v with the whole Hessian of the loss (the sum of squared residuals), by reverse mode twice."""
    parameters = list(model.parameters())
    loss = torch.stack([model(p).square().sum() for p in points]).sum()
    slope = torch.autograd.grad(loss, parameters, create_graph=True, allow_unused=True, materialize_grads=True)
    return list(torch.autograd.grad(slope, parameters, v, allow_unused=True, materialize_grads=True))


def conjugate_gradients(apply: Callable[[Parts], Parts], b: Parts, scale: Parts) -> Iterator[tuple[Parts, float, float]]:
    """Ever better x with ``apply(x) = b``, preconditioned by the diagonal ``scale`` (Hestenes & Stiefel 1952), without an end.

    With each: r'z, the square of the scaled residual that is left, and what the step added to b'x, which grows towards b'A^-1 b.
    """
    x, r = [torch.zeros_like(g) for g in b], b
    z = [a / d for a, d in zip(r, scale, strict=True)]
    direction, rz = z, dot(r, z)
    while rz > 0:
        bent = apply(direction)
        curvature = dot(direction, bent)
        if not curvature > 0:  # nothing but rounding is left
            return
        length = rz / curvature
        gain = length * rz
        x, r = plus(x, length, direction), plus(r, -length, bent)
        z = [a / d for a, d in zip(r, scale, strict=True)]
        rz, before = dot(r, z), rz
        yield x, rz, gain
        direction = plus(z, rz / before, direction)


def dot(a: Parts, b: Parts) -> float:
    """<a, b> over all parts."""
    return sum(float((x.detach() * y.detach()).sum()) for x, y in zip(a, b, strict=True))


def plus(a: Parts, s: float, b: Parts) -> Parts:
    """a + s b."""
    return [x + s * y for x, y in zip(a, b, strict=True)]
