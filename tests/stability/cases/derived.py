"""A case of every registered model that says its textbook formula: the truth is that formula, the grid what its parameters declare."""

import inspect
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import torch

from torchbrdf.bsdf.base import Bsdf
from torchbrdf.optics.fresnel import Fresnel
from torchbrdf.registry import BSDFS, FRESNEL_TERMS, registered
from torchbrdf.testing.textbook import Point
from torchbrdf.value import Param

from ..case import Case, Columns, Draw
from ..dual import Exact, where
from . import points
from .vectors import everyday_point, no_half_vector, stacked

M = Exact()
FEW = 1e-3  # of the brightest of three lights: a lobe dimmer than this is no everyday value
NEAR = 5e-4  # of a kink, in cosines


def derived() -> Iterator[Case]:
    """The cases; a Fresnel slot is empty, and once filled, with another registered term for each model."""
    terms = [term for term in registered(FRESNEL_TERMS) if term.textbook is not None]
    for k, cls in enumerate(c for c in registered(BSDFS) if c.textbook is not None):
        for variant in cls.variants:
            if says(cls, variant):
                yield case_of(cls, None, variant)
        if "fresnel" in cls._fields:
            yield case_of(cls, terms[k % len(terms)], cls.variants[0])


def says(cls: type[Bsdf], variant: dict[str, Any]) -> bool:
    """Whether the textbook formula covers a choice."""
    point = Point(M, *np.eye(3, dtype=object)[[2, 2, 2]][:, :, None])
    one = dict.fromkeys(cls._params, 1)
    slot = {"fresnel": lambda cos: 1} if "fresnel" in cls._fields else {}
    return cls.textbook(M, point, **{**one, **slot, **choices(cls), **variant}) is not NotImplemented


def choices(cls: type[Bsdf]) -> dict[str, Any]:
    """The static fields, as they are where nothing is said."""
    return {name: getattr(cls, name) for name in cls._fields if name not in cls._params and name != "fresnel"}


def case_of(cls: type[Bsdf], term: type[Fresnel] | None, variant: dict[str, Any]) -> Case:
    """Of a class in one of its variants, with a Fresnel term in its slot or none."""
    own, inner = cls._params, {} if term is None else term._params
    has_slot = "fresnel" in cls._fields

    def make(*parameters: torch.Tensor) -> Bsdf:
        slot = {} if term is None else {"fresnel": term(*parameters[len(own) :])}
        return cls(**dict(zip(own, parameters, strict=False)), **slot, **variant)

    def truth(p: Point, *values: Any) -> Any:
        slot = {"fresnel": lambda cos: 1 if term is None else term.textbook(M, cos, *values[len(own) :])} if has_slot else {}
        f = cls.textbook(M, p, **dict(zip(own, values, strict=False)), **slot, **{**choices(cls), **variant})
        return where(p.above, f, 0) if cls.domain is Bsdf.domain else f

    return case(
        ", ".join([cls.__name__, *([] if variant == cls.variants[0] else variant.values()), *([term.__name__] if term else [])]),
        {**own, **inner},
        make,
        truth,
        covers=(cls.__name__, *([term.__name__] if term else [])),
        source="".join(inspect.getsource(c.textbook) for c in (cls, term) if c) + repr((own, inner)),
    )


