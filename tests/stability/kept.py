"""Exact results kept between runs, in ``.cache/truths`` of the checkout: they are what takes the time, and they change only with
the files that say what is true and where. The name of the folder within is a hash of those files and of the
packages behind them, so that nothing stale is ever read; ``rm -r .cache`` costs nothing but time.
"""

import functools
import hashlib
import os
import pickle
import re
import shutil
import sys
import tempfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gmpy2
import numpy as np
import torch

from torchbrdf.ledger import exact
from torchbrdf.testing import textbook

from . import dual

HERE = Path(__file__).resolve().parent
FOLDER = HERE.parents[1] / ".cache" / "truths"
SOURCES = ("case.py", "truth.py", "kept.py", "cases/*.py")  # of this folder
OF_THE_PACKAGE = (exact.__file__, textbook.__file__)  # of the package a truth takes these, and ``Case.source``
DIGITS = 160  # bits that are kept of each exact number: a hundred more than the results that it is compared with have

shortened = np.frompyfunc(lambda x: gmpy2.round2(x, DIGITS) if x else x, 1, 1)


@functools.cache
def version() -> str:
    """Of the truths: changes with the sources and with the packages that draw and compute."""
    found = hashlib.sha256(f"{sys.version_info[:2]} {gmpy2.version()} {gmpy2.mpfr_version()} {np.__version__} {torch.__version__}".encode())
    for path in (*sorted(p for pattern in SOURCES for p in HERE.glob(pattern)), *map(Path, OF_THE_PACKAGE)):
        found.update(path.name.encode() + path.read_bytes())
    return found.hexdigest()[:16]


def kept(compute: Callable[..., Any]) -> Callable[..., Any]:
    """A function of a case and a dtype whose results are kept in memory (until :func:`forget`) and on disk for the next runs.

    Each call leaves the precision behind that the dtype's truths are computed and compared in.
    """

    @functools.wraps(compute)
    def found(case: Any, dtype: torch.dtype) -> Any:
        dual.set_precision(dtype)
        key = (compute.__name__, case, dtype)
        if key not in _in_memory:
            name = re.sub(r"[^\w.]+", "-", f"{case.name} {compute.__name__} {dtype} {case.points} {zlib.crc32(case.source.encode())}")
            _in_memory[key] = _from_disk(FOLDER / version() / f"{name}.pickle", lambda: compute(case, dtype))
        return _in_memory[key]

    return found


_in_memory: dict[Any, Any] = {}


def forget() -> None:
    """The truths of one dtype on whole grids take about a gigabyte."""
    _in_memory.clear()


def _from_disk(path: Path, compute: Callable[[], Any]) -> Any:
    if path.exists():
        return pickle.loads(path.read_bytes())
    result = compute()
    _write(path, pickle.dumps(result))
    return result


def _write(path: Path, data: bytes) -> None:
    """At one go, as several processes may do so; truths of former versions go."""
    path.parent.mkdir(parents=True, exist_ok=True)
    for former in FOLDER.iterdir():
        if former != path.parent:
            shutil.rmtree(former, ignore_errors=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
        file.write(data)
    os.replace(file.name, path)
