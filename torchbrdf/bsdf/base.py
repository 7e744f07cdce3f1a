"""The verbs of every reflection model, written once: normalise, build the shared :class:`Geometry`, mask, stack.

A model is one formula on :class:`Geometry` (:meth:`Bsdf.formula`), its density and its sampler.
"""

import enum
from abc import abstractmethod
from collections.abc import Iterable
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor

from .. import arguments, numerics, vector
from ..geometry import Geometry
from ..optics.fresnel import Fresnel
from ..value import Value
from ..vector import Vec

Channels = tuple[Tensor, ...]
PLANAR_CHANNELS = 4  # up to here colours are written out channel by channel; more of them broadcast as [..., C]


class Lobe(enum.Enum):
    """What kind of light transport a lobe is; a plan chooses effects by it."""

    DIFFUSE = "diffuse reflection"
    GLOSSY = "glossy reflection"
    MIRROR = "mirror reflection"

    @property
    def is_delta(self) -> bool:
        """Whether the lobe reflects into a single direction."""
        return self is Lobe.MIRROR


class BSDFSample(NamedTuple):
    """What ``sample`` returns. ``pdf`` of a delta lobe is the discrete probability of choosing it."""

    wi: Tensor  # [..., 3] unit, in the frame of wo
    weight: Tensor  # [..., C] f cos / pdf; 0 for a direction below the horizon
    pdf: Tensor  # [..., 1] per steradian of wi given wo
    lobe: Tensor  # [..., 1] index into bsdf.lobes


class Draw(NamedTuple):
    """A sample inside the formulas: components, channels and ``[...]`` tensors."""

    wi: Vec
    weight: Channels
    pdf: Tensor
    lobe: Tensor


