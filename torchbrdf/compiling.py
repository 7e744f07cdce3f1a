"""``torch.compile`` the way this package wants it: one full graph, recomputing instead of saving, and no surprise without g++."""

import functools
import warnings
from collections.abc import Callable
from typing import Any

import torch

from . import torch_compat

_warned = False


def compile(fn: Callable[..., Any], *, fullgraph: bool = True, recompute: bool | None = None) -> Callable[..., Any]:
    """Compile ``fn`` (a function, a plan, or an ``nn.Module``) and fall back to eager, with one warning, where it cannot be.

    A module stays a module (``torch.compile``'s wrapper), so DDP takes it. A plan and a shader compile to a graph for one light, which is
    called again for each of several: no other number compiles anew, and memory does not grow with it. (In a function of your own
    all lights are computed at once.) ``recompute`` lets backward compute intermediate
    values again instead of reading them from memory: a formula of a few hundred flops per pixel is faster so, and a graph with a loss
    in it is not, and takes longer to compile. None: where the graph does not end in a single number. For a loss and its gradients
    see :func:`torchbrdf.value_and_grad`. Compiling needs a C++ compiler; without one torch raises at the first call, even where its
    cache is warm.
    """
    if not callable(fn):
        raise TypeError(f"compile: expected a function, a plan or a module, found {type(fn).__name__}")
    backend = inductor(recompute)
    if not backend:
        return fn
    make = functools.partial(torch.compile, fullgraph=fullgraph, backend=backend)
    own = getattr(fn, "compiled_with", None)  # plans and shaders know what is worth a graph
    return own(make) if own else make(fn)


def inductor(recompute: bool | None = False) -> Any:
    """The backend of ``torch.compile``; None, with one warning, where there is no C++ compiler."""
    if not torch_compat.has_cpp_compiler():
        _warn_once("no C++ compiler (g++) was found: running eagerly, several times slower; install g++ to compile")
        return None
    return torch_compat.fusing_backend() if recompute is False else torch_compat.recomputing_backend(bool(recompute))


def _warn_once(message: str) -> None:
    global _warned
    if not _warned:
        warnings.warn(message, RuntimeWarning, stacklevel=4)
        _warned = True
