"""Measured complex index of refraction of metals, 0.3 to 0.9 micrometres.

Cu, Au, Ag: Johnson & Christy 1972; Ti, Cr, Fe, Ni: Johnson & Christy 1974; Al: Rakic 1995. The numbers, each table with its
source, lie beside this file in ``metals.json``; they come from the refractiveindex.info database (CC0 1.0).
"""

import bisect
import functools
import json
from collections.abc import Iterable
from pathlib import Path


@functools.cache
def tables() -> dict[str, dict]:
    """``{metal: {"source": citation, "rows": [[wavelength in um, n, k], ...]}}``, rows by increasing wavelength."""
    return json.loads(Path(__file__).with_name("metals.json").read_text(encoding="utf-8"))["metals"]


def index_at(metal: str, wavelengths_um: Iterable[float]) -> tuple[list[float], list[float]]:
    """``(eta, k)`` of a metal, by its chemical symbol, at wavelengths in micrometres: linear between the measured points.

    Raises ``ValueError`` for a metal that has no table and for a wavelength outside of it: nothing is extrapolated.
    """
    if metal not in tables():
        raise ValueError(f"metal: found {metal!r}, known are {sorted(tables())}; give Conductor(eta, k) the numbers of others")
    rows = tables()[metal]["rows"]
    pairs = [_between(rows, float(w), metal) for w in wavelengths_um]
    return [n for n, _ in pairs], [k for _, k in pairs]


def _between(rows: list[list[float]], wavelength: float, metal: str) -> tuple[float, float]:
    first, last = rows[0][0], rows[-1][0]
    if not first <= wavelength <= last:
        raise ValueError(f"wavelengths_um: found {wavelength:g} um, the table of {metal} covers [{first:g}, {last:g}] um (0.55 is green)")
    i = min(bisect.bisect_right(rows, [wavelength, float("inf"), 0.0]), len(rows) - 1)
    (w0, n0, k0), (w1, n1, k1) = rows[i - 1], rows[i]
    t = (wavelength - w0) / (w1 - w0)
    return n0 + t * (n1 - n0), k0 + t * (k1 - k0)
