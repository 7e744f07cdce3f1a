r"""What single scattering loses on a rough surface, and the lobe that gives it back.

Of the light that arrives at a cosine mu, facets that are mirrors send E(mu) out after one reflection; L = 1 - E meets further facets.
What these send out is taken as

.. math:: f_{ms} = F_{ms}\,\frac{L(\mu_i)\,L(\mu_o)}{\pi\,\bar L}, \qquad \bar L = 2\int_0^1 L(\mu)\,\mu\,d\mu, \qquad
   F_{ms} = \frac{\bar F^2\,\bar E}{1 - \bar F\,\bar L}, \quad \bar E = 1 - \bar L

which is reciprocal and returns F_ms L(mu), all of L where F is 1 (Kelemen & Szirmay-Kalos 2001; Kulla & Conty 2017; F_ms as Jakob et
al. 2014, each further reflection by the average Fresnel reflectance).

L is a fit, smooth in mu and alpha: with :math:`w = 3\alpha/(\mu + 3\alpha)` and :math:`x = \mu(1 + 3\alpha)/(\mu + 3\alpha)`, it is
:math:`x\,w^2 p^2` where it vanishes at grazing, :math:`w^2 p^2` for separable shadowing; p is a polynomial in x (its root for
correlated GGX) and in 2 alpha/(1 + alpha). Never below 0. ``python -m torchbrdf.bsdf.make_lost_energy`` makes it, and prints the
error against quadrature, that of the albedo of a white surface: see :data:`~torchbrdf.bsdf.lost_energy_fit.ERRORS`.

Roughness along two axes is approximate: alpha is the root of the mean square :math:`(\alpha_x^2 + \alpha_y^2)/2`, but in w and x that
along the direction, the root of :math:`\alpha_x^2x^2 + \alpha_y^2y^2 + \mu^2(\alpha_x^2 + \alpha_y^2)/2`. The albedo of a white surface
is then off by up to 0.08 at (0.4, 0.1) and (0.3, 0.6), 0.18 at (1, 0.3), 0.25 at (1, 0.1), mostly too low.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from .. import numerics
from ..geometry import Channels, Viewer, each
from ..optics.distribution import Rough
from ..optics.fresnel import Fresnel
from ..vector import Vec
from .lost_energy_fit import TEXT

REACH = 3.0  # cosines up to 3 alpha are where light is lost
DEGREE_X, DEGREE_A, DEGREE_MEAN, DEGREE_LOG = 12, 8, 14, 4


class Fit(NamedTuple):
    """The coefficients of one distribution and shadowing, of Chebyshev's polynomials of arguments in [-1, 1]."""

    rows: tuple[tuple[float, ...], ...]  # of p: [degree in x][degree in alpha]
    mean: tuple[float, ...]  # of the average over alpha^2, which is a polynomial, and
    log: tuple[float, ...]  # one more times log alpha
    root: bool  # whether p is a polynomial in the root of x
    vanishes: bool  # whether L is 0 at grazing


def shape_of(distribution: str, shadowing: str) -> tuple[bool, bool]:
    """``(root, vanishes)`` of a fit: how L goes at grazing."""
    return (distribution, shadowing) == ("ggx", "smith_correlated"), shadowing != "smith_separable"


def read(text: str) -> dict[tuple[str, str], Fit]:
    """The fits as the script writes them: a name, then numbers."""
    found, width, rows = {}, DEGREE_A + 1, DEGREE_X + 1
    for block in text.strip().split("\n\n"):
        name, *words = block.split()
        distribution, shadowing = name.split("+")
        c = tuple(map(float, words))
        split = rows * width
        p = tuple(c[k * width : (k + 1) * width] for k in range(rows))
        mean = c[split : split + DEGREE_MEAN + 1]
        found[distribution, shadowing] = Fit(p, mean, c[split + DEGREE_MEAN + 1 :], *shape_of(distribution, shadowing))
    return found


FITS = read(TEXT)


