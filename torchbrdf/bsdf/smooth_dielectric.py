r"""A smooth interface between two clear media: what it does not reflect as a mirror, it refracts.

.. math::
    f = F(\theta_o) \frac{\delta(\omega_i - R(\omega_o))}{|\cos\theta_i|}
    + \frac{n_o^2}{n_i^2} (1 - F(\theta_o)) \frac{\delta(\omega_i - T(\omega_o))}{|\cos\theta_i|}

=========  ==============================  ==================================================================
parameter  unit, range                     meaning
=========  ==============================  ==================================================================
eta        [..., 1] > 0                    n(inside) / n(outside); n points outside
mode       "radiance", "flux"              whether radiance that crosses grows by (n_o/n_i)^2, or power is counted
part       "both", "reflection", ...       both lobes, or one of them alone ("transmission")
=========  ==============================  ==================================================================

``F`` is the exact law of a dielectric, ``R`` and ``T`` the directions of mirror reflection and of refraction (Snell). A viewer below the
surface (n.wo < 0) sees the inverse index, and total internal reflection beyond its critical angle: there the reflected weight is
exactly 1 and no sample is refracted. The weights are ``F`` and ``(n_o/n_i)^2 (1 - F)``, ``1 - F`` with all its digits, so that
``f(wi, wo)/n_o^2 = f(wo, wi)/n_i^2``. ``mode="flux"`` drops the factor: it is the adjoint, ``f(wo, wi)``, of what is traced from the light.
``BSDFSample.eta`` is n_i/n_o, n(side of wi) / n(side of wo), in both modes.

One index for all channels, which decides where the ray goes: dispersion sends every wavelength elsewhere, and is one model each.
The directional albedo is 1. At eta = 1 nothing is reflected and ``wi = -wo``. Not smooth at the horizon and at the critical angle
(slope infinite outside, 0 inside). Source: Fresnel 1823; the factor Nicodemus 1963, Veach 1997, sec. 5.2.

>>> import torch, torchbrdf as tb
>>> glass, up = tb.SmoothDielectric(1.5), torch.tensor([0.0, 0.0, 1.0])
>>> through = glass.sample(up, torch.tensor([0.5, 0.5, 0.9]))
>>> through.wi[2], through.eta, through.weight * through.pdf  # 0.96 / 1.5^2
(tensor(-1.), tensor([1.5000]), tensor([0.4267]))
"""

from typing import Any, NamedTuple

import torch
from torch import Tensor

from .. import arguments
from ..geometry import Channels, Geometry, Viewer
from ..optics.dielectric import Split, split
from ..optics.fresnel import ETA
from ..value import SCALAR, param, value
from ..vector import Vec, scale
from .base import Bsdf, nearest
from .lobe import Delta, Draw, Lobe

MODES = ("radiance", "flux")
PARTS = {
    "both": (Lobe.DELTA_REFLECTION, Lobe.DELTA_TRANSMISSION),
    "reflection": (Lobe.DELTA_REFLECTION,),
    "transmission": (Lobe.DELTA_TRANSMISSION,),
}


class Crossing(NamedTuple):
    """What the interface does for one viewer."""

    reflected: Tensor  # F
    transmitted: Tensor  # 1 - F
    eta: Tensor  # n(other side) / n(side of the viewer)
    wi: Vec  # the refracted direction, (0, 0, 0) under total reflection
    cos_i: Tensor  # n.wi of it