class Bsdf(Value):
    """Interface of the reflection models.

    ``wi [..., 3]`` points to the light, ``wo [..., 3]`` to the viewer, both away from the surface. Without ``n`` they are in
    the local frame (z = normal); with ``n [..., 3]`` in its space. Batch axes broadcast with those of the parameters.
    Directions are normalised inside unless ``assume_unit=True``. Half types compute in float32 and round once.
    """

    lobes: tuple[Lobe, ...] = ()
    reciprocal: bool = True
    variants: ClassVar[tuple[dict[str, Any], ...]] = ({},)  # the static choices of a model, which the contract takes in turn

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
        held = [v for v in self.nested() if isinstance(v, Bsdf | Fresnel)]
        counts = [("own parameters", _widest(self)), *((type(v).__name__, v.channels) for v in held)]
        if len({c for _, c in counts} - {1}) > 1:
            raise ValueError(f"{type(self).__name__}: different numbers of colour channels: {counts}; use one C, or 1")

    @abstractmethod
    def formula(self, g: Geometry) -> Channels:
        """f in 1/sr per channel, finite for every pair of directions; the caller masks the horizon."""

    def mirror_reflectance(self, g: Geometry) -> Channels:
        """What the mirror lobes reflect at ``g.cos_o``, per channel: the weight of their sample."""
        return (torch.zeros_like(g.cos_o),)

    @abstractmethod
    def density(self, g: Geometry) -> Tensor:
        """pdf ``[...]`` of ``wi`` given ``wo``, 0 for delta lobes."""

    @abstractmethod
    def draw(self, wo: Vec, u: Vec, wide: bool) -> Draw:
        """Sample in the local frame from uniform numbers ``u``."""

    @property
    def energy_bound(self) -> Tensor | None:
        """Upper bound ``[..., C]`` of the directional albedo over all directions; None where the model promises none."""
        return None

    def kink_distance(self, g: Geometry) -> Tensor:
        """How far ``[...]`` (in cosines) a geometry is from where f is not smooth: from the horizon, unless a model adds to it.

        Derivatives are claimed, and checked, where this is positive.
        """
        return torch.minimum(g.cos_i, g.cos_o)

    def select(self, lobes: Iterable[Lobe]) -> "Bsdf | None":
        """The part of this model made of the given kinds of lobe; None if nothing is left."""
        return self if set(self.lobes) & set(lobes) else None

    def evaluate(
        self, wi: Tensor, wo: Tensor, n: Tensor | None = None, tangent: Tensor | None = None, *, assume_unit: bool = False
    ) -> Tensor:
        """f(wi, wo) in 1/sr, ``[..., C]``, without the cosine. 0 unless both directions are strictly above the horizon."""
        g = self.geometry(wi, wo, n, tangent, assume_unit)
        lit = g.lit.to(g.cos_i.dtype)
        return join([f * lit for f in self.formula(g)], g.wide).to(wi.dtype)

    def pdf(self, wi: Tensor, wo: Tensor, n: Tensor | None = None, tangent: Tensor | None = None, *, assume_unit: bool = False) -> Tensor:
        """Density ``[..., 1]`` per steradian with which :meth:`sample` gives ``wi`` for ``wo``. Integrates to 1 over the sphere."""
        g = self.geometry(wi, wo, n, tangent, assume_unit)
        density = torch.where(g.cos_o > 0, self.density(g), 0.0)
        return (density if g.wide else density.unsqueeze(-1)).to(wi.dtype)

    def sample(
        self, wo: Tensor, u: Tensor, n: Tensor | None = None, tangent: Tensor | None = None, *, assume_unit: bool = False
    ) -> BSDFSample:
        """Draw ``wi`` for ``wo`` from uniform ``u [..., 2]`` in [0, 1)."""
        if arguments.floats(u, "u").shape[-1:] != (2,):
            raise ValueError(f"u: expected shape [..., 2] of numbers in [0, 1), found {list(u.shape)}")
        self._check_directions(u.shape[:-1], wo=wo, n=n, tangent=tangent)
        if u.device != wo.device:
            raise TypeError(f"u: on {u.device} beside wo on {wo.device}; convert it with .to(...)")
        wide = self.is_wide
        wo_c = _take(wo, wide, assume_unit)
        n_c, t_c = (None if v is None else _take(v, wide, assume_unit) for v in (n, tangent))
        u_c = [numerics.widen(x.unsqueeze(-1) if wide else x) for x in u.unbind(-1)]
        if n_c is None:
            axes, local = None, wo_c
        else:
            axes = vector.frame_components(n_c, t_c)
            local = Vec(*(vector.dot(a, wo_c) for a in axes))
        drawn = self.draw(local, Vec(u_c[0], u_c[1], u_c[0]), wide)
        wi = drawn.wi if axes is None else vector.combine(axes, drawn.wi)
        return self._sampled(drawn, wi, local.z > 0, wide, wo.dtype)

    def _sampled(self, d: Draw, wi: Vec, visible: Tensor, wide: bool, dtype: torch.dtype) -> BSDFSample:
        up = visible & (d.wi.z > 0)
        weight = join([torch.where(up, w, 0.0) for w in d.weight], wide)
        pdf = torch.where(visible, d.pdf, 0.0)
        wi, pdf, lobe = (wi, pdf.unsqueeze(-1), d.lobe.unsqueeze(-1)) if not wide else (Vec(*(c[..., 0] for c in wi)), pdf, d.lobe)
        return BSDFSample(vector.stack(wi).to(dtype), weight.to(dtype), pdf.to(dtype), lobe)

    def directional_albedo(self, wo: Tensor, n: Tensor | None = None, *, order: int = 48) -> Tensor:
        """Power fraction ``[..., C]`` of light arriving along ``wo`` that leaves again.

        In closed form where there is one; else by a product quadrature of ``order^2`` nodes over the sampler's own unit
        square, where the integrand is ``sample(...).weight`` (error about 1e-3 at order 48, from the kink at the horizon).
        """
        arguments.floats(wo, "wo", 3)
        if not isinstance(order, int) or order < 1:
            raise ValueError(f"order: expected the number of nodes along one side, a whole number >= 1, found {order!r}")
        x, weights = (t.to(numerics.working_dtype(wo.dtype)).to(wo.device) for t in gauss_legendre(order))
        azimuth = (torch.arange(order, dtype=x.dtype, device=x.device) + 0.5) / order
        u = torch.stack(torch.meshgrid(x, azimuth, indexing="ij"), -1).reshape(-1, 2)
        out = torch.zeros((), dtype=x.dtype, device=x.device)
        w = weights.repeat_interleave(order) / order
        lead = (order * order,) + (1,) * len(torch.broadcast_shapes(wo.shape[:-1], self.batch_shape, () if n is None else n.shape[:-1]))
        s = self.sample(numerics.widen(wo), u.reshape(*lead, 2), None if n is None else numerics.widen(n))
        return (out + (s.weight * w.reshape(*lead, 1)).sum(0)).to(wo.dtype)

    def mixture_weight(self, wo: Vec, wide: bool) -> Tensor:
        """The share ``[...]`` of samples that a sum should give this model: its directional albedo, coarsely, detached."""
        flat = Vec(*(c[..., 0] for c in wo)) if wide else wo
        albedo = self.detach().directional_albedo(vector.stack(flat).detach(), order=6).mean(-1)
        return albedo.unsqueeze(-1) if wide else albedo

    @property
    def is_wide(self) -> bool:
        """Whether colours of this model broadcast as ``[..., C]`` rather than channel by channel."""
        return self.channels > PLANAR_CHANNELS

    @property
    def channels(self) -> int:
        """C, the number of colour channels of the result."""
        return max(_widest(self), *(v.channels for v in self.nested() if isinstance(v, Bsdf | Fresnel)), 1)

    def geometry(
        self, wi: Tensor, wo: Tensor, n: Tensor | None = None, tangent: Tensor | None = None, assume_unit: bool = False
    ) -> Geometry:
        """Check the directions against the parameters and take them apart."""
        self._check_directions(wi=wi, wo=wo, n=n, tangent=tangent)
        wide = self.is_wide
        wi_c, wo_c = (_take(v, wide, assume_unit) for v in (wi, wo))
        n_c, t_c = (None if v is None else _take(v, wide, assume_unit) for v in (n, tangent))
        return Geometry(wi_c, wo_c, n_c if n_c is not None else local_normal(wi_c), t_c, wide)

    def view_geometry(self, wo: Tensor, n: Tensor | None) -> Geometry:
        """The geometry of what depends on ``wo`` alone."""
        return self.geometry(arguments.floats(wo, "wo", 3), wo, n)

    def _check_directions(self, u: tuple[int, ...] = (), **given: Tensor | None) -> None:
        """Directions must be tensors ``[..., 3]`` of one dtype and device, that of the parameters, and broadcast with them."""
        found = {name: arguments.floats(v, name, 3) for name, v in given.items() if v is not None or name in ("wi", "wo")}
        first, reference = next(iter(found.items()))
        check_same_kind(self, reference, first)
        for name, v in found.items():
            if v.dtype != reference.dtype or v.device != reference.device:
                raise TypeError(f"{name}: {_kind(v)} beside {first}: {_kind(reference)}; convert one with .to(...)")
        shapes = {name: tuple(v.shape[:-1]) for name, v in found.items()} | {"parameters": tuple(self.batch_shape), "u": tuple(u)}
        arguments.broadcast(shapes, "batch shapes")

    def __add__(self, other: "Bsdf") -> "Bsdf":
        from .combine import Sum

        return Sum((self, other)) if isinstance(other, Bsdf) else NotImplemented

    def __mul__(self, scale: Tensor | float) -> "Bsdf":
        from .combine import Scaled

        return Scaled(self, scale)  # type: ignore[arg-type]

    __rmul__ = __mul__


