"""What effects share: the shading points, taken apart once, and the shape of an effect."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, Protocol

from torch import Tensor

from .. import numerics, vector
from ..bsdf.base import Bsdf, Channels
from ..light.base import Light
from ..scene.gbuffer import GBuffer
from ..vector import Geometry, Vec


class Surface(NamedTuple):
    """The shading points of a G-buffer in components; ``valid`` leaves out background and broken normals."""

    position: Vec
    n: Vec
    wo: Vec
    tangent: Vec | None
    valid: Tensor
    cos_o: Tensor
    wide: bool

    @staticmethod
    def of(g: GBuffer, wide: bool) -> "Surface":
        """Directions are normalised here, once; zero and non-finite ones become 0, and so does their radiance."""

        def parts(v: Tensor) -> Vec:
            return Vec(*((c.unsqueeze(-1) if wide else c) for c in vector.components(numerics.widen(v))))

        n, wo = (vector.normalize_components(parts(v)) for v in (g.normal, g.require_view()))
        tangent = None if g.tangent is None else parts(g.tangent)
        valid = g.valid if wide else g.valid.squeeze(-1)
        return Surface(parts(g.position), n, wo, tangent, valid, vector.dot(n, wo), wide)

    def towards(self, wi: Vec) -> Geometry:
        """The geometry of light from ``wi``; what depends on the viewer alone is shared by all lights."""
        return Geometry(wi, self.wo, self.n, self.tangent, self.wide, {"cos_o": self.cos_o})


class Effect(Protocol):
    """One way in which light reaches the eye: ``(row of the light, radiance per channel)`` for each light it serves."""

    def __call__(self, bsdf: Bsdf, surface: Surface, lights: Sequence[Light], visibility: Tensor | None) -> Iterator[tuple[int, Channels]]: ...


def rows_of(lights: Sequence[Light], kind: type[Any]) -> Iterator[tuple[int, Any]]:
    """(first row, light) of each light of a kind; a light takes ``len(light)`` rows, in the order of the list."""
    row = 0
    for light in lights:
        if isinstance(light, kind):
            yield row, light
        row += len(light)
