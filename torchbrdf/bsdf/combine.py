"""Models made of models: ``a + b`` and ``scale * a``.

A sum adds the lobes; they share one :class:`Geometry`. It samples one of its terms, chosen in proportion to the detached
directional albedo of each, and its pdf is that mixture's. A scaled model multiplies by a colour ``[..., C]`` >= 0.
"""

from collections.abc import Iterable

import torch
from torch import Tensor

from .. import numerics
from ..geometry import Geometry, each
from ..interval import Interval
from ..value import COLOUR, param, value
from ..vector import Vec
from .base import Bsdf, Channels, Draw, Lobe, inverse_density, local_normal, nearest


@value
class Sum(Bsdf):
    r"""The sum of ``terms``; written ``a + b``. Smooth where all of them are.

    .. math:: f = \sum_j f_j
    """

    terms: tuple[Bsdf, ...]

    def __post_init__(self) -> None:
        if not isinstance(self.terms, tuple | list):
            raise TypeError(f"Sum.terms: expected one BSDF or more, found {type(self.terms).__name__}")
        if not self.terms or not all(isinstance(t, Bsdf) for t in self.terms):
            raise TypeError(f"Sum.terms: expected one BSDF or more, found {[type(t).__name__ for t in self.terms]}")
        flat = [inner for t in self.terms for inner in (t.terms if isinstance(t, Sum) else (t,))]
        object.__setattr__(self, "terms", tuple(flat))
        super().__post_init__()

    @property
    def lobes(self) -> tuple[Lobe, ...]:  # type: ignore[override]
        return tuple(lobe for t in self.terms for lobe in t.lobes)

    @property
    def reciprocal(self) -> bool:  # type: ignore[override]
        return all(t.reciprocal for t in self.terms)

    @property
    def energy_bound(self) -> Tensor | None:
        bounds = [b for t in self.terms if (b := t.energy_bound) is not None]
        return sum(bounds[1:], bounds[0]) if len(bounds) == len(self.terms) else None

    def kink_distance(self, g: Geometry) -> Tensor:
        return nearest(*(t.kink_distance(g) for t in self.terms))

    def select(self, lobes: Iterable[Lobe]) -> Bsdf | None:
        kinds = tuple(lobes)
        kept = tuple(s for t in self.terms if (s := t.select(kinds)) is not None)
        return Sum(kept) if len(kept) > 1 else kept[0] if kept else None

    def formula(self, g: Geometry) -> Channels:
        return _total([t.formula(g) for t in self.terms])

    def mirror_reflectance(self, g: Geometry) -> Channels:
        return _total([t.mirror_reflectance(g) for t in self.terms])

    def density(self, g: Geometry) -> Tensor:
        shares = self._shares(g)
        return sum((p * t.density(g) for p, t in zip(shares, self.terms, strict=True)), torch.zeros_like(g.cos_i))

    def _shares(self, g: Geometry) -> list[Tensor]:
        """The probability of each term; equal ones where nothing reflects. Sampler and pdf must agree on it, frame or no frame."""
        weights = [t.mixture_weight(g.wo_local(), g.wide) for t in self.terms]
        total = sum(weights[1:], weights[0])
        return [torch.where(total > 0, w / torch.where(total > 0, total, 1.0), 1.0 / len(weights)) for w in weights]

    def draw(self, wo: Vec, u: Vec, wide: bool) -> Draw:
        """Choose a term with ``u.x``, stretch its interval back to [0, 1), and sample the term with it."""
        shares = self._shares(Geometry(wo, wo, local_normal(wo), None, wide))
        below = torch.zeros_like(shares[0])
        chosen: Draw | None = None
        offset = 0
        for share, term in zip(shares, self.terms, strict=True):
            mine = (u.x >= below) & (share > 0)
            stretched = numerics.unit_interval((u.x - below) / torch.where(share > 0, share, 1.0))
            fraction = torch.where(mine, stretched.clamp_max(1.0 - torch.finfo(below.dtype).eps), 0.5)
            one = term.draw(wo, Vec(fraction, u.y, fraction), wide)
            one = self._mixed(one, wo, share, term, offset, wide)
            chosen = one if chosen is None else _choose(mine, one, chosen)
            below, offset = below + share, offset + len(term.lobes)
        assert chosen is not None
        return chosen

    def _mixed(self, d: Draw, wo: Vec, share: Tensor, term: Bsdf, offset: int, wide: bool) -> Draw:
        """Weight and pdf of a term's sample under the whole mixture (a delta lobe competes with nothing)."""
        lobe = d.lobe + offset
        deltas = torch.tensor([kind.is_delta for kind in self.lobes], device=lobe.device)[lobe]
        alone = numerics.reciprocal_or_zero(share.expand_as(d.pdf))
        if all(kind.is_delta for kind in term.lobes):
            return Draw(d.wi, tuple(w * alone for w in d.weight), d.pdf * share, lobe)
        g = Geometry(d.wi, wo, local_normal(d.wi), None, wide)
        pdf = self.density(g)
        factor = torch.where(g.lit, g.cos_i * inverse_density(pdf), 0.0)
        weight = each(lambda f, w: torch.where(deltas, w * alone, f * factor), self.formula(g), d.weight)
        return Draw(d.wi, weight, torch.where(deltas, d.pdf * share, pdf), lobe)

    def directional_albedo(self, wo: Tensor, n: Tensor | None = None, *, order: int = 48) -> Tensor:
        """The sum of the terms' albedos."""
        parts = [t.directional_albedo(wo, n, order=order) for t in self.terms]
        return sum(parts[1:], parts[0])


