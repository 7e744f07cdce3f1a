"""Materials: the ``nn.Module`` face of any value (a BSDF, a Fresnel term, a light), one field per parameter."""

import dataclasses
from typing import Any

from torch import Tensor, nn

from .. import synonyms
from ..bsdf.base import Bsdf
from ..scene.gbuffer import GBuffer
from ..value import Value
from .fields import Constant, Field, Given


class Material(nn.Module):
    """``Material(tb.Lambert, albedo=tb.nn.Texture(...))``: ``material(g)`` is a ``Lambert`` at every pixel of ``g``.

    A parameter may be a :class:`Field`, any other module that answers to a G-buffer (such as a network, which then keeps to the
    legal range itself), a number or tensor (held constant; one that requires a gradient is used as it is, and an ``nn.Parameter``
    registered), or, where the model takes a value such as a Fresnel term, another ``Material`` or that value itself. The tensors of such
    a value follow the module and stand in its state_dict; names and flags pass through as they are.
    """

    def __init__(self, model: type[Value], **parameters: Any) -> None:
        super().__init__()
        if not (isinstance(model, type) and issubclass(model, Value)):
            raise TypeError(f"Material: expected a model (a class such as tb.Lambert), found {_name(model)}")
        self.model = model
        self.fixed: dict[str, Any] = {}
        self._check_names(set(parameters))
        for name, given in parameters.items():
            self._take(name, given)

    def _check_names(self, given: set[str]) -> None:
        model = self.model.__name__
        unknown = given - set(self.model._fields)
        if unknown:
            hint = synonyms.argument(self.model, min(unknown))
            raise TypeError(f"Material({model}): unknown parameter {sorted(unknown)}; {hint}legal are {list(self.model._fields)}")
        needed = {f.name for f in dataclasses.fields(self.model) if f.default is dataclasses.MISSING}  # type: ignore[arg-type]
        if needed - given:
            raise TypeError(f"Material({model}): missing parameter {sorted(needed - given)}; give a number, a tensor or a field")

    def _take(self, name: str, given: Any) -> None:
        spec = self.model.params().get(name)
        if self.model.decides(name, given):
            self.fixed[name] = int(given)  # in graphs, too, a number is known
            return
        if spec is not None and given is not None and not isinstance(given, nn.Module):
            given = Given(given) if isinstance(given, Tensor) and given.requires_grad else Constant(given)
        if isinstance(given, Value):
            given = Held(given)
        if isinstance(given, Field) and spec is not None:
            given.bind(spec.constraint, f"{self.model.__name__}.{name}")
        if isinstance(given, nn.Module):
            self.add_module(name, given)
        else:
            self.fixed[name] = given

    def forward(self, g: GBuffer) -> Any:
        """The value at every pixel of ``g``."""
        return self.model(**self.fixed, **{name: field(g) for name, field in self._modules.items() if field is not None})

    def __add__(self, other: nn.Module) -> "MaterialSum":
        return MaterialSum(self, other)

    def extra_repr(self) -> str:
        return ", ".join([self.model.__name__, *(f"{k}={v!r}" for k, v in self.fixed.items())])


class Held(nn.Module):
    """A value as it is: its tensors are buffers (or parameters, where they are ``nn.Parameter``)."""

    def __init__(self, value: Value) -> None:
        super().__init__()
        self.value, self.names = value.detach(), []
        for path, t in value.named_tensors():
            name = f"held_{path.translate(str.maketrans('.[', '__', ']'))}"  # no attribute of a module is called so
            self.names.append(name)
            if isinstance(t, nn.Parameter):
                self.register_parameter(name, t)
            else:
                self.register_buffer(name, t)

    def forward(self, g: GBuffer) -> Any:
        """The value, with the tensors as they are now."""
        tensors = iter([getattr(self, name) for name in self.names])
        return self.value.map(lambda _: next(tensors))

    def extra_repr(self) -> str:
        return repr(self.value)


class MaterialSum(nn.Module):
    """The sum of materials; written ``a + b``."""

    def __init__(self, *terms: nn.Module) -> None:
        super().__init__()
        if not terms or not all(isinstance(t, nn.Module) for t in terms):
            raise TypeError(f"MaterialSum: expected one material or more, found {list(map(_name, terms))}")
        self.terms = nn.ModuleList(terms)

    def forward(self, g: GBuffer) -> Bsdf:
        """The sum of the BSDFs at every pixel of ``g``."""
        first, *rest = (term(g) for term in self.terms)
        return sum(rest, first)

    def __add__(self, other: nn.Module) -> "MaterialSum":
        return MaterialSum(*self.terms, other)


def _name(x: Any) -> str:
    return repr(x) if isinstance(x, str | int | float | None) else type(x).__name__
