"""Fresnel's equations in 320 bits from the complex amplitudes, independent of the library's formulation."""

import mpmath

mpmath.mp.prec = 320


def reflectance(cos_i: float, eta: float, k: float = 0.0) -> mpmath.mpf:
    """Unpolarised reflectance at exactly these floating-point inputs; 1 from the critical angle on, 0 at eta = 1."""
    if eta == 1 and k == 0:
        return mpmath.mpf(0)
    c, n = mpmath.mpf(cos_i), mpmath.mpc(eta, k)
    cos_t = mpmath.sqrt(1 - (1 - c * c) / (n * n))
    r_s, r_p = (c - n * cos_t) / (c + n * cos_t), (n * c - cos_t) / (n * c + cos_t)
    return (abs(r_s) ** 2 + abs(r_p) ** 2) / 2


def derivative(which: int, *inputs: float) -> mpmath.mpf:
    """Partial derivative of :func:`reflectance` by central differences of 1e-40: exact to 70 digits."""
    h = mpmath.mpf(10) ** -40
    moved = [[mpmath.mpf(x) + (s * h if i == which else 0) for i, x in enumerate(inputs)] for s in (1, -1)]
    return (reflectance(*moved[0]) - reflectance(*moved[1])) / (2 * h)
