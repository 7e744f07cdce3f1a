r"""What a rough dielectric boundary reflects of light from outside: its directional albedo E, one reflection at facets.

.. math:: E(\mu) = (1 - L(\mu, \alpha))\; F(c(\mu, \alpha, \eta), \eta)

L is what a white surface of the same facets loses (:mod:`~torchbrdf.bsdf.lost_energy`), F the exact Fresnel reflectance, and c the
cosine at which F is its mean over the facets that reflect; for a smooth surface c is mu and E is F. c is a fit,

.. math:: c = \mu + \frac{3\alpha}{\mu + 3\alpha}\,\frac{\alpha}{\alpha + 0.3}\;p, \qquad x = \mu\,\frac{1 + 3\alpha}{\mu + 3\alpha}

of a polynomial p in x, in 1.1 alpha/(alpha + 0.1) and in 2.4 (eta - 1)/(eta - 0.6) / 2, for eta in [1.125, 3]: below, where F falls from 1
within a cosine of sqrt(eta^2 - 1), a polynomial of this degree does not follow it. ``python -m torchbrdf.bsdf.make_boundary_albedo``
makes it; its errors are :data:`~torchbrdf.bsdf.boundary_albedo_fit.ERRORS`. For one roughness, not for two axes: across the smaller one
E at grazing is beyond what any single alpha has.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from .. import numerics
from ..geometry import Channels
from ..interval import Interval
from ..optics.dielectric import Split, split
from ..optics.distribution import Rough
from ..optics.fresnel import Dielectric
from ..quadrature import gauss_legendre
from .boundary_albedo_fit import TEXT
from .lost_energy import DEGREE_A as DEGREE_A_LOST
from .lost_energy import FITS, REACH, Lost, chebyshev, clenshaw, summed

DEGREE_X, DEGREE_A, DEGREE_N, DEGREE_INSIDE = 7, 6, 5, 10
COAT = Interval(1.125, 3.0, typical=(1.2, 2.5))
NODES, WEIGHTS = gauss_legendre(12)
Rows = tuple[tuple[tuple[float, ...], ...], ...]


def read(text: str) -> dict[tuple[str, str], Rows]:
    """The coefficients as the script writes them, by distribution and shadowing: [degree in x][in alpha][in eta]."""
    found, n = {}, DEGREE_N + 1
    for block in filter(None, text.strip().split("\n\n")):
        name, *words = block.split()
        distribution, shadowing = name.split("+")
        c = tuple(map(float, words))
        a = (DEGREE_INSIDE if shadowing == "inside" else DEGREE_A) + 1
        lines = [c[k : k + n] for k in range(0, len(c), n)]
        found[distribution, shadowing] = tuple(tuple(lines[k : k + a]) for k in range(0, len(lines), a))
    return found


BOUNDARY_FITS = read(TEXT)


def inside_reflectance(distribution: str, alpha: Tensor, eta: Tensor) -> Tensor:
    """Mitsuba's ``internal_reflectance``: about the share of diffuse light from inside that one reflection at facets throws back."""
    by_alpha, by_eta = chebyshev(roughness_argument(alpha), DEGREE_INSIDE), chebyshev(index_argument(eta), DEGREE_N)
    return _both(BOUNDARY_FITS[distribution, "inside"][0], by_alpha, by_eta)


def roughness_argument(alpha: Tensor) -> Tensor:
    """alpha in [0, 1] to [-1, 1], denser at 0."""
    return 2.2 * alpha / (alpha + 0.1) - 1.0


def index_argument(eta: Tensor) -> Tensor:
    """eta in [1, 3] to [-1, 1], denser at 1."""
    return 2.4 * (eta - 1.0) / (eta - 0.6) - 1.0