class Lost(NamedTuple):
    """The fit at the roughness of each point."""

    series: Channels  # coefficients of p by degree in x
    mean: Tensor  # the average of L over diffuse light
    rough: Rough
    square: Tensor  # alpha^2, of two axes the mean
    root: bool
    vanishes: bool

    @staticmethod
    def of(fit: Fit, rough: Rough) -> "Lost":
        """At a roughness."""
        square = rough.area if rough.isotropic else 0.5 * (rough.x * rough.x + rough.y * rough.y)
        alpha = rough.x if rough.isotropic else torch.sqrt(square)
        basis = chebyshev(centred(alpha), DEGREE_MEAN)
        mean = square * (summed(fit.mean, basis) + torch.log(alpha) * summed(fit.log, basis))
        return Lost(_series(fit.rows, basis), mean, rough, square, fit.root, fit.vanishes)

    def at(self, cos: Tensor, local: Vec | None) -> Tensor:
        """L in [0, 1] at a cosine >= 0; of a direction in the local frame where the roughness has two axes."""
        alpha = self.rough.x if local is None else numerics.safe_sqrt(self.rough.projected2(cos, local) + self.square * cos * cos)
        reach = REACH * alpha
        inverse = numerics.reciprocal_or_zero(cos + reach)  # without a direction there is none
        x = cos * (1.0 + reach) * inverse
        z = 2.0 * (numerics.safe_sqrt(x) if self.root else x) - 1.0
        p = clenshaw(self.series, z) * (reach * inverse)
        return p * p * x if self.vanishes else p * p

    def gain(self, fresnel: Fresnel, viewer: Viewer) -> Channels:
        """F_ms per channel."""
        return each(lambda f: f * f * (1.0 - self.mean) / (1.0 - f * self.mean), fresnel.average(viewer.layout))

    def density(self, cos: Tensor) -> Tensor:
        """pdf of :meth:`draw`, ``cos / (pi (alpha^2 + cos^2) log(1 + 1/alpha^2))``; 0 below the horizon."""
        c = numerics.positive(cos)
        return c / ((self.square + c * c) * (math.pi * torch.log1p(1.0 / self.square)))

    def draw(self, x: Tensor, y: Tensor) -> Vec:
        """A direction about as L cos has it, of uniform numbers."""
        phi = 2.0 * math.pi * y
        cos2 = numerics.unit_interval(self.square * torch.expm1(x * torch.log1p(1.0 / self.square)))
        sin = torch.sqrt(1.0 - cos2)
        return Vec(sin * torch.cos(phi), sin * torch.sin(phi), numerics.safe_sqrt(cos2))


def centred(alpha: Tensor) -> Tensor:
    """Roughness in [0, 1] to [-1, 1]: ``2 a - 1`` of ``a = 2 alpha / (1 + alpha)``."""
    return (3.0 * alpha - 1.0) / (1.0 + alpha)


def chebyshev(x: Tensor, degree: int) -> list[Tensor]:
    """Chebyshev's polynomials up to a degree >= 1."""
    found, twice = [torch.ones_like(x), x], 2.0 * x
    for _ in range(degree - 1):
        found.append(torch.addcmul(-found[-2], twice, found[-1]))
    return found


def summed(coefficients: Sequence[float], basis: list[Tensor]) -> Tensor:
    """The polynomial of these coefficients."""
    total = coefficients[0] * basis[0]
    for c, polynomial in zip(coefficients[1:], basis[1:], strict=False):
        total = torch.add(total, polynomial, alpha=c)
    return total


def _series(rows: Sequence[Sequence[float]], basis: list[Tensor]) -> Channels:
    """A polynomial for each row; eagerly of a few points all at once, where a hundred operations on each would be dear."""
    t = basis[0]
    if not numerics.few(t):
        return tuple(summed(row, basis) for row in rows)
    columns = torch.tensor(rows, dtype=t.dtype).to(t.device).reshape(len(rows), -1, *(1,) * t.dim()).unbind(1)
    total = columns[0] * t
    for column, polynomial in zip(columns[1:], basis[1:], strict=False):
        total = torch.addcmul(total, column, polynomial)
    return total.unbind(0)


def clenshaw(coefficients: Sequence[Tensor], x: Tensor) -> Tensor:
    """The polynomial of these coefficients, each a number of every point (Clenshaw 1955)."""
    twice = 2.0 * x
    later, last = coefficients[-1], torch.addcmul(coefficients[-2], twice, coefficients[-1])
    for c in coefficients[-3:0:-1]:
        later, last = last, torch.addcmul(c - later, twice, last)
    return torch.addcmul(coefficients[0] - later, x, last)