def _widest(v: Value) -> int:
    return max((t.shape[-1] for _, t, s in v.own_tensors() if s.size is None), default=1)


def _kind(t: Tensor) -> str:
    return f"{str(t.dtype).removeprefix('torch.')} on {t.device}"


def check_same_kind(v: Value, reference: Tensor, name: str) -> None:
    """Batched parameters must have the dtype and device of ``reference``; unbatched CPU ones follow it."""
    for field, t, _ in v.own_tensors():
        follows = t.dim() == 1 and t.device.type == "cpu"
        if not follows and (t.dtype != reference.dtype or t.device != reference.device):
            raise TypeError(f"{type(v).__name__}.{field}: {_kind(t)} beside {name}: {_kind(reference)}; convert one with .to(...)")
    for inner in v.nested():
        check_same_kind(inner, reference, name)


def _take(v: Tensor, wide: bool, assume_unit: bool) -> Vec:
    c = vector.components(numerics.widen(v))
    if not assume_unit:
        c = vector.normalize_components(c)
    return Vec(*(x.unsqueeze(-1) for x in c)) if wide else c


def local_normal(w: Vec) -> Vec:
    """The z axis, without batch axes, in the dtype and on the device of ``w``."""
    zero = w.x.new_zeros(())
    return Vec(zero, zero, w.x.new_ones(()))


def join(channels: Iterable[Tensor], wide: bool) -> Tensor:
    """Channels of a formula -> ``[..., C]``."""
    parts = tuple(channels)
    return parts[0] if wide else vector.stack(parts)


def nearest(*distances: Tensor) -> Tensor:
    """The smallest of some distances, elementwise."""
    least = distances[0]
    for d in distances[1:]:
        least = torch.minimum(least, d)
    return least


def inverse_density(pdf: Tensor) -> Tensor:
    """1 / pdf; 0 for a direction of negligible density, which a sampler gives by rounding alone."""
    return numerics.reciprocal_or_zero(pdf, numerics.negligible(pdf.dtype))


def draw_from(model: Bsdf, wi: Vec, wo: Vec, wide: bool) -> Draw:
    """Finish a non-delta sample: weight = f cos / pdf from the model's own formula and density."""
    g = Geometry(wi, wo, local_normal(wi), None, wide)
    pdf = model.density(g)
    factor = torch.where(g.lit, wi.z * inverse_density(pdf), 0.0)
    return Draw(wi, tuple(f * factor for f in model.formula(g)), pdf, torch.zeros_like(pdf, dtype=torch.int64))


def gauss_legendre(order: int) -> tuple[Tensor, Tensor]:
    """Nodes and weights on [0, 1]."""
    import numpy as np

    x, w = np.polynomial.legendre.leggauss(order)
    return torch.from_numpy(0.5 * (x + 1.0)), torch.from_numpy(0.5 * w)
