"""What must not change a result: batch axes, memory, the dtype (but for its rounding), ``vmap``, and the compiler."""

from typing import Any

import torch
from torch import Tensor

from ..bsdf.base import PLANAR_CHANNELS, Bsdf
from ..vector import is_planar
from .subject import Outcome, Probe, batched, leaves, probes

POINTS = 4
ROUNDED = 16.0  # float32 roundings allowed in every input and in the result
ROUNDINGS = 64.0  # of float64 between two orders of the same sums; an exponent of 200 magnifies them most


def broadcasting(subject: Any, rng: torch.Generator, thorough: bool = False) -> Outcome:
    """Batch axes of points and of parameters must broadcast, and give what calls one at a time give."""
    worst = 0.0
    for probe in probes(subject, rng, POINTS):
        many, xs = batched(subject, POINTS, rng), list(probe.inputs.values())
        rows = range(len(xs[0]))
        together = probe.call(many.map(lambda t: t.unsqueeze(1)), *(x.unsqueeze(0) for x in xs))
        singly = [[probe.call(many[i], *(x[j] for x in xs)) for j in rows] for i in range(POINTS)]
        worst = max(worst, _difference(together, _stacked(singly)))
        together = probe.call(subject, xs[0].unsqueeze(1), *(x.unsqueeze(0) for x in xs[1:]))
        singly = [[probe.call(subject, xs[0][i], *(x[j] for x in xs[1:])) for j in rows] for i in rows]
        worst = max(worst, _difference(together, _stacked(singly)) if len(xs) > 1 else 0.0)
    return Outcome("broadcasting", worst <= ROUNDINGS * torch.finfo(torch.float64).eps, worst, "batched against singly, relative")


def _stacked(rows: list[list[Tensor]]) -> Tensor:
    return torch.stack([torch.stack(row) for row in rows])


def _difference(found: Tensor, expected: Tensor) -> float:
    """Over the largest value; infinite where the shapes differ, NaN counted as different."""
    if found.shape != expected.shape:
        return float("inf")
    worst = float((found - expected).abs().max() / expected.abs().max().clamp_min(torch.finfo(expected.dtype).tiny))
    return worst if worst == worst else float("inf")


def planar_memory(subject: Any, rng: torch.Generator, thorough: bool = False) -> Outcome:
    """``evaluate`` of ``[H, W, 3]`` directions must be planar: each channel one contiguous run."""
    name = "planar_memory"
    if not isinstance(subject, Bsdf):
        return Outcome.absent(name, "not a BSDF")
    if subject.channels > PLANAR_CHANNELS:
        return Outcome.absent(name, f"more than {PLANAR_CHANNELS} channels broadcast instead")
    w = torch.randn(3, 5, 3, generator=rng, dtype=torch.float64)
    results = [subject.evaluate(w, -w, w), batched(subject, 5, rng).evaluate(w, w, w)]
    return Outcome(name, all(is_planar(f) for f in results), None, f"strides {results[0].stride()} of shape {list(results[0].shape)}")


def dtypes(subject: Any, rng: torch.Generator, thorough: bool = False) -> Outcome:
    """float32, bfloat16 and float16 against float64 at the same, rounded inputs.

    Allowed is one rounding to the dtype, and what errors of a few float32 roundings in every input amount to, by the
    model's own derivatives. The figure is the largest error over the allowed one.
    """
    worst, where = 0.0, ""
    for probe in probes(subject, rng, 256 if thorough else 64):
        for dtype in (torch.float32, torch.bfloat16, torch.float16):
            found, error = _dtype_error(probe, subject, dtype, rng)
            error = float("inf") if found != dtype or error != error else error
            worst, where = max((worst, where), (error, f" ({str(dtype).removeprefix('torch.')})"))
    return Outcome("dtypes", worst <= 1.0, worst, f"error over the allowed one{where}")


def _dtype_error(probe: Probe, subject: Any, dtype: torch.dtype, rng: torch.Generator) -> tuple[torch.dtype, float]:
    xs = list(probe.inputs.values())
    rounded = batched(subject, len(xs[0]), rng).to(dtype)
    found = probe.call(rounded, *(x.to(dtype) for x in xs))
    exact, slack = _conditioned(probe, rounded.to(torch.float64), [x.to(dtype).double() for x in xs])
    info, single = torch.finfo(dtype), torch.finfo(torch.float32).eps
    # Lobes are flushed to 0 where float32 would turn denormal; a half type has denormals of its own.
    least = 2.0**10 * torch.finfo(torch.float32).tiny + info.smallest_normal * info.eps
    allowed = info.eps * exact.abs() + ROUNDED * single * (slack + exact.abs()) + least
    usable = exact.abs() < info.max
    return found.dtype, float(((found.double() - exact).abs() / allowed)[usable].max())


def _conditioned(probe: Probe, value: Any, xs: list[Tensor]) -> tuple[Tensor, Tensor]:
    """The value, and the sum over all inputs of |derivative| |input|, both ``[N, C]``."""
    _, parameters, rebuild = leaves(value)
    inputs = [x.detach().requires_grad_() for x in (*parameters, *xs)]
    exact = probe.call(rebuild(inputs[: len(parameters)]), *inputs[len(parameters) :])
    slack = []
    for channel in exact.unbind(-1):
        grads = torch.autograd.grad(channel.sum(), inputs, retain_graph=True, allow_unused=True, materialize_grads=True)
        # a direction's components are rounded as parts of a unit vector: against 1, not against themselves
        slack.append(sum((g.abs() * x.detach().abs().amax(-1, keepdim=True)).sum(-1) for g, x in zip(grads, inputs, strict=True)))
    return exact.detach(), torch.stack([s for s in slack if isinstance(s, Tensor)], -1)


def vmap(subject: Any, rng: torch.Generator, thorough: bool = False) -> Outcome:
    """``torch.func.vmap`` over materials and points together must equal the batched call."""
    worst = 0.0
    for probe in probes(subject, rng, POINTS):
        xs = list(probe.inputs.values())
        many = batched(subject, len(xs[0]), rng)
        worst = max(worst, _difference(torch.func.vmap(probe.call)(many, *xs), probe.call(many, *xs)))
    return Outcome("vmap", worst <= ROUNDINGS * torch.finfo(torch.float64).eps, worst, "against the batched call, relative")
