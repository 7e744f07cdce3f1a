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

# what is hard about it: (wi, wo, n)
TRIPLES: dict[str, tuple[tuple[float, float, float], ...]] = {
    "all along the normal": ((0, 0, 1), (0, 0, 1), (0, 0, 1)),
    "wi = wo; the edge of Phong's lobe": ((DIAGONAL, 0, DIAGONAL), (DIAGONAL, 0, DIAGONAL), (0, 0, 1)),
    "the mirror direction": ((-DIAGONAL, 0, DIAGONAL), (DIAGONAL, 0, DIAGONAL), (0, 0, 1)),
    "wi = -wo": ((-DIAGONAL, 0, -DIAGONAL), (DIAGONAL, 0, DIAGONAL), (0, 0, 1)),
    "wi = -wo in the horizon": ((1, 0, 0), (-1, 0, 0), (0, 0, 1)),
    "the grazing mirror direction": ((1, 0, TINY), (-1, 0, TINY), (0, 0, 1)),
    "grazing, wi = wo": ((1, 0, TINY), (1, 0, TINY), (0, 0, 1)),
    "wi grazing": ((1, 0, TINY), (0, 0, 1), (0, 0, 1)),
    "wo grazing": ((0, 0, 1), (1, 0, TINY), (0, 0, 1)),
    "wi in the horizon": ((1, 0, 0), (0, 0, 1), (0, 0, 1)),
    "wo in the horizon": ((0, 0, 1), (0, 1, 0), (0, 0, 1)),
    "wi straight below": ((0, 0, -1), (0, 0, 1), (0, 0, 1)),
    "wi.h at the critical angle": ((0.5, 0, CRITICAL), (-0.5, 0, CRITICAL), (0, 0, 1)),
    "no normal": ((0.3, 0.4, 0.5), (-0.3, 0.1, 0.5), (0, 0, 0)),
    "no wi": ((0, 0, 0), (0, 0, 1), (0, 0, 1)),
    "no wo": ((0, 0, 1), (0, 0, 0), (0, 0, 1)),
    "a normal that is NaN": ((0.3, 0.4, 0.5), (-0.3, 0.1, 0.5), (math.nan, 0, 1)),
    "an infinite wo": ((0.3, 0.4, 0.5), (math.inf, 0.1, 0.5), (0, 0, 1)),
    "lengths far from 1": ((0, SHORT, SHORT), (LONG, 0, LONG), (0, 0, SHORT)),
    "wi = -wo, seen from below": ((0.3, 0.4, 0.5), (-0.3, -0.4, 0.5), (0, 0, -1)),
}
LAST = 1.0 - 2.0**-24
UNIFORM = ((0.0, 0.0, 0.0), (0.5, 0.5, 0.5), (LAST, LAST, LAST), (0.0, LAST, 0.0), (LAST, 0.0, LAST))
COSINES = (0.0, TINY, 0.1, CRITICAL, math.nextafter(CRITICAL, 0), math.nextafter(CRITICAL, 1), 1.0, 1.0 + 2.0**-23, 1.0 + 2.0**-52, -0.1)


def hard_cases(subject: Any, rng: torch.Generator, thorough: bool = False) -> Outcome:
    """Values and gradients of every verb at every hard geometry, with each parameter at each of its hard values in turn."""
    variants, labels = zip(*variations(subject), strict=True)
    bad = []
    for dtype in (torch.float32, torch.float64):
        kind = str(dtype).removeprefix("torch.")
        all_of_them = [v.to(dtype) for v in variants]
        found = list(_not_finite(all_of_them, labels, dtype)) or list(_alone(all_of_them[0], dtype))
        bad += [f"{what}, {kind}" for what in found]
    detail = (
        f"not finite: {'; '.join(bad[:3])}{f' and {len(bad) - 3} more' * (len(bad) > 3)}"
        if bad
        else "verbs and gradients that are not finite"
    )
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
        if isinstance(held, tuple) and all(isinstance(inner, Value) for inner in held):
            for i, inner in enumerate(held):
                yield from ((value.replace(**{name: (*held[:i], v, *held[i + 1 :])}), label) for v, label in _extreme(inner))


