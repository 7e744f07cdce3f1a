"""The published table: measure everything, print it, and write docs/stability.md."""

from collections.abc import Iterable, Iterator
from pathlib import Path

import torch

from . import bounds, curvature, kept, measure, rivals
from .case import Case
from .cases import CASES
from .curvature import Curvature
from .measure import Figures

PAGE = Path(__file__).resolve().parents[2] / "docs" / "stability.md"
DTYPES = (torch.float32, torch.float64, torch.bfloat16, torch.float16)
BATCH = 8  # formulas compiled together
UNITS = {
    "ulp": "ulp",
    "length": "ulp of the length",
    "scale": "ulp of 1",
    "exp": "(4 + 2&#124;ln&#124;) eps",
    "backward": "input roundings",
}


def name_of(dtype: torch.dtype) -> str:
    return str(dtype).removeprefix("torch.")


def batches(cases: tuple[Case, ...]) -> Iterator[tuple[Case, ...]]:
    """A few at a time."""
    yield from (cases[i : i + BATCH] for i in range(0, len(cases), BATCH))


def figure(x: float | None) -> str:
    """Three digits; a dash for what was not measured."""
    if x is None:
        return "–"
    return f"{x:.2g}" if x < 100 else "inf" if x == float("inf") else f"{x:.0e}"


