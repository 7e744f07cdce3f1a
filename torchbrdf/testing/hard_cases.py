"""Finite values and gradients where formulas break: grazing, no half vector, mirror, horizon, no normal, extreme parameters."""

import math
from collections.abc import Iterator
from typing import Any

import torch
from torch import Tensor

from ..bsdf.base import Bsdf
from ..optics.fresnel import Fresnel
from ..value import Value
from .subject import Outcome, leaves

DIAGONAL = math.sqrt(0.5)
CRITICAL = math.sqrt(0.75)  # cosine of the critical angle of eta = 1/2, which is among the hard values
TINY, SHORT, LONG = 2.0**-100, 2.0**-66, 2.0**66  # squares of TINY vanish in float32

# (wi, wo, n)
TRIPLES: tuple[tuple[tuple[float, float, float], ...], ...] = (
    ((0, 0, 1), (0, 0, 1), (0, 0, 1)),  # all along the normal
    ((DIAGONAL, 0, DIAGONAL), (DIAGONAL, 0, DIAGONAL), (0, 0, 1)),  # wi = wo; also the edge of Phong's lobe
    ((-DIAGONAL, 0, DIAGONAL), (DIAGONAL, 0, DIAGONAL), (0, 0, 1)),  # the mirror direction
    ((-DIAGONAL, 0, -DIAGONAL), (DIAGONAL, 0, DIAGONAL), (0, 0, 1)),  # wi = -wo: no half vector
    ((1, 0, 0), (-1, 0, 0), (0, 0, 1)),  # the same, in the horizon
    ((1, 0, TINY), (-1, 0, TINY), (0, 0, 1)),  # grazing mirror direction
    ((1, 0, TINY), (1, 0, TINY), (0, 0, 1)),  # grazing, wi = wo
    ((1, 0, TINY), (0, 0, 1), (0, 0, 1)),
    ((0, 0, 1), (1, 0, TINY), (0, 0, 1)),
    ((1, 0, 0), (0, 0, 1), (0, 0, 1)),  # exactly in the horizon
    ((0, 0, 1), (0, 1, 0), (0, 0, 1)),
    ((0, 0, -1), (0, 0, 1), (0, 0, 1)),
    ((0.5, 0, CRITICAL), (-0.5, 0, CRITICAL), (0, 0, 1)),  # wi.h at the critical angle
    ((0.3, 0.4, 0.5), (-0.3, 0.1, 0.5), (0, 0, 0)),  # no normal
    ((0, 0, 0), (0, 0, 1), (0, 0, 1)),
    ((0, 0, 1), (0, 0, 0), (0, 0, 1)),
    ((0.3, 0.4, 0.5), (-0.3, 0.1, 0.5), (math.nan, 0, 1)),
    ((0.3, 0.4, 0.5), (math.inf, 0.1, 0.5), (0, 0, 1)),
    ((0, SHORT, SHORT), (LONG, 0, LONG), (0, 0, SHORT)),  # far from unit length
    ((0.3, 0.4, 0.5), (-0.3, -0.4, 0.5), (0, 0, -1)),
)
LAST = 1.0 - 2.0**-24
UNIFORM = ((0.0, 0.0, 0.0), (0.5, 0.5, 0.5), (LAST, LAST, LAST), (0.0, LAST, 0.0), (LAST, 0.0, LAST))
COSINES = (0.0, TINY, 0.1, CRITICAL, math.nextafter(CRITICAL, 0), math.nextafter(CRITICAL, 1), 1.0, 1.0 + 2.0**-23, 1.0 + 2.0**-52, -0.1)


def hard_cases(subject: Any, rng: torch.Generator, thorough: bool = False) -> Outcome:
    """Values and gradients of every verb at every hard geometry, with each parameter at each of its hard values in turn."""
    bad = []
    for variant, label in variations(subject):
        for dtype in (torch.float32, torch.float64):
            bad += [f"{what}, {label}, {str(dtype).removeprefix('torch.')}" for what in _not_finite(variant.to(dtype), dtype)]
    detail = f"not finite: {'; '.join(bad[:4])}" if bad else "verbs and gradients that are not finite"
    return Outcome("hard_cases", not bad, float(len(bad)), detail)


def variations(value: Any) -> Iterator[tuple[Any, str]]:
    """The value itself, and with one parameter, nested ones too, at one of its hard values."""
    yield value, "as given"
    yield from _extreme(value)


def _extreme(value: Value) -> Iterator[tuple[Value, str]]:
    for name, tensor, spec in value.own_tensors():
        for x in spec.constraint.extremes():
            yield value.replace(**{name: torch.full_like(tensor, x)}), f"{type(value).__name__}.{name} = {x:g}"
    for name in value._fields:
        held = getattr(value, name)
        if isinstance(held, Value):
            yield from ((value.replace(**{name: v}), label) for v, label in _extreme(held))
        if isinstance(held, tuple):
            for i, inner in enumerate(held):
                yield from ((value.replace(**{name: (*held[:i], v, *held[i + 1 :])}), label) for v, label in _extreme(inner))


def _not_finite(value: Any, dtype: torch.dtype) -> Iterator[str]:
    for verb, call, inputs in _verbs(value, dtype):
        names, parameters, rebuild = leaves(value)
        asked = [t.detach().clone().requires_grad_() for t in (*parameters, *inputs.values())]
        out = call(rebuild(asked[: len(parameters)]), *asked[len(parameters) :])
        if not bool(torch.isfinite(out).all()):
            yield f"{verb}"
        if out.requires_grad:
            grads = torch.autograd.grad(out.sum(), asked, allow_unused=True, materialize_grads=True)
            yield from (f"{verb} by {name}" for name, g in zip([*names, *inputs], grads, strict=True) if not bool(torch.isfinite(g).all()))


def _verbs(value: Any, dtype: torch.dtype) -> Iterator[tuple[str, Any, dict[str, Tensor]]]:
    if isinstance(value, Fresnel):
        yield "reflectance", lambda v, cos: v.reflectance(cos), {"cos_i": torch.tensor(COSINES, dtype=dtype).unsqueeze(-1)}
        return
    if not isinstance(value, Bsdf):
        return
    wi, wo, n = (x.contiguous() for x in torch.tensor(TRIPLES, dtype=dtype).unbind(1))
    u = torch.tensor(UNIFORM, dtype=dtype).unsqueeze(1)
    w = {"wi": wi, "wo": wo, "n": n}
    yield "evaluate", lambda v, wi, wo, n: v.evaluate(wi, wo, n), w
    yield "pdf", lambda v, wi, wo, n: v.pdf(wi, wo, n), w
    yield "sample weight", lambda v, wo, n: v.sample(wo, u, n).weight, {"wo": wo, "n": n}
    yield "directional_albedo", lambda v, wo, n: v.directional_albedo(wo, n, order=4), {"wo": wo, "n": n}