def _alone(value: Any, dtype: torch.dtype) -> Iterator[str]:
    """What is not finite about a single material, whose parameters have no batch axes."""
    for verb, call, inputs, _ in _verbs(value, dtype):
        names, parameters, rebuild = leaves(value)
        asked = [t.detach().clone().requires_grad_() for t in (*parameters, *inputs.values())]
        out = call(rebuild(asked[: len(parameters)]), *asked[len(parameters) :])
        found = zip(["", *names, *inputs], (out, *_slopes(out, asked)), strict=True)
        bad = [name for name, x in found if not bool(torch.isfinite(x).all())]
        yield from (f"{verb}{f' by {name}' * bool(name)} of a material without batch axes" for name in bad)


def _not_finite(variants: list[Any], labels: tuple[str, ...], dtype: torch.dtype) -> Iterator[str]:
    """The same of all variants beside all cases at once, each pair with inputs of its own, so that the first bad one is named."""
    names, _, rebuild = leaves(variants[0])
    tables = [torch.stack(ts) for ts in zip(*(leaves(v)[1] for v in variants), strict=True)]
    for verb, call, inputs, cases in _verbs(variants[0], dtype):
        count, each = len(cases), [t.unsqueeze(1).expand(-1, len(cases), *t.shape[1:]) for t in tables]
        given = [x.expand(len(variants), *x.shape) for x in inputs.values()]
        asked = [t.detach().flatten(0, 1).clone().requires_grad_() for t in (*each, *given)]
        out = call(rebuild(asked[: len(tables)]), *asked[len(tables) :])
        for name, found in zip(["", *names, *inputs], (out, *_slopes(out, asked)), strict=True):
            rows = (~torch.isfinite(found)).flatten(1).any(1).nonzero().flatten().tolist()
            if rows:
                where = f"{cases[rows[0] % count]}, {labels[rows[0] // count]}"
                yield f"{verb}{f' by {name}' * bool(name)} at {where}{f' and {len(rows) - 1} more' * (len(rows) > 1)}"


def _slopes(out: Tensor, inputs: list[Tensor]) -> tuple[Tensor, ...]:
    if not out.requires_grad:
        return tuple(torch.zeros_like(x) for x in inputs)
    return torch.autograd.grad(out.sum(), inputs, allow_unused=True, materialize_grads=True)


def _verbs(value: Any, dtype: torch.dtype) -> Iterator[tuple[str, Any, dict[str, Tensor], list[str]]]:
    """(name, function of a value and its inputs, the inputs ``[N, k]``, what is hard about each)."""
    if isinstance(value, Fresnel):
        cosines = {"cos_i": torch.tensor(COSINES, dtype=dtype).unsqueeze(-1)}
        yield "reflectance", lambda v, cos: v.reflectance(cos), cosines, [f"cosine {c:.9g}" for c in COSINES]
    if not isinstance(value, Bsdf):
        return
    cases = list(TRIPLES)
    wi, wo, n = (x.contiguous() for x in torch.tensor(list(TRIPLES.values()), dtype=dtype).unbind(1))
    w, viewed = {"wi": wi, "wo": wo, "n": n}, {"wo": wo, "n": n}
    yield "evaluate", lambda v, wi, wo, n: v.evaluate(wi, wo, n), w, cases
    yield "pdf", lambda v, wi, wo, n: v.pdf(wi, wo, n), w, cases
    u = torch.tensor(UNIFORM, dtype=dtype)
    drawn = {name: x.repeat_interleave(len(u), 0) for name, x in viewed.items()} | {"u": u.repeat(len(cases), 1)}
    yield "sample", _sampled, drawn, [f"{c}, u = {x}" for c in cases for x in UNIFORM]
    yield "directional_albedo", lambda v, wo, n: v.directional_albedo(wo, n, order=4), viewed, cases


def _sampled(bsdf: Bsdf, wo: Tensor, n: Tensor, u: Tensor) -> Tensor:
    """Directions by their values alone, whose slopes are steep at the ends of u; weights and densities with their slopes."""
    s = bsdf.sample(wo, u.detach(), n)
    return torch.cat([s.wi.detach(), s.weight, s.pdf], -1)
