"""First and second derivatives of every parameter and direction against finite differences, away from the declared kinks."""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from .subject import Outcome, Probe, generator, leaves, probes

POINTS = 4


def gradients(subject: Any, rng: torch.Generator, thorough: bool = False) -> Outcome:
    """``torch.autograd.gradcheck`` in float64, one input at a time, so that the failing one is named."""
    wrong, count = [], 0
    for probe in probes(subject, rng, 4 * POINTS if thorough else POINTS):
        names, inputs, call = _function(probe, subject)
        for i, name in enumerate(names):
            count += inputs[i].numel()
            if not _passes(torch.autograd.gradcheck, call, inputs, only=i):
                wrong.append(f"{probe.name} by {name}{_where(probe, subject, torch.autograd.gradcheck, i)}")
    return Outcome("gradients", not wrong, float(count), f"wrong: {', '.join(wrong)}" if wrong else "derivatives checked")


def second_gradients(subject: Any, rng: torch.Generator, thorough: bool = False) -> Outcome:
    """``torch.autograd.gradgradcheck`` of all inputs at once, mixed derivatives included; along random directions unless thorough."""
    wrong, count = [], 0
    for probe in probes(subject, rng, POINTS):
        _, inputs, call = _function(probe, subject)
        count += sum(x.numel() for x in inputs)
        if not _passes(_gradgradcheck, call, inputs, fast_mode=not thorough):
            wrong.append(f"{probe.name}{_where(probe, subject, _gradgradcheck, None, fast_mode=not thorough)}")
    return Outcome("second_gradients", not wrong, float(count), f"wrong: {', '.join(wrong)}" if wrong else "inputs checked")


def _gradgradcheck(call: Callable[..., Tensor], inputs: list[Tensor], **how: Any) -> bool:
    """torch's, whose own cotangents are drawn anew at each run and may cancel; these are positive, and always the same."""
    out = call(*inputs)
    cotangents = (0.5 + torch.rand(out.shape, generator=generator(0), dtype=out.dtype)).requires_grad_()
    return torch.autograd.gradgradcheck(call, inputs, cotangents, **how)


def _where(probe: Probe, subject: Any, test: Callable[..., bool], only: int | None, **how: Any) -> str:
    """The first of a probe's points at which a check fails, in words."""
    for k in range(len(next(iter(probe.inputs.values())))):
        one = probe._replace(inputs={name: x[k : k + 1] for name, x in probe.inputs.items()})
        _, inputs, call = _function(one, subject)
        if not _passes(test, call, inputs, only, **how):
            return f" at {one.at(0)}"
    return ""


def _function(probe: Probe, subject: Any) -> tuple[list[str], list[Tensor], Callable[..., Tensor]]:
    names, parameters, rebuild = leaves(subject)
    k = len(parameters)

    def call(*xs: Tensor) -> Tensor:
        return probe.call(rebuild(list(xs[:k])), *xs[k:])

    return names + list(probe.inputs), parameters + list(probe.inputs.values()), call


def _passes(test: Callable[..., bool], call: Callable[..., Tensor], inputs: list[Tensor], only: int | None = None, **how: Any) -> bool:
    asked = [x.detach().clone().requires_grad_(x.is_floating_point() and only in (None, i)) for i, x in enumerate(inputs)]
    # torch's defaults: steps of 1e-6, whose own error in float64 is far below a relative 1e-3
    return test(call, asked, raise_exception=False, **how)
