#!/usr/bin/env python3
"""Set everything up in .venv (needs Python >= 3.11 and pip, nothing else) and do one thing:

python3 run.py recover [options]   recover a material from photographs (examples/recover_material.py)
python3 run.py test [options]      the tests, a few minutes
python3 run.py slow [options]      the slow tests: full grids, chi2, compilation, Mitsuba, examples
python3 run.py check               ruff (lint and format) and mypy
python3 run.py stability [options] measure every formula against exact arithmetic (docs/stability.md)
python3 run.py bench [options]     what shading costs beside textbook code (benchmarks/shade.py)
"""

import hashlib
import os
import subprocess
import sys
import venv
from pathlib import Path

HERE = Path(__file__).resolve().parent
VENV = HERE / ".venv"
PYTHON = VENV / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
OLDEST = (3, 11)
# task: (the extra it needs, the commands that do it)
TASKS = {
    "recover": ("examples", [["examples/recover_material.py"]]),
    "test": ("test", [["-m", "pytest"]]),
    "slow": ("test", [["-m", "pytest", "-m", "slow"]]),
    "check": ("dev", [["-m", "ruff", "check", "."], ["-m", "ruff", "format", "--check", "."], ["-m", "mypy"]]),
    "stability": ("test", [["tests/stability"]]),
    "bench": ("bench", [["benchmarks/shade.py"]]),
}


def set_up(extra: str) -> None:
    """Make the virtual environment and install this package with ``extra``, unless that was done for this very pyproject."""
    wanted = hashlib.sha256((HERE / "pyproject.toml").read_bytes() + extra.encode()).hexdigest()
    stamp = VENV / f"installed-{extra}"
    if PYTHON.exists() and stamp.exists() and stamp.read_text() == wanted:
        return
    if not PYTHON.exists():
        print(f"making {VENV.name}/", flush=True)
        venv.create(VENV, with_pip=True)
    print(f"installing torchbrdf[{extra}] and what it needs; the first time this takes minutes", flush=True)
    subprocess.check_call([str(PYTHON), "-m", "pip", "install", "--quiet", "--editable", f"{HERE}[{extra}]"])
    stamp.write_text(wanted)


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
    set_up(extra)
    for command in commands:
        code = subprocess.call([str(PYTHON), *command, *sys.argv[2:]], cwd=HERE)
        if code:
            return code
    return 0


if __name__ == "__main__":
    sys.exit(main())
