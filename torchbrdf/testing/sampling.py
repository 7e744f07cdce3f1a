"""Samples against their density, their weights against ``evaluate``, and delta lobes, which have nothing else to show."""

from typing import Any

import torch
from torch import Tensor

from ..bsdf.base import Bsdf
from ..bsdf.lobe import Lobe
from ..vector import Frame, reflect
from .partition import Partition, is_delta, spread_samples
from .subject import DELTA, Outcome, above, at_angles, directions, spread, transmits, uniform, viewers

ANGLES = (0.0, 45.0, 80.0)
SIGNIFICANCE = 1e-3  # chance that a right sampler fails, over all directions; the planted faults reach 1e-18 and less
LEAST = 5.0  # expected counts below this are pooled; chi-square is not to be trusted for fewer
STANDARD_ERRORS = 5.0


def pdf_integrates_to_one(subject: Any, rng: torch.Generator, thorough: bool = False) -> Outcome:
    """Over the whole sphere; short of 1 by the probability with which delta lobes are chosen."""
    if spread(subject) is None:
        return Outcome.absent("pdf_integrates_to_one", "no lobe that has a density")
    worst = 0.0
    for wo in at_angles(*ANGLES).split(1):
        total = float(Partition.of(subject, wo, rng).integrals(subject, wo).sum())
        worst = max(worst, abs(total + delta_probability(subject, wo) - 1.0))
    # kinks (the horizon of a cosine, the edge of a lobe) cross the bins and cost the quadrature some 1e-4
    return Outcome("pdf_integrates_to_one", worst <= 1e-3, worst, "largest |integral - 1|")


def delta_probability(bsdf: Bsdf, wo: Tensor) -> float:
    """The share of samples that a delta lobe takes, over evenly spread u."""
    if bsdf.select(DELTA) is None:
        return 0.0
    i = torch.arange(2**15, dtype=wo.dtype)
    golden = (i * 0.5 * (5**0.5 - 1.0)) % 1.0  # a Kronecker lattice
    u = torch.stack([golden, (i * (2.0**0.5 - 1.0)) % 1.0, (i + 0.5) / len(i)], -1)
    return 1.0 - len(spread_samples(bsdf, wo, u)) / len(i)


def samples_follow_pdf(subject: Any, rng: torch.Generator, thorough: bool = False) -> Outcome:
    """Chi-square test at several ``wo``, Sidak-corrected; the figure is the smallest p-value."""
    name = "samples_follow_pdf"
    if spread(subject) is None:
        return Outcome.absent(name, "no lobe that has a density")
    wos = at_angles(*range(0, 90, 10)) if thorough else at_angles(*ANGLES)
    p = min(chi2(subject, wo, rng, 200_000 if thorough else 20_000) for wo in wos.split(1))
    threshold = 1.0 - (1.0 - SIGNIFICANCE) ** (1.0 / len(wos))
    return Outcome(name, p > threshold, p, f"smallest p of chi-square, rejected below {threshold:.2g}")


def chi2(bsdf: Bsdf, wo: Tensor, rng: torch.Generator, count: int) -> float:
    """p-value of ``count`` samples for ``wo [1, 3]`` against the integral of the pdf over adaptive bins."""
    partition = Partition.of(bsdf, wo, rng)
    wi = spread_samples(bsdf, wo, uniform(count, rng))
    expected = partition.integrals(bsdf, wo).flatten() * count
    observed = partition.counts(wi).flatten().to(expected.dtype)
    rest = torch.tensor([count - len(wi), delta_probability(bsdf, wo) * count], dtype=expected.dtype)
    return p_value(torch.cat([observed, rest[:1]]), torch.cat([expected, rest[1:]]))


def p_value(observed: Tensor, expected: Tensor) -> float:
    """Pearson's chi-square with small bins pooled; 0 if samples lie where none may be."""
    order = expected.argsort()
    small = int((expected[order].cumsum(0) < LEAST).sum()) + 1
    observed, expected = (torch.cat([x[order[:small]].sum().reshape(1), x[order[small:]]]) for x in (observed, expected))
    if float(expected.min()) < LEAST:
        return 0.0 if float(observed[0]) > 4.0 * LEAST else 1.0
    statistic = ((observed - expected) ** 2 / expected).sum()
    freedom = torch.tensor(len(expected) - 1.0, dtype=statistic.dtype)
    return float(torch.special.gammaincc(0.5 * freedom, 0.5 * statistic))


def weights_match(subject: Any, rng: torch.Generator, thorough: bool = False) -> Outcome:
    """``weight * pdf`` must be ``evaluate`` times the cosine, and the sample's pdf that of ``pdf``, in world space too."""
    name = "weights_match"
    if spread(subject) is None:
        return Outcome.absent(name, "no lobe that has a density")
    frame = Frame.from_normal(directions(1024, rng))
    wo = frame.to_world(viewers(subject, 1024, rng))
    s = subject.sample(wo, uniform(1024, rng), frame.normal)
    f, pdf = subject.evaluate(s.wi, wo, frame.normal), subject.pdf(s.wi, wo, frame.normal)
    cos = frame.to_local(s.wi)[:, 2:].abs()
    kept = ~is_delta(subject, s.lobe)
    worst = max(_relative((s.weight * s.pdf)[kept], (f * cos)[kept]), _relative(s.pdf[kept], pdf[kept]))
    # the two routes differ by rounding alone, which an exponent of 1e4 magnifies ten-thousandfold
    return Outcome(name, worst <= 2.0**20 * torch.finfo(f.dtype).eps, worst, "weight pdf against f cos, over the largest")


