"""A loss and its gradients as one compiled graph, for training steps."""

import functools
import types
from collections.abc import Callable, Iterator
from typing import Any

import torch
from torch import Tensor, nn

from .compiling import inductor
from .value import Value

Gradients = Any  # as the first argument of the loss: a tensor, a value, a container of them, or {name: tensor} of a module's parameters


def value_and_grad(
    loss: Callable[..., Tensor], *, fill: bool = False, compiled: bool | str | Callable[..., Any] = True
) -> Callable[..., tuple[Tensor, Gradients]]:
    """``step(learned, *args, **kwargs) -> (value, gradients)`` of ``loss(learned, *args, **kwargs)``, a tensor with one element.

    ``learned`` is an ``nn.Module`` (a :class:`~torchbrdf.nn.Shader`, say; the gradients are ``{name: tensor}`` of its parameters that
    require one), a tensor, a value, or a tuple, list or dictionary of tensors and values (the gradients have the same structure).
    Value and gradients are computed by one graph, so that nothing between forward and backward passes through memory.
    ``fill=True`` also adds the gradients to ``.grad``, as ``backward`` does: for optimisers, and to add up chunks of pixels or lights.
    Nothing can be differentiated further: neither result has a history. Runs eagerly where there is no C++ compiler, and with
    ``compiled=False``; anything else is a backend of ``torch.compile``. Not for DistributedDataParallel, whose hooks wait for ``backward``.
    """
    if not callable(loss):
        raise TypeError(f"value_and_grad: expected a function loss(learned, ...), found {type(loss).__name__}")

    def run(tensors: Any, called: Any, args: tuple[Any, ...], kwargs: dict[str, Any]) -> tuple[Gradients, Tensor]:
        return torch.func.grad_and_value(lambda t: _loss_at(called, t, args, kwargs))(tensors)

    graph = _compile(run, compiled)
    as_module = functools.lru_cache(maxsize=1)(
        lambda module: _Called(loss, module)
    )  # the same object in every step, or torch compiles anew

    def step(learned: Any, *args: Any, **kwargs: Any) -> tuple[Tensor, Gradients]:
        tensors = _learned_tensors(learned)
        called = as_module(learned) if isinstance(learned, nn.Module) else loss
        with torch.no_grad():  # what is not learned has no gradient, whatever it requires
            gradients, value = graph(_map(Tensor.detach, tensors), called, args, kwargs)
        if fill:
            _add(tensors, gradients)
        return value, gradients

    return step


def _compile(run: Any, compiled: Any) -> Callable[..., Any]:
    backend = inductor() if compiled is True else compiled
    # torch allows few compilations of one code object; every step function brings its own.
    own = types.FunctionType(run.__code__.replace(), run.__globals__, run.__name__, None, run.__closure__)
    return torch.compile(own, fullgraph=True, backend=backend) if backend else run


class _Called(nn.Module):
    """A loss as the forward pass of a module, so that all uses of the learned module in it see the parameters given for the call."""

    def __init__(self, loss: Callable[..., Tensor], learned: nn.Module) -> None:
        super().__init__()
        self.loss, self.learned = loss, learned

    def forward(self, *args: Any, **kwargs: Any) -> Tensor:
        return self.loss(self.learned, *args, **kwargs)


def _loss_at(called: Callable[..., Tensor], tensors: Any, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Tensor:
    if not isinstance(called, _Called):
        return called(tensors, *args, **kwargs)
    return torch.func.functional_call(called, {f"learned.{name}": t for name, t in tensors.items()}, args, kwargs)


def _learned_tensors(learned: Any) -> Any:
    """What is differentiated."""
    if isinstance(learned, nn.Module):
        found = {name: p for name, p in learned.named_parameters() if p.requires_grad}
        if not found:
            raise ValueError(f"learned: {type(learned).__name__} has no parameter that requires a gradient; there is nothing to learn")
        return found
    return _map(_floating, learned)


def _floating(t: Tensor) -> Tensor:
    if not t.is_floating_point():
        raise TypeError(f"learned: found a tensor of {t.dtype}, which has no gradient; give tensors of floats")
    return t


def _map(fn: Callable[[Tensor], Tensor], x: Any) -> Any:
    if isinstance(x, Tensor):
        return fn(x)
    if isinstance(x, Value):
        return x.map(fn)
    if isinstance(x, dict):
        return {name: _map(fn, v) for name, v in x.items()}
    if isinstance(x, (tuple, list)):
        return type(x)(_map(fn, v) for v in x)
    raise TypeError(
        f"learned: expected a module, a tensor, a value, or a tuple, list or dictionary of tensors and values, found {type(x).__name__}"
        + ("; put modules into one, such as torch.nn.ModuleList" if isinstance(x, nn.Module) else "")
    )


def _add(tensors: Any, gradients: Any) -> None:
    """Gradients to ``.grad``, like ``backward``."""
    for t, gradient in zip(_leaves(tensors), _leaves(gradients), strict=True):
        t.grad = gradient if t.grad is None else t.grad + gradient


def _leaves(x: Any) -> Iterator[Tensor]:
    if isinstance(x, Tensor):
        yield x
    else:
        inner = (t for _, t in x.named_tensors()) if isinstance(x, Value) else x.values() if isinstance(x, dict) else x
        for one in inner:
            yield from _leaves(one)
