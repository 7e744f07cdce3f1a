"""What figures were measured on, and how: the machine, the versions, the commit; and an allocator that keeps what is freed."""

import os
import platform
import subprocess
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import Any

# glibc is told to keep what is freed: else times are mostly page faults, more or fewer as it happens to trim.
ALLOCATOR = {"MALLOC_TRIM_THRESHOLD_": str(2**33), "MALLOC_MMAP_THRESHOLD_": str(2**25), "MALLOC_TOP_PAD_": str(2**28)}
CACHE = "TORCHINDUCTOR_CACHE_DIR"  # of compiled code: a new one, so that compiling is measured, not reading
NEEDED = ("gmpy2", "matplotlib", "tqdm")


def restarted() -> int | None:
    """Run this command again with the allocator and an empty cache, and return its exit code; None in the process so started."""
    if ALLOCATOR.items() <= os.environ.items():
        return None
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, **ALLOCATOR, CACHE: cache}
        return subprocess.call([sys.executable, "-m", "torchbrdf.ledger", *sys.argv[1:]], env=environment)


def said(threads: int, pixels: int, rounds: int, points: int) -> dict[str, Any]:
    """To be written beside the figures."""
    import torch

    return {
        "device": processor(),
        "threads": threads,
        "cores": os.cpu_count(),
        "load": round(os.getloadavg()[0], 1) if hasattr(os, "getloadavg") else None,
        "versions": {"python": platform.python_version(), **{name: version(name) for name in ("torch", "numpy", "gmpy2")}},
        "vector instructions": torch.backends.cpu.get_cpu_capability(),
        "commit": commit(),
        "pixels": pixels,
        "rounds": rounds,
        "points": points,
    }


def processor() -> str:
    """Its name, where the system tells."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.machine())


def commit() -> str:
    """Of the checkout this package lies in; with a + where files differ from it; empty outside of one."""
    here = Path(__file__).resolve().parent

    def git(*command: str) -> str:
        done = subprocess.run(["git", "-C", str(here), *command], capture_output=True, text=True, check=False)
        return done.stdout.strip() if done.returncode == 0 else ""

    try:
        found = git("rev-parse", "--short=10", "HEAD")
        return found + ("+" if found and git("status", "--porcelain", "--untracked-files=no", "--", str(here.parent)) else "")
    except OSError:
        return ""


def missing() -> str:
    """What has to be installed, in one line; empty if nothing."""
    from importlib.util import find_spec

    absent = [name for name in NEEDED if sys.modules.get(name, name) is None or find_spec(name) is None]
    return f"the ledger needs {', '.join(absent)}, not found here; install with: pip install 'torchbrdf[bench]'" if absent else ""
