"""The picture of a report: albedo over angle against its bound; samples against their density."""

from pathlib import Path
from typing import Any

import torch

from ..bsdf.base import Bsdf
from .partition import BINS, Partition
from .sampling import counted
from .subject import at_angles, generator, materials, spread

ANGLES = [*range(0, 85, 5), *range(85, 90)]
COUNT, TOGETHER = 20_000, 4  # samples; bins in a bar


def save(subject: Any, path: str | Path) -> None:
    """Draw ``subject`` (of a batch, one material) into the file ``path``. Needs matplotlib."""
    from matplotlib.figure import Figure

    single = materials(subject, generator(0), 1)[0]
    figure = Figure(figsize=(10, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    if isinstance(single, Bsdf):
        _albedo(left, single)
        _histogram(right, single)
    else:
        _reflectance(left, single)
        right.set_axis_off()
    figure.suptitle(repr(single), fontsize=8, wrap=True)
    figure.savefig(path, dpi=120)


def _albedo(axes: Any, bsdf: Bsdf) -> None:
    for k, channel in enumerate(bsdf.directional_albedo(at_angles(*ANGLES)).unbind(-1)):
        axes.plot(ANGLES, channel.tolist(), color=f"C{k}", label=f"channel {k}")
    bounds = [] if bsdf.energy_bound is None else bsdf.energy_bound.expand(bsdf.channels).tolist()
    for k, bound in enumerate(bounds):
        axes.axhline(bound, color=f"C{k}", linestyle=":")
    axes.set(xlabel="angle of wo from the normal, degrees", ylabel="directional albedo (dotted: its bound)", ylim=(0, None))
    axes.legend()


def _histogram(axes: Any, bsdf: Bsdf) -> None:
    axes.set(xlabel="bins of the sphere, for wo at 45°", ylabel=f"of {COUNT} samples")
    if spread(bsdf) is None:
        axes.text(0.5, 0.5, "delta lobes only", ha="center", transform=axes.transAxes)
        return
    rng = generator(0)
    found = counted(bsdf, Partition.of(bsdf, at_angles(45.0), rng), rng, COUNT)
    observed, expected = (x[0, :BINS].reshape(-1, TOGETHER).sum(1) for x in (found.observed, found.expected))
    bars = range(len(observed))
    axes.bar(bars, observed.tolist(), color="0.8", label="samples")
    axes.errorbar(bars, expected.tolist(), torch.sqrt(expected.clamp_min(0.0)).tolist(), fmt="k.", label="pdf, one standard deviation")
    axes.legend()


def _reflectance(axes: Any, term: Any) -> None:
    angles = torch.linspace(0, 90, 181, dtype=torch.float64)
    for k, channel in enumerate(term.reflectance(torch.cos(torch.deg2rad(angles)).unsqueeze(-1)).unbind(-1)):
        axes.plot(angles.tolist(), channel.tolist(), color=f"C{k}", label=f"channel {k}")
    axes.set(xlabel="angle of incidence, degrees", ylabel="reflectance", ylim=(0, 1))
    axes.legend()
