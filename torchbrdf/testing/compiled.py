"""``torch.compile(fullgraph=True)`` must give what eager gives, forward and backward."""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from ..torch_compat import compile_error
from .subject import Outcome, batched, leaves, probes

ROUNDINGS = 2.0**14  # of float32: fused sums are taken in another order, which exponents of 200 magnify


def compiles(subject: Any, rng: torch.Generator, thorough: bool = False, backend: str = "inductor") -> Outcome:
    """Value and gradients of the compiled function against eager, in float32.

    ``backend="aot_eager"`` traces the same graph and its backward pass in a second or two, without fusing anything.
    """
    worst = 0.0
    for probe in probes(subject, rng, 64):
        xs = [x.float() for x in probe.inputs.values()]
        _, parameters, rebuild = leaves(batched(subject, len(xs[0]), rng).to(torch.float32))
        k, call = len(parameters), probe.call

        def function(*ts: Tensor, k: int = k, call: Callable[..., Tensor] = call, rebuild: Callable[..., Any] = rebuild) -> Tensor:
            return call(rebuild(list(ts[:k])), *ts[k:])

        torch.compiler.reset()
        try:
            found = _with_gradients(torch.compile(function, fullgraph=True, backend=backend), [*parameters, *xs])
        except compile_error() as error:
            if "InvalidCxxCompiler" in f"{error}":
                return Outcome.absent("compiles", "there is no C++ compiler")
            return Outcome("compiles", False, None, f"{type(error).__name__}: {str(error).splitlines()[0]}")
        worst = max(worst, *map(_difference, found, _with_gradients(function, [*parameters, *xs])))
    return Outcome("compiles", worst <= ROUNDINGS * torch.finfo(torch.float32).eps, worst, "compiled against eager, relative")


def _with_gradients(function: Callable[..., Tensor], inputs: list[Tensor]) -> list[Tensor]:
    asked = [x.detach().clone().requires_grad_() for x in inputs]
    out = function(*asked)
    grads = torch.autograd.grad(out.sum(), asked, allow_unused=True, materialize_grads=True)
    return [out.detach(), *grads]


def _difference(a: Tensor, b: Tensor) -> float:
    worst = float((a - b).abs().max() / b.abs().max().clamp_min(1.0))
    return worst if worst == worst else float("inf")
