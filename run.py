#!/usr/bin/env python3
"""Set everything up in .venv (needs Python >= 3.11 and pip, nothing else) and do one thing:

python3 run.py recover [options]   recover a material from photographs (examples/recover_material.py)
python3 run.py test [options]      the tests, a few minutes
python3 run.py slow [options]      the slow tests: full grids, chi2, compilation, Mitsuba, examples
python3 run.py oldest [options]    the same tests on the lowest versions that pyproject.toml states, in .venv-oldest (Python 3.11, 3.12)
python3 run.py check               ruff (lint and format) and mypy
python3 run.py stability [options] measure every formula against exact arithmetic (docs/stability.md)
python3 run.py ledger [options]    what accuracy costs: every method of every law (docs/accuracy-cost.md), about six minutes
python3 run.py bench [options]     what it all costs beside textbook code and Dr.Jit; writes the figures of docs/benchmark.md
"""

import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
OLDEST = (3, 11)
# task: (the extra it needs, the commands that do it)
TASKS = {
    "recover": ("examples", [["examples/recover_material.py"]]),
    "test": ("test", [["-m", "pytest"]]),
    "slow": ("test", [["-m", "pytest", "-m", "slow"]]),
    "oldest": ("test", [["-m", "pytest"]]),
    "check": ("dev", [["-m", "ruff", "check", "."], ["-m", "ruff", "format", "--check", "."], ["-m", "mypy"]]),
    "stability": ("test", [["tests/stability"]]),
    "ledger": ("bench", [["-m", "torchbrdf.ledger"]]),
    "bench": ("bench", [[f"benchmarks/{name}.py", "--write"] for name in ("formulas", "shade", "per_call", "lights")]),
}


def set_up(extra: str, oldest: bool = False) -> str:
    """The Python of a virtual environment with this package and ``extra``, made unless that was done for this very pyproject."""
    home = HERE / (".venv-oldest" if oldest else ".venv")
    python = home / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    wanted = hashlib.sha256((HERE / "pyproject.toml").read_bytes() + extra.encode()).hexdigest()
    stamp = home / f"installed-{extra}"
    if python.exists() and stamp.exists() and stamp.read_text() == wanted:
        return str(python)
    if not python.exists():
        print(f"making {home.name}/", flush=True)
        first = shutil.which("python3.11") if oldest else None
        subprocess.check_call([first or sys.executable, "-m", "venv", str(home)])
    print(f"installing torchbrdf[{extra}] and what it needs; the first time this takes minutes", flush=True)
    exactly = lowest(extra) if oldest else []
    subprocess.check_call([str(python), "-m", "pip", "install", "--quiet", "--editable", f"{HERE}[{extra}]", *exactly])
    stamp.write_text(wanted)
    return str(python)


def lowest(extra: str) -> list[str]:
    """What this package and ``extra`` require, each at the lowest version that pyproject.toml allows; what those need is up to pip."""
    import tomllib

    project = tomllib.loads((HERE / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return [r.replace(">=", "==") for r in (*project["dependencies"], *project["optional-dependencies"][extra])]


def main() -> int:
    """Run the task that was named."""
    if sys.version_info < OLDEST:
        print(f"Python 3.11 or newer is needed, this is {sys.version.split()[0]}; run this file with a newer python3")
        return 2
    task = sys.argv[1] if len(sys.argv) > 1 else ""
    if task not in TASKS:
        print(__doc__)
        return 2
    extra, commands = TASKS[task]
    python = set_up(extra, oldest=task == "oldest")
    for command in commands:
        code = subprocess.call([python, *command, *sys.argv[2:]], cwd=HERE)
        if code:
            return code
    return 0


if __name__ == "__main__":
    sys.exit(main())
