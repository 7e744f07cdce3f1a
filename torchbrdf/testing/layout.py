"""What must not change a result: batch axes, memory, the dtype (but for its rounding), ``vmap``, and the compiler."""

from typing import Any

import torch
from torch import Tensor

from ..bsdf.base import PLANAR_CHANNELS, Bsdf
from ..vector import is_planar
from .subject import Outcome, Probe, batched, calls, leaves, probes

POINTS = 4
ROUNDED = 16.0  # float32 roundings allowed in every input and in the result
ROUNDINGS = 64.0  # of float64 between two orders of the same sums; an exponent of 200 magnifies them most


def broadcasting(subject: Any, rng: torch.Generator, thorough: bool = False) -> Outcome:
    """Batch axes of points and of parameters must broadcast, and give what calls one at a time give: every verb."""
    worst, where = 0.0, ""
    for probe in (*probes(subject, rng, POINTS), *calls(subject, rng, POINTS // 2)):
        try:
            error, what = _broadcast_error(probe, subject, rng)
        except (RuntimeError, ValueError) as raised:
            error, what = float("inf"), f" raised {str(raised).splitlines()[0]}"
        worst, where = max((worst, where), (error, f"; {probe.name}{what}"))
    return Outcome("broadcasting", worst <= ROUNDINGS * torch.finfo(torch.float64).eps, worst, f"batched against singly, relative{where}")


def _broadcast_error(probe: Probe, subject: Any, rng: torch.Generator) -> tuple[float, str]:
    """The larger one of materials beside points, and of the first input beside the others; and of which shapes it is."""
    xs = list(probe.inputs.values())
    rows, many = range(len(xs[0])), batched(subject, len(xs[0]), rng)
    together = probe.call(many.map(lambda t: t.unsqueeze(1)), *(x.unsqueeze(0) for x in xs))
    errors = [(together, [[probe.call(many[i], *(x[j] for x in xs)) for j in rows] for i in rows], "materials [N, 1], points [1, N]")]
    if len(xs) > 1:
        together = probe.call(subject, xs[0].unsqueeze(1), *(x.unsqueeze(0) for x in xs[1:]))
        singly = [[probe.call(subject, xs[0][i], *(x[j] for x in xs[1:])) for j in rows] for i in rows]
        errors.append((together, singly, f"{next(iter(probe.inputs))} [N, 1, 3] beside others [1, N, 3]"))
    return max((_difference(found, _stacked(one)), f": {shapes}") for found, one, shapes in errors)


def _stacked(rows: list[list[Tensor]]) -> Tensor:
    return torch.stack([torch.stack(row) for row in rows])


def _difference(found: Tensor, expected: Tensor) -> float:
    """Over the largest value; infinite where the shapes differ, NaN counted as different."""
    if found.shape != expected.shape:
        return float("inf")
    worst = float((found - expected).abs().max() / expected.abs().max().clamp_min(torch.finfo(expected.dtype).tiny))
    return worst if worst == worst else float("inf")


def planar_memory(subject: Any, rng: torch.Generator, thorough: bool = False) -> Outcome:
    """``evaluate``, ``sample`` and ``directional_albedo`` of ``[H, W, 3]`` directions must be planar: each channel one contiguous run."""
    name = "planar_memory"
    if not isinstance(subject, Bsdf):
        return Outcome.absent(name, "not a BSDF")
    if subject.channels > PLANAR_CHANNELS:
        return Outcome.absent(name, f"more than {PLANAR_CHANNELS} channels broadcast instead")
    w, u = (torch.randn(3, 5, 3, generator=rng, dtype=torch.float64) for _ in range(2))
    results: dict[str, Tensor] = {}
    for one, materials in ((subject, "one material"), (batched(subject, 5, rng), "materials [5]")):
        s = one.sample(w, torch.sigmoid(u), w)
        found = {"evaluate": one.evaluate(w, w, w), "sample: wi": s.wi, "sample: weight": s.weight}
        found["directional_albedo"] = one.directional_albedo(w, w, order=4)
        results |= {f"{verb} of {materials}": x for verb, x in found.items()}
    strided = [f"{verb} has strides {x.stride()} of shape {list(x.shape)}" for verb, x in results.items() if not is_planar(x)]
    detail = "; ".join(strided[:2]) + f" and {len(strided) - 2} more" * (len(strided) > 2)
    return Outcome(name, not strided, None, detail or f"strides {results['evaluate of one material'].stride()}")


def dtypes(subject: Any, rng: torch.Generator, thorough: bool = False) -> Outcome:
    """float32, bfloat16 and float16 against float64 at the same, rounded inputs.

    Allowed is one rounding to the dtype, and what errors of a few float32 roundings in every input amount to, by the
    model's own derivatives. The figure is the largest error over the allowed one.
    """
    worst, where = 0.0, ""
    for probe in probes(subject, rng, 256 if thorough else 64):
        for dtype in (torch.float32, torch.bfloat16, torch.float16):
            error, k = _dtype_error(probe, subject, dtype, rng)
            worst, where = max((worst, where), (error, f"; {str(dtype).removeprefix('torch.')} {probe.name} at {probe.at(k)}"))
    return Outcome("dtypes", worst <= 1.0, worst, f"error over the allowed one{where}")


def _dtype_error(probe: Probe, subject: Any, dtype: torch.dtype, rng: torch.Generator) -> tuple[float, int]:
    """The largest one, infinite for NaN or a result of another type, and which of the inputs it is at."""
    xs = list(probe.inputs.values())
    rounded = batched(subject, len(xs[0]), rng).to(dtype)
    found = probe.call(rounded, *(x.to(dtype) for x in xs))
    exact, slack = _conditioned(probe, rounded.to(torch.float64), [x.to(dtype).double() for x in xs])
    info, single = torch.finfo(dtype), torch.finfo(torch.float32).eps
    # Lobes are flushed to 0 where float32 would turn denormal; a half type has denormals of its own.
    least = 2.0**10 * torch.finfo(torch.float32).tiny + info.smallest_normal * info.eps
    allowed = info.eps * exact.abs() + ROUNDED * single * (slack + exact.abs()) + least
    error = torch.where(exact.abs() < info.max, ((found.double() - exact).abs() / allowed).nan_to_num(nan=torch.inf), 0.0)
    worst, k = error.amax(-1).max(0)
    return float("inf") if found.dtype != dtype else float(worst), int(k)


def _conditioned(probe: Probe, value: Any, xs: list[Tensor]) -> tuple[Tensor, Tensor]:
    """The value, and the sum over all inputs of |derivative| |input|, both ``[N, C]``."""
    _, parameters, rebuild = leaves(value)
    inputs = [x.detach().requires_grad_() for x in (*parameters, *xs)]
    exact = probe.call(rebuild(inputs[: len(parameters)]), *inputs[len(parameters) :])
    slack = []
    for channel in exact.unbind(-1):
        grads = torch.autograd.grad(channel.sum(), inputs, retain_graph=True, allow_unused=True, materialize_grads=True)
        # a direction's components are rounded as parts of a unit vector: against 1, not against themselves
        slack.append(sum((g.abs() * x.detach().abs().amax(-1, keepdim=True)).flatten(1).sum(1) for g, x in zip(grads, inputs, strict=True)))
    return exact.detach(), torch.stack([s for s in slack if isinstance(s, Tensor)], -1)


def vmap(subject: Any, rng: torch.Generator, thorough: bool = False) -> Outcome:
    """``torch.func.vmap`` over materials and points together must equal the batched call."""
    worst, where = 0.0, ""
    for probe in probes(subject, rng, POINTS):
        xs = list(probe.inputs.values())
        many = batched(subject, len(xs[0]), rng)
        error = _difference(torch.func.vmap(probe.call)(many, *xs), probe.call(many, *xs))
        worst, where = max((worst, where), (error, f"; {probe.name}"))
    return Outcome("vmap", worst <= ROUNDINGS * torch.finfo(torch.float64).eps, worst, f"against the batched call, relative{where}")
