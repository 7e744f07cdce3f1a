"""``torch.compile`` the way this package wants it: one full graph, recomputing instead of saving, and no surprise without g++."""

import warnings
from collections.abc import Callable
from typing import Any

import torch

_warned = False


def compile(fn: Callable[..., Any], *, fullgraph: bool = True, recompute: bool = True) -> Callable[..., Any]:
    """Compile ``fn`` (a function, a plan, or an ``nn.Module``) and fall back to eager, with one warning, where it cannot be.

    A module stays a module (``torch.compile``'s wrapper), so DDP takes it. ``recompute`` lets backward compute intermediate
    values again instead of reading them from memory: a formula of a few hundred flops per pixel is faster so. Compiling needs a
    C++ compiler; without one torch raises at the first call, even where its cache is warm.
    """
    if not callable(fn):
        raise TypeError(f"compile: expected a function, a plan or a module, found {type(fn).__name__}")
    if not _has_compiler():
        _warn_once("no C++ compiler (g++) was found: running eagerly, several times slower; install g++ to compile")
        return fn
    return torch.compile(fn, fullgraph=fullgraph, backend=_recomputing if recompute else "inductor")


def _recomputing(graph: torch.fx.GraphModule, inputs: Any) -> Any:
    """The inductor backend with a budget of 0 for what the forward pass saves."""
    from torch._inductor.compile_fx import compile_fx

    with torch._functorch.config.patch(activation_memory_budget=0.0):
        return compile_fx(graph, inputs)


def _has_compiler() -> bool:
    """By inductor's own search: CXX if it is set, else g++ (clang++ on macOS)."""
    from torch._inductor.cpp_builder import get_cpp_compiler

    try:
        return bool(get_cpp_compiler())
    except RuntimeError:  # InvalidCxxCompiler among them
        return False


def _warn_once(message: str) -> None:
    global _warned
    if not _warned:
        warnings.warn(message, RuntimeWarning, stacklevel=3)
        _warned = True
