"""The verbs of every reflection model, written once: normalise, build the shared geometry, mask by the domain, stack.

A model is one formula on :class:`~torchbrdf.geometry.Geometry` (:meth:`Bsdf.formula`), its density and its sampler; a delta lobe
is one method, :meth:`Bsdf.deltas`.
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar

import torch
from torch import Tensor

from .. import arguments, numerics, parameters, vector
from ..geometry import Channels, Geometry, Layout, Viewer
from ..optics.fresnel import Fresnel
from ..value import Value, once
from ..vector import Vec
from .lobe import BSDFSample, Delta, Draw, Lobe

ALBEDO_ORDER = 32  # the knee: of the Phong and Blinn lobes (exponents 0 to 1e5, all Fresnel terms) 48 is not more accurate, 24 is 4x less
PLANAR_CHANNELS = 4  # up to here colours are written out channel by channel; more of them broadcast as [..., C]


class Bsdf(Value):
    """Interface of the reflection models.

    ``wi [..., 3]`` points to the light, ``wo [..., 3]`` to the viewer, both away from the surface. Without ``n`` they are in
    the local frame (z = normal); with ``n [..., 3]`` in its space. Batch axes broadcast with those of the parameters.
    Directions are normalised inside unless ``assume_unit=True``. Half types compute in float32 and round once.
    """

    lobes: tuple[Lobe, ...] = ()
    reciprocal: bool = True
    variants: ClassVar[tuple[dict[str, Any], ...]] = ({},)  # the static choices of a model, which the contract takes in turn
    textbook: ClassVar[Callable[..., Any] | None] = None  # f as its source prints it: torchbrdf/testing/textbook.py

    def __post_init__(self) -> None:
        super().__post_init__()
        term = getattr(self, "fresnel", None)
        if term is not None and not isinstance(term, Fresnel):
            raise TypeError(
                f"{type(self).__name__}.fresnel: expected a Fresnel term such as Schlick(f0) or None, found {type(term).__name__}"
            )

    def check_shapes(self) -> None:
        """As every value; and what it holds (Fresnel terms, other models) must have the same channels, or 1."""
        super().check_shapes()
        held = [v for v in self.nested() if isinstance(v, (Bsdf, Fresnel))]
        counts = {"own parameters": self.own_channels, **{f"{k} {type(v).__name__}": v.channels for k, v in enumerate(held)}}
        arguments.one_count(counts, f"{type(self).__name__}: different numbers of colour channels")

    # What a model says of itself ---------------------------------------------------------------------------------------

    @abstractmethod
    def formula(self, g: Geometry) -> Channels:
        """f in 1/sr per channel, delta lobes apart, finite for every pair of directions; the caller masks the domain."""

    @abstractmethod
    def density(self, g: Geometry) -> Tensor:
        """pdf ``[...]`` over the whole sphere with which :meth:`draw` gives ``wi``; 0 where there are delta lobes alone."""

    @abstractmethod
    def draw(self, viewer: Viewer, u: Vec) -> Draw:
        """A direction from uniform numbers ``u`` (x, y, and z to choose among lobes), for a viewer in the local frame; no delta lobe.

        (0, 0, 0) where there is none to give: such a sample is lost, and :meth:`density` integrates to that much less than 1.
        """

    def deltas(self, viewer: Viewer) -> list[Delta]:
        """What each delta lobe does; none, unless a model says otherwise."""
        return []

    def domain(self, g: Geometry) -> Tensor:
        """Where (bool) the model sends light: both directions strictly above the horizon, unless a model says otherwise."""
        return g.above

    def albedo_at(self, viewer: Viewer, order: int) -> Channels:
        """The directional albedo of light arriving along ``viewer.wo``: by quadrature, unless a model has it in closed form."""
        from .albedo import quadrature_albedo

        return quadrature_albedo(self, viewer, order)

    def strength(self, viewer: Viewer) -> Tensor:
        """A cheap estimate ``[...]`` of the share of light that the lobes other than deltas reflect: how often a sum samples them."""
        bound = self.energy_bound
        return torch.ones_like(viewer.cos_o) if bound is None else viewer.layout.average(bound)

    @property
    def energy_bound(self) -> Tensor | None:
        """Upper bound ``[..., C]`` of the directional albedo over all directions: 1, unless a model knows better.

        It is a promise, and every model makes one: that it reflects no more than this, nor more than it receives (a bound above 1, as a
        sum of loose bounds may be, does not excuse an albedo above 1). A model that is not meant to conserve energy returns None, which
        promises nothing, as does every model made of it; ``tb.testing.check`` then reports the largest albedo and does not judge it.
        """
        return torch.ones(1, dtype=torch.float64)

    @property
    def lambertian(self) -> Tensor | None:
        """The albedo ``[..., C]`` of a model that is ``albedo / pi`` at every pair of directions above the horizon; None of any other."""
        return None

    def exchange(self, g: Geometry) -> Tensor:
        """f(wi, wo) / f(wo, wi) ``[...]`` of a reciprocal model: 1, unless the directions are in different media."""
        return torch.ones_like(g.cos_i)

    @property
    def is_adjoint(self) -> bool:
        """Whether ``evaluate(wi, wo)`` is f(wo, wi) of radiance, as of what is traced from the light: that of models in flux mode."""
        return getattr(self, "mode", "") == "flux" or any(v.is_adjoint for v in self.nested() if isinstance(v, Bsdf))

    def kink_distance(self, g: Geometry) -> Tensor:
        """How far ``[...]`` (in cosines) a geometry is from where f is not smooth: from the horizon, unless a model adds to it.

        Derivatives are claimed, and checked, where this is positive.
        """
        return torch.minimum(g.cos_i.abs(), g.cos_o.abs())

    @classmethod
    def may_hold(cls, model: "Bsdf") -> bool:
        """Whether a model may stand inside one of this class: any, unless a class says otherwise; the contract chooses by it."""
        return True

    # The verbs ---------------------------------------------------------------------------------------------------------

    def select(self, wanted: Lobe) -> "Bsdf | None":
        """The part of this model made of the wanted kinds of lobe (see :meth:`Lobe.serves`); None if nothing is left."""
        return self if any(lobe.serves(wanted) for lobe in self.lobes) else None

    def evaluate(
        self,
        wi: Tensor,
        wo: Tensor,
        n: Tensor | None = None,
        tangent: Tensor | None = None,
        *,
        assume_unit: bool = False,
        cosine: bool = False,
    ) -> Tensor:
        r"""f(wi, wo) in 1/sr, ``[..., C]``, without the cosine; 0 outside the model's domain (:meth:`domain`).

        ``cosine=True``: times \|n.wi\|, as the reflection equation has it; compiled it then stays one loop over the points.
        """
        g = self.geometry(wi, wo, n, tangent, assume_unit)
        factor = self.domain(g).to(g.cos_i.dtype)
        if cosine:
            factor = factor * g.cos_i.abs()
        return g.viewer.layout.join([f * factor for f in self.formula(g)]).to(wi.dtype)

    def pdf(self, wi: Tensor, wo: Tensor, n: Tensor | None = None, tangent: Tensor | None = None, *, assume_unit: bool = False) -> Tensor:
        """Density ``[..., 1]`` per steradian with which :meth:`sample` gives ``wi`` for ``wo``; 0 outside the model's domain.

        Integrates to 1, less the share of samples that are drawn outside the domain (their weight is 0) and the share of delta lobes:
        those have no density, and this is that of the other lobes alone, 0 for a :class:`Mirror`. A sample that came from a delta
        reports in ``BSDFSample.pdf`` the discrete probability with which that lobe was chosen, not this.
        """
        from .sampler import mixture_density

        g = self.geometry(wi, wo, n, tangent, assume_unit)
        density = mixture_density(self, g)
        whole = self._whole(torch.broadcast_shapes(density.shape, g.cos_i.shape, g.cos_o.shape))
        density = torch.where(self.domain(g).expand(whole), density, 0.0)
        return g.viewer.layout.join_number(density).to(wi.dtype)

    def sample(
        self, wo: Tensor, u: Tensor, n: Tensor | None = None, tangent: Tensor | None = None, *, assume_unit: bool = False
    ) -> BSDFSample:
        """Draw ``wi`` for ``wo`` from uniform ``u [..., 3]`` in [0, 1); u.z chooses the lobe (``[..., 2]`` will do for a single lobe)."""
        from .sampler import sample

        size = arguments.floats(u, "u").shape[-1:]
        if size != (3,) and not (size == (2,) and len(self.lobes) == 1):
            more = f", the third chooses among the {len(self.lobes)} lobes: torch.rand(..., 3)" if size == (2,) else ""
            raise ValueError(f"u: expected shape [..., 3] of numbers in [0, 1), found {list(u.shape)}{more}")
        viewer = self.viewer(wo, n, tangent, assume_unit, u.shape[:-1])
        if u.device != wo.device:
            raise TypeError(f"u: on {u.device} beside wo on {wo.device}; convert it with .to(...)")
        layout = viewer.layout
        lifted = [layout.lift(numerics.widen(x)) for x in u.unbind(-1)]
        numbers = [x.expand(self._whole(x.shape)) for x in lifted]
        s = sample(self, viewer, Vec(numbers[0], numbers[1], numbers[-1]))
        wi = layout.join_vector(s.wi)
        weight, pdf, eta = layout.join(s.weight), layout.join_number(s.pdf), layout.join_number(s.eta)
        return BSDFSample(wi.to(wo.dtype), weight.to(wo.dtype), pdf.to(wo.dtype), layout.join_number(s.lobe), eta.to(wo.dtype))

    def directional_albedo(self, w: Tensor, n: Tensor | None = None, tangent: Tensor | None = None, *, order: int = ALBEDO_ORDER) -> Tensor:
        """Power fraction ``[..., C]`` of light arriving along ``w`` that leaves again, to any side.

        In closed form where there is one; else by a product quadrature of ``order^2`` nodes over the sampler's own unit square, in
        chunks of bounded memory. Its error is that of the kinks inside the hemisphere: below 1e-4 with none, up to 4e-3 where F has a
        critical angle (order 16: 7e-4 and 1.5e-2), up to 1e-2 within 2 degrees of grazing for a broad lobe whose half vectors are
        drawn without regard to the viewer, so that half of them face away.
        """
        if not isinstance(order, int) or order < 1:
            raise ValueError(f"order: expected the number of nodes along one side, a whole number >= 1, found {order!r}")
        self._check_directions(w=w, n=n, tangent=tangent)
        viewer = self._viewer(w, n, tangent, False)
        return viewer.layout.join(self.albedo_at(viewer, order)).to(w.dtype)

    # Around them -------------------------------------------------------------------------------------------------------

    @property
    def is_wide(self) -> bool:
        """Whether colours of this model broadcast as ``[..., C]`` rather than channel by channel."""
        return self.channels > PLANAR_CHANNELS

    @once
    def channels(self) -> int:
        """C, the number of colour channels of the result."""
        return max(self.own_channels, *(v.channels for v in self.nested() if isinstance(v, (Bsdf, Fresnel))), 1)

    def geometry(
        self, wi: Tensor, wo: Tensor, n: Tensor | None = None, tangent: Tensor | None = None, assume_unit: bool = False
    ) -> Geometry:
        """Check the directions against the parameters and take them apart."""
        self._check_directions(wi=wi, wo=wo, n=n, tangent=tangent)
        viewer = self._viewer(wo, n, tangent, assume_unit)
        return Geometry(viewer, _unit(viewer.layout, wi, assume_unit))

    def viewer(
        self, wo: Tensor, n: Tensor | None = None, tangent: Tensor | None = None, assume_unit: bool = False, batch: tuple[int, ...] = ()
    ) -> Viewer:
        """Check what belongs to the viewer, and the ``batch`` axes of random numbers, against the parameters; and take it apart."""
        self._check_directions(batch, wo=wo, n=n, tangent=tangent)
        return self._viewer(wo, n, tangent, assume_unit)

    def _whole(self, numbers: torch.Size) -> torch.Size:
        """The shape of numbers broadcast with the parameters': a density that does not depend on them has their batch axes, too."""
        return torch.broadcast_shapes(numbers, (*self.batch_shape, 1) if self.is_wide else self.batch_shape)

    def _viewer(self, wo: Tensor, n: Tensor | None, tangent: Tensor | None, assume_unit: bool) -> Viewer:
        layout = Layout.beside(wo, self.is_wide)
        normal = None if n is None else _unit(layout, n, assume_unit)
        along = None if tangent is None else layout.vector(tangent)  # made unit by the viewer, where a model asks for a frame
        return Viewer(_unit(layout, wo, assume_unit), normal, along, layout=layout)

    def _check_directions(self, u: tuple[int, ...] = (), **given: Tensor | None) -> None:
        """Directions must be tensors ``[..., 3]`` of one dtype and device, that of the parameters, and broadcast with them."""
        found = {name: arguments.floats(v, name, 3) for name, v in given.items() if v is not None or name in ("wi", "wo", "w")}
        first, reference = next(iter(found.items()))
        parameters.check(self, reference, first)
        for name, v in found.items():
            if v.dtype != reference.dtype or v.device != reference.device:
                raise TypeError(f"{name}: {parameters.kind(v)} beside {first}: {parameters.kind(reference)}; convert one with .to(...)")
        shapes = {name: tuple(v.shape[:-1]) for name, v in found.items()} | {"parameters": tuple(self.batch_shape), "u": tuple(u)}
        arguments.broadcast(shapes, "batch shapes")

    def __add__(self, other: "Bsdf") -> "Bsdf":
        from .combine import Sum

        return Sum((self, other)) if isinstance(other, Bsdf) else NotImplemented

    def __mul__(self, scale: Tensor | float) -> "Bsdf":
        from .combine import Scaled

        return Scaled(self, scale)  # type: ignore[arg-type]

    __rmul__ = __mul__


def _unit(layout: Layout, v: Tensor, assume_unit: bool) -> Vec:
    wide = numerics.widen(v)
    parts = vector.components(wide) if assume_unit else vector.unit_components(wide)
    return Vec(*map(layout.lift, parts))


def nearest(*distances: Tensor) -> Tensor:
    """The smallest of some distances, elementwise."""
    least = distances[0]
    for d in distances[1:]:
        least = torch.minimum(least, d)
    return least
