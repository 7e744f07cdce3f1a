"""Microfacet theory: distributions of normals and Smith's functions, isotropic and anisotropic."""

from collections.abc import Callable

import gmpy2
import numpy as np

from torchbrdf.optics import microfacet

from ..case import Case, Columns, Draw
from ..dual import erf, exp, pi, plain, sqrt, where
from .fresnel import between
from .vectors import positive

# ---- truths


def squared_if_positive(x):
    return where(np.asarray(plain(x) >= 0, dtype=bool), x, 0)


def ggx_d(c, s2, alpha):
    q = squared_if_positive(s2) / alpha + alpha * (c * c)
    lit = positive(c)
    return (where(lit, 1 / (pi() * where(lit, q * q, 1)), 0),)


def beckmann_d(c, s2, alpha):
    lit = positive(c)
    c2 = where(lit, c * c, 1)
    return (where(lit, exp(-1 * squared_if_positive(s2) / (alpha * alpha * c2)) / (pi() * (alpha * alpha) * (c2 * c2)), 0),)


def local(d):
    """A distribution of the slopes of a local vector of any length."""

    def anisotropic(x, y, z, ax, ay):
        lit = positive(z)
        length2 = where(lit, x * x + y * y + z * z, 1)
        z2 = where(lit, z * z / length2, 1)
        slope2 = (x * x / (ax * ax) + y * y / (ay * ay)) / where(lit, z * z, 1)
        return (where(lit, d(slope2) / (pi() * ax * ay * (z2 * z2)), 0),)

    return anisotropic


def projected_roughness(x, y, ax, ay):
    square = x * x * (ax * ax) + y * y * (ay * ay)
    off = positive(square)
    return (where(off, sqrt(where(off, square, 1)), 0),)


def ggx_slope(nu):
    return (sqrt(1 + 1 / (nu * nu)) - 1) / 2


def ggx_smooth(c, a):
    """The parabola that GGX's Lambda is at a = 0."""
    return (a / c) * (a / c) / 4


def beckmann_slope(nu):
    return (erf(nu) - 1) / 2 + exp(-1 * (nu * nu)) / (2 * sqrt(pi()) * nu)


def walter_slope(nu):
    value = (1 - DECIMAL("1.259") * nu + DECIMAL("0.396") * (nu * nu)) / (DECIMAL("3.535") * nu + DECIMAL("2.181") * (nu * nu))
    small = np.asarray((plain(nu) < 1.6) & (plain(value) > 0), dtype=bool)
    return where(small, value, 0)


def DECIMAL(text: str) -> gmpy2.mpfr:
    return gmpy2.mpfr(text)


def smith(slope: Callable) -> Callable:
    """Lambda of cosine and projected roughness, and where the cosine is above the horizon."""

    def lam(c, a):
        lit = positive(c)
        rough = positive(a) & lit
        flat = ggx_smooth(where(lit, c, 1), a) if slope is ggx_slope else 0
        return where(rough, slope(where(rough, c, 1) / where(rough, a, 1)), flat), lit

    return lam


def smith_lambda(slope: Callable) -> Callable:
    lam = smith(slope)
    return lambda c, a: (where(lam(c, a)[1], lam(c, a)[0], gmpy2.inf()),)


def g1(slope: Callable) -> Callable:
    lam = smith(slope)
    return lambda c, a: (where(lam(c, a)[1], 1 / (1 + lam(c, a)[0]), 0),)


def g2(slope: Callable, visibility: bool = False) -> Callable:
    lam = smith(slope)

    def value(ci, ai, co, ao):
        (li, i), (lo, o) = lam(ci, ai), lam(co, ao)
        lit = i & o
        scale = 4 * where(lit, ci * co, 1) if visibility else 1
        return (where(lit, 1 / ((1 + li + lo) * scale), 0),)

    return value


# ---- grids

ROUGHNESS = [1e-4, 1e-3, 0.01, 0.1, 0.5, 1.0]


def alpha_bulk(draw: Draw):
    return lambda n: draw.spread(n, 0.15 if draw.half else 1e-4, 1.0)


def slopes(draw: Draw, count: int, alpha: np.ndarray, deepest: float) -> np.ndarray:
    """Angles of normals that the distribution holds: tan^2 up to ``deepest`` alpha^2, a tenth of them anywhere."""
    inside = np.arctan(alpha * np.sqrt(draw.uniform(count, 0, deepest)))
    return np.where(draw.uniform(count) < 0.1, np.arccos(draw.cosine_bulk(count)), inside) if deepest > 100 else inside


def distribution_grid(deepest: float):
    def grid(draw: Draw) -> np.ndarray:
        cos = draw.rounded(draw.cosines()).tolist()
        special = np.array([(c, max(1.0 - c * abs(c), 0.0), a) for c in cos for a in draw.rounded(ROUGHNESS)])
        alpha = alpha_bulk(draw)(draw.points)
        theta = slopes(draw, draw.points, alpha, min(deepest, 5.0) if draw.half and deepest < 100 else deepest)
        bulk = np.column_stack([np.cos(theta), np.sin(theta) ** 2, alpha])
        return draw.rounded(np.concatenate([special, bulk]))

    return grid


