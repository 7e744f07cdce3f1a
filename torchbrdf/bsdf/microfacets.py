"""What models of microfacets share: their choices, the Smith lengths of both directions, half vectors as the distributions take them.

A model has ``alpha``, and ``distribution``, ``shadowing`` and ``smith`` by name. Each figure is computed once for a viewer or a pair.
"""

from collections.abc import Callable
from typing import Protocol

from torch import Tensor

from .. import arguments, vector
from ..geometry import Geometry, Viewer
from ..optics.beckmann import Beckmann, walter_length
from ..optics.blinn import Blinn
from ..optics.distribution import Distribution, Facet, Rough
from ..optics.ggx import GGX
from ..vector import Vec
from .shadowing import SHADOWING

Length = Callable[[Tensor, Tensor], Tensor]  # the Smith length, of a cosine and the square of the projected roughness
DISTRIBUTIONS: dict[str, type[Distribution]] = {"ggx": GGX, "beckmann": Beckmann, "blinn": Blinn}


class Microfacets(Protocol):
    """The fields of such a model."""

    @property
    def alpha(self) -> Tensor: ...

    @property
    def distribution(self) -> str: ...

    @property
    def shadowing(self) -> str: ...

    @property
    def smith(self) -> str: ...


def check_choices(model: Microfacets) -> None:
    """Raise ``ValueError`` for a name that is none, or does not go with another."""
    name = type(model).__name__
    arguments.one_of(model.distribution, f"{name}.distribution", DISTRIBUTIONS)
    arguments.one_of(model.shadowing, f"{name}.shadowing", SHADOWING)
    arguments.one_of(model.smith, f"{name}.smith", ("exact", "walter"))
    if model.smith == "walter" and model.distribution != "beckmann":
        raise ValueError(f"{name}.smith: found 'walter' beside {model.distribution!r}; it is an approximation of 'beckmann' alone")


def normals(model: Microfacets) -> type[Distribution]:
    """The formulas of the distribution."""
    return DISTRIBUTIONS[model.distribution]


def rough(model: Microfacets, viewer: Viewer) -> Rough:
    """The roughness beside the points."""
    return viewer.once(model.alpha, lambda: Rough.of(model.alpha, viewer.layout), "rough")


def facet(model: Microfacets, g: Geometry, half: Vec, local: Callable[[], Vec], length2: Tensor) -> Facet:
    """A half vector; ``local`` gives the same in the local frame, which is asked for where roughness has two axes."""
    at = rough(model, g.viewer)
    if not at.isotropic:
        return Facet.local(local(), at, length2)
    across = vector.cross(g.n, half)
    flat2 = vector.dot(across, across)
    return Facet(vector.dot(g.n, half), flat2, flat2 / (at.x * at.x), length2)


def smith_length(model: Microfacets) -> Length:
    """The Smith length by the choice of its Lambda."""
    return walter_length if model.smith == "walter" else normals(model).smith_length


def length_i(model: Microfacets, by: Length, g: Geometry) -> Tensor:
    """The Smith length of wi; below the surface that of its image above."""
    at = rough(model, g.viewer)
    return by(g.cos_i.abs(), at.projected2(g.cos_i, None if at.isotropic else g.wi_local))


def length_o(model: Microfacets, by: Length, viewer: Viewer) -> Tensor:
    """Of wo, once for a viewer."""

    def compute() -> Tensor:
        at = rough(model, viewer)
        return by(viewer.cos_o.abs(), at.projected2(viewer.cos_o, None if at.isotropic else viewer.local.wo))

    return viewer.once(model.alpha, compute, by.__qualname__)


def smith_only(model: Microfacets) -> bool:
    """Whether the shadowing is that of another distribution: of Blinn's, Smith's has no closed form."""
    return model.distribution == "blinn" and model.shadowing != "v_cavity"
