"""Directions as three components, and the one door between frames.

A direction is ``[..., 3]`` at the border and a tuple of three ``[...]`` tensors inside a formula. Memory is *planar*: the
strides of ``[..., 3]`` are those of ``[3, ...]``, so that each component is one contiguous run and a compiler can fuse the
whole formula. Take apart with :func:`components` (``unbind``), put together with :func:`stack`; never index ``x[..., i]``,
whose backward scatters into zeros and doubles the time.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from . import arguments, numerics


class Vec(NamedTuple):
    """Three components ``[...]`` of directions, positions or normals."""

    x: Tensor
    y: Tensor
    z: Tensor


def components(v: Tensor) -> Vec:
    """``[..., 3]`` -> three ``[...]``."""
    return Vec(*v.unbind(-1))


def stack(parts: Sequence[Tensor]) -> Tensor:
    """k tensors ``[...]`` -> planar ``[..., k]`` (shape ``[..., k]``, strides of ``[k, ...]``)."""
    return torch.stack(torch.broadcast_tensors(*parts), 0).movedim(0, -1)


def planar(v: Tensor) -> Tensor:
    """The same ``[..., k]`` values in planar memory (no copy where they already are)."""
    return v.movedim(-1, 0).contiguous().movedim(0, -1)


def is_planar(v: Tensor) -> bool:
    """Whether each component of ``v [..., k]`` is one contiguous run of memory."""
    return v.movedim(-1, 0).is_contiguous()


def dot(a: Vec, b: Vec) -> Tensor:
    """Inner product ``[...]``."""
    return torch.addcmul(torch.addcmul(a.x * b.x, a.y, b.y), a.z, b.z)


def cross(a: Vec, b: Vec) -> Vec:
    """Vector product."""
    return Vec(
        torch.addcmul(a.y * b.z, a.z, b.y, value=-1),
        torch.addcmul(a.z * b.x, a.x, b.z, value=-1),
        torch.addcmul(a.x * b.y, a.y, b.x, value=-1),
    )


def add(a: Vec, b: Vec) -> Vec:
    """a + b."""
    return Vec(a.x + b.x, a.y + b.y, a.z + b.z)


def subtract(a: Vec, b: Vec) -> Vec:
    """a - b."""
    return Vec(a.x - b.x, a.y - b.y, a.z - b.z)


def scale(a: Vec, s: Tensor | float) -> Vec:
    """s a."""
    return Vec(a.x * s, a.y * s, a.z * s)


def direction_and_inverse_length(v: Vec) -> tuple[Vec, Tensor]:
    """Unit vector and 1 / length of *finite* vectors, without overflow or underflow: they are scaled by their largest component.

    A zero vector gives direction 0 and inverse length 0, both with gradient 0; so does one so short that 1 / length, which is
    also the slope of the direction, is not a number of the dtype.
    """
    if not torch.compiler.is_compiling():
        return _direction_and_inverse_length(torch.stack(torch.broadcast_tensors(*v)))
    x, y, z = (c.detach().abs() for c in v)
    shrink = _shrink(torch.maximum(torch.maximum(x, y), z))
    u = scale(v, shrink)
    inverse = _inverse_length(u)
    return scale(u, inverse), inverse * shrink


def _direction_and_inverse_length(p: Tensor) -> tuple[Vec, Tensor]:
    """Of components ``[3, ...]``: eagerly with fewer operations."""
    shrink = _shrink(p.detach().abs().amax(0))
    u = p * shrink
    inverse = torch.rsqrt((u * u).sum(0).clamp_min(0.5))
    return Vec(*(u * inverse).unbind(0)), inverse * shrink


def _shrink(largest: Tensor) -> Tensor:
    """1 / the largest component, a constant; 0 for vectors that count as none. Its rounding does not matter: it leaves with the length."""
    return torch.reciprocal(torch.threshold(largest, 2.0 / torch.finfo(largest.dtype).max, math.inf))


def _inverse_length(u: Vec) -> Tensor:
    """Of vectors whose largest component is 1, or 0 for those that count as none: the bound of 1/2 is met by these alone."""
    return torch.rsqrt(dot(u, u).clamp_min(0.5))


def direction_and_length(v: Vec) -> tuple[Vec, Tensor]:
    """Unit vector and length of finite vectors; 0 and 0, with gradient 0, for the zero vector."""
    direction, _ = direction_and_inverse_length(v)
    return direction, dot(direction, v)


def normalize_components(v: Vec) -> Vec:
    """Unit vector; zero and non-finite vectors give 0 with gradient 0."""
    x, y, z = (c.detach().abs() for c in v)
    return _unit(Vec(*map(numerics.finite_or_zero, v)), torch.maximum(torch.maximum(x, y), z))


def unit_components(v: Tensor) -> Vec:
    """``[..., 3]`` to unit length and apart, as :func:`normalize_components`; eagerly with fewer operations."""
    if torch.compiler.is_compiling():  # components fuse into one loop, a reduction over an axis of 3 does not
        return normalize_components(components(v))
    return Vec(*_unit_planes(v.movedim(-1, 0), 0).unbind(0))


def unit_pair(a: Tensor, b: Tensor) -> tuple[Vec, Vec]:
    """:func:`unit_components` of two at once: eagerly with fewer operations, where they are few and of one shape."""
    both = _unit_planes(torch.stack([a.movedim(-1, 0), b.movedim(-1, 0)]), 1).flatten(0, 1).unbind(0)
    return Vec(*both[:3]), Vec(*both[3:])


def _unit_planes(p: Tensor, axis: int) -> Tensor:
    """Along the axis of components, as :func:`normalize_components`; eagerly."""
    largest = torch.nan_to_num(p.detach().abs().amax(axis, keepdim=True), math.inf, math.inf)
    u = numerics.finite_or_zero(p) * _shrink(largest)
    return u * torch.rsqrt((u * u).sum(axis, keepdim=True).clamp_min(0.5))


def finite_components(v: Tensor) -> Vec:
    """``[..., 3]`` apart, with 0, and gradient 0, for what is not finite; eagerly in one operation."""
    if torch.compiler.is_compiling():
        return Vec(*map(numerics.finite_or_zero, components(v)))
    return components(numerics.finite_or_zero(v))


def _unit(v: Vec, largest: Tensor) -> Vec:
    """Of vectors whose components are finite, or were not and now are; of those ``largest`` is infinite or NaN."""
    u = scale(v, _shrink(torch.where(largest < math.inf, largest, math.inf)))
    return scale(u, _inverse_length(u))


def normalize(v: Tensor) -> Tensor:
    """``[..., 3]`` to unit length; zero and non-finite vectors become 0 with gradient 0."""
    return _stacked(unit_components(numerics.widen(arguments.floats(v, "v", 3))), v)


def _widened(v: Tensor, name: str) -> Vec:
    return components(numerics.widen(arguments.floats(v, name, 3)))


def _stacked(parts: Sequence[Tensor], like: Tensor) -> Tensor:
    return numerics.rounded_back(stack(parts), like.dtype)


def reflect_components(w: Vec, n: Vec) -> Vec:
    """``2 (n.w) n - w``."""
    twice = 2.0 * dot(n, w)
    return Vec(twice * n.x - w.x, twice * n.y - w.y, twice * n.z - w.z)


def reflect(w: Tensor, n: Tensor) -> Tensor:
    """Mirror direction ``2 (n.w) n - w`` of ``w [..., 3]`` (pointing away from the surface) about the unit normal ``n [..., 3]``."""
    return _stacked(reflect_components(_widened(w, "w"), _widened(n, "n")), w)


def refract(w: Tensor, n: Tensor, eta: Tensor | float) -> tuple[Tensor, Tensor]:
    """Direction of ``w [..., 3]`` after refraction, by Snell's law, and whether there is one.

    ``w`` and ``n`` are unit and point away from the surface, on either side of it; ``eta [..., 1]`` is
    n(far side of w) / n(side of w), > 0. Returns ``wt [..., 3]``, on the far side, and ``valid [..., 1]`` (bool). Under total
    internal reflection ``wt`` is 0 with gradient 0. Source: Heckbert 1989 in the ``g`` form of Cook & Torrance 1982,
    which stays accurate at the critical angle. Not smooth at that angle (true slope -inf just outside, 0 inside).
    """
    wc, nc = _widened(w, "w"), _widened(n, "n")
    ratio = torch.as_tensor(eta, dtype=wc.x.dtype, device=w.device)
    ratio = ratio.squeeze(-1) if ratio.dim() else ratio
    # To the last digit and its sign: near the critical angle, and in the plane of the surface, rounding would choose the result.
    cos, cos_low = numerics.sum_of_products(*zip(wc, nc, strict=True))
    cos_i = numerics.with_slope_of(cos, dot(wc, nc))
    g2 = numerics.eta2_minus_sin2(cos_i, ratio, cos_low=cos_low)
    valid = g2 > 0
    along_normal = cos_i - torch.where(cos_i < 0, -1.0, 1.0) * numerics.safe_sqrt(g2)
    bent = (torch.where(valid, (along_normal * nk - wk) / ratio, 0.0) for wk, nk in zip(wc, nc, strict=True))
    return _stacked(tuple(bent), w), valid.unsqueeze(-1)


class Frame(NamedTuple):
    """Orthonormal axes ``[..., 3]`` of a shading point: ``normal`` is local z, ``tangent`` is local x."""

    tangent: Tensor
    bitangent: Tensor
    normal: Tensor

    @staticmethod
    def from_normal(n: Tensor, tangent: Tensor | None = None) -> "Frame":
        """Frame about the unit normal ``n [..., 3]``, turned so that x lies along ``tangent [..., 3]`` where one is given.

        Without a tangent: Duff et al. 2017 (eq. 4, with copysign), accurate to 1.3 eps for every n; its x axis jumps where
        n.z changes sign. A tangent that is zero or parallel to n falls back to it.
        """
        axes = frame_components(_widened(n, "n"), None if tangent is None else _widened(tangent, "tangent"))
        return Frame(*(_stacked(a, n) for a in axes))

    def to_local(self, w: Tensor) -> Tensor:
        """World ``w [..., 3]`` -> local."""
        wc = _widened(w, "w")
        return _stacked([dot(_widened(a, "axis"), wc) for a in self], w)

    def to_world(self, w: Tensor) -> Tensor:
        """Local ``w [..., 3]`` -> world."""
        return _stacked(combine(tuple(_widened(a, "axis") for a in self), _widened(w, "w")), w)


def combine(axes: Sequence[Vec], w: Vec) -> Vec:
    """``w.x axes[0] + w.y axes[1] + w.z axes[2]``."""
    return add(add(scale(axes[0], w.x), scale(axes[1], w.y)), scale(axes[2], w.z))


def frame_components(n: Vec, tangent: Vec | None = None, handedness: Tensor | None = None) -> tuple[Vec, Vec, Vec]:
    """Axes (x, y, z = n) of :class:`Frame`; y = ``handedness`` (n x x), right-handed without it."""
    sign = torch.copysign(torch.ones_like(n.z), n.z)
    a = -1.0 / (sign + n.z)
    b = n.x * n.y * a
    x = Vec(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x)
    if tangent is not None:
        x = _along(tangent, n, x)
    y = cross(n, x)
    return x, y if handedness is None else scale(y, torch.where(handedness < 0, -1.0, 1.0)), n


def _along(tangent: Vec, n: Vec, otherwise: Vec) -> Vec:
    """The tangent made orthogonal to n; ``otherwise`` where nothing but rounding is left of it."""
    left = _reject(normalize_components(tangent), n)
    given = dot(left, left) > (8.0 * torch.finfo(n.z.dtype).eps) ** 2
    # Once more, because the first subtraction cancels for a tangent close to n ("twice is enough": Giraud et al. 2005).
    exact = normalize_components(_reject(normalize_components(left), n))
    return Vec(*(torch.where(given, t, d) for t, d in zip(exact, otherwise, strict=True)))


def _reject(v: Vec, n: Vec) -> Vec:
    return subtract(v, scale(n, dot(v, n)))
