"""Approximations of Fresnel's laws, as functions of the laws' own inputs, so that they can be compared with them.

A cosine in [0, 1], ``eta`` > 0 and ``k`` >= 0, tensors that broadcast; smooth, and finite on the closed ranges.
"""

import torch
from torch import Tensor

from .conductor import conductor

AT_82_DEGREES = 1.0 / 7.0  # the cosine at which c (1 - c)^6 is largest
LARGEST = AT_82_DEGREES * (1.0 - AT_82_DEGREES) ** 6


def schlick(cos_i: Tensor, f0: Tensor) -> Tensor:
    """From the reflectance at normal incidence (Schlick 1994, eq. 15)."""
    m = 1.0 - cos_i
    m2 = m * m
    grazing = m2 * m2 * m
    return f0 * (1.0 - grazing) + grazing


def constant(cos_i: Tensor, f0: Tensor) -> Tensor:
    """The reflectance at normal incidence, at every angle."""
    return torch.broadcast_tensors(f0, cos_i)[0]


def dielectric_f0(eta: Tensor) -> Tensor:
    """Exact reflectance at normal incidence."""
    amplitude = (eta - 1.0) / (eta + 1.0)
    return amplitude * amplitude


def conductor_f0(eta: Tensor, k: Tensor) -> Tensor:
    """Exact reflectance at normal incidence."""
    less, more = eta - 1.0, eta + 1.0
    return (less * less + k * k) / (more * more + k * k)


def dielectric_schlick(cos_i: Tensor, eta: Tensor) -> Tensor:
    """Schlick 1994 from the exact reflectance at normal incidence."""
    return schlick(cos_i, dielectric_f0(eta))


def dielectric_constant(cos_i: Tensor, eta: Tensor) -> Tensor:
    """As if at normal incidence."""
    return constant(cos_i, dielectric_f0(eta))


def conductor_schlick(cos_i: Tensor, eta: Tensor, k: Tensor) -> Tensor:
    """Schlick 1994 from the exact reflectance at normal incidence; Lazanyi & Szirmay-Kalos 2005, eq. 4, write it in eta and k:
    ``((eta - 1)^2 + 4 eta (1 - c)^5 + k^2) / ((eta + 1)^2 + k^2)``."""
    return schlick(cos_i, conductor_f0(eta, k))


def conductor_constant(cos_i: Tensor, eta: Tensor, k: Tensor) -> Tensor:
    """As if at normal incidence."""
    return constant(cos_i, conductor_f0(eta, k))


def lazanyi(cos_i: Tensor, eta: Tensor, k: Tensor, a: Tensor | float, alpha: Tensor | float) -> Tensor:
    """Schlick's, less ``a c (1 - c)^alpha``, of which the two numbers are fitted to each metal (Lazanyi & Szirmay-Kalos 2005)."""
    return conductor_schlick(cos_i, eta, k) - a * cos_i * (1.0 - cos_i) ** alpha


def f82_tint(cos_i: Tensor, f0: Tensor, tint: Tensor) -> Tensor:
    """Lazanyi's term with alpha = 6, from what is left of Schlick's approximation at 82 degrees (Hoffman 2019; Kutz et al. 2021)."""
    m2 = (1.0 - cos_i) * (1.0 - cos_i)
    dip = cos_i * m2 * m2 * m2 / LARGEST
    return schlick(cos_i, f0) - dip * (1.0 - tint) * schlick(torch.full_like(f0, AT_82_DEGREES), f0)


def conductor_f82(cos_i: Tensor, eta: Tensor, k: Tensor) -> Tensor:
    """:func:`f82_tint` with the exact reflectances at 0 and at 82 degrees: what a fit to this metal can reach."""
    f0 = conductor_f0(eta, k)
    at_82 = torch.full_like(f0, AT_82_DEGREES)
    return f82_tint(cos_i, f0, conductor(at_82, eta, k) / schlick(at_82, f0))


def average_egan(eta: Tensor) -> Tensor:
    """A dielectric's reflectance of diffuse light, from a fit of that of the light inside (Egan & Hilgeman 1973)."""
    within = -1.4399 / (eta * eta) + 0.7099 / eta + 0.6681 + 0.0636 * eta
    return 1.0 - (1.0 - within) * (eta * eta)


def average_deon(eta: Tensor) -> Tensor:
    """The same by a polynomial in 1/eta, for eta >= 1 (d'Eon & Irving 2011, twice their C_1)."""
    x = 1.0 / eta
    return 0.919317 + x * (-3.4793 + x * (6.75335 + x * (-7.80989 + x * (4.98554 - 1.36881 * x))))
