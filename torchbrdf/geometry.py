"""What formulas read: how colours lie, what one viewer sees, and one pair of directions; each figure computed once, when asked for.

:class:`Layout` says how parameters stand beside directions. :class:`Viewer` is made once per shading point and holds what
depends on the viewer alone; :class:`Geometry` is made once per light or sample and holds the rest.
"""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from . import numerics, vector
from .layout import Channels, Layout, each
from .vector import Vec, add, cross, dot, scale

__all__ = ["Channels", "Geometry", "Layout", "Viewer", "each", "memo"]


def memo(compute: Callable[[Any], Any]) -> property:
    """A property computed once per object. (``functools.cached_property`` takes a lock, which breaks full graphs on 3.11.)"""
    name = compute.__name__

    def get(self: Any) -> Any:
        if name not in self._memo:
            self._memo[name] = compute(self)
        return self._memo[name]

    return property(get, doc=compute.__doc__)


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
        return torch.minimum(self.cos_i, self.cos_o) > 0

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
        n, cos_o = self.n, self.cos_o
        d = Vec(*(torch.addcmul(h, x, cos_o, value=-2) for h, x in zip(self.half, n, strict=True)))
        return 0.5 * dot(d, d)

    def half_across(self, eta: Tensor) -> Vec:
        """wi + eta wo for ``eta`` = n(side of wo) / n(side of wi): the half vector of refraction, any length (Walter et al. 2007)."""
        return add(self.wi, scale(self.wo, eta))


def local_normal(w: Vec) -> Vec:
    """The z axis, without batch axes, in the dtype and on the device of ``w``."""
    zero = w.x.new_zeros(())
    return Vec(zero, zero, w.x.new_ones(()))