class Boundary(NamedTuple):
    """The fit at the roughness and the index of each point."""

    series: Channels  # coefficients of p by degree in x
    through: Channels  # of what is let through over 1 - F; none where nobody asks
    lost: Lost
    alpha: Tensor
    eta: Tensor

    @staticmethod
    def of(distribution: str, shadowing: str, rough: Rough, eta: Tensor, through: bool = False) -> "Boundary":
        """At an isotropic roughness and an index; ``through``: :meth:`let_through` will be asked, too."""
        lost, alpha = Lost.of(FITS[distribution, shadowing], rough), rough.x
        by_alpha, by_eta = chebyshev(roughness_argument(alpha), DEGREE_A), chebyshev(index_argument(eta), DEGREE_N)
        names = [shadowing] + ["through"] * through
        series = [tuple(_both(row, by_alpha, by_eta) for row in BOUNDARY_FITS[distribution, name]) for name in names]
        return Boundary(series[0], series[-1] if through else (), lost, alpha, eta)

    def at(self, cos: Tensor) -> Tensor:
        """E in [0, 1] at a cosine >= 0."""
        return (1.0 - self.lost.at(cos, None)) * self._split(cos)[0].reflected

    def let_through(self, cos: Tensor) -> Tensor:
        """What refraction at one facet each lets in, without what meets a second one; of separable shadowing."""
        at, x = self._split(cos)
        return at.transmitted * clenshaw(self.through, x)

    def _split(self, cos: Tensor) -> tuple[Split, Tensor]:
        """The reflectance at the mean cosine of the facets, and the argument of the polynomials."""
        reach = REACH * self.alpha
        inverse = numerics.reciprocal_or_zero(cos + reach)
        x = 2.0 * cos * (1.0 + reach) * inverse - 1.0
        step = clenshaw(self.series, x) * (reach * inverse) * (self.alpha / (self.alpha + 0.3))
        return split(numerics.unit_interval(cos + step), self.eta), x

    def mean_let_in(self, through: bool = False) -> Tensor:
        """The average of 1 - E, or of :meth:`let_through`, over diffuse light, by Gauss's rule of 12 nodes in the root of the cosine."""
        like = self.alpha + self.eta
        x, weight = (v.to(like).reshape(-1, *(1,) * like.dim()) for v in (NODES, WEIGHTS))
        let_in = self.let_through(x * x) if through else 1.0 - self.at(x * x)
        return (let_in * (4.0 * x * x * x * weight)).sum(0)


def textbook(m: Any, alpha: Any, eta: Any, distribution: str, shadowing: str) -> tuple[Any, Any]:
    """E as a function of the cosine, and the average of 1 - E, in an arithmetic of :mod:`~torchbrdf.testing.textbook`; isotropic."""
    fit, reach = FITS[distribution, shadowing], REACH * alpha
    t, n = _plain((3 * alpha - 1) / (1 + alpha), DEGREE_A_LOST), _plain(2.4 * (eta - 1) / (eta - 0.6) - 1, DEGREE_N)
    a = _plain(2.2 * alpha / (alpha + 0.1) - 1, DEGREE_A)
    of_lost = [_dot(row, t) for row in fit.rows]
    of_cosine = [_dot([_dot(c, n) for c in row], a) for row in BOUNDARY_FITS[distribution, shadowing]]

    def reflected(mu: Any) -> Any:
        x, w = mu * (1 + reach) / (mu + reach), reach / (mu + reach)
        p = w * _dot(of_lost, _plain(2 * (m.sqrt(x) if fit.root else x) - 1, len(of_lost) - 1))
        lost = p * p * x if fit.vanishes else p * p
        cos = mu + w * alpha / (alpha + 0.3) * _dot(of_cosine, _plain(2 * x - 1, DEGREE_X))
        cos = m.where(m.positive(cos), m.where(m.positive(1 - cos), cos, 1), 0)
        return (1 - lost) * Dielectric.textbook(m, cos, eta)

    nodes = zip(NODES.tolist(), WEIGHTS.tolist(), strict=True)
    return reflected, sum((1 - reflected(x * x + 0 * alpha)) * (4 * x * x * x * weight) for x, weight in nodes)


def _plain(x: Any, degree: int) -> list[Any]:
    found = [1 + 0 * x, x]
    while len(found) <= degree:
        found.append(2 * x * found[-1] - found[-2])
    return found


def _dot(a: Sequence[Any], b: Sequence[Any]) -> Any:
    return sum((x * y for x, y in zip(a[1:], b[1:], strict=True)), a[0] * b[0])


def _both(row: Sequence[Sequence[float]], by_alpha: list[Tensor], by_eta: list[Tensor]) -> Tensor:
    total = summed(row[0], by_eta) * by_alpha[0]
    for c, polynomial in zip(row[1:], by_alpha[1:], strict=True):
        total = torch.addcmul(total, summed(c, by_eta), polynomial)
    return total
