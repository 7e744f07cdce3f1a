"""Measured complex index of refraction of metals, 0.3 to 0.9 micrometres.

Cu, Au, Ag: Johnson & Christy 1972; Ti, Cr, Fe, Ni: Johnson & Christy 1974; Al: Rakic 1995. The numbers, each table with its
source, lie beside this file in ``metals.json``; they come from the refractiveindex.info database (CC0 1.0).
"""

import bisect
import functools
import itertools
import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ..io import files


@functools.cache
def tables() -> dict[str, dict]:
    """``{metal: {"source": citation, "rows": [[wavelength in um, n, k], ...]}}``, rows by increasing wavelength."""
    return read(Path(__file__).with_name("metals.json"))


def read(path: Path) -> dict[str, dict]:
    """The tables of a file; ``ValueError`` names the file and the metal where they are not what :func:`tables` says."""
    try:
        found = json.loads(files.existing(path, "metals").read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: damaged ({files.reason(error)}); install the package again") from None
    metals = found.get("metals") if isinstance(found, dict) else None
    if not isinstance(metals, dict):
        raise ValueError(f"{path}: there is no 'metals' in it; install the package again")
    for name, table in metals.items():
        if not (isinstance(table, dict) and _is_sound(table.get("rows"))):
            raise ValueError(
                f"{path}: {name}: expected rows [wavelength, n > 0, k >= 0] by increasing wavelength; install the package again"
            )
    return metals


def _is_sound(rows: Any) -> bool:
    """Two rows or more of three finite numbers, n > 0, k >= 0, by increasing wavelength."""
    numbers = isinstance(rows, list) and all(isinstance(r, list) and len(r) == 3 and all(type(x) in (int, float) for x in r) for r in rows)
    if not numbers or len(rows) < 2:
        return False
    legal = all(0 < w < math.inf and 0 < n < math.inf and 0 <= k < math.inf for w, n, k in rows)
    return legal and all(a[0] < b[0] for a, b in itertools.pairwise(rows))


def index_at(metal: str, wavelengths_um: Iterable[float]) -> tuple[list[float], list[float]]:
    """``(eta, k)`` of a metal, by its chemical symbol, at wavelengths in micrometres: linear between the measured points.

    Raises ``ValueError`` for a metal that has no table and for a wavelength outside of it: nothing is extrapolated.
    """
    if not isinstance(metal, str) or metal not in tables():
        raise ValueError(f"metal: found {metal!r}, known are {sorted(tables())}; give Conductor(eta, k) the numbers of others")
    rows = tables()[metal]["rows"]
    try:
        wanted = [float(w) for w in wavelengths_um]
    except (TypeError, ValueError):
        raise TypeError(f"wavelengths_um: expected numbers in micrometres such as (0.65, 0.55, 0.45), found {wavelengths_um!r}") from None
    pairs = [_between(rows, w, metal) for w in wanted]
    return [n for n, _ in pairs], [k for _, k in pairs]


def _between(rows: list[list[float]], wavelength: float, metal: str) -> tuple[float, float]:
    first, last = rows[0][0], rows[-1][0]
    if not first <= wavelength <= last:
        raise ValueError(f"wavelengths_um: found {wavelength:g} um, the table of {metal} covers [{first:g}, {last:g}] um (0.55 is green)")
    i = min(bisect.bisect_right(rows, [wavelength, float("inf"), 0.0]), len(rows) - 1)
    (w0, n0, k0), (w1, n1, k1) = rows[i - 1], rows[i]
    t = (wavelength - w0) / (w1 - w0)
    return n0 + t * (n1 - n0), k0 + t * (k1 - k0)