def case(
    name: str, specs: dict[str, Param], make: Callable[..., Bsdf], truth: Callable[..., Any], covers: tuple[str, ...], source: str = ""
) -> Case:
    """``make(*parameters)`` seen through ``evaluate(wi, wo, n)``; ``truth(point, *parameters)``, 0 where nothing is sent."""

    def call(*c: torch.Tensor) -> Any:
        wi, wo, n = (torch.stack(c[k : k + 3], -1) for k in (0, 3, 6))
        return make(*(p.unsqueeze(-1) for p in c[9:])).evaluate(wi, wo, n).unbind(-1)

    return Case(
        name,
        (*points.NAMES, *specs),
        call,
        lambda *c: (truth(Point(M, c[:3], c[3:6], c[6:9]), *c[9:]),),
        lambda draw: points.with_parameters(draw, *(column(spec, draw) for spec in specs.values())),
        lambda x: everyday(x, specs, make),
        covers=covers,
        error="backward",
        vectors=True,
        kinks={"kink_distance of the model": lambda x: kinked(x, specs, make)},
        outside={"at the horizon, up to rounding": points.near_horizon},
        outside_twice={"a vector so short that 1 / (length alpha^2) overflows": too_short} if "alpha" in specs else {},
        source=source,
    )


def too_short(x: Columns) -> Any:
    """Second derivatives are 0 there, where a lobe is flushed to 0, or leave the dtype; what is 0 times that is not known."""
    lengths = [np.linalg.norm(stacked(x, k), axis=1) for k in ("wi", "wo", "n")]
    shortest = np.minimum.reduce([np.where(length > 0, length, 1.0) for length in lengths])  # no vector is no question
    return shortest * x["alpha"] ** 2 < 16 / x.working.max


def column(spec: Param, draw: Draw) -> np.ndarray:
    """Typical values of a parameter, and its hard ones: the closed ends of the range, and what it declares."""
    if spec.event not in ((1,), ("C",), ("A",), ("K",)):
        raise NotImplementedError(f"parameters of shape {spec.shape} come with a case of their own: tests/stability/cases")
    low, high = spec.constraint.typical or (spec.constraint.low, spec.constraint.high)
    count = points.rows_of(draw)
    bulk = draw.spread(count, low, high) if low > 0 and high > 10 * low else draw.uniform(count, low, high)
    # Nor a roughness whose distribution peaks, at 1 / (pi alpha^2), beyond the dtype.
    hard = [x for x in spec.constraint.extremes() if abs(x) <= draw.info.max and (x == 0 or 1 / x**2 <= draw.info.max)]
    return np.where(draw.uniform(count) < 0.1, draw.rng.choice(hard, count), bulk) if hard else bulk


def everyday(x: Columns, specs: dict[str, Param], make: Callable[..., Bsdf]) -> Any:
    """Parameters typical and no colour dark, both directions off the horizon, and a value bright enough to be seen."""
    typical = [_inside(x[name], spec) for name, spec in specs.items()]
    wi, wo, n = (points.unit_rows(stacked(x, k)) for k in ("wi", "wo", "n"))
    mirror = 2 * (n * wo).sum(1, keepdims=True) * n - wo
    model = make(*(torch.from_numpy(x[name]).unsqueeze(-1) for name in specs))
    seen = [model.evaluate(*map(torch.from_numpy, (light, wo, n))).squeeze(-1).numpy() for light in (wi, mirror, wo, n)]
    return np.logical_and.reduce([*typical, everyday_point(x), ~no_half_vector(x), seen[0] > FEW * np.max(seen[1:], 0)])


def _inside(values: np.ndarray, spec: Param) -> np.ndarray:
    low, high = spec.constraint.typical or (spec.constraint.low, spec.constraint.high)
    return (values >= (max(low, 0.01) if spec.is_colour else low)) & (values <= high)


def kinked(x: Columns, specs: dict[str, Param], make: Callable[..., Bsdf]) -> Any:
    """Near what the model declares not to be smooth, other than the horizon, whose slopes are those of the lit side."""
    model = make(*(torch.from_numpy(x[name]).unsqueeze(-1) for name in specs))
    g = model.geometry(*(torch.from_numpy(points.unit_rows(stacked(x, k))) for k in ("wi", "wo", "n")))
    distance, horizon = model.kink_distance(g).numpy(), torch.minimum(g.cos_i.abs(), g.cos_o.abs()).numpy()
    return ((distance < NEAR) & (distance < horizon)) | points.lost_half_vector(x)


CASES = tuple(derived())
