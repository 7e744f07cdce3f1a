"""Materials: the ``nn.Module`` face of any value (a BSDF, a Fresnel term, a light), one field per parameter."""

from typing import Any

from torch import Tensor, nn

from ..bsdf.base import Bsdf
from ..scene.gbuffer import GBuffer
from ..value import Value
from .fields import Constant, Field


class Material(nn.Module):
    """``Material(tb.Lambert, albedo=tb.nn.Texture(...))``: ``material(g)`` is a ``Lambert`` at every pixel of ``g``.

    A parameter may be a :class:`Field`, a number or tensor (held constant), or, where the model takes a value such as a
    Fresnel term, another ``Material`` or that value itself. Other arguments (names, flags) pass through.
    """

    def __init__(self, model: type[Value], **parameters: Any) -> None:
        super().__init__()
        self.model, self.fixed = model, {}
        unknown = set(parameters) - set(model._fields)
        if unknown:
            raise TypeError(f"Material({model.__name__}): unknown parameter {sorted(unknown)}; legal are {list(model._fields)}")
        for name, given in parameters.items():
            self._take(name, given)

    def _take(self, name: str, given: Any) -> None:
        spec = self.model.params().get(name)
        if spec is not None and not isinstance(given, nn.Module) and given is not None:
            given = Constant(given)
        if isinstance(given, Field) and spec is not None:
            given.bind(spec.constraint, f"{self.model.__name__}.{name}")
        if isinstance(given, nn.Module):
            self.add_module(name, given)
        else:
            self.fixed[name] = given

    def forward(self, g: GBuffer) -> Any:
        """The value at every pixel of ``g``."""
        return self.model(**self.fixed, **{name: field(g) for name, field in self.named_children()})

    def __add__(self, other: nn.Module) -> "MaterialSum":
        return MaterialSum(self, other)

    def extra_repr(self) -> str:
        return ", ".join([self.model.__name__, *(f"{k}={v!r}" for k, v in self.fixed.items())])


class MaterialSum(nn.Module):
    """The sum of materials; written ``a + b``."""

    def __init__(self, *terms: nn.Module) -> None:
        super().__init__()
        self.terms = nn.ModuleList(terms)

    def forward(self, g: GBuffer) -> Bsdf:
        first, *rest = (term(g) for term in self.terms)
        return sum(rest, first)

    def __add__(self, other: nn.Module) -> "MaterialSum":
        return MaterialSum(*self.terms, other)


def parameters_of(material: nn.Module) -> dict[str, Tensor]:
    """Every learned parameter by its dotted name, in physical units, detached."""
    from .fields import Stored

    return {name: m.value.detach() for name, m in material.named_modules() if isinstance(m, Stored) and m.learned}