@value
class SmoothDielectric(Bsdf):
    """A mirror of reflectance F, and refraction of the rest. ``eta``: n(inside) / n(outside)."""

    eta: Tensor = param(ETA, SCALAR, "index of refraction, inside over outside")
    mode: str = "radiance"
    part: str = "both"

    variants = ({"mode": "radiance"}, {"mode": "flux"}, {"part": "reflection"}, {"part": "transmission"})

    def __post_init__(self) -> None:
        arguments.one_of(self.mode, "SmoothDielectric.mode", MODES)
        arguments.one_of(self.part, "SmoothDielectric.part", PARTS)
        one_index("SmoothDielectric.eta", self.eta)
        super().__post_init__()

    @property
    def lobes(self) -> tuple[Lobe, ...]:  # type: ignore[override]
        return PARTS[self.part]

    def select(self, wanted: Lobe) -> Bsdf | None:
        kept = tuple(lobe for lobe in self.lobes if lobe.serves(wanted))
        return self.replace(part=next(name for name, lobes in PARTS.items() if lobes == kept)) if kept else None

    def domain(self, g: Geometry) -> Tensor:
        """The lobes' sides of the surface, above and below it."""
        return g.same_side | g.across if self.part == "both" else g.across if self.part == "transmission" else g.same_side

    def formula(self, g: Geometry) -> Channels:
        return (self.density(g),)

    def density(self, g: Geometry) -> Tensor:
        return torch.zeros_like(g.cos_i + g.cos_o + g.scalar(self.eta))

    def draw(self, viewer: Viewer, u: Vec) -> Draw:
        return Draw(viewer.mirror)

    def deltas(self, viewer: Viewer) -> list[Delta]:
        at = self.crossing(viewer)
        factor = 1.0 / (at.eta * at.eta) if self.mode == "radiance" else 1.0
        both = (
            Delta(viewer.mirror, viewer.cos_o, (at.reflected,)),
            Delta(at.wi, at.cos_i, (at.transmitted * factor,), lobe=1, eta=at.eta),
        )
        return list(both) if self.part == "both" else [both[self.part == "transmission"]._replace(lobe=0)]

    def crossing(self, viewer: Viewer) -> Crossing:
        """Shares and direction; computed once for a viewer."""
        return viewer.once(self, lambda: self._crossing(viewer))

    def _crossing(self, viewer: Viewer) -> Crossing:
        cos, eta = viewer.cos_o * viewer.side, self._eta_of(viewer)
        at = split(cos, eta)
        back = bent(viewer.wo, viewer.n, viewer.side * (at.g - cos), at, eta)
        return Crossing(at.reflected, at.transmitted, eta, scale(back, -1.0), -viewer.side * at.g / eta)

    def _eta_of(self, viewer: Viewer) -> Tensor:
        """n(other side) / n(side of the viewer)."""
        eta = viewer.scalar(self.eta)
        return torch.where(viewer.side < 0, 1.0 / eta, eta)

    def albedo_at(self, viewer: Viewer, order: int) -> Channels:
        """Of power: 1, or that of the one lobe; 0 at the horizon."""
        at = self.crossing(viewer)
        whole = {"both": torch.ones_like(at.reflected), "reflection": at.reflected, "transmission": at.transmitted}
        return (whole[self.part] * (viewer.cos_o != 0).to(at.eta.dtype),)

    def kink_distance(self, g: Geometry) -> Tensor:
        """The horizon, and the distance of g^2 from 0, its value at the critical angle."""
        eta, cos = self._eta_of(g.viewer), g.cos_o
        return nearest(super().kink_distance(g), (cos * cos - (1.0 - eta) * (1.0 + eta)).abs())


def bent(w: Vec, n: Vec, along: Tensor, at: Split, eta: Tensor) -> Vec:
    """The refracted direction of ``w``, on the side of ``w``: ``w`` plus ``along`` times n, over eta. (0, 0, 0) under total reflection."""
    passes, inverse = at.g > 0, 1.0 / eta
    return Vec(*(torch.where(passes, (a + along * b) * inverse, 0.0) for a, b in zip(w, n, strict=True)))


def one_index(name: str, eta: Any) -> None:
    """An index a channel is what the Fresnel terms take, and no interface that refracts."""
    size = list(torch.as_tensor(eta).shape if isinstance(eta, (list, tuple)) else getattr(eta, "shape", ()))
    if size and size[-1] != 1:
        raise ValueError(
            f"{name}: expected shape [..., 1], found {size}; every channel would be refracted elsewhere, so take one model for each "
            f"index, as in [tb.SmoothDielectric(n) for n in eta] (or x[..., None], where this is one number a point)"
        )
