"""The lobes of Phong and Blinn as functions of one cosine, with their normalisations."""

import gmpy2
import numpy as np
import torch

from torchbrdf import numerics
from torchbrdf.bsdf import blinn_phong, phong

from ..case import Case, Draw
from ..dual import exp, pi, plain, power, where
from .fresnel import between

EXPONENTS = [0.0, 1e-3, 0.5, 1.0, 2.0, 10.0, 300.0, 1e4]
NORMALIZATION = {"none": lambda s: 1, "bound": lambda s: (s + 1) / (2 * pi()), "modified": lambda s: (s + 2) / (2 * pi())}


def exponents(draw: Draw) -> list[float]:
    return [*EXPONENTS, *([] if draw.dtype.itemsize == 2 else [1e6, 1e7])]


def lobe(m, s):
    """(1 - m)^s, black beyond the horizon of the lobe, 0^0 = 1."""
    black = np.asarray(plain(m) > 1, dtype=bool)
    return where(black, 0, power(where(black, 1, 1 - m), s))


def blinn_factor(s):
    return (s + 2) * (s + 4) / (8 * pi() * (exp(s * (-gmpy2.log(gmpy2.mpfr(2)) / 2)) + s))


def cosine_lobe(cos, s):
    """Blinn's, of a cosine; its sine is that of the same angle, rounded."""
    return (power(cos, s) * blinn_factor(s),)


def lobe_grid(draw: Draw) -> np.ndarray:
    """Complements of the cosine: 0, 1 and their neighbours; a bulk where the lobe is a normal number, up to e^-60 of its peak."""
    ms = [0.0, draw.denormal, draw.info.tiny, draw.info.eps, 1e-3, 0.5, *draw.near(1.0), 1.5]
    s = np.where(
        draw.uniform(draw.points) < 0.2,
        draw.uniform(draw.points, 0, 3),
        draw.spread(draw.points, 1.0, 3e2 if draw.dtype == torch.float16 else 1e4 if draw.half else 1e7),
    )
    depth = draw.uniform(draw.points, 0, 8 if draw.dtype.itemsize == 2 else 60)
    m = np.minimum(-np.expm1(-depth / np.maximum(s, 1e-9)), 0.99)
    return np.concatenate([draw.product(ms, exponents(draw)), draw.rounded(np.column_stack([m, s]))])


def factor_grid(draw: Draw) -> np.ndarray:
    special = draw.rounded([*exponents(draw), draw.denormal, draw.info.tiny, draw.info.eps])[:, None]
    return draw.fill(special, lambda n: draw.spread(n, 1e-4, 1e4 if draw.half else 1e7))


def call_lobe(normalization):
    def call(m, s):
        wide = [numerics.widen(x) for x in (m, s)]
        return (numerics.rounded_back(numerics.log1p_power(*wide) * phong.NORMALIZATIONS[normalization](wide[1]), m.dtype),)

    return call


def phong_case(normalization: str) -> Case:
    factor = NORMALIZATION[normalization]
    return Case(
        f"Phong lobe ({normalization})",
        ("m", "exponent"),
        call_lobe(normalization),
        lambda m, s: (lobe(m, s) * factor(s),),
        lobe_grid,
        lambda x: between("exponent", 1.0, 200.0)(x) & (x["m"] < 0.9) & (x["m"] * x["exponent"] < 7),
        covers=(f"Phong.{normalization}",),
        error="exp",
        peak=lambda x: np.array([factor(gmpy2.mpfr(s)) for s in x["exponent"]], dtype=object),
        kinks={"edge of the lobe": lambda x: x["m"] == 1},
    )


CASES = (
    *(phong_case(name) for name in NORMALIZATION),
    Case(
        "Blinn-Phong factor",
        ("exponent",),
        lambda s: (numerics.rounded_back(blinn_phong.normal_view_factor(numerics.widen(s)), s.dtype),),
        lambda s: (blinn_factor(s),),
        factor_grid,
        between("exponent", 1.0, 200.0),
        covers=(),
    ),
)
