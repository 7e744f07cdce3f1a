"""``torch.compile`` the way this package wants it: one full graph, recomputing instead of saving, and no surprise without g++."""

import shutil
import warnings
from collections.abc import Callable
from typing import Any

import torch

_warned = False


def compile(fn: Callable[..., Any], *, fullgraph: bool = True, recompute: bool = True) -> Callable[..., Any]:
    """Compile ``fn`` (a function, a plan, or an ``nn.Module``) and fall back to eager, with one warning, where it cannot be.

    ``recompute`` lets backward compute intermediate values again instead of reading them from memory: a formula of a few
    hundred flops per pixel is faster so. On a CPU, compiling needs a C++ compiler; without one torch raises even where its
    cache is warm.
    """
    if not _has_compiler():
        _warn_once("no C++ compiler (g++) was found: running eagerly, several times slower; install g++ to compile")
        return fn
    compiled = torch.compile(fn, fullgraph=fullgraph)
    if not recompute:
        return compiled

    def run(*args: Any, **kwargs: Any) -> Any:
        with torch._functorch.config.patch(activation_memory_budget=0.0):  # type: ignore[attr-defined]
            return compiled(*args, **kwargs)

    return run


def _has_compiler() -> bool:
    import torch._inductor.config as inductor

    names = inductor.cpp.cxx if isinstance(inductor.cpp.cxx, tuple | list) else (inductor.cpp.cxx,)
    return torch.cuda.is_available() or any(name and shutil.which(str(name)) for name in (*names, "g++", "clang++"))


def _warn_once(message: str) -> None:
    global _warned
    if not _warned:
        warnings.warn(message, RuntimeWarning, stacklevel=3)
        _warned = True
