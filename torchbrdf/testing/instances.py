"""Instances of every registered model, drawn from what its fields declare: a new model is tested without a new test."""

import itertools
import types
import typing
from collections.abc import Iterator
from typing import Any

import torch

from ..bsdf.base import Bsdf
from ..optics.fresnel import Fresnel
from ..registry import BSDFS, FRESNEL_TERMS, registered
from ..value import Param, Value
from .subject import generator

COLOURS, ENTRIES = 3, {"A": 1}  # of a roughness one number; two are a variant


def instances(thorough: bool = False, seed: int = 0) -> Iterator[tuple[str, Any]]:
    """(label, value) of every registered Fresnel term and BSDF, float64.

    Parameters are drawn from the typical range of their constraint; a class's ``variants`` and Fresnel slots (empty, and each
    registered term) are taken in turn, those of the first variant in all combinations if ``thorough``; models made of models hold typical mixtures.
    """
    for cls in (*registered(FRESNEL_TERMS), *registered(BSDFS)):
        yield from of_class(cls, thorough, seed)


def of_class(cls: type[Value], thorough: bool = False, seed: int = 0) -> Iterator[tuple[str, Any]]:
    """Instances of one class, registered or not."""
    hints = typing.get_type_hints(cls)
    rng = generator(seed)
    slots = {name: [f for f in _fillings(hints[name], rng) if _fits(cls, f[1])] for name in cls._fields if name not in cls._params}
    slots = {name: fillings for name, fillings in slots.items() if fillings}
    variants: tuple[dict[str, Any], ...] = getattr(cls, "variants", ({},))
    for k, variant in enumerate(variants):
        for filling in _combinations(slots) if thorough and k == 0 else _in_turn(slots, every=k == 0, first=k if thorough else 0):
            static = {name: v for name, (_, v) in filling.items()} | dict(variant)
            labels = [str(v) for v in variant.values()] + [label for label, _ in filling.values()]
            drawn = {name: draw(spec, rng) for name, spec in cls._params.items()}
            yield f"{cls.__name__}({', '.join(labels)})", cls(**{**drawn, **static})


def _fits(cls: type[Value], filling: Any) -> bool:
    return not (isinstance(filling, Bsdf) and issubclass(cls, Bsdf)) or cls.may_hold(filling)


def draw(spec: Param, rng: torch.Generator) -> torch.Tensor:
    """A typical value of a parameter, in its event shape; colours have three channels, other named axes two entries."""
    shape = tuple(n if isinstance(n, int) else COLOURS if n == "C" else ENTRIES.get(n, 2) for n in spec.event)
    return spec.constraint.draw(shape, rng)


def _combinations(slots: dict[str, list[tuple[str, Any]]]) -> Iterator[dict[str, tuple[str, Any]]]:
    """Each filling of each slot with each of the others."""
    yield from (dict(zip(slots, fillings, strict=True)) for fillings in itertools.product(*slots.values()))


def _in_turn(slots: dict[str, list[tuple[str, Any]]], every: bool, first: int = 0) -> Iterator[dict[str, tuple[str, Any]]]:
    """Each filling of each slot once, beside changing ones of the others; the ``first`` alone where not every one is asked for."""
    count = max((len(fillings) for fillings in slots.values()), default=1) if every else 1
    yield from ({name: fillings[(first + k) % len(fillings)] for name, fillings in slots.items()} for k in range(count))


def _fillings(hint: Any, rng: torch.Generator) -> Iterator[tuple[str, Any]]:
    """What may stand in a field of this type, labelled; nothing for plain data, which ``variants`` speak for."""
    options = typing.get_args(hint) if isinstance(hint, types.UnionType) or typing.get_origin(hint) is typing.Union else (hint,)
    if type(None) in options:
        yield "-", None
    for option in options:
        if isinstance(option, type) and issubclass(option, Fresnel):
            for term in registered(FRESNEL_TERMS):
                yield term.__name__, term(**{name: draw(spec, rng) for name, spec in term._params.items()})
        elif isinstance(option, type) and issubclass(option, Bsdf):
            yield from ((label, terms[0] if len(terms) == 1 else _sum(terms)) for label, terms in mixtures(rng))
        elif typing.get_origin(option) is tuple and Bsdf in typing.get_args(option):
            yield from ((label, terms) for label, terms in mixtures(rng) if len(terms) > 1)


def _sum(terms: tuple[Bsdf, ...]) -> Bsdf:
    from ..bsdf.combine import Sum

    return Sum(terms)


def mixtures(rng: torch.Generator) -> Iterator[tuple[str, tuple[Bsdf, ...]]]:
    """Typical contents of a model made of models: one lobe, two, one of them a delta, a nested mixture, and Lambert's surface.

    The colours of two lobes beside one another are halved: each alone may reflect nearly all, and no mixture may reflect more.
    """
    from ..bsdf.blinn_phong import BlinnPhong
    from ..bsdf.lambert import Lambert
    from ..bsdf.mirror import Mirror
    from ..bsdf.phong import Phong

    def of(cls: type[Bsdf], share: float = 1.0, **static: Any) -> Any:
        drawn = {name: draw(spec, rng) * (share if spec.is_colour else 1.0) for name, spec in cls._params.items()}
        return cls(**drawn, **static)

    schlick = next(v for label, v in _fillings(Fresnel, rng) if label == "Schlick")
    yield "Phong", (of(Phong, fresnel=schlick),)
    yield "Lambert + Phong", (of(Lambert, 0.5), of(Phong, 0.5, fresnel=schlick))
    yield "Lambert + Mirror", (of(Lambert, 0.5), of(Mirror, 0.5, fresnel=schlick))
    yield "BlinnPhong + 0.5 (Lambert + Mirror)", (of(BlinnPhong, 0.5), 0.5 * (of(Lambert, 0.5) + of(Mirror, 0.5)))
    yield "Lambert", (of(Lambert),)
