"""Pictures of what was measured: error against time with the Pareto front, and what an approximation looks like."""

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..method import Law
from .record import Record
from .rows import COMPILED, EAGER, WITHOUT

MARKERS = {EAGER: "o", COMPILED: "s", WITHOUT: "^"}
SHOWN = {"dielectric": {"eta": (1.5, 1.5, 1.5)}}  # inputs of the picture of a law, red, green, blue; else the middle of its everyday ranges
SIDE = 160  # pixels
SCALE = 0.1  # of false colours, either way


def draw(found: Record, laws: dict[str, Law], folder: Path) -> dict[str, list[str]]:
    """Write every picture into ``folder``; the names by law, those of all laws under ``""``."""
    names: dict[str, list[str]] = {"": []}
    timed = {name: law for name, law in found["laws"].items() if all(row["costs"] for row in law["rows"])}
    if timed:
        names[""].append(_save(_fronts(timed, columns=2), folder / "ledger.png"))
    for name in found["laws"]:
        names[name] = [_save(_fronts({name: timed[name]}, columns=1), folder / f"ledger-time-{name}.png")] if name in timed else []
        if any(not m.exact for m in laws[name].methods) and "cos_i" in laws[name].inputs:
            names[name].append(_save(_strip(laws[name]), folder / f"ledger-look-{name}.png"))
    return names


def front(points: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
    """Of (time, error): those that no other is both faster and more accurate than, in order of time."""
    found: list[tuple[float, float]] = []
    for time, error in sorted(points):
        if not found or error < found[-1][1]:
            found.append((time, error))
    return found


def _fronts(laws: dict[str, Any], columns: int) -> Any:
    from matplotlib.figure import Figure

    rows = -(-len(laws) // columns)
    figure = Figure(figsize=(6.4 * columns, 3.6 * rows), layout="constrained")
    for k, (name, law) in enumerate(laws.items()):
        _front(figure.add_subplot(rows, columns, k + 1), name, law["rows"])
    return figure


def _front(axes: Any, name: str, rows: list[dict[str, Any]]) -> None:
    from matplotlib import colormaps, ticker

    labels = list(dict.fromkeys(_label(row) for row in rows))
    colours = {label: colormaps["tab20"](2 * j % 20 + j // 10 % 2) for j, label in enumerate(labels)}
    points = [(row["costs"]["both"]["median"], max(float(row["errors"]["value"]["p999"]), 1e-17)) for row in rows]
    axes.step(*zip(*front(points), strict=True), where="post", color="0.6", linewidth=1, zorder=1)
    for row, (time, error) in zip(rows, points, strict=True):
        c = row["costs"]["both"]
        axes.plot([c["low"], c["high"]], [error, error], color=colours[_label(row)], linewidth=1)
        if row["errors"]["hard_value"]:
            axes.plot(
                [time, time], [error, max(error, float(row["errors"]["hard_value"]["p999"]))], ":_", color=colours[_label(row)], linewidth=1
            )
        face = "white" if row["how"] == EAGER else colours[_label(row)]
        axes.plot(time, error, MARKERS[row["how"]], color=colours[_label(row)], markerfacecolor=face, markersize=7)
    axes.set(xscale="log", yscale="log", title=name, xlabel="ns a pixel, value and gradients", ylabel="relative error, p99.9")
    axes.xaxis.set_major_locator(ticker.LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(ticker.FormatStrFormatter("%g"))
    axes.xaxis.set_minor_locator(ticker.NullLocator())
    shown = [(m, how, "0.3", "white" if how == EAGER else "0.3") for how, m in MARKERS.items()]
    entries = [("o", label, colours[label], colours[label]) for label in labels] + shown
    handles = [axes.plot([], [], m, color=c, markerfacecolor=face, label=words)[0] for m, words, c, face in entries]
    axes.legend(handles=handles, fontsize="x-small", loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    axes.grid(alpha=0.3)


def _label(row: dict[str, Any]) -> str:
    return row["method"] if row["dtype"] == "float32" else f"{row['method']}, {row['dtype']}"


def _strip(law: Law) -> Any:
    """Reflectance over all angles of incidence, from 0 in the middle to 90 degrees at the rim; below, the difference from the default."""
    from matplotlib.figure import Figure

    cos = _disc()
    truth = _reflectance(law, law.default.formula, cos)
    shown = [m for m in law.methods if m is law.default or not m.exact]
    figure = Figure(figsize=(1.9 * len(shown) + 0.9, 4.0), layout="constrained")
    panels = figure.subplots(2, len(shown), squeeze=False)
    for above, below, method in zip(*panels, shown, strict=True):
        error = _reflectance(law, method.formula, cos) - truth
        above.imshow(np.clip(np.nan_to_num(truth + error, nan=1.0), 0.0, 1.0) ** (1 / 2.2))
        above.set_title(method.name, fontsize="small")
        if method is not law.default:
            worst = np.take_along_axis(error, np.abs(np.nan_to_num(error)).argmax(-1)[..., None], -1)[..., 0]
            image = below.imshow(worst, cmap="RdBu_r", vmin=-SCALE, vmax=SCALE)
            below.set_title(f"at most {np.nanmax(np.abs(error)):.2g}", fontsize="small")
    for panel in panels.ravel():
        panel.axis("off")
    figure.colorbar(image, ax=panels[1, :].tolist(), label=f"less {law.default.name}", shrink=0.8, extend="both")
    return figure


def _disc() -> torch.Tensor:
    """Cosines ``[S, S]`` of angles that grow evenly with the distance from the middle; NaN beyond 90 degrees."""
    axis = (torch.arange(SIDE, dtype=torch.float64) + 0.5) * (2.0 / SIDE) - 1.0
    radius = torch.sqrt(axis * axis + axis[:, None] ** 2)
    return torch.where(radius < 1.0, torch.cos(radius * (math.pi / 2)), torch.nan)


def _reflectance(law: Law, formula: Any, cos: torch.Tensor) -> np.ndarray:
    """``[S, S, 3]``"""
    middle = {name: ((low + high) / 2,) * 3 for name, (low, high) in law.inputs.items()}
    colours = middle | SHOWN.get(law.name, {}) | _metal(law)
    inputs = [cos.nan_to_num(0.5) if name == "cos_i" else torch.tensor(colours[name], dtype=torch.float64) for name in law.inputs]
    found = [formula(*(x if x.dim() > 1 else x[k].expand_as(cos) for x in inputs)) for k in range(3)]
    return torch.stack([torch.where(cos.isnan(), torch.nan, f) for f in found], -1).numpy()


def _metal(law: Law) -> dict[str, tuple[float, ...]]:
    """Copper, where a law asks for both parts of an index."""
    from ..optics.fresnel import Conductor

    copper = Conductor.named("Cu")
    return {"eta": tuple(copper.eta.tolist()), "k": tuple(copper.k.tolist())} if {"eta", "k"} <= law.inputs.keys() else {}


def _save(figure: Any, file: Path) -> str:
    """As a small PNG; its name. Lines need few colours, false colours all of them."""
    import io

    from PIL import Image

    drawn = io.BytesIO()
    figure.savefig(drawn, dpi=100)
    image = Image.open(drawn).convert("RGB")
    (image if "look" in file.name else image.quantize(256)).save(file, optimize=True)
    return file.name
