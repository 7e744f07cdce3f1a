"""Measure the laws that were asked for, one after the other."""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from .. import registry
from ..method import Law
from . import machine, page, record
from .cost import Cost, costs, steps
from .errors import Errors, Measured, broken
from .record import Record
from .rows import EAGER, Row, rows_of


def everything(asked: argparse.Namespace, out: Path | None) -> int:
    """Print all, write it to ``out``; 1 if a method does not keep its claim."""
    from tqdm import tqdm

    laws = chosen(asked.laws)
    torch.set_num_threads(asked.threads)
    rows = {name: rows_of(law, compiled=not asked.only_errors) for name, law in laws.items()}
    total = sum(len(r) + (0 if asked.only_errors else steps(r, asked.rounds)) for r in rows.values())
    on = machine.said(asked.threads, asked.pixels, asked.rounds, asked.points)
    found: Record = {"laws": {}}
    wrong: list[str] = []
    with tqdm(total=total, unit="step") as bar:

        def say(what: str) -> None:
            bar.set_description_str(what)
            bar.update()

        for name, law in laws.items():
            measured, of_law = one(law, rows[name], asked, say)
            found["laws"][name] = {"machine": on, **measured}
            wrong += of_law
    print(page.text(found))
    if out is not None:
        publish(found, out)
    for line in wrong:
        print(f"not as claimed: {line}")
    return 1 if wrong else 0


def chosen(names: list[str]) -> dict[str, Law]:
    """The laws of these names; all of them, if none is named."""
    laws = registry.laws()
    unknown = [name for name in names if name not in laws]
    if unknown:
        raise SystemExit(f"--laws: found {', '.join(unknown)}; there are {', '.join(laws)}")
    return {name: laws[name] for name in names or laws}


def one(law: Law, rows: list[Row], asked: argparse.Namespace, say: Callable[[str], Any]) -> tuple[Record, list[str]]:
    """The record of a law, and the claims that it does not keep."""
    measured = {dtype: Measured(law, dtype, asked.points) for dtype in dict.fromkeys(row.dtype for row in rows)}
    eager: dict[tuple[str, torch.dtype], Errors] = {}
    for row in rows:
        say(f"{law.name}: errors of {row.label}")
        if row.how == EAGER:
            eager[row.name, row.dtype] = measured[row.dtype].errors(row.formula)
    errors = [eager[row.name, row.dtype] for row in rows]
    prices: list[Cost | None] = [None for _ in rows]
    if not asked.only_errors:
        timed = costs(law, rows, measured, asked.pixels, asked.rounds, say)
        prices = [cost for cost, _ in timed]
        errors = [e if row.how == EAGER else compiled for row, e, (_, compiled) in zip(rows, errors, timed, strict=True)]
    wrong = [line for m in law.methods for line in broken(m, eager[m.name, torch.float32], law)]
    return record.of_law(law, rows, errors, prices), wrong


def publish(found: Record, out: Path) -> None:
    """The page, the JSON beside it, and the pictures in ``images``; laws that were not measured this time stay as they were."""
    from . import pictures

    (out / "images").mkdir(parents=True, exist_ok=True)
    file, laws = out / "accuracy-cost.json", registry.laws()
    known = {**(record.read(file)["laws"] if file.exists() else {}), **found["laws"]}
    whole: Record = {"laws": {name: known[name] for name in laws if name in known}}
    names = pictures.draw(whole, laws, out / "images")
    record.write(whole, file)
    (out / "accuracy-cost.md").write_text(page.text(whole, names), encoding="utf-8")
    print(f"written: {out / 'accuracy-cost.md'}, .json and {sum(map(len, names.values()))} pictures")