def table(head: list[str], rows: Iterable[list[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def eager_row(case: Case, f: Figures) -> list[str]:
    """Everything about one formula in one dtype."""
    bad = "/".join(str(n) for n in (f.values_not_finite, f.slopes_not_finite, f.seconds_not_finite))
    outside = "/".join(str(n) for n in (f.negative, f.above_one))
    left_out = "; ".join(f"{reason} {n}" for reason, n in f.excluded.items()) or "–"
    errors = [*(figure(x) for x in (f.p999, f.worst, f.slope_everyday)), f"{100 * f.slopes_bad:.2f} %", figure(f.second_everyday)]
    return [case.name, str(f.points), bad, outside, UNITS[case.error], *errors, left_out]


EAGER_HEAD = [
    "formula",
    "points",
    "not finite: value/slope/second",
    "below 0/above 1",
    "unit",
    "p99.9",
    "max",
    "slope",
    "off",
    "second",
    "excluded points",
]


def eager(dtype: torch.dtype, device: str) -> dict[str, Figures]:
    """Every formula, eagerly."""
    from tqdm import tqdm

    return {case.name: measure.run(case, dtype, device=device) for case in tqdm(CASES, f"{name_of(dtype)}, eager")}


def compiled(dtype: torch.dtype, device: str) -> dict[str, Figures]:
    """Every formula, compiled with a full graph."""
    from tqdm import tqdm

    found: dict[str, Figures] = {}
    for batch in tqdm(list(batches(CASES)), f"{name_of(dtype)}, compiled"):
        found |= dict(zip((c.name for c in batch), measure.run_compiled(batch, dtype, device), strict=True))
    return found


def curved(dtype: torch.dtype, device: str, compile_too: bool) -> dict[str, Curvature]:
    """Second derivatives along one direction, of every formula, in float32 (compiling them takes as long as everything else)."""
    from tqdm import tqdm

    if dtype != torch.float32:
        return {case.name: Curvature(0, None) for case in CASES}
    found: dict[str, Curvature] = {}
    for batch in tqdm(list(batches(CASES)), f"{name_of(dtype)}, {'compiled' if compile_too else 'eager'}, second derivatives"):
        found |= dict(zip((c.name for c in batch), curvature.run(batch, dtype, device, compile_too), strict=True))
    return found


def compiled_row(case: Case, c: Figures, e: Figures, second: Curvature, second_eager: Curvature) -> list[str]:
    """Compiled beside eager."""
    bad = f"{c.values_not_finite}/{c.slopes_not_finite}/{second.not_finite}"
    pairs = [(c.p999, e.p999), (c.worst, e.worst), (c.slope_everyday, e.slope_everyday), (second.worst, second_eager.worst)]
    return [case.name, bad, f"{c.negative}/{c.above_one}", *(f"{figure(x)} ({figure(y)})" for x, y in pairs)]


COMPILED_HEAD = [
    "formula",
    "not finite: value/slope/second",
    "below 0/above 1",
    "p99.9 (eager)",
    "max (eager)",
    "slope (eager)",
    "second (eager)",
]


def compiled_part(dtype: torch.dtype, device: str, figures: dict[str, Figures]) -> tuple[list[str], list[str]]:
    """The table, and what does not hold."""
    fused, twice, twice_eager = compiled(dtype, device), curved(dtype, device, True), curved(dtype, device, False)
    rows = [compiled_row(c, fused[c.name], figures[c.name], twice[c.name], twice_eager[c.name]) for c in CASES]
    broken = []
    for c in CASES:
        found = bounds.undone(fused[c.name], figures[c.name], c.error) + bounds.violations(fused[c.name], c.error, c.vectors, dtype)
        found += bounds.bent(twice[c.name], twice_eager[c.name], dtype)
        broken += [f"{name_of(dtype)}, compiled, {c.name}: {v}" for v in found]
    return [f"### {name_of(dtype)}, compiled", table(COMPILED_HEAD, rows)], broken


def rival_rows(ours: dict[str, Figures]) -> Iterator[list[str]]:
    """This library, textbook and Mitsuba, in float32 on the same grids."""
    theirs = rivals.mitsuba()
    for case in CASES:
        found = {"torchbrdf": ours[case.name]}
        if case.name in rivals.TEXTBOOK:
            found["textbook"] = rivals.textbook(case, torch.float32)
        if case.name in theirs:
            found["Mitsuba"] = rivals.mitsuba_figures(case, theirs[case.name])
        for who, f in found.items() if len(found) > 1 else ():
            slopes = who == "torchbrdf" or case.name not in rivals.OTHER_ARGUMENTS
            not_finite = f"{f.values_not_finite}/{f.slopes_not_finite if slopes else '–'}"
            errors = [
                figure(f.p999),
                figure(f.worst),
                figure(f.slope_everyday if slopes else None),
                f"{100 * f.slopes_bad:.2f} %" if slopes else "–",
            ]
            yield [case.name if who == "torchbrdf" else "", who, not_finite, f"{f.negative}/{f.above_one}", *errors]


RIVAL_HEAD = ["formula", "", "not finite: value/slope", "below 0/above 1", "p99.9", "max", "everyday slope", "slopes off by > 1e-4"]


def worst_of(figures: Iterable[Figures]) -> str:
    """Totals of what must be 0."""
    counts = [
        sum(getattr(f, k) for f in figures)
        for k in ("values_not_finite", "slopes_not_finite", "seconds_not_finite", "negative", "above_one")
    ]
    return " / ".join(map(str, counts))


def measure_all(device: str, compile_too: bool, write: bool) -> int:
    """Print the tables (write them if asked to) and what does not hold; returns how many bounds are broken."""
    parts, broken = [], []
    for dtype in DTYPES:
        figures = eager(dtype, device)
        parts += [f"## {name_of(dtype)}", table(EAGER_HEAD, (eager_row(c, figures[c.name]) for c in CASES))]
        broken += [f"{name_of(dtype)}, {c.name}: {v}" for c in CASES for v in bounds.violations(figures[c.name], c.error, c.vectors, dtype)]
        if dtype == torch.float32:
            parts[:0] = ["## Side by side", RIVALS, table(RIVAL_HEAD, rival_rows(figures))]
        if compile_too:
            more, failed = compiled_part(dtype, device, figures)
            parts += more
            broken += failed
        kept.forget()
    verdict = "Every bound holds." if not broken else "Bounds that do not hold:\n\n" + "\n".join(f"- {b}" for b in broken)
    text = "\n\n".join([HEAD.format(formulas=len(CASES)), verdict, *parts]) + "\n"
    print(text)
    if write:
        PAGE.write_text(text, encoding="utf-8")
        print(f"wrote {PAGE.relative_to(PAGE.parents[1])}")
    return len(broken)


HEAD = f"""<!-- Written by `python run.py stability`: measured, never edited. The bounds are in tests/stability/bounds.py. -->
# Stability, measured

Look up here how exact a formula is before you build on it: the errors of its value and of its derivatives in your dtype, eagerly and
compiled, at hard inputs as well as at everyday ones, and beside textbook code and Mitsuba. Rows are formulas; the columns are explained below.

{{formulas}} formulas are measured against exact arithmetic, at 10 000 points at least each, in four dtypes. The exact value is the textbook's formula in 320 to
2600 bits with exact first and second derivatives (dual numbers over arbitrary-precision floats, `torchbrdf/ledger/exact.py`); inputs are exactly
the numbers of the dtype. What a value and a slope *ought* to be at an edge is said in [numerics](numerics.md), and the exact value follows that.

| column | meaning |
| --- | --- |
| points | how many inputs were tried |
| not finite: value/slope/second | how often the result, a first or a second derivative was infinite or NaN although the exact one is a number of the dtype |
| below 0/above 1 | how often a result was negative, or a reflectance above 1, which neither can be |
| unit | in what the next two columns count errors (next table) |
| p99.9 | the error of the value that 99.9 % of the points do not exceed |
| max | the largest error of the value at any point |
| slope, everyday slope | the largest error of a first derivative at everyday inputs, relative to the derivative or the value, whichever is larger (from vectors: to the length of the gradient); half types round the slope itself |
| off, slopes off by > 1e-4 | the share of all points at which a first derivative is wrong by more than 1e-4 in that sense (4 eps for half types): extremes, where rounding the inputs changes as much |
| second | the same as *slope* for second derivatives; compiled, it is the Hessian times (1, ..., 1), by forward over reverse, in float32 |
| excluded points | how many points were left out of the errors, and why; less than 1 % together, overflows of the dtype apart |
| (eager) | the figure in brackets is the eager one, beside the compiled one |

| unit | one of it is |
| --- | --- |
| ulp | the spacing of numbers of the dtype at the result |
| ulp of the length | the spacing at the length of a vector of results |
| ulp of 1 | the spacing at 1, for sums of products of that size |
| (4 + 2&#124;ln&#124;) eps | what an exponential may lose at f/f_peak far below its peak; ln is the logarithm of that ratio |
| input roundings | what rounding every direction and parameter once may change: eps (&#124;f&#124; + Σ&#124;x&#124;&#124;∂f/∂x&#124;) |

The inputs hold the exact special values and their neighbours to the ulp: cosines 0, ±denormal, 1, 1 ± ulp; indices 1, 1 ± ulp, 1 ± 1e-7, towards 0;
every critical angle ± 3 ulp and total reflection; k = 0, denormal, 1e3; exponents 0, 1e-3 … 1e7 at bases 0 and 1; alpha 1e-4 … 1 and
alpha_x/alpha_y of 1e4; wi = wo, wi = −wo, the mirror direction, the horizon; zero, denormal, huge and non-unit vectors; the poles of frames
and of lat-long maps; 1e6 times 1e-12.

| what must hold | bound |
| --- | --- |
| not finite, negative, above 1 | 0 |
| p99.9, algebraic formulas | {bounds.ULP:g} ulp |
| p99.9, exponentials | {bounds.EXPONENTIAL:g} × (4 + 2&#124;ln&#124;) eps |
| p99.9, several directions | {bounds.BACKWARD:g} input roundings |
| p99.9, bfloat16 and float16 | {bounds.HALF_ULP:g} ulp |
| slope, everyday | {bounds.SLOPE_SCALAR:g} (scalars), {bounds.SLOPE_VECTOR:g} (vectors) |
| second, everyday | {bounds.SECOND[torch.float64]:g} (float64), {bounds.SECOND[torch.float32]:g} (float32) |
| compiled | at most {bounds.COMPILED:g} × the eager error |

Run it: `python3 run.py stability` (`--device cuda` on a GPU, `--no-compile` for the eager half)."""
RIVALS = """float32, the same points. *Textbook* is competent torch code with the usual clamps (`tests/stability/rivals.py`); *Mitsuba* its own functions through its LLVM
back end. "–": the rival's function takes other arguments (an angle from the cosine alone), so that its slopes mean something else."""


def main() -> int:
    """The command line."""
    import argparse

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--no-compile", action="store_true", help="leave the compiled half out (minutes)")
    parser.add_argument("--no-write", action="store_true", help="print only")
    options = parser.parse_args()
    return 1 if measure_all(options.device, not options.no_compile, not options.no_write) else 0