def anisotropic_grid(deepest: float):
    def grid(draw: Draw) -> np.ndarray:
        count = draw.points
        ax = alpha_bulk(draw)(count)
        ay = np.clip(ax * draw.spread(count, 0.5 if draw.half else 1e-4, 2.0 if draw.half else 1e4), 0.15 if draw.half else 1e-4, 1.0)
        radius = np.sqrt(draw.uniform(count, 0, min(deepest, 5.0) if draw.half else deepest))
        phi = draw.uniform(count, 0, 2 * np.pi)
        vector = np.stack([ax * radius * np.cos(phi), ay * radius * np.sin(phi), np.ones(count)], 1)
        vector /= np.linalg.norm(vector, axis=1, keepdims=True)
        lengths = np.where(draw.uniform(count) < 0.7, 1.0, draw.spread(count, 0.1, 10.0) if draw.half else draw.spread(count, 1e-8, 1e8))
        kinds = [
            (0, 0, 1),
            (0, 0, 0),
            (1, 0, 0),
            (1, 0, draw.denormal),
            (0, 1e-3, 1),
            (1e-3, 0, -1),
            (0.6, 0, 0.8),
            (0, 0, draw.denormal),
            (0, 0, draw.info.max),
        ]
        pairs = [(1e-4, 1.0), (1.0, 1e-4), (1e-4, 1e-4), (1.0, 1.0), (0.3, 0.2)]
        special = np.array([(*k, *p) for k in kinds for p in pairs])
        return draw.rounded(np.concatenate([special, np.column_stack([vector * lengths[:, None], ax, ay])]))

    return grid


def roughness_grid(draw: Draw) -> np.ndarray:
    components = [0.0, -draw.denormal, draw.info.tiny, draw.info.eps, 0.6, 1.0]
    special = draw.product(components, components, [1e-4, 1.0], [1e-4, 0.3])
    return draw.fill(special, *[lambda n: draw.spread(n, 1e-6, 1.0)] * 2, *[alpha_bulk(draw)] * 2)


def cosines_and_roughness(draw: Draw, pairs: int, deepest: float | None):
    def roughness(c: np.ndarray) -> np.ndarray:
        """alpha sin; for Beckmann, such that exp(-nu^2) mostly is a number."""
        free = alpha_bulk(draw)(len(c)) * np.sqrt(1 - c * c)
        return free if deepest is None else np.maximum(free, c / np.sqrt(draw.uniform(len(c), 0.01, deepest)))

    def both(n: int) -> np.ndarray:
        c = np.maximum(draw.cosine_bulk(n), 1e-2 if draw.half else 1e-6)
        return np.column_stack([c, roughness(c)])

    special = draw.product(draw.cosines(), [0.0, draw.denormal, *ROUGHNESS])
    if pairs == 2:
        some = special[draw.rng.permutation(len(special))[:14]]
        special = np.array([(*p, *q) for p in some for q in some])
    return draw.rounded(np.concatenate([special, np.concatenate([both(draw.points) for _ in range(pairs)], 1)]))


def smith_grid(pairs: int = 1, deepest: float | None = None):
    return lambda draw: cosines_and_roughness(draw, pairs, deepest)


# ---- claims


def everyday_roughness(*names: str):
    def mask(x: Columns):
        good = np.ones(len(x[names[0]]), dtype=bool)
        for name in names:
            good &= between(name, 0.05, 1.0)(x)
        return good

    return mask


def bright(x: Columns):
    """Where Beckmann's D is above 1e-6 of its peak."""
    return everyday_roughness("alpha")(x) & (x["cos_h"] > 0.05) & (x["sin2_h"] < 13 * (x["alpha"] * x["cos_h"]) ** 2)


def bright_anisotropic(x: Columns):
    slope2 = (x["x"] / x["alpha_x"]) ** 2 + (x["y"] / x["alpha_y"]) ** 2
    return everyday_roughness("alpha_x", "alpha_y")(x) & (np.abs(x["z"] - 0.5) < 0.45) & (slope2 < 13 * x["z"] ** 2)


def everyday_smith(x: Columns):
    good = np.ones(len(next(iter(x.values()))), dtype=bool)
    for name, column in x.items():
        good &= (column >= 0.05) & (column <= 1.0) if name.startswith("cos") else (column >= 0.02) & (column <= 1.0)
    return good


def peak(x: Columns):
    return np.array([1 / (pi() * gmpy2.mpfr(a) ** 2) for a in x["alpha"]], dtype=object)


def peak_anisotropic(x: Columns):
    return np.array([1 / (pi() * gmpy2.mpfr(a) * gmpy2.mpfr(b)) for a, b in zip(x["alpha_x"], x["alpha_y"], strict=True)], dtype=object)


