"""The density of samples: its integral, and a chi-square test of samples against it."""

from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..bsdf.base import Bsdf
from .partition import BINS, Partition
from .sphere import TOLERANCE, integral, pilots, sampling_density, spread_samples
from .subject import DELTA, Outcome, spread, uniform, views
from .words import degrees

ANGLES = (0.0, 45.0, 80.0)
GRAZING = (89.0, 89.9)
SIGNIFICANCE = 1e-3  # chance that a right sampler fails, over all directions; the planted faults reach 1e-18 and less
LEAST = 5.0  # expected counts below this are pooled; chi-square is not to be trusted for fewer


def pdf_integrates_to_one(subject: Any, rng: torch.Generator, thorough: bool = False) -> Outcome:
    """Over the whole sphere; short of 1 by the probability of delta lobes, and of samples that are lost."""
    name = "pdf_integrates_to_one"
    if spread(subject) is None:
        return Outcome.absent(name, "no lobe that has a density")
    wo = views(subject, (*ANGLES, *GRAZING) if thorough else ANGLES)
    cells = integral(lambda wi, v: sampling_density(subject, wi, v), wo, *pilots(subject, wo, rng))
    error = (cells.total(cells.value).squeeze(-1) + absent_share(subject, wo) - 1.0).abs()
    worst = int(torch.nan_to_num(error, nan=torch.inf).argmax())
    figure, doubt = float(error[worst]), float(cells.error[worst])
    detail = f"largest |integral - 1|, for wo at {degrees(wo[worst])}"
    return Outcome(name, figure <= 2.0 * TOLERANCE, figure, detail + f", known to {doubt:.1g}" * (doubt > 2.0 * TOLERANCE))


def absent_share(bsdf: Bsdf, wo: Tensor) -> Tensor:
    """The share ``[V]`` of samples that have no density, for each of ``wo [V, 3]``, over evenly spread u."""
    i = torch.arange(2**10, dtype=wo.dtype)
    lost = bool((bsdf.sample(wo.unsqueeze(1), _lattice(i)).wi == 0).all(-1).any())
    if bsdf.select(DELTA) is None and not lost:
        return torch.zeros(len(wo), dtype=wo.dtype)
    u = _lattice(torch.arange(2**17 if lost else 2**13, dtype=wo.dtype))
    _, of = spread_samples(bsdf, wo, u)
    share = 1.0 - torch.bincount(of, minlength=len(wo)) / len(u)
    return share.clamp_min(1.0 / len(u)) if lost else share  # what is rarer than that, so many numbers may have missed


def _lattice(i: Tensor) -> Tensor:
    """Kronecker's, with the third number in even steps: a choice among lobes is measured to 1 / len(i)."""
    return torch.stack([(i * 0.5 * (5**0.5 - 1.0)) % 1.0, (i * (2.0**0.5 - 1.0)) % 1.0, (i + 0.5) / len(i)], -1)


def samples_follow_pdf(subject: Any, rng: torch.Generator, thorough: bool = False) -> Outcome:
    """Chi-square test at several ``wo``, Sidak-corrected; the figure is the smallest p-value."""
    name = "samples_follow_pdf"
    if spread(subject) is None:
        return Outcome.absent(name, "no lobe that has a density")
    wo = views(subject, (*range(0, 90, 10), *GRAZING) if thorough else ANGLES)
    partition, count = Partition.of(subject, wo, rng), 200_000 if thorough else 20_000
    found = counted(subject, partition, rng, count)
    least = of_several(SIGNIFICANCE, len(wo))
    p = [agreement(o, e) for o, e in zip(found.observed, found.expected, strict=True)]
    worst = min(range(len(wo)), key=lambda k: p[k])
    detail = f"smallest p of chi-square, rejected below {least:.2g}; for wo at {degrees(wo[worst])}"
    return Outcome(name, p[worst] > least, p[worst], detail if p[worst] > least else f"{detail}: {found.worst(worst)}")


def of_several(significance: float, tests: int) -> float:
    """The significance of each of some independent tests that together have the one given (Sidak 1967)."""
    return 1.0 - (1.0 - significance) ** (1.0 / tests)


