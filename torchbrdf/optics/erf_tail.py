r"""The tail in Beckmann's Lambda: :math:`w(\nu) = e^{-\nu^2} h(\nu)`, :math:`h = 1/\sqrt\pi - \nu\,\mathrm{erfcx}(\nu)`.

The textbook forms subtract nearly equal numbers: for large nu, h is about :math:`1 / (2 \sqrt\pi \nu^2)`. But h is the Laplace
transform of a positive function, so it falls without a wiggle, and a rational function of it that is good enough comes out
with positive coefficients only: sums of positive terms, in which nothing cancels, and neither do the derivatives.

The coefficients are least squares fits of relative error, reweighted towards minimax (Lawson 1961; Sanathanan & Koerner 1963),
made in 400 bits. Relative error of h: 7e-11 on [0, 9.4] (float32), 2e-18 before rounding on [0, 26.7] (float64); beyond,
:math:`e^{-\nu^2}` is below the smallest normal number.
"""

import torch
from torch import Tensor

from ..numerics import product_error

# fmt: off
_SINGLE = (
    (0.56418958358, 0.63226226172, 0.36572822813, 0.12592346068, 0.025624668914, 0.0025208411353),
    (1.0, 2.8931095397, 3.7761393451, 2.9024630458, 1.4321807946, 0.4598319416, 0.09083527024, 0.008936185747),
)
_DOUBLE = (
    (0.5641895835477563, 1.1035501415532505, 1.0965471054280844, 0.7113510263061615, 0.32961352636456615, 0.11325042427138171,
     0.02914016041349342, 0.00554638644633848, 0.000749925311056262, 0.0000655295976518128, 0.000002850925535124041),
    (1.0, 3.7284455489689017, 6.552076810876789, 7.189653393756444, 5.498564324635386, 3.0955958430750266, 1.3194636455612125,
     0.43060600331150783, 0.10727164350641508, 0.020009872599736727, 0.002673575412655742, 0.00023229637541403493,
     0.000010106267886741872),
)
# fmt: on


def exponential_tail(c: Tensor, a: Tensor) -> Tensor:
    """``w(c / a)`` for c >= 0, a > 0 with c / a up to 9.3 (float32) or 26.6 (float64), accurate to a few roundings throughout."""
    nu = c / a
    square = nu * nu
    numerator, denominator = _DOUBLE if nu.dtype == torch.float64 else _SINGLE
    return torch.exp(-square) * _lost_by_rounding(c.detach(), a.detach(), nu.detach()) * (_horner(numerator, nu) / _horner(denominator, nu))


def _horner(ascending: tuple[float, ...], x: Tensor) -> Tensor:
    value = ascending[-1] * x + ascending[-2]
    for coefficient in ascending[-3::-1]:
        value = value * x + coefficient
    return value


def _lost_by_rounding(c: Tensor, a: Tensor, nu: Tensor) -> Tensor:
    """``exp(-(c/a)^2) / exp(-fl(nu^2))``: a rounding of nu costs nu^2 roundings of the exponential, unless it is given back."""
    square, product = nu * nu, nu * a
    beyond = ((c - product) - product_error(nu, a, product)) / a  # c / a - nu; c - product is exact
    return 1.0 - (product_error(nu, nu, square) + 2.0 * nu * beyond)