def too_smooth(x: Columns):
    """A projected roughness that no alpha of 1e-4 or more can have; 0 is that of the normal."""
    pairs = [(x[f"cos{k}"], x[f"alpha_sin{k}"]) for k in ("", "_i", "_o") if f"cos{k}" in x]
    return np.logical_or.reduce([(a > 0) & (a < 0.9e-4 * np.sqrt(np.maximum(1 - c * c, 1e-6))) for c, a in pairs])


def tiny_vector(x: Columns):
    """So short that the reciprocal of its square, its second derivatives' size, is no number."""
    return np.max([np.abs(x[k]) for k in "xyz" if k in x], 0) < 2 / np.sqrt(x.working.max)


def below_walter(x: Columns):
    """Where the fit has its root, after which it is 0."""
    with np.errstate(all="ignore"):
        nu = x["cos"] / x["alpha_sin"]
    return np.abs(nu - WALTER_ROOT) < 1e-5


WALTER_ROOT = (1.259 - np.sqrt(1.259**2 - 4 * 0.396)) / (2 * 0.396)
LOCAL = ("x", "y", "z", "alpha_x", "alpha_y")
NORMAL = ("cos_h", "sin2_h", "alpha")
ONE, TWO = ("cos", "alpha_sin"), ("cos_i", "alpha_sin_i", "cos_o", "alpha_sin_o")


def of(name: str, inputs: tuple[str, ...], truth: Callable, grid: Callable, everyday: Callable, **more) -> Case:
    """The case of one function of the module."""
    function = getattr(microfacet, name)
    return Case(f"microfacet.{name}", inputs, lambda *x: (function(*x),), truth, grid, everyday, covers=(f"microfacet.{name}",), **more)


CASES = (
    of("ggx_d", NORMAL, ggx_d, distribution_grid(1e4), lambda x: everyday_roughness("alpha")(x) & (x["cos_h"] > 0.05)),
    of(
        "ggx_d_anisotropic",
        LOCAL,
        local(lambda t: 1 / ((1 + t) * (1 + t))),
        anisotropic_grid(100.0),
        lambda x: everyday_roughness("alpha_x", "alpha_y")(x) & (np.abs(x["z"] - 0.5) < 0.45),
        outside_twice={"tiny vector": tiny_vector},
    ),
    of("beckmann_d", NORMAL, beckmann_d, distribution_grid(60.0), bright, error="exp", peak=peak),
    of(
        "beckmann_d_anisotropic",
        LOCAL,
        local(lambda t: exp(-1 * t)),
        anisotropic_grid(60.0),
        bright_anisotropic,
        error="exp",
        peak=peak_anisotropic,
        outside_twice={"tiny vector": tiny_vector},
    ),
    of(
        "projected_roughness",
        LOCAL[:2] + LOCAL[3:],
        projected_roughness,
        roughness_grid,
        lambda x: everyday_roughness("alpha_x", "alpha_y")(x) & (np.maximum(x["x"], x["y"]) > 0.05),
        kinks={"tip of the cone": lambda x: (x["x"] == 0) & (x["y"] == 0)},
        outside_twice={"tiny vector": tiny_vector},
    ),
    of("ggx_lambda", ONE, smith_lambda(ggx_slope), smith_grid(), everyday_smith, outside={"alpha below 1e-4": too_smooth}),
    of("ggx_g1", ONE, g1(ggx_slope), smith_grid(), everyday_smith, at_most_one=True, outside={"alpha below 1e-4": too_smooth}),
    of("ggx_g2", TWO, g2(ggx_slope), smith_grid(2), everyday_smith, at_most_one=True, outside={"alpha below 1e-4": too_smooth}),
    of("ggx_visibility", TWO, g2(ggx_slope, visibility=True), smith_grid(2), everyday_smith, outside={"alpha below 1e-4": too_smooth}),
    of("beckmann_lambda", ONE, smith_lambda(beckmann_slope), smith_grid(1, 60.0), everyday_smith, outside={"alpha below 1e-4": too_smooth}),
    of(
        "beckmann_g1",
        ONE,
        g1(beckmann_slope),
        smith_grid(1, 60.0),
        everyday_smith,
        at_most_one=True,
        outside={"alpha below 1e-4": too_smooth},
    ),
    of(
        "beckmann_g2",
        TWO,
        g2(beckmann_slope),
        smith_grid(2, 60.0),
        everyday_smith,
        at_most_one=True,
        outside={"alpha below 1e-4": too_smooth},
    ),
    of(
        "beckmann_lambda_walter",
        ONE,
        smith_lambda(walter_slope),
        smith_grid(1, 4.0),
        everyday_smith,
        kinks={"end of the fit": below_walter},
        outside={"alpha below 1e-4": too_smooth},
        error="backward",
    ),
)
