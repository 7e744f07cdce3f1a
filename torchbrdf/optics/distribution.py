"""Distributions of microfacet normals: what each answers, in formulas on numbers and as verbs on directions.

A distribution is three formulas. Of a half vector h of any length, in a frame whose z is the normal, with the *stretched* square
x^2/alpha_x^2 + y^2/alpha_y^2: the density D per steradian. Of a direction: its **Smith length** c (1 + 2 Lambda), which is
sqrt(c^2 + a^2) for GGX (a the projected roughness): with R_i, R_o those of both directions,

=======================  ==============================  ===============================
G1 / (2 c)               1 / (c + R)                     no quotient by a cosine is left
G2 / (4 c_i c_o)         1 / (2 (c_o R_i + c_i R_o))     height-correlated
G1 G1 / (4 c_i c_o)      1 / ((c_i + R_i)(c_o + R_o))    separable
=======================  ==============================  ===============================

And a normal drawn in proportion to what a viewer sees of it, G1(w) max(0, w.h) D(h) / c (Heitz 2018).
"""

import math
from abc import abstractmethod
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor

from .. import arguments, numerics, parameters, vector
from ..geometry import Layout
from ..interval import Interval
from ..value import Value
from ..vector import Vec

ALPHA = Interval(0.0, 1.0, open_low=True, typical=(0.1, 1.0), hard=(1e-4,))
AXES = ("A",)  # shape of a roughness: one number, or one along the tangent and one along the bitangent


class Rough(NamedTuple):
    """Roughness along tangent and bitangent, as numbers beside points."""

    x: Tensor
    y: Tensor
    isotropic: bool

    @staticmethod
    def of(alpha: Tensor, layout: Layout) -> "Rough":
        """Of a parameter ``[..., 1]`` or ``[..., 2]``."""
        if alpha.shape[-1] == 1:
            one = layout.scalar(alpha)
            return Rough(one, one, True)
        x, y = layout.rows(layout.follow(alpha), 1)
        return Rough(layout.lift(x), layout.lift(y), False)

    @property
    def area(self) -> Tensor:
        """alpha_x alpha_y"""
        return self.x * self.y

    def projected2(self, cos: Tensor, local: Vec | None) -> Tensor:
        """Square of the projected roughness of a unit direction: of its cosine where isotropic, else of its components."""
        if self.isotropic or local is None:
            return self.x * self.x * ((1.0 - cos) * (1.0 + cos))
        return (self.x * local.x) ** 2 + (self.y * local.y) ** 2


class Facet(NamedTuple):
    """A half vector of any length in the frame of a surface."""

    z: Tensor  # n.h
    flat2: Tensor  # |n x h|^2, not by cancellation
    stretched2: Tensor  # x^2/alpha_x^2 + y^2/alpha_y^2
    length2: Tensor  # |h|^2

    @staticmethod
    def local(h: Vec, rough: Rough, length2: Tensor | None = None) -> "Facet":
        """From components along tangent, bitangent and normal."""
        x2, y2 = h.x * h.x, h.y * h.y
        flat2 = x2 + y2
        stretched2 = x2 / (rough.x * rough.x) + y2 / (rough.y * rough.y)
        return Facet(h.z, flat2, stretched2, flat2 + h.z * h.z if length2 is None else length2)


