r"""F82 tint: Schlick's curve with a dip before grazing, as metals have it, from two colours.

.. math:: F = S(c) - \frac{c\,(1-c)^6}{\frac17 (\frac67)^6}\,(1 - t)\,S(\tfrac17), \qquad S(c) = F_0 + (1 - F_0)(1 - c)^5

At :math:`c = 1/7`, 82 degrees, the reflectance is t times that of Schlick's curve. Below 0, where the tint of a dark surface under a
half would take it, the curve is held to 0: there alone it is not smooth. Source: Hoffman 2019 and
Kutz et al. 2021 (OpenPBR's metals), of Lazanyi & Szirmay-Kalos 2005.
"""

from typing import Any

import torch
from torch import Tensor

from .. import numerics
from ..geometry import Channels, Layout, each
from ..interval import UNIT
from ..value import COLOUR, param, value
from .approximations import AT_82_DEGREES, LARGEST
from .fresnel import Fresnel


@value
class F82Tint(Fresnel):
    """Schlick's curve from ``f0`` at normal incidence, times ``tint`` at 82 degrees (1: Schlick's own)."""

    f0: Tensor = param(UNIT, COLOUR, "reflectance at normal incidence")
    tint: Tensor = param(UNIT, COLOUR, "at 82 degrees, over that of Schlick's curve")

    @staticmethod
    def textbook(m: Any, cos: Any, f0: Any, tint: Any) -> Any:
        def schlick(x: Any) -> Any:
            return f0 + (1 - f0) * (1 - x) * (1 - x) * (1 - x) * (1 - x) * (1 - x)

        m2 = (1 - cos) * (1 - cos)
        seventh = 1 / (7 + 0 * f0)
        dip = cos * m2 * m2 * m2 * 7**7 / 6**6
        found = schlick(cos) - dip * (1 - tint) * schlick(seventh)
        return m.where(m.positive(found), found, 0)

    def terms(self, layout: Layout, cos: Tensor) -> Channels:
        return tuple(numerics.positive(curve - lost) for curve, lost in self._parts(layout, cos))

    def kink_distance(self, layout: Layout, cos: Tensor) -> Tensor:
        """How far the dip is from taking all of the curve, as a share of both; beyond, the term is held to 0."""
        away = [(curve - lost).abs() * numerics.reciprocal_or_zero(curve + lost) for curve, lost in self._parts(layout, cos)]
        away = [torch.where(curve > 0, d, 1.0) for d, (curve, _) in zip(away, self._parts(layout, cos), strict=True)]
        return torch.stack(torch.broadcast_tensors(*away)).amin(0)

    def _parts(self, layout: Layout, cos: Tensor) -> list[tuple[Tensor, Tensor]]:
        """Schlick's curve and what is taken off, per channel."""
        m = numerics.positive(1.0 - cos)  # cos may exceed 1 by rounding
        m2 = m * m
        grazing = m2 * m2 * m
        dip, rest, at_82 = cos * grazing * m / LARGEST, 1.0 - grazing, (1.0 - AT_82_DEGREES) ** 5
        f0s, tints = layout.colour(self.f0), layout.colour(self.tint)
        curves = each(lambda f0, tint: (f0 * rest + grazing).expand_as(f0 * tint * m), f0s, tints)
        dips = each(lambda f0, tint: dip * (1.0 - tint) * (f0 * (1.0 - at_82) + at_82), f0s, tints)
        return list(zip(curves, dips, strict=True))
