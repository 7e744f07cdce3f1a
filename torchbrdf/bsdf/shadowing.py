"""How much of a rough surface light and viewer both reach: masking and shadowing over 4 cos_i cos_o, by name.

Each is a function of a geometry and of the Smith lengths of both directions (see :mod:`torchbrdf.optics.distribution`), finite
outside the domain, and 0 where both cosines are below the root of the smallest number.

====================  ================================================  ==================================================
``"smith_correlated"`` 1 / (1 + Lambda_i + Lambda_o)                     Ross et al. 2005; Heitz 2014
``"smith_separable"``  G1(wi) G1(wo)                                     Smith 1967; Walter et al. 2007
``"v_cavity"``         min(1, 2 n.h n.wi / wo.h, 2 n.h n.wo / wo.h)      Torrance & Sparrow 1967; Cook & Torrance 1982
====================  ================================================  ==================================================
"""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from .. import numerics
from ..geometry import Geometry

Length = Callable[[], Tensor]


def smith_correlated(g: Geometry, length_i: Length, length_o: Length) -> Tensor:
    """Height-correlated: neither is hidden behind the height that hides the other."""
    both = g.cos_o.abs() * length_i() + g.cos_i.abs() * length_o()
    return 0.5 * _inverse(both)


def smith_separable(g: Geometry, length_i: Length, length_o: Length) -> Tensor:
    """As if both were hidden independently."""
    return _inverse((g.cos_i.abs() + length_i()) * (g.cos_o.abs() + length_o()))


def v_cavity(g: Geometry, length_i: Length, length_o: Length) -> Tensor:
    """Symmetric grooves; of no distribution's shape. With n.h / wo.h = 2 (n.wi + n.wo) / \\|wi + wo\\|^2."""
    ci, co = g.cos_i.abs(), g.cos_o.abs()
    hidden = torch.maximum(ci, co) * (g.half2 * _inverse(ci + co))
    return _inverse(torch.maximum(4.0 * ci * co, hidden))


def _inverse(x: Tensor) -> Tensor:
    return numerics.reciprocal_or_zero(x, numerics.negligible(x.dtype))


SHADOWING: dict[str, Callable[[Geometry, Length, Length], Tensor]] = {
    "smith_correlated": smith_correlated,
    "smith_separable": smith_separable,
    "v_cavity": v_cavity,
}
TEXTBOOK = {
    "smith_correlated": lambda m, p, lam: 1 / (1 + lam(p.cos_i) + lam(p.cos_o)),
    "smith_separable": lambda m, p, lam: 1 / ((1 + lam(p.cos_i)) * (1 + lam(p.cos_o))),
    "v_cavity": lambda m, p, lam: _least(m, 1, _least(m, 2 * p.cos_h * p.cos_i / p.wi_h, 2 * p.cos_h * p.cos_o / p.wi_h)),
}


def _least(m: Any, a: Any, b: Any) -> Any:
    return m.where(m.positive(b - a), a, b)