@value
class Scaled(Bsdf):
    r"""``factor * inner``; written ``factor * a`` or ``a * factor``. Smooth where the inner model is.

    .. math:: f = k \, f_{inner}
    """

    inner: Bsdf
    factor: Tensor = param(Interval(0.0, typical=(0.1, 1.0)), COLOUR, "colour that multiplies the model")

    def __post_init__(self) -> None:
        if not isinstance(self.inner, Bsdf):
            raise TypeError(f"Scaled.inner: expected a BSDF such as tb.Lambert(albedo), found {type(self.inner).__name__}")
        super().__post_init__()

    @property
    def lobes(self) -> tuple[Lobe, ...]:  # type: ignore[override]
        return self.inner.lobes

    @property
    def reciprocal(self) -> bool:  # type: ignore[override]
        return self.inner.reciprocal

    @property
    def energy_bound(self) -> Tensor | None:
        bound = self.inner.energy_bound
        return None if bound is None else bound * self.factor

    def kink_distance(self, g: Geometry) -> Tensor:
        return self.inner.kink_distance(g)

    def select(self, lobes: Iterable[Lobe]) -> Bsdf | None:
        kept = self.inner.select(lobes)
        return None if kept is None else Scaled(kept, self.factor)

    def formula(self, g: Geometry) -> Channels:
        return each(lambda f, k: f * k, self.inner.formula(g), g.colour(self.factor))

    def mirror_reflectance(self, g: Geometry) -> Channels:
        return each(lambda r, k: r * k, self.inner.mirror_reflectance(g), g.colour(self.factor))

    def density(self, g: Geometry) -> Tensor:
        return self.inner.density(g)

    def draw(self, wo: Vec, u: Vec, wide: bool) -> Draw:
        d = self.inner.draw(wo, u, wide)
        g = Geometry(d.wi, wo, wo, None, wide)
        return d._replace(weight=each(lambda w, k: w * k, d.weight, g.colour(self.factor)))

    def directional_albedo(self, wo: Tensor, n: Tensor | None = None, *, order: int = 48) -> Tensor:
        """``factor`` times the inner albedo."""
        inner = self.inner.directional_albedo(wo, n, order=order)
        return (inner * (self.factor.to(inner) if self.factor.dim() == 1 else self.factor)).to(wo.dtype)


def _total(parts: list[Channels]) -> Channels:
    total = parts[0]
    for p in parts[1:]:
        total = each(lambda a, b: a + b, total, p)
    return total


def _choose(mine: Tensor, a: Draw, b: Draw) -> Draw:
    wi = Vec(*(torch.where(mine, x, y) for x, y in zip(a.wi, b.wi, strict=True)))
    weight = each(lambda x, y: torch.where(mine, x, y), a.weight, b.weight)
    return Draw(wi, weight, torch.where(mine, a.pdf, b.pdf), torch.where(mine, a.lobe, b.lobe))
