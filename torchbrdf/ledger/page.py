"""The published page: tables of what was measured."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from .errors import OFF
from .record import Record
from .rows import COMPILED

HEAD = Path(__file__).with_name("head.md")  # the words above the tables
ERRORS = [
    "method",
    "dtype",
    "how",
    "value p99.9",
    "max",
    "mean",
    f"> {OFF:g}",
    "slope p99.9",
    "max",
    "mean",
    f"> {OFF:g}",
    "absolute max",
    "mean",
]
COSTS = ["method", "dtype", "how", "forward", "both", "forward, ns", "both, ns", "kept", "compile, s"]


def text(found: Record, pictures: dict[str, list[str]] | None = None) -> str:
    """The whole page; ``pictures`` are names of files in ``images``, by law."""
    measured = {name: _measured_on(law["machine"]) for name, law in found["laws"].items()}
    at_once = len(set(measured.values())) == 1
    parts = [HEAD.read_text(encoding="utf-8").strip(), *list(measured.values())[: int(at_once)]]
    if pictures:
        parts += [_picture(name, "Error against time, all laws") for name in pictures.get("", [])]
    for name, law in found["laws"].items():
        parts += [
            f"## {name}",
            *([] if at_once else [measured[name]]),
            *_law(law),
            *(_picture(p, f"{name}: {_shows(p)}") for p in (pictures or {}).get(name, [])),
        ]
    return "\n\n".join(parts) + "\n"


def table(head: list[str], rows: Iterable[list[str]]) -> str:
    """In Markdown."""
    return "\n".join("| " + " | ".join(line) + " |" for line in [head, ["---"] * len(head), *rows])


def number(x: Any) -> str:
    """Two digits; a dash for what there is not."""
    return "–" if x is None else str(x) if isinstance(x, str) else "0" if x == 0 else f"{x:.2g}" if 1e-3 <= abs(x) < 100 else f"{x:.1e}"


def _measured_on(machine: dict[str, Any]) -> str:
    versions = ", ".join(f"{name} {v}" for name, v in machine["versions"].items())
    threads = f"{machine['threads']} thread{'s' if machine['threads'] > 1 else ''} of {machine['cores']}"
    return (
        f"Measured on: {machine['device']} ({machine['vector instructions']}), {threads}, load {machine['load']} when the run began; "
        f"{versions}; commit {machine['commit'] or 'unknown'}; "
        f"{machine['pixels']} pixels, {machine['rounds']} rounds, {machine['points']} points."
    )


def _law(law: dict[str, Any]) -> list[str]:
    domain = ", ".join(f"{name} in [{low:g}, {high:g}]" for name, (low, high) in law["domain"].items())
    above = "directions above the horizon, the lobe above 1e-3 of its peak; " if law["directions"] else ""
    hard = f" Hard points: {law['hard']}." if law["hard"] else ""
    methods = [
        [f"**{m['name']}** (default)" if m["default"] else m["name"], f"`{m['call']}`", m["source"], m["claim"].replace("|", "&#124;")]
        for m in law["methods"]
    ]
    parts = [f"Everyday domain: {above}{domain}.{hard}", table(["method", "how to call it", "source", "claim"], methods)]
    angles = list(law["rows"][0]["errors"]["spot"])
    head = [*ERRORS, *(f"Spot, {a}" for a in angles), *(["hard"] if law["hard"] else [])]
    parts.append(table(head, [_errors(row, angles, bool(law["hard"])) for row in law["rows"]]))
    base = next((r["costs"] for r in law["rows"] if r["how"] == COMPILED and r["costs"]), None)
    return parts if base is None else [*parts, table(COSTS, [_costs(row, base) for row in law["rows"] if row["costs"]])]


def _named(row: dict[str, Any]) -> list[str]:
    return [row["method"], row["dtype"], row["how"]]


def _errors(row: dict[str, Any], angles: list[str], hard: bool) -> list[str]:
    e = row["errors"]
    spread = [x for by in ("value", "slope") for x in (*(number(e[by][k]) for k in ("p999", "worst", "mean")), _percent(e[by]["off"]))]
    absolute = [number(e["absolute"]["worst"]), number(e["absolute"]["mean"])]
    edges = [f"{number(e['hard_value']['p999'])} / {number(e['hard_slope']['p999'])}" if e["hard_value"] else "–"] if hard else []
    return [*_named(row), *spread, *absolute, *(number(e["spot"].get(a)) for a in angles), *edges]


def _percent(share: float) -> str:
    return "0" if share == 0 else f"{100 * share:.0f} %" if share >= 0.1 else f"{100 * share:.2g} %"


def _costs(row: dict[str, Any], base: dict[str, Any]) -> list[str]:
    c = row["costs"]
    ratios = [f"{c[k]['median'] / base[k]['median']:.2f}" for k in ("forward", "both")]
    spread = [f"{c[k]['median']:.2f} ({c[k]['low']:.2f}–{c[k]['high']:.2f})" for k in ("forward", "both")]
    return [*_named(row), *ratios, *spread, f"{c['kept']:.0f}", "–" if c["compiling"] is None else f"{c['compiling']:.1f}"]


def _picture(name: str, words: str) -> str:
    return f"![{words}](images/{name})"


def _shows(name: str) -> str:
    return "error against time" if name.startswith("ledger-time") else "what the approximations look like, and their error"
