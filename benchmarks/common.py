"""What the benchmarks share: a steady allocator, rivals that take turns, ratios, and the figures part of docs/benchmark.md."""

import argparse
import os
import platform
import re
import statistics
import sys
import time
from collections.abc import Callable, Iterable
from importlib import metadata
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from tqdm import tqdm

PAGE = Path(__file__).resolve().parents[1] / "docs" / "benchmark.md"
# glibc is told to keep what is freed: else every rival's time is mostly page faults, more or fewer as it happens to trim.
ALLOCATOR = {"MALLOC_TRIM_THRESHOLD_": str(2**33), "MALLOC_MMAP_THRESHOLD_": str(2**25), "MALLOC_TOP_PAD_": str(2**28)}
WARM_UP = 2  # rounds that compile and warm up, and are left out
Race = dict[tuple[str, str], Callable[[], Any]]  # {(rival, column): one run}
Times = dict[tuple[str, str], list[float]]  # milliseconds of every round


def steady() -> None:
    """Start this program again with the steady allocator."""
    if not ALLOCATOR.items() <= os.environ.items():
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, **ALLOCATOR})


def options(doc: str | None, points: int, rounds: int, threads: int = 2) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, default=points, help="points or pixels, about")
    parser.add_argument("--rounds", type=int, default=rounds, help="timed rounds")
    parser.add_argument("--threads", type=int, default=threads)
    parser.add_argument("--write", action="store_true", help="put the tables into docs/benchmark.md")
    return parser


def race(runs: Race, rounds: int, doing: str) -> Times:
    """Everybody once a round, so that a noisy machine disturbs all alike."""
    times: Times = {k: [] for k in runs}
    for n in tqdm(range(rounds + WARM_UP), desc=doing, leave=False):
        for k, run in runs.items():
            start = time.perf_counter()
            run()
            if n >= WARM_UP:
                times[k].append((time.perf_counter() - start) * 1e3)
    return times


def milliseconds(t: list[float]) -> str:
    """The median, and the quartiles."""
    low, middle, high = statistics.quantiles(t, n=4, method="inclusive") if len(t) > 1 else t * 3
    return f"{middle:.3g} ({low:.3g}–{high:.3g})"


def ratio(a: list[float], b: list[float]) -> float:
    """How many times ``b`` is ``a``: the median over the rounds, in each of which they ran next to one another."""
    return statistics.median(y / x for x, y in zip(a, b, strict=True))


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    head = list(head)
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def comparison(times: Times, columns: list[str], faster_than: str, slower_than: str | None = None) -> str:
    """Rivals by columns: milliseconds, the speed-up over one rival and the time in units of another's."""
    head = ["rival"]
    for c in columns:
        head += [f"{c}, ms", f"speed-up over {faster_than}", *([f"time / {slower_than}"] if slower_than else [])]
    rows = []
    for rival in dict.fromkeys(name for name, _ in times):
        row = [rival]
        for c in columns:
            row += _cells(times.get((rival, c)), times[faster_than, c], times[slower_than, c] if slower_than else None)
        rows.append(row)
    return table(head, rows)


def _cells(mine: list[float] | None, base: list[float], best: list[float] | None) -> list[str]:
    if mine is None:
        return ["–"] * (2 if best is None else 3)
    return [milliseconds(mine), f"{ratio(mine, base):.1f}×", *([] if best is None else [f"{ratio(best, mine):.2f}"])]


def disagreement(a: Tensor, b: Tensor, part: float) -> float:
    """The difference, relative to the magnitude plus its mean, below which a part of the numbers lies."""
    difference = ((a.to(b.dtype) - b).abs() / (b.abs() + b.abs().mean())).reshape(-1)
    return float(difference.nan_to_num(nan=torch.inf).kthvalue(max(1, round(part * difference.numel()))).values)


def need_agreement(rival: str, found: dict[str, Tensor], truth: dict[str, Tensor], part: float) -> None:
    """Stop the program unless a part of all numbers agrees to 1e-5."""
    worst = {name: disagreement(found[name], truth[name], part) for name in truth}
    print(f"  {rival:<20} " + "  ".join(f"{name} {w:.0e}" for name, w in worst.items()))
    for name, w in worst.items():
        if not w < 1e-5:
            raise SystemExit(f"{rival}: {name} disagrees with the textbook by {w:.1e}; nothing was timed")


def machine(threads: int) -> str:
    """What it ran on, in one line."""
    cpu = f"{platform.machine()} CPU ({torch.backends.cpu.get_cpu_capability()})"
    used = f"{threads} thread{'s' * (threads > 1)}"
    return f"{cpu}, {used}, float32; Python {platform.python_version()}, torch {torch.__version__}"


def version(package: str) -> str:
    return f"{package} {metadata.version(package)}"


def publish(section: str, text: str, write: bool) -> None:
    """Print a section of the figures; ``write`` it between its markers in docs/benchmark.md."""
    print(f"\n{text}\n")
    if not write:
        return
    page, mark = PAGE.read_text(encoding="utf-8"), f"<!-- {section}: %s -->"
    begin, end = re.escape(mark % "begin"), re.escape(mark % "end")
    new, count = re.subn(f"({begin}\n).*?({end})", lambda m: f"{m[1]}{text}\n{m[2]}", page, flags=re.DOTALL)
    if count != 1:
        raise SystemExit(f"docs/benchmark.md: expected the markers {mark % 'begin'} and {mark % 'end'} once, found {count}")
    PAGE.write_text(new, encoding="utf-8")
