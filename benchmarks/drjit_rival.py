"""Dr.Jit's frozen function as a rival: the same textbook formula, traced once into one kernel by its LLVM backend."""

import ctypes.util
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

Formula = Callable[[Any, dict[str, Any]], Any]  # textbook(m, p) in an arithmetic m


class DrJit:
    """The arithmetic of Dr.Jit's arrays, and its frozen functions. Raises ImportError or RuntimeError where it cannot run."""

    def __init__(self, threads: int) -> None:
        os.environ.setdefault("DRJIT_LIBLLVM_PATH", _newest_llvm())
        import drjit as dr
        from drjit.llvm.ad import Array2f, Array3f, Float

        dr.set_thread_count(threads)
        self.dr, self.arrays = dr, {1: Float, 2: Array2f, 3: Array3f}
        dr.eval(Float(1.0) + 1.0)  # finds and loads libLLVM

    def array(self, t: Tensor) -> Any:
        """A tensor ``[N, 1]``, ``[N, 2]`` or ``[N, 3]``."""
        planes = t.detach().T.contiguous().numpy()
        found = self.arrays[t.shape[-1]](planes if len(planes) > 1 else planes[0])
        self.dr.eval(found)
        return found

    def tensor(self, x: Any) -> Tensor:
        rows = torch.as_tensor(x.numpy())
        return rows.T if rows.dim() > 1 else rows[:, None]

    # The arithmetic of benchmarks/workloads.py
    def dot(self, a: Any, b: Any) -> Any:
        return self.dr.dot(a, b)

    def normalize(self, a: Any) -> Any:
        return self.dr.normalize(a)

    def cross(self, a: Any, b: Any) -> Any:
        return self.dr.cross(a, b)

    def pair(self, a: Any) -> tuple[Any, Any]:
        return a.x, a.y

    def sqrt(self, a: Any) -> Any:
        return self.dr.sqrt(self.dr.select(a > 0.0, a, 0.0))  # not maximum, which LLVM 15 cannot translate

    def power(self, a: Any, s: Any) -> Any:
        return self.dr.power(self.dr.select(a > 1e-6, a, 1e-6), s)

    def masked(self, mask: Any, a: Any) -> Any:
        return self.dr.select(mask, a, 0.0)

    def forward(self, formula: Formula) -> Callable[[dict[str, Any]], Any]:
        frozen = self.dr.freeze(lambda p: formula(self, p))
        return lambda p: self._done(frozen(p))

    def both(self, formula: Formula) -> Callable[[dict[str, Any], dict[str, Any], Any], dict[str, Any]]:
        """Gradients of ``sum(weight * formula)``; the sum itself is not computed."""
        dr = self.dr

        def gradients(learned: dict[str, Any], rest: dict[str, Any], weight: Any) -> dict[str, Any]:
            own = {name: type(v)(v) for name, v in learned.items()}
            dr.enable_grad(own)
            dr.backward(dr.dot(formula(self, {**rest, **own}), weight))
            return {name: dr.grad(v) for name, v in own.items()}

        frozen = dr.freeze(gradients)
        return lambda learned, rest, weight: self._done(frozen(learned, rest, weight))

    def _done(self, result: Any) -> Any:
        self.dr.eval(result)
        self.dr.sync_thread()
        return result


def find(threads: int) -> DrJit | None:
    """Dr.Jit, or None with one line that says why. Tried in a process of its own: an LLVM that it is too new for ends the process."""
    tried = subprocess.run([sys.executable, __file__], capture_output=True, text=True)
    if tried.returncode == 0:
        return DrJit(threads)
    why = (tried.stderr.strip().splitlines() or [f"exit status {tried.returncode}"])[-1]
    print(f"Dr.Jit is left out: {why} (it needs the package drjit and libLLVM; DRJIT_LIBLLVM_PATH names the latter)")
    return None


def attempt() -> None:
    """Every formula once, with gradients."""
    import workloads

    dj = DrJit(1)
    for name in workloads.NAMES:
        q = {k: dj.array(v) for k, v in workloads.points(name, 64, torch.float32).items()}
        dj.forward(workloads.textbook(name))(q)
        dj.both(workloads.textbook(name))({"normal": q["normal"]}, q, q["albedo"])


def _newest_llvm() -> str:
    """Dr.Jit looks by itself in a few places; Debian and Ubuntu have the library under its version's name."""
    found = [f for folder in ("/usr/lib", "/usr/lib64", "/usr/local/lib") for f in Path(folder).glob("**/libLLVM*.so*")]
    by_version = sorted(found, key=lambda f: [int(n) for n in "".join(c if c.isdigit() else " " for c in f.name).split()])
    return str(by_version[-1]) if by_version else ctypes.util.find_library("LLVM") or ""


if __name__ == "__main__":
    attempt()