class Counted(NamedTuple):
    """Samples in the bins of a partition, in its dark, and without a density: ``[V, BINS + 2]``; and in its cells, ``[M]``."""

    partition: Partition
    observed: Tensor
    expected: Tensor
    surplus: Tensor  # of each cell, observed less expected

    def worst(self, view: int) -> str:
        """The bin of one wo that is furthest from what is expected, in words."""
        observed, expected = self.observed[view], self.expected[view]
        k = int(((observed - expected).square() / expected.clamp_min(1.0)).argmax())
        where = f"about wi at {self.partition.place(view, k, self.surplus)}" if k <= BINS else "without a density"
        return f"{observed[k]:.0f} of {observed.sum():.0f} samples {where}, {expected[k]:.4g} expected"


def counted(bsdf: Bsdf, partition: Partition, rng: torch.Generator, count: int) -> Counted:
    """``count`` samples for each wo of a partition. Raises ``ValueError`` for samples that are no directions."""
    wi, of = zip(*(_samples(bsdf, partition.wo, k, rng, count) for k in range(len(partition.wo))), strict=True)
    cells = partition.counts(torch.cat(wi), torch.cat(of))
    absent = torch.tensor([count - len(w) for w in wi], dtype=cells.dtype)
    observed = torch.cat([partition.sums(cells), absent.unsqueeze(1)], 1)
    expected = torch.cat([partition.integrals, absent_share(bsdf, partition.wo).unsqueeze(1)], 1) * count
    return Counted(partition, observed, expected, cells - count * partition.cells.value[:, 0])


def _samples(bsdf: Bsdf, wo: Tensor, k: int, rng: torch.Generator, count: int) -> tuple[Tensor, Tensor]:
    wi, _ = spread_samples(bsdf, wo[k : k + 1], uniform(count, rng))
    bad = int((~((wi.norm(dim=-1) - 1.0).abs() < 1e-6)).sum())
    if bad:
        raise ValueError(f"{bad} of {count} samples are no unit vectors, for wo at {degrees(wo[k])}")
    return wi, torch.full((len(wi),), k)


def agreement(observed: Tensor, expected: Tensor) -> float:
    """p-value of one row: of the bins, and of what lies in the dark, where the quadrature may have overlooked a little."""
    if float(observed[:-1].sum()) == 0.0 == float(expected[:-1].sum()):  # a delta lobe takes all, as under total reflection
        return 1.0
    bins = torch.arange(len(observed)) != BINS
    count = float(observed.sum())
    dark = too_many(float(observed[BINS]), float(expected[BINS]) + TOLERANCE * count)
    return together(p_value(observed[bins], expected[bins]), dark)


def p_value(observed: Tensor, expected: Tensor) -> float:
    """Pearson's chi-square, all bins that expect less than 5 pooled; if even together they do, Poisson's test of too many.

    Raises ``ValueError`` for what is a single bin in the end: it tells nothing.
    """
    small = expected < LEAST
    few = float(observed[small].sum()), float(expected[small].sum())
    observed, expected = (torch.cat([x[~small], x.new_tensor(f).expand(1)]) for x, f in zip((observed, expected), few, strict=True))
    if few[1] >= LEAST:
        return chi_square(observed, expected)
    observed, expected = observed[:-1], expected[:-1]
    if few == (0.0, 0.0):  # empty bins say nothing
        if len(expected) < 2:
            raise ValueError("p_value: one bin tells nothing; at least two must expect something")
        return chi_square(observed, expected)
    return together(too_many(*few), *[chi_square(observed, expected)] * (len(expected) > 1))


def chi_square(observed: Tensor, expected: Tensor) -> float:
    """Pearson's test; one degree of freedom less than there are bins."""
    statistic = ((observed - expected) ** 2 / expected).sum()
    freedom = torch.tensor(len(expected) - 1.0, dtype=statistic.dtype)
    return float(torch.special.gammaincc(0.5 * freedom, 0.5 * statistic))


def too_many(observed: float, expected: float) -> float:
    """Poisson's probability of ``observed`` or more."""
    return 1.0 if observed == 0 else float(torch.special.gammainc(*torch.tensor([observed, expected], dtype=torch.float64)))


def together(*p: float) -> float:
    """p-value of the smallest of independent ones."""
    return 1.0 - (1.0 - min(p)) ** len(p)
