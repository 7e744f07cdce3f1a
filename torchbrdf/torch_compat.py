"""Every private name of torch that this package uses, each with what is done where a version of torch does not have it.

torch may rename what starts with an underscore in any release. So each such name is asked for here alone, when it is first needed,
and what is done without it is right, if slower or less informative; ``tests/test_torch_compat.py`` takes each away in turn.
"""

import functools
import os
import shutil
import sys
from collections.abc import Callable, Sequence
from typing import Any

import torch

ABSENT = (ImportError, AttributeError, TypeError)  # a name that is gone, or takes other arguments than it did


def register_node(
    cls: type[Any],
    flatten: Callable[[Any], tuple[list[Any], Any]],
    unflatten: Callable[[Any, Any], Any],
    names: Callable[[Any], Sequence[str]],
    saved_as: str,
) -> None:
    """Let ``torch.func``, ``torch.compile`` and ``torch.export`` see through ``cls``; ``names`` are those of its children,
    ``saved_as`` what exported programs call it.

    Where torch takes no names: without them. Without the private module: not at all; such values are opaque to transforms, and
    everything else works.
    """
    try:
        from torch.utils import _pytree as pytree

        register, key = pytree.register_pytree_node, pytree.GetAttrKey
    except ABSENT:
        return

    def flatten_with_keys(v: Any) -> tuple[list[tuple[Any, Any]], Any]:
        children, context = flatten(v)
        return [(key(name), child) for name, child in zip(names(v), children, strict=True)], context

    try:
        register(cls, flatten, unflatten, flatten_with_keys_fn=flatten_with_keys, serialized_type_name=saved_as)
    except TypeError:
        register(cls, flatten, unflatten)


# From how many operations on inductor keeps a value under a name of its own, and how many names one loop may hold. (By its defaults, 30 and
# 64, it repeats most of a long formula for each of its many gradients.) Measured on CPUs, one light, forward and backward: compiled in a
# third of the processor time, and as fast. A loss and its gradients as one graph are slower by a quarter with the first, and with the
# second take half the time where the formula is long (exact Fresnel terms, two axes): one loop in place of four, with nothing between.
LONG_FORMULAS = {"realize_opcount_threshold": 10, "max_fusion_size": 256}
LOSSES = {"max_fusion_size": 1000}


@functools.cache  # torch compiles again for a backend that is another object
def recomputing_backend(always: bool = False) -> Any:
    """The inductor backend of ``torch.compile`` with a budget of 0 for what the forward pass saves; backward computes it again.

    Not so, unless ``always``, for a graph that gives a single number, a loss: reductions and what a loss adds are dear to compute twice.
    Without the private names: inductor as it is, whose results are the same.
    """
    try:
        from torch._functorch import config
        from torch._inductor.compile_fx import compile_fx

        with config.patch(activation_memory_budget=0.0):
            pass
    except (*ABSENT, KeyError):
        return "inductor"

    def recomputing(graph: torch.fx.GraphModule, inputs: Any) -> Any:
        if not always and _gives_a_number(graph):
            return compile_fx(graph, inputs, config_patches=_settings(inputs, LOSSES))
        with config.patch(activation_memory_budget=0.0):
            return compile_fx(graph, inputs, config_patches=_settings(inputs, LONG_FORMULAS))

    return recomputing


@functools.cache
def fusing_backend() -> Any:
    """The inductor backend of ``torch.compile`` for a loss and its gradients as one graph. Without the private names: inductor as it is."""
    try:
        from torch._inductor.compile_fx import compile_fx
    except ABSENT:
        return "inductor"

    def fusing(graph: torch.fx.GraphModule, inputs: Any) -> Any:
        return compile_fx(graph, inputs, config_patches=_settings(inputs, LOSSES))

    return fusing


def _settings(inputs: Any, wanted: dict[str, Any]) -> dict[str, Any]:
    """Those of the wanted settings that inductor has, for a graph of inputs on CPUs; elsewhere, and without the private names, none."""
    try:
        from torch._inductor import config
    except ABSENT:
        return {}
    if any(isinstance(x, torch.Tensor) and x.device.type != "cpu" for x in inputs):
        return {}
    return {name: value for name, value in wanted.items() if hasattr(config, name)}


def _gives_a_number(graph: torch.fx.GraphModule) -> bool:
    """Whether a result of a traced graph has no axes and a gradient. Without the record that torch keeps of results: no."""
    (output,) = graph.graph.find_nodes(op="output")
    found = [node.meta.get("example_value") for node in output.all_input_nodes]
    return any(isinstance(x, torch.Tensor) and not x.dim() and x.requires_grad for x in found)


def has_cpp_compiler() -> bool:
    """Whether there is a C++ compiler, by inductor's own search: CXX if it is set, else the usual one.

    Without the private name: whether that program is on the path.
    """
    try:
        from torch._inductor.cpp_builder import get_cpp_compiler
    except ABSENT:
        usual = {"win32": "cl", "darwin": "clang++"}.get(sys.platform, "g++")
        return shutil.which(os.environ.get("CXX", usual)) is not None
    try:
        return bool(get_cpp_compiler())
    except RuntimeError:  # InvalidCxxCompiler among them
        return False


def compile_error() -> type[Exception]:
    """What ``torch.compile`` raises where it cannot compile. Without the private name: its base, ``RuntimeError``."""
    try:
        from torch._dynamo.exc import TorchDynamoException
    except ABSENT:
        return RuntimeError
    return TorchDynamoException