def _relative(a: Tensor, b: Tensor) -> float:
    return float((a - b).abs().max() / b.abs().max())


def dark_outside_domain(subject: Any, rng: torch.Generator, thorough: bool = False) -> Outcome:
    """Outside ``domain`` everything is 0: ``evaluate``, ``pdf``, the weights of samples. Nothing crosses without a transmission lobe."""
    name = "dark_outside_domain"
    if not isinstance(subject, Bsdf):
        return Outcome.absent(name, "not a BSDF")
    mirrored = torch.tensor([1.0, 1.0, -1.0], dtype=torch.float64)
    up = torch.cat([above(1024, rng), at_angles(*[89.0] * 1024)])
    wo = torch.cat([up, up * mirrored])
    s = subject.sample(wo, uniform(4096, rng))
    wi = torch.cat([s.wi, directions(4096, rng), wo * mirrored])
    wo = wo.repeat(3, 1)
    dark = ~subject.domain(subject.geometry(wi, wo)).reshape(-1)
    if not transmits(subject):
        dark = dark | (wi[:, 2] * wo[:, 2] <= 0)
    if type(subject).domain is Bsdf.domain:
        dark = dark | (wi[:, 2] <= 0) | (wo[:, 2] <= 0)
    leaked = (s.weight.abs().sum(-1) + s.pdf.abs().sum(-1))[dark[:4096] & ~is_delta(subject, s.lobe)]
    values = subject.evaluate(wi, wo).abs().sum(-1)[dark] + subject.pdf(wi, wo).abs().sum(-1)[dark]
    total = float(leaked.sum() + values.sum())
    return Outcome(name, total == 0.0, total, "sum of what should be 0")


def mean_weight(subject: Any, rng: torch.Generator, thorough: bool = False) -> Outcome:
    """The mean of ``sample(...).weight``, as power, must be the directional albedo, delta lobes included; of reciprocal models."""
    name = "mean_weight"
    if not isinstance(subject, Bsdf):
        return Outcome.absent(name, "not a BSDF")
    if not subject.reciprocal:
        return Outcome.absent(name, "the model is not reciprocal: samples follow the light that arrives, the albedo that which leaves")
    count, worst = 100_000 if thorough else 8192, 0.0
    for wo in at_angles(*ANGLES).split(1):
        s = subject.sample(wo, uniform(count, rng))
        weight = s.weight * s.eta * s.eta  # of power: radiance grows by the square of the index across an interface
        # 2e-3: twice the stated error of directional_albedo's quadrature, relative to the brightest channel
        floor = 2e-3 * max(1.0, float(weight.mean(0).max())) / STANDARD_ERRORS
        error = (weight.mean(0) - subject.directional_albedo(wo)).abs()
        worst = max(worst, float((error / (weight.std(0) / count**0.5 + floor)).max()))
    return Outcome(name, worst <= STANDARD_ERRORS, worst, "standard errors between mean weight and albedo")


def delta_lobes(subject: Any, rng: torch.Generator, thorough: bool = False) -> Outcome:
    """``sample`` and ``deltas`` agree on direction and weight; a mirror lobe mirrors; a model of deltas alone evaluates to 0."""
    if not isinstance(subject, Bsdf) or subject.select(DELTA) is None:
        return Outcome.absent("delta_lobes", "no delta lobe")
    n = directions(512, rng)
    wo = Frame.from_normal(n).to_world(viewers(subject, 512, rng))
    s, viewer = subject.sample(wo, uniform(512, rng), n), subject.viewer(wo, n)
    worst = 0.0
    for d in subject.deltas(viewer):
        taken = ((s.lobe == d.lobe) & (s.pdf > 0)).squeeze(-1)
        wi, weight = (x.expand(*wo.shape[:-1], x.shape[-1]) for x in (viewer.layout.join_vector(d.wi), viewer.layout.join(d.weight)))
        worst = max(worst, _largest((s.wi - wi)[taken]), _largest((s.weight * s.pdf - weight)[taken]))
        if subject.lobes[d.lobe] == Lobe.DELTA_REFLECTION:
            worst = max(worst, _largest(wi - reflect(wo, n)))
        if spread(subject) is None:
            worst = max(worst, _largest(subject.evaluate(wi, wo, n)), _largest(subject.pdf(wi, wo, n)))
    return Outcome("delta_lobes", worst <= 64 * torch.finfo(wo.dtype).eps, worst, "largest error of direction, weight, evaluate")


def _largest(x: Tensor) -> float:
    return float(x.abs().max()) if x.numel() else 0.0
