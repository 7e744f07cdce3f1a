"""Models made of models: ``a + b`` and ``scale * a``.

A sum adds the lobes, and their directional albedos; they share one :class:`~torchbrdf.geometry.Geometry`. It samples one of its
terms, chosen in proportion to a cheap estimate of what each reflects (``strength``), and its pdf is that mixture's. A scaled model
multiplies by a colour ``[..., C]`` >= 0.
"""

import torch
from torch import Tensor

from .. import parameters
from ..geometry import Channels, Geometry, Viewer, each
from ..interval import Interval
from ..sampling import choose
from ..value import COLOUR, param, value
from ..vector import Vec
from .base import Bsdf, nearest
from .lobe import Delta, Draw, Lobe
from .sampler import has_spread, normalised


@value
class Sum(Bsdf):
    r"""The sum of ``terms``; written ``a + b``. Smooth where all of them are.

    .. math:: f = \sum_j f_j
    """

    terms: tuple[Bsdf, ...]

    def __post_init__(self) -> None:
        if not isinstance(self.terms, (tuple, list)):
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
        return _total([t.energy_bound for t in self.terms])

    @property
    def lambertian(self) -> Tensor | None:
        return _total([t.lambertian for t in self.terms])

    def exchange(self, g: Geometry) -> Tensor:
        """That of the term that lets light through: the terms are one surface, between the same two media."""
        return next((t for t in self.terms if any(lobe.transmits for lobe in t.lobes)), self.terms[0]).exchange(g)

    def kink_distance(self, g: Geometry) -> Tensor:
        return nearest(*(t.kink_distance(g) for t in self.terms))

    def select(self, wanted: Lobe) -> Bsdf | None:
        kept = tuple(s for t in self.terms if (s := t.select(wanted)) is not None)
        if len(kept) == len(self.terms) and all(s is t for s, t in zip(kept, self.terms, strict=True)):
            return self
        return Sum(kept) if len(kept) > 1 else kept[0] if kept else None

    def domain(self, g: Geometry) -> Tensor:
        """The union of the terms' domains; outside its own, each term is 0."""
        if _of_one_domain(self.terms):
            return g.above
        found = self.terms[0].domain(g)
        for t in self.terms[1:]:
            found = found | t.domain(g)
        return found

    def formula(self, g: Geometry) -> Channels:
        total = _inside(self.terms[0], g, self.terms)
        for t in self.terms[1:]:
            total = each(torch.add, total, _inside(t, g, self.terms))
        return total

    def strength(self, viewer: Viewer) -> Tensor:
        return sum((t.strength(viewer) for t in self._spread()), torch.zeros_like(viewer.cos_o))

    def density(self, g: Geometry) -> Tensor:
        parts = zip(self._shares(g.viewer), self._spread(), strict=True)
        return sum((share * t.density(g) for share, t in parts), torch.zeros_like(g.cos_i + g.cos_o))

    def draw(self, viewer: Viewer, u: Vec) -> Draw:
        """Choose a term with ``u.z``, and draw from it."""
        chosen, rest = choose(u.z, self._shares(viewer))
        numbers = Vec(u.x, u.y, rest)
        found: Draw | None = None
        for mask, term in zip(chosen, self._spread(), strict=True):
            drawn = term.draw(viewer, numbers)
            drawn = drawn._replace(lobe=drawn.lobe + self._first_lobe(term))
            found = drawn if found is None else either(mask, drawn, found)
        assert found is not None
        return found

    def deltas(self, viewer: Viewer) -> list[Delta]:
        return [d._replace(lobe=d.lobe + self._first_lobe(t)) for t in self.terms for d in t.deltas(viewer)]

    def albedo_at(self, viewer: Viewer, order: int) -> Channels:
        """The sum of the terms' albedos."""
        total = self.terms[0].albedo_at(viewer, order)
        for t in self.terms[1:]:
            total = each(torch.add, total, t.albedo_at(viewer, order))
        return total

    def _spread(self) -> list[Bsdf]:
        return [t for t in self.terms if has_spread(t)]

    def _shares(self, viewer: Viewer) -> list[Tensor]:
        """The probability of each term that is no delta; computed once for a viewer."""
        return viewer.once(self.terms, lambda: normalised([t.strength(viewer) for t in self._spread()]))

    def _first_lobe(self, term: Bsdf) -> int:
        return sum(len(t.lobes) for t in self.terms[: [t is term for t in self.terms].index(True)])


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
        return None if bound is None else torch.mul(*parameters.alike(bound, self.factor))

    @property
    def lambertian(self) -> Tensor | None:
        albedo = self.inner.lambertian
        return None if albedo is None else torch.mul(*parameters.alike(albedo, self.factor))

    def exchange(self, g: Geometry) -> Tensor:
        return self.inner.exchange(g)

    def kink_distance(self, g: Geometry) -> Tensor:
        return self.inner.kink_distance(g)

    def select(self, wanted: Lobe) -> Bsdf | None:
        kept = self.inner.select(wanted)
        return None if kept is None else self if kept is self.inner else Scaled(kept, self.factor)

    def domain(self, g: Geometry) -> Tensor:
        return self.inner.domain(g)

    def formula(self, g: Geometry) -> Channels:
        return each(torch.mul, self.inner.formula(g), g.colour(self.factor))

    def strength(self, viewer: Viewer) -> Tensor:
        return self.inner.strength(viewer) * viewer.layout.average(self.factor)

    def density(self, g: Geometry) -> Tensor:
        return self.inner.density(g)

    def draw(self, viewer: Viewer, u: Vec) -> Draw:
        return self.inner.draw(viewer, u)

    def deltas(self, viewer: Viewer) -> list[Delta]:
        return [d._replace(weight=each(torch.mul, d.weight, viewer.colour(self.factor))) for d in self.inner.deltas(viewer)]

    def albedo_at(self, viewer: Viewer, order: int) -> Channels:
        """``factor`` times the inner albedo."""
        return each(torch.mul, self.inner.albedo_at(viewer, order), viewer.colour(self.factor))


def _total(colours: list[Tensor | None]) -> Tensor | None:
    """The sum of colours of several terms; None where one of them has none."""
    known = [c for c in colours if c is not None]
    if len(known) < len(colours):
        return None
    known = parameters.alike(*known)
    return sum(known[1:], known[0])


def _inside(term: Bsdf, g: Geometry, terms: tuple[Bsdf, ...]) -> Channels:
    """A term's formula, held to its own domain where the terms' domains differ."""
    if _of_one_domain(terms):
        return term.formula(g)
    inside = term.domain(g).to(g.cos_i.dtype)
    return tuple(f * inside for f in term.formula(g))


def _of_one_domain(terms: tuple[Bsdf, ...]) -> bool:
    """Whether all terms keep the usual one, :attr:`Geometry.above`."""
    return all(type(t).domain is Bsdf.domain for t in terms)


def either(mask: Tensor, a: Draw, b: Draw) -> Draw:
    """One draw where the mask is true, the other elsewhere."""
    wi = Vec(*(torch.where(mask, x, y) for x, y in zip(a.wi, b.wi, strict=True)))
    lobe, eta = (torch.where(mask, x, y) for x, y in ((a.lobe, b.lobe), (a.eta, b.eta)))
    return Draw(wi, lobe, eta)
