"""What was measured, as plain numbers: what the JSON holds, and what the page and the pictures are made of."""

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

from ..method import Law
from .cost import Cost
from .errors import Errors
from .rows import Row, dtype_name

Record = dict[str, Any]


def of_law(law: Law, rows: list[Row], errors: list[Errors], costs: list[Cost | None]) -> Record:
    """One law: its domain, its methods, its rows."""
    methods = [
        {"name": m.name, "call": m.call, "source": m.source, "claim": m.claim, "exact": m.exact, "default": m is law.default}
        for m in law.methods
    ]
    found = [
        {
            "method": row.name,
            "exact": row.method is None or row.method.exact,
            "dtype": dtype_name(row.dtype),
            "how": row.how,
            "errors": _plain(e),
            "costs": None if c is None else _plain(c),
        }
        for row, e, c in zip(rows, errors, costs, strict=True)
    ]
    domain = {name: list(between) for name, between in law.inputs.items()}
    return {"domain": domain, "directions": list(law.vectors), "hard": law.hard_where, "methods": methods, "rows": found}


def _plain(x: Any) -> Any:
    """Dataclasses as dictionaries of numbers with four digits; what is not finite as text, which JSON has no numbers for."""
    if dataclasses.is_dataclass(x):
        return {f.name: _plain(getattr(x, f.name)) for f in dataclasses.fields(x)}
    if isinstance(x, dict):
        return {k: _plain(v) for k, v in x.items()}
    return x if not isinstance(x, float) else float(f"{x:.4g}") if math.isfinite(x) else str(x)


def missing(laws: dict[str, Law], record: Record) -> list[str]:
    """Which registered laws and methods have no row, in words."""
    found = {(name, row["method"]) for name, law in record["laws"].items() for row in law["rows"] if row["costs"] is not None}
    return [f"{law.name}, {m.name}" for law in laws.values() for m in law.methods if (law.name, m.name) not in found]


def write(record: Record, file: Path) -> None:
    """As JSON."""
    file.write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def read(file: Path) -> Record:
    """Written by :func:`write`."""
    return dict(json.loads(file.read_text(encoding="utf-8")))
