"""What formulas read: how colours lie, what one viewer sees, and one pair of directions; each figure computed once, when asked for.

:class:`Layout` says how parameters stand beside directions. :class:`Viewer` is made once per shading point and holds what
depends on the viewer alone; :class:`Geometry` is made once per light or sample and holds the rest.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from . import numerics, parameters, vector
from .vector import Vec, add, cross, dot, scale, subtract

Channels = tuple[Tensor, ...]


def each(formula: Callable[..., Tensor], *colours: Sequence[Tensor]) -> Channels:
    """Map a formula over channels; a colour with a single channel serves them all."""
    count = max([len(c) for c in colours])
    if any(len(c) not in (1, count) for c in colours):
        raise ValueError(f"colours have different numbers of channels: {[len(c) for c in colours]}; use one C, or 1")
    return tuple(formula(*(c[k] if len(c) > 1 else c[0] for c in colours)) for k in range(count))


def memo(compute: Callable[[Any], Any]) -> property:
    """A property computed once per object. (``functools.cached_property`` takes a lock, which breaks full graphs on 3.11.)"""
    name = compute.__name__

    def get(self: Any) -> Any:
        if name not in self._memo:
            self._memo[name] = compute(self)
        return self._memo[name]

    return property(get, doc=compute.__doc__)


class Layout(NamedTuple):
    """How colours lie beside numbers ``[...]`` of one dtype and device.

    ``wide=False`` takes a colour apart into single channels ``[...]`` (fastest for a few); ``wide=True`` keeps it as one
    ``[..., C]`` tensor, beside which numbers carry a trailing 1.
    """

    wide: bool
    dtype: torch.dtype
    device: torch.device

    @staticmethod
    def beside(points: Tensor, wide: bool = False) -> "Layout":
        """The layout of formulas at ``points``, in their working dtype."""
        return Layout(wide, numerics.working_dtype(points.dtype), points.device)

    def colour(self, parameter: Tensor) -> Channels:
        """A parameter ``[..., C]`` as the channels that a formula maps over."""
        p = self.follow(parameter, apart=not self.wide)
        # Not unbind(-1), whose derivative is interleaved memory.
        return (p,) if self.wide else p.movedim(-1, 0).unbind(0) if p.dim() > 1 else p.unbind(0)

    def rows(self, parameter: Tensor, event: int) -> tuple[Tensor, ...]:
        """A parameter whose last ``event`` axes are one parameter, ``[..., K, *rest]``, as K parameters ``[..., *rest]``."""
        return parameter.movedim(-event, 0).unbind(0)

    def scalar(self, parameter: Tensor) -> Tensor:
        """A parameter ``[..., 1]`` as a number."""
        p = self.follow(parameter, apart=not self.wide)
        return p if self.wide else p.squeeze(-1)

    def average(self, parameter: Tensor) -> Tensor:
        """The mean of a colour ``[..., C]`` as a number."""
        p = self.follow(parameter, apart=not self.wide).mean(-1, keepdim=True)
        return p if self.wide else p.squeeze(-1)

    def mean(self, channels: Channels) -> Tensor:
        """The mean of channels as a number."""
        return channels[0].mean(-1, keepdim=True) if self.wide else sum(channels[1:], channels[0]) / len(channels)

    def vector(self, v: Tensor) -> Vec:
        """``[..., 3]`` as three numbers."""
        return Vec(*map(self.lift, vector.components(self.follow(v))))

    def lift(self, x: Tensor) -> Tensor:
        """A tensor ``[...]`` as a number."""
        return x.unsqueeze(-1) if self.wide else x

    def join(self, channels: Iterable[Tensor]) -> Tensor:
        """Channels of a formula -> ``[..., C]``, planar unless wide."""
        parts = tuple(channels)
        return parts[0] if self.wide else vector.stack(parts)

    def join_vector(self, v: Vec) -> Tensor:
        """Three numbers -> ``[..., 3]``, planar."""
        return vector.stack([c.squeeze(-1) for c in v] if self.wide else v)

    def join_number(self, x: Tensor) -> Tensor:
        """A number -> ``[..., 1]``."""
        return x if self.wide else x.unsqueeze(-1)

    def follow(self, parameter: Tensor, axes: int = 1, apart: bool = False) -> Tensor:
        """A parameter by the rule of :mod:`~torchbrdf.parameters`."""
        return parameters.follow(parameter, self.dtype, self.device, axes, apart)


class Viewer:
    """One viewer of each shading point: unit ``wo``, unit normal ``n`` (None: the local frame, z = normal) and, if given, a tangent.

    ``tangent`` is made unit and orthogonal to the normal when first needed; zero, parallel and non-finite ones count as none.
    """

    def __init__(
        self, wo: Vec, n: Vec | None = None, tangent: Vec | None = None, handedness: Tensor | None = None, layout: Layout | None = None
    ) -> None:
        self.layout = layout if layout is not None else Layout.beside(wo.z)
        self.wo, self.is_local, self.tangent, self.handedness = wo, n is None, tangent, handedness
        self.n = local_normal(wo) if n is None else n
        self._memo: dict[str, Any] = {}
        self._held: list[tuple[Any, str, Any]] = []

    def colour(self, parameter: Tensor) -> Channels:
        """A parameter ``[..., C]`` as channels."""
        return self.layout.colour(parameter)

    def scalar(self, parameter: Tensor) -> Tensor:
        """A parameter ``[..., 1]`` as a number."""
        return self.layout.scalar(parameter)

    def once(self, owner: Any, compute: Callable[[], Any], name: str = "") -> Any:
        """What ``owner``, a model, computes for this viewer: computed when first asked for and never twice. Several by ``name``."""
        for holder, called, found in self._held:
            if holder is owner and called == name:
                return found
        found = compute()
        self._held.append((owner, name, found))
        return found

    @memo
    def cos_o(self) -> Tensor:
        """n.wo"""
        return self.wo.z if self.is_local else dot(self.n, self.wo)

    @memo
    def axes(self) -> tuple[Vec, Vec, Vec] | None:
        """Tangent, bitangent and normal; None in the local frame, whose axes are those of the coordinates."""
        return None if self.is_local else vector.frame_components(self.n, self.tangent, self.handedness)

    def to_local(self, w: Vec) -> Vec:
        """A direction in the local frame."""
        return w if self.axes is None else Vec(*(dot(a, w) for a in self.axes))

    def to_world(self, w: Vec) -> Vec:
        """A direction of the local frame in the space of ``n``."""
        return w if self.axes is None else vector.combine(self.axes, w)

    @memo
    def local(self) -> "Viewer":
        """The same viewer in the local frame."""
        return self if self.is_local else Viewer(self.to_local(self.wo), layout=self.layout)

    @memo
    def mirror(self) -> Vec:
        """The mirror direction 2 (n.wo) n - wo."""
        return Vec(-self.wo.x, -self.wo.y, self.wo.z) if self.is_local else vector.reflect_components(self.wo, self.n)

    @memo
    def mirror_axes(self) -> tuple[Vec, Vec, Vec]:
        """Axes about the mirror direction, for lobes that are sampled about it."""
        return vector.frame_components(self.mirror)

    @memo
    def side(self) -> Tensor:
        """1 where the viewer is on the side of the normal, -1 on the other."""
        return torch.copysign(torch.ones_like(self.cos_o), self.cos_o.detach())

    @memo
    def facing(self) -> "Viewer":
        """The same viewer of the surface turned to it; in the local frame, both mirrored at the surface. Tangent and bitangent stay."""
        if self.is_local:
            return Viewer(Vec(self.wo.x, self.wo.y, self.wo.z * self.side), layout=self.layout)
        handedness = self.side if self.handedness is None else self.handedness * self.side
        return Viewer(self.wo, scale(self.n, self.side), self.tangent, handedness, self.layout)


class Geometry:
    """Unit ``wi`` (to the light) beside a :class:`Viewer`: the figures that formulas of both directions share, each ``[...]``.

    ``cos_i`` is given where it is known better than by n.wi.
    """

    def __init__(self, viewer: Viewer, wi: Vec, cos_i: Tensor | None = None) -> None:
        self.viewer, self.wi = viewer, wi
        self._memo: dict[str, Any] = {} if cos_i is None else {"cos_i": cos_i}

    @property
    def wo(self) -> Vec:
        """The direction to the viewer."""
        return self.viewer.wo

    @property
    def n(self) -> Vec:
        """The normal."""
        return self.viewer.n

    @property
    def cos_o(self) -> Tensor:
        """n.wo"""
        return self.viewer.cos_o

    def colour(self, parameter: Tensor) -> Channels:
        """A parameter ``[..., C]`` as channels."""
        return self.viewer.layout.colour(parameter)

    def scalar(self, parameter: Tensor) -> Tensor:
        """A parameter ``[..., 1]`` as a number."""
        return self.viewer.layout.scalar(parameter)

    @memo
    def cos_i(self) -> Tensor:
        """n.wi"""
        return self.wi.z if self.viewer.is_local else dot(self.n, self.wi)

    @memo
    def above(self) -> Tensor:
        """Both directions strictly above the horizon (bool)."""
        return (self.cos_i > 0) & (self.cos_o > 0)

    @memo
    def same_side(self) -> Tensor:
        """Both directions strictly on one side of the surface, either one: reflection (bool)."""
        return self.cos_i * self.viewer.side * (self.cos_o != 0) > 0

    @memo
    def across(self) -> Tensor:
        """The directions strictly on different sides of the surface: transmission (bool)."""
        return self.cos_i * self.viewer.side * (self.cos_o != 0) < 0

    @memo
    def wi_local(self) -> Vec:
        """``wi`` in the local frame."""
        return self.viewer.to_local(self.wi)

    @memo
    def swapped(self) -> "Geometry":
        """The same pair with the roles of light and viewer exchanged."""
        v = self.viewer
        other = Viewer(self.wi, None if v.is_local else v.n, v.tangent, v.handedness, v.layout)
        other._memo["axes"] = v.axes
        return Geometry(other, v.wo)

    @memo
    def facing(self) -> "Geometry":
        """The same pair seen from the surface turned to the viewer (see :attr:`Viewer.facing`)."""
        wi = Vec(self.wi.x, self.wi.y, self.wi.z * self.viewer.side) if self.viewer.is_local else self.wi
        return Geometry(self.viewer.facing, wi)

    @memo
    def half(self) -> Vec:
        """wi + wo, not normalised."""
        return add(self.wi, self.wo)

    @memo
    def half2(self) -> Tensor:
        """|wi + wo|^2, 0 where the two are opposite and there is no half vector."""
        return dot(self.half, self.half)

    @memo
    def wi_h(self) -> Tensor:
        """wi.h = wo.h = |wi + wo| / 2, in [0, 1]; 0 with gradient 0 where there is no half vector, or only rounding is left of it."""
        return 0.5 * numerics.safe_sqrt(self.half2, numerics.negligible(self.half2.dtype))

    @memo
    def inverse_half(self) -> Tensor:
        """1 / |wi + wo|, 0 where there is no half vector."""
        return numerics.reciprocal_or_zero(2.0 * self.wi_h)

    @memo
    def cos_h(self) -> Tensor:
        """n.h, 0 where there is no half vector."""
        return dot(self.n, self.half) * self.inverse_half

    @memo
    def sin2_h(self) -> Tensor:
        """|n x h|^2 by the cross product: no cancellation near the mirror direction."""
        c = scale(cross(self.n, self.half), self.inverse_half)
        return dot(c, c)

    @memo
    def mirror_complement(self) -> Tensor:
        """1 - wi.R(wo) as half the squared distance |R(wo) - wi|^2 / 2, accurate near the mirror direction."""
        d = subtract(scale(self.n, 2.0 * self.cos_o), self.half)
        return 0.5 * dot(d, d)

    def half_across(self, eta: Tensor) -> Vec:
        """wi + eta wo for ``eta`` = n(side of wo) / n(side of wi): the half vector of refraction, any length (Walter et al. 2007)."""
        return add(self.wi, scale(self.wo, eta))


def local_normal(w: Vec) -> Vec:
    """The z axis, without batch axes, in the dtype and on the device of ``w``."""
    zero = w.x.new_zeros(())
    return Vec(zero, zero, w.x.new_ones(()))
