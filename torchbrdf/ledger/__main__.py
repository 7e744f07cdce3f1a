"""``python -m torchbrdf.ledger``: measure every registered law, print, write the page, the JSON and the pictures."""

import argparse
import sys
from pathlib import Path

from . import machine

CHECKOUT = Path(__file__).resolve().parents[2] / "docs"


def options(arguments: list[str] | None = None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m torchbrdf.ledger", description="What accuracy costs, law by law.")
    parser.add_argument(
        "--laws", nargs="+", default=[], metavar="LAW", help="these alone, the others stay as they are; written to --out alone"
    )
    parser.add_argument("--only-errors", action="store_true", help="no times; written to --out alone")
    parser.add_argument("--points", type=int, default=4000, help="at which errors are measured")
    parser.add_argument("--pixels", type=int, default=2**18, help="that are timed at once")
    parser.add_argument("--rounds", type=int, default=15, help="of timing, in which all methods of a law take turns")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--out", type=Path, default=None, help="folder for accuracy-cost.md, .json and images/; docs of the checkout")
    found = parser.parse_args(arguments)
    for name in ("points", "pixels", "rounds", "threads"):
        if getattr(found, name) < 1:
            parser.error(f"--{name}: found {getattr(found, name)}, a whole number >= 1 is needed")
    return found


def main(arguments: list[str] | None = None) -> int:
    """Exit code."""
    asked = options(arguments)
    absent = machine.missing()
    if absent:
        print(absent, file=sys.stderr)
        return 2
    again = None if asked.only_errors or arguments is not None else machine.restarted()
    if again is not None:
        return again
    from . import measure

    out = asked.out or (CHECKOUT if CHECKOUT.is_dir() and not asked.laws and not asked.only_errors else None)
    return measure.everything(asked, out)


if __name__ == "__main__":
    sys.exit(main())
