r"""A smooth clear coat over a diffuse base: varnish, glaze, plastic.

.. math::
    f = F(\theta_o) \frac{\delta(\omega_i - R(\omega_o))}{\cos\theta_i} + \frac{(1 - F(\theta_i))(1 - F(\theta_o))}{\eta^2}
    \left[ f_{base}(\omega_i', \omega_o') + \frac{\rho^2 F_{di}}{\pi (1 - \rho F_{di})} \right]

=========  ================  ============================================================
parameter  unit, range       meaning
=========  ================  ============================================================
base       a BSDF            what lies below: lobes of diffuse reflection alone
eta        [..., 1] > 0      n(coat) / n(outside)
gloss      True, False       whether the coat's own mirror reflection is part of the model
=========  ================  ============================================================

Light enters through the coat, is scattered by the base, and leaves or is thrown back to the base again and again. What is scattered once
is exact: :math:`\omega'` are the refracted directions, under which the base sees light and viewer. What the coat throws back is taken as
diffuse: :math:`\rho` is the albedo of the base under diffuse light, and :math:`F_{di} = 1 - (1 - F_{de})/\eta^2` the part of diffuse
light that does not get out, by :math:`F_{de} = 2\int F(\mu)\mu\,d\mu` (``tb.fresnel.dielectric_average``).

Over a Lambert base, sums and multiples included, all is exact, and the brackets are :math:`\rho/\pi / (1 - \rho F_{di})`: the directional
albedo is :math:`F + (1 - F)\,\rho(1 - F_{di})/(1 - \rho F_{di})`, and 1 at every angle and eta where rho is 1. Over another base the
albedo is a quadrature, and so is rho, of 512 pairs of directions for every material; energy is approximate (0.02 for Minnaert's surface of
k from 1.2 to 3) and not promised (``energy_bound`` is None).

Reciprocal where the base is. ``gloss=False`` leaves out the mirror reflection, as polarised photographs do. The colour of a coat of one
index is that of the base. At eta = 1 it is the base itself; the slope by eta jumps there, as that of F_de does, and is that towards
eta > 1. Not smooth at the horizon, at the critical angle (of eta < 1), and where the base is not. Source: Saunderson 1942, with F_di of
Walsh 1926; over Lambert's surface at every angle Wolff 1994.

>>> import torch, torchbrdf as tb
>>> up = torch.tensor([0.0, 0.0, 1.0])
>>> tb.Coated(tb.Lambert([1.0, 0.5, 0.0]), 1.5).directional_albedo(up)
tensor([1.0000, 0.3161, 0.0400])
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from .. import numerics
from ..geometry import Channels, Geometry, Viewer, each
from ..optics.dielectric import Split, split
from ..optics.dielectric_average import dielectric_average
from ..optics.fresnel import ETA, Dielectric
from ..value import SCALAR, param, value
from ..vector import Vec
from .base import Bsdf, nearest
from .lobe import Delta, Draw, Lobe
from .mean_albedo import mean_albedo
from .mirror import Mirror
from .smooth_dielectric import bent, one_index


class Below(NamedTuple):
    """What the coat and the base do for one viewer."""

    at: Split  # of the coat, along wo
    rho: Channels  # albedo of the base under diffuse light
    gain: Channels  # 1 / (1 - rho F_di)
    escape: Tensor  # 1 - F_di
    eta: Tensor  # read once, so that a half type rounds its slope once


@value
class Coated(Bsdf):
    """A smooth coat of index ``eta`` over a diffuse ``base``."""

    base: Bsdf
    eta: Tensor = param(ETA, SCALAR, "index of refraction, coat over outside")
    gloss: bool = True

    variants = ({"gloss": True}, {"gloss": False})

    def __post_init__(self) -> None:
        if not isinstance(self.base, Bsdf):
            raise TypeError(f"Coated.base: expected a BSDF such as tb.Lambert(albedo), found {type(self.base).__name__}")
        if not self.may_hold(self.base):
            found = ", ".join(dict.fromkeys(lobe.label for lobe in self.base.lobes if lobe != Lobe.DIFFUSE_REFLECTION))
            raise ValueError(f"Coated.base: expected lobes of diffuse reflection alone, found {found} of {type(self.base).__name__}")
        if not isinstance(self.gloss, bool):
            raise TypeError(f"Coated.gloss: found {self.gloss!r}, legal are True and False")
        one_index("Coated.eta", self.eta)
        super().__post_init__()

    @classmethod
    def may_hold(cls, model: Bsdf) -> bool:
        return all(lobe.value == Lobe.DIFFUSE_REFLECTION.value for lobe in model.lobes)

    @property
    def lobes(self) -> tuple[Lobe, ...]:  # type: ignore[override]
        return (Lobe.DELTA_REFLECTION,) * self.gloss + self.base.lobes

    @property
    def reciprocal(self) -> bool:  # type: ignore[override]
        return self.base.reciprocal

    @property
    def energy_bound(self) -> Tensor | None:
        return None if self.base.lambertian is None else super().energy_bound

    def select(self, wanted: Lobe) -> Bsdf | None:
        mirror, diffuse = self.gloss and Lobe.DELTA_REFLECTION.serves(wanted), Lobe.DIFFUSE_REFLECTION.serves(wanted)
        if diffuse:
            return self if mirror == self.gloss else self.replace(gloss=mirror)
        return Mirror(torch.ones_like(self.eta), Dielectric(self.eta)) if mirror else None

    def formula(self, g: Geometry) -> Channels:
        below = self.below(g.viewer)
        over, eta = split(g.cos_i, below.eta), below.eta
        through = below.at.transmitted * over.transmitted / (eta * eta)
        if self.base.lambertian is not None:
            through = through * (1.0 / math.pi)
            return each(lambda rho, gain: through * rho * gain, below.rho, below.gain)
        inner = self.inner(g, over)
        through = through * self.base.domain(inner).to(through.dtype)
        within = (1.0 - below.escape) * (1.0 / math.pi)
        again = each(lambda rho, gain: rho * rho * gain * within, below.rho, below.gain)
        return each(lambda f, more: through * (f + more), self.base.formula(inner), again)

    def density(self, g: Geometry) -> Tensor:
        return self.base.density(g)

    def draw(self, viewer: Viewer, u: Vec) -> Draw:
        """As the base draws for the viewer outside: for diffuse light that is near enough."""
        drawn = self.base.draw(viewer, u)
        return drawn._replace(lobe=drawn.lobe + int(self.gloss))

    def deltas(self, viewer: Viewer) -> list[Delta]:
        return [Delta(viewer.mirror, viewer.cos_o, (self.below(viewer).at.reflected,))] if self.gloss else []

    def strength(self, viewer: Viewer) -> Tensor:
        return viewer.layout.mean(self.diffuse_albedo(viewer))

    def diffuse_albedo(self, viewer: Viewer) -> Channels:
        """That of what the base sends back through the coat, exact for a Lambert base."""
        below = self.below(viewer)
        enters = below.at.transmitted * below.escape
        return each(lambda rho, gain: enters * rho * gain, below.rho, below.gain)

    def albedo_at(self, viewer: Viewer, order: int) -> Channels:
        """In closed form over a Lambert base, else by quadrature."""
        if self.base.lambertian is None:
            return super().albedo_at(viewer, order)
        mirror = self.below(viewer).at.reflected if self.gloss else 0.0
        above = (viewer.cos_o > 0).to(viewer.cos_o.dtype)
        return tuple((mirror + a) * above for a in self.diffuse_albedo(viewer))

    def kink_distance(self, g: Geometry) -> Tensor:
        """The horizon, the critical angles of both directions, and what is not smooth about the base."""
        eta = self.below(g.viewer).eta
        total = (1.0 - eta) * (1.0 + eta)
        critical = [(cos * cos - total).abs() for cos in (g.cos_i, g.cos_o)]
        seen = g if self.base.lambertian is not None else self.inner(g, split(g.cos_i, eta))
        return nearest(super().kink_distance(g), *critical, self.base.kink_distance(seen))

    def below(self, viewer: Viewer) -> Below:
        """What depends on the viewer and the material; computed once for a viewer."""
        return viewer.once(self, lambda: self._below(viewer))

    def _below(self, viewer: Viewer) -> Below:
        eta, flat = viewer.scalar(self.eta), self.base.lambertian
        escape = (1.0 - dielectric_average(eta)) / (eta * eta)
        rho = mean_albedo(self.base, viewer.layout) if flat is None else viewer.colour(flat)
        # 1 - rho F_di without the difference of what may be equal
        gain = tuple(1.0 / ((1.0 - r) + r * escape) for r in rho)
        return Below(split(viewer.cos_o, eta), rho, gain, escape, eta)

    def inner(self, g: Geometry, over: Split) -> Geometry:
        """The pair of directions below the coat: those of the light that the base meets, pointing up."""
        v, eta = g.viewer, self.below(g.viewer).eta
        wo, wi = (
            bent(w, v.n, at.g - numerics.unit_interval(c), at, eta)
            for w, c, at in ((v.wo, v.cos_o, self.below(v).at), (g.wi, g.cos_i, over))
        )
        viewer = Viewer(wo, None if v.is_local else v.n, v.tangent, v.handedness, v.layout)
        viewer._memo["axes"] = v.axes
        return Geometry(viewer, wi)
