"""A model beside its textbook formula: what ``formula`` computes with care is what the source prints.

A model or Fresnel term may say what it computes in the plainest way, as a static method ``textbook``::

    textbook(m, p, albedo, ...)    # a model: p is a Point, then its fields by name
    textbook(m, cos, f0, ...)      # a Fresnel term

in an arithmetic ``m``: operators, ``m.pi``, ``m.sqrt``, ``m.exp``, ``m.log``, ``m.erf``, ``m.power(x, s)`` of x >= 0 with 0^0 = 1,
``m.positive(x)`` (a mask) and ``m.where(mask, a, b)``. Here it runs on float64 tensors; the project's own stability tests run it
in hundreds of digits with exact derivatives. Every parameter comes in as one number a point, one channel at a time; a Fresnel
slot as a function of a cosine, a parameter of several numbers as a tuple. ``NotImplemented`` stands for a choice that it does not say.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..optics.fresnel import Fresnel
from .subject import Outcome, probes, spread
from .words import pair

ROUNDINGS = 2.0**20  # times eps of the largest f: a textbook's cosine to a high power loses that many


class Reals:
    """The arithmetic ``m`` of float64 tensors."""

    pi = math.pi

    @staticmethod
    def sqrt(x: Any) -> Tensor:
        return torch.sqrt(_number(x))

    @staticmethod
    def exp(x: Any) -> Tensor:
        return torch.exp(_number(x))

    @staticmethod
    def log(x: Any) -> Tensor:
        return torch.log(_number(x))

    @staticmethod
    def erf(x: Any) -> Tensor:
        return torch.erf(_number(x))

    @staticmethod
    def power(x: Any, s: Any) -> Tensor:
        return torch.pow(_number(x), s)

    @staticmethod
    def positive(x: Any) -> Tensor:
        return _number(x) > 0

    @staticmethod
    def where(mask: Tensor, a: Any, b: Any) -> Tensor:
        return torch.where(mask, _number(a), _number(b))


def _number(x: Any) -> Tensor:
    return torch.as_tensor(x, dtype=torch.float64)


class Point:
    """The invariants of one shading point in an arithmetic ``m``, by the names of :class:`~torchbrdf.geometry.Geometry`.

    ``cos_i``, ``cos_o``, ``wi_wo`` (wi.wo); ``above`` and ``same_side`` (masks); ``cos_mirror`` (wi.R(wo)) and ``mirror_complement``,
    what it lacks to 1; with the half vector h: ``wi_h`` (wi.h), ``cos_h`` (n.h) and ``cos2_h``, its square, all 0 where there is no h.
    """

    def __init__(self, m: Any, wi: Any, wo: Any, n: Any) -> None:
        wi, wo, n = (unit(m, w) for w in (wi, wo, n))
        self.cos_i, self.cos_o = dot(n, wi), dot(n, wo)
        self.wi_wo = dot(wi, wo)
        self.above = m.positive(self.cos_i) & m.positive(self.cos_o)
        self.same_side = m.positive(self.cos_i * self.cos_o)
        half = tuple(a + b for a, b in zip(wi, wo, strict=True))
        half2, side = dot(half, half), cross(n, half)
        there = m.positive(half2)
        length = m.sqrt(m.where(there, half2, 1))
        self.wi_h = m.where(there, length / 2, 0)
        self.cos_h = m.where(there, dot(n, half) / length, 0)
        self.cos2_h = m.where(there, 1 - dot(side, side) / m.where(there, half2, 1), 0)
        apart = tuple(2 * self.cos_o * a - b for a, b in zip(n, half, strict=True))
        self.mirror_complement = dot(apart, apart) / 2
        self.cos_mirror = 1 - self.mirror_complement
        self.m, self.wi, self.wo, self.n = m, wi, wo, n

    def facet_across(self, n_i: Any, n_o: Any) -> "FacetAcross":
        """The facet that refracts one direction into the other, between media of these indices (Walter et al. 2007, eq. 16)."""
        m = self.m
        h = tuple(n_i * a + n_o * b for a, b in zip(self.wi, self.wo, strict=True))
        length2, side, cos_h = dot(h, h), cross(self.n, h), dot(self.n, h)
        up = m.where(m.positive(cos_h), 1, -1)
        wi_h, wo_h, cos_h = up * dot(self.wi, h), up * dot(self.wo, h), up * cos_h
        seen = m.positive(wi_h * self.cos_i) & m.positive(wo_h * self.cos_o) & m.positive(cos_h) & m.positive(-1 * self.cos_i * self.cos_o)
        wi_h, wo_h = (m.where(m.positive(c), c, -1 * c) for c in (wi_h, wo_h))
        length2 = m.where(m.positive(length2), length2, 1)
        wi_h, wo_h, cos_h = (x / m.sqrt(length2) for x in (wi_h, wo_h, cos_h))
        return FacetAcross(seen, wi_h, wo_h, cos_h, 1 - dot(side, side) / length2, length2)


class FacetAcross(NamedTuple):
    """A facet h that refracts; no cosine is below 0."""

    there: Any  # a mask: the directions are on different sides of the surface, and see the facet from there
    wi_h: Any
    wo_h: Any
    cos_h: Any
    cos2_h: Any
    length2: Any  # |n_i wi + n_o wo|^2


def dot(a: Any, b: Any) -> Any:
    """Of two triples of numbers."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Any, b: Any) -> Any:
    """Of two triples of numbers."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def unit(m: Any, v: Any) -> Any:
    """To unit length; the zero vector stays."""
    length2 = dot(v, v)
    alive = m.positive(length2)
    return tuple(m.where(alive, x / m.sqrt(m.where(alive, length2, 1)), 0) for x in v)


def textbook(subject: Any, rng: torch.Generator, thorough: bool = False) -> Outcome:
    """Largest difference between a model and its textbook formula, over its largest value; away from kinks."""
    if subject.textbook is None or (not isinstance(subject, Fresnel) and spread(subject) is None):
        return Outcome.absent("textbook", "the model says none")
    probe = next(iter(probes(subject, rng, 4096 if thorough else 256)))
    found = probe.call(subject, **probe.inputs)
    plain = [_channel(subject, k, *probe.inputs.values()) for k in range(found.shape[-1])]
    said = [channel for channel in plain if channel is not None]
    if len(said) < len(plain):
        return Outcome.absent("textbook", "the model says none for this choice")
    worst, k = (found - torch.stack(said, -1)).abs().nan_to_num(nan=torch.inf).amax(-1).max(0)
    largest = float(found.abs().max())
    return Outcome(
        "textbook", float(worst) <= ROUNDINGS * torch.finfo(found.dtype).eps * largest, float(worst), _where(probe.inputs, int(k))
    )


def _where(x: dict[str, Tensor], k: int) -> str:
    at = f"cos_i = {x['cos_i'][k].item():.4g}" if "cos_i" in x else pair(x["wi"][k], x["wo"][k], x["n"][k])
    return f"largest difference from the textbook formula; {at}"


def _channel(subject: Any, k: int, *points: Tensor) -> Tensor | None:
    """One channel of the textbook formula, if it says one."""
    if isinstance(subject, Fresnel):
        return _term(subject, k)(points[0].squeeze(-1))
    p = Point(Reals, *(w.unbind(-1) for w in points))
    found = subject.textbook(Reals, p, **_fields(subject, k))
    return None if found is NotImplemented else torch.as_tensor(found, dtype=torch.float64).expand(len(points[0]))


def _fields(subject: Any, k: int) -> dict[str, Any]:
    """The fields of a model or term: numbers for channel ``k``; a Fresnel slot as a function; a static choice as it is."""
    found = {name: getattr(subject, name) for name in subject._fields}
    hints = subject.params()
    slots = {name for name, v in found.items() if name == "fresnel" or isinstance(v, Fresnel)}
    numbers = {name: _of_channel(v, hints[name].is_colour, k) for name, v in found.items() if name in hints}
    return {**found, **numbers, **{name: _term(found[name], k) for name in slots}}


def _of_channel(v: Tensor | None, is_colour: bool, k: int) -> Any:
    if v is None:
        return None
    return v[min(k, len(v) - 1)] if is_colour else v[0] if len(v) == 1 else tuple(v)


def _term(term: Any, k: int) -> Callable[[Any], Any]:
    """A Fresnel term, or none, as a function of a cosine: by its own textbook formula if it says one."""
    if term is None:
        return lambda cos: 1
    if term.textbook is None:
        return lambda cos: term.reflectance(cos.unsqueeze(-1))[..., min(k, term.channels - 1)]
    return lambda cos: term.textbook(Reals, cos, **_fields(term, k))