class Distribution(Value):
    """Interface of the distributions of normals. ``alpha [..., 1]`` or ``[..., 2]``, a slope; directions are in the local frame."""

    alpha: Tensor
    textbook: ClassVar[tuple[Any, Any]]  # (D, Lambda) as their sources print them: torchbrdf/testing/textbook.py

    @staticmethod
    @abstractmethod
    def density(facet: Facet, rough: Rough) -> Tensor:
        """D ``[...]`` in 1/sr for n.h > 0; finite elsewhere."""

    @staticmethod
    @abstractmethod
    def smith_length(cos: Tensor, projected2: Tensor) -> Tensor:
        """c (1 + 2 Lambda) ``[...]`` for c >= 0; the square of the projected roughness may be below 0 by rounding."""

    @staticmethod
    @abstractmethod
    def visible_normal(w: Vec, rough: Rough, u: Vec) -> Vec:
        """A unit normal by the density ``D(h) max(0, w.h) G1(w) / w.z`` of :meth:`drawn_as`, of uniform u.x, u.y, for a unit w."""

    @classmethod
    def drawn_as(cls) -> "type[Distribution]":
        """The distribution whose visible normals are drawn: this one, unless its own have no sampler."""
        return cls

    def check_shapes(self) -> None:
        """As every value; and one or two numbers of roughness."""
        super().check_shapes()
        need_axes(self.alpha, f"{type(self).__name__}.alpha")

    # The verbs ---------------------------------------------------------------------------------------------------------

    def d(self, h: Tensor) -> Tensor:
        """D ``[..., 1]`` in 1/sr of normals ``h [..., 3]`` of any length; 0 where z <= 0."""
        v, layout, rough = self._taken_apart(h, "h")
        return self._number(self.density(Facet.local(v, rough), rough) * numerics.step(v.z), layout, h)

    def smith_lambda(self, w: Tensor) -> Tensor:
        """Smith's Lambda ``[..., 1]`` >= 0 of unit ``w [..., 3]``; inf at and below the horizon."""
        v, layout, rough = self._taken_apart(w, "w")
        c = torch.where(v.z > 0, v.z, 1.0)
        lam = 0.5 * (self.smith_length(c, rough.projected2(c, v)) / c - 1.0)
        return self._number(torch.where(v.z > 0, lam, math.inf), layout, w)

    def g1(self, w: Tensor) -> Tensor:
        """Masking ``[..., 1]`` of unit ``w [..., 3]``: ``1 / (1 + Lambda)``; 0 at and below the horizon."""
        v, layout, rough = self._taken_apart(w, "w")
        return self._number(self._g1(v, rough), layout, w)

    def g2(self, wi: Tensor, wo: Tensor) -> Tensor:
        """Height-correlated masking and shadowing ``[..., 1]``, ``1 / (1 + Lambda_i + Lambda_o)``; 0 unless both are above the horizon."""
        i, layout, rough = self._taken_apart(wi, "wi")
        o, _, _ = self._taken_apart(wo, "wo")
        above = numerics.step(i.z) * numerics.step(o.z)
        ci, co = (c * above + (1.0 - above) for c in (i.z, o.z))
        ri, ro = self.smith_length(ci, rough.projected2(ci, i)), self.smith_length(co, rough.projected2(co, o))
        return self._number(2.0 * ci * co / (co * ri + ci * ro) * above, layout, wi)

    def sample(self, w: Tensor, u: Tensor) -> Tensor:
        """Unit normals ``[..., 3]`` of those that unit ``w [..., 3]`` sees, from uniform ``u [..., 2]`` in [0, 1)."""
        v, _, rough = self._taken_apart(w, "w")
        x, y = arguments.floats(u, "u", 2).to(v.z.dtype).unbind(-1)
        return vector.stack(self.visible_normal(v, rough, Vec(x, y, y))).to(w.dtype)

    def pdf(self, w: Tensor, h: Tensor) -> Tensor:
        """Density ``[..., 1]`` per steradian of h with which :meth:`sample` gives unit ``h``: ``G1(w) max(0, w.h) D(h) / w.z``.

        Blinn's are drawn as those of GGX.
        """
        v, layout, rough = self._taken_apart(w, "w")
        n, _, _ = self._taken_apart(h, "h")
        c = torch.where(v.z > 0, v.z, 1.0)
        by = self.drawn_as()
        seen = 2.0 * torch.relu(vector.dot(v, n)) / (c + by.smith_length(c, rough.projected2(c, v)))
        return self._number(by.density(Facet.local(n, rough), rough) * seen * numerics.step(v.z) * numerics.step(n.z), layout, w)

    def _g1(self, v: Vec, rough: Rough) -> Tensor:
        above = numerics.step(v.z)
        c = v.z * above + (1.0 - above)
        return 2.0 * c / (c + self.smith_length(c, rough.projected2(c, v))) * above

    def _taken_apart(self, w: Tensor, name: str) -> tuple[Vec, Layout, Rough]:
        parameters.check(self, arguments.floats(w, name, 3), name)
        layout = Layout.beside(w)
        return layout.vector(w), layout, Rough.of(self.alpha, layout)

    def _number(self, x: Tensor, layout: Layout, like: Tensor) -> Tensor:
        return layout.join_number(x).to(like.dtype)


def need_axes(alpha: Tensor, where: str) -> None:
    """Raise ``ValueError`` unless a roughness is one number or two."""
    if alpha.shape[-1] not in (1, 2):
        raise ValueError(
            f"{where}: expected shape [..., 1], or [..., 2] along tangent and bitangent, found {list(alpha.shape)}; "
            "one number for each point is alpha.unsqueeze(-1)"
        )


def local_direction(stretched: Vec, rough: Rough) -> Vec:
    """A normal of the surface of roughness 1 as one of this surface."""
    return vector.normalize_components(Vec(stretched.x * rough.x, stretched.y * rough.y, stretched.z))


def alpha_from_roughness(roughness: Tensor) -> Tensor:
    """``roughness ** 2``: perceptual roughness (Burley 2012), as of glTF and OpenPBR, to the slope alpha."""
    return roughness * roughness


def roughness_from_alpha(alpha: Tensor) -> Tensor:
    """The other way."""
    return torch.sqrt(alpha)


def alpha_from_exponent(exponent: Tensor) -> Tensor:
    """``sqrt(2 / (s + 2))``: the slope of the Blinn-Phong distribution of exponent s (Walter et al. 2007)."""
    return torch.sqrt(2.0 / (exponent + 2.0))


def exponent_from_alpha(alpha: Tensor) -> Tensor:
    """``2 / alpha^2 - 2``: the other way; below 0 beyond alpha = 1."""
    return 2.0 * (1.0 - alpha) * (1.0 + alpha) / (alpha * alpha)
