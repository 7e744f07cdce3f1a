"""Fresnel's laws: truth by the complex amplitudes, or by the textbook's real ones; grids that meet the critical angle to the ulp."""

import numpy as np

from torchbrdf.optics import fresnel

from ..case import Case, Draw
from ..dual import plain, sqrt, where

UNIT = (0.05, 1.0)  # everyday cosines; everyday indices are the typical ones of the declarations


def held(c):
    """A cosine held to [0, 1], without slope beyond."""
    return where(plain(c) < 0, 0, where(plain(c) > 1, 1, c))


def refracted(c, eta):
    """(cos_t or 1, whether anything is refracted, whether the media are the same)."""
    cos2 = 1 - (1 - c * c) / (eta * eta)
    matched = np.asarray(plain(eta) == 1, dtype=bool)
    through = np.asarray(plain(cos2) > 0, dtype=bool) & ~matched
    return sqrt(where(through, cos2, 1)), through, matched


def amplitudes(c, eta):
    """r_s and r_p; their modulus, 1, under total reflection."""
    c = held(c)
    t, through, matched = refracted(c, eta)
    otherwise = where(matched, 0, 1)
    return (
        where(through, (c - eta * t) / where(through, c + eta * t, 1), otherwise),
        where(through, (eta * c - t) / where(through, eta * c + t, 1), otherwise),
    )


def dielectric(c, eta):
    r_s, r_p = amplitudes(c, eta)
    return ((r_s * r_s + r_p * r_p) / 2,)


def refraction_cosine(c, eta):
    c = held(c)
    t, through, matched = refracted(c, eta)
    return (where(matched, c, where(through, t, 0)),)


def conductor(c, eta, k):
    c = held(c)
    vacuum = np.asarray((plain(eta) == 1) & (plain(k) == 0), dtype=bool)
    s2 = 1 - c * c
    real = where(vacuum, 1, eta * eta - k * k - s2)
    imag = 2 * eta * k
    forward = np.asarray(plain(real) >= 0, dtype=bool)
    modulus = sqrt(where((plain(real) == 0) & (plain(imag) == 0), 1, real * real + imag * imag))
    large = sqrt((modulus + where(forward, real, -1 * real)) / 2)
    small = imag / (2 * large)
    a, b = where(forward, large, small), where(forward, small, large)
    # r_s and r_p with n^2 = eta^2 - k^2 + 2 i eta k written out
    r_s = ((c - a) * (c - a) + b * b) / ((c + a) * (c + a) + b * b)
    re, im = (eta * eta - k * k) * c, imag * c
    r_p = ((re - a) * (re - a) + (im - b) * (im - b)) / ((re + a) * (re + a) + (im + b) * (im + b))
    return (where(vacuum, 0, (r_s + r_p) / 2),)


def schlick(c, f0):
    m = 1 - held(c)
    return (f0 + (1 - f0) * (m * m * m * m * m),)


def critical(draw: Draw, etas) -> np.ndarray:
    """The critical angle of each index and its neighbours to the ulp."""
    rows = []
    for eta in draw.rounded(etas):
        cos = float(np.sqrt((1 - eta) * (1 + eta)))
        rows += [(c, eta) for c in draw.near(cos, 3)] + [(c, eta) for c in draw.rounded(cos * (1 + np.array([1e-5, 1e-3, -1e-3])))]
    return np.array(rows)


def etas(draw: Draw) -> list[float]:
    return [*draw.near(1.0), *draw.rounded([1 - 1e-7, 1 + 1e-7, 1e-3, 0.25, 0.5, 2 / 3, 0.75, 0.999, 1.001, 1.33, 1.5, 2.42, 10.0, 100.0])]


def eta_bulk(draw: Draw):
    return lambda n: np.where(
        draw.rng.integers(0, 3, n) > 0, draw.spread(n, 0.25, 4.0), 1 + draw.rng.choice([-1, 1], n) * draw.spread(n, 1e-6, 0.5)
    )


def dielectric_grid(draw: Draw) -> np.ndarray:
    special = np.concatenate(
        [draw.product(draw.cosines(), etas(draw)), critical(draw, [1e-2, 0.25, 0.4, 0.5, 2 / 3, 0.75, 0.95, 0.999, 1 - 1e-4])]
    )
    return draw.fill(special, draw.cosine_bulk, eta_bulk(draw))


def conductor_grid(draw: Draw) -> np.ndarray:
    small = [draw.info.tiny if not draw.half else 1e-3, 1e-2, 0.05]
    special = draw.product(draw.cosines(), [*small, 0.2, 0.5, 1.0, 1.5, 3.0, 10.0], [0.0, draw.denormal, 1e-3, 0.5, 2.0, 7.0, 1e3])
    angle = critical(draw, [0.25, 0.5, 0.75, 0.95])
    special = np.concatenate([special, *[np.column_stack([angle, np.full(len(angle), k)]) for k in draw.rounded([0.0, 1e-3, 0.1])]])
    return draw.fill(special, draw.cosine_bulk, lambda n: draw.spread(n, 0.02, 10.0), lambda n: draw.spread(n, 1e-3, 20.0))


def schlick_grid(draw: Draw) -> np.ndarray:
    f0 = [0.0, draw.denormal, 0.02, 0.04, 0.5, *draw.near(1.0, 1)[:2]]
    return draw.fill(draw.product(draw.cosines(), f0), draw.cosine_bulk, draw.uniform)


def between(name, low, high):
    return lambda x: (x[name] >= low) & (x[name] <= high)


def at_threshold(x):
    """Exactly at the critical angle in the real numbers: the slope outside is infinite."""
    return np.array([c * c == (1 - e) * (1 + e) for c, e in zip(x["cos_i"], x["eta"], strict=True)])


def everyday_dielectric(x):
    g2 = (x["eta"] - 1) * (x["eta"] + 1) + x["cos_i"] ** 2
    return between("cos_i", *UNIT)(x) & between("eta", 1.2, 2.5)(x) | between("cos_i", *UNIT)(x) & between("eta", 0.4, 0.83)(x) & (
        g2 > 0.05
    )


CASES = (
    Case(
        "fresnel.dielectric",
        ("cos_i", "eta"),
        lambda c, eta: (fresnel.dielectric(c, eta),),
        dielectric,
        dielectric_grid,
        everyday_dielectric,
        covers=("fresnel.dielectric", "Dielectric"),
        at_most_one=True,
    ),
    Case(
        "fresnel.amplitudes, r_s",
        ("cos_i", "eta"),
        lambda c, eta: fresnel.amplitudes(c, eta)[:1],
        lambda c, eta: amplitudes(c, eta)[:1],
        dielectric_grid,
        everyday_dielectric,
        covers=("fresnel.amplitudes",),
        signed=True,
        at_most_one=True,
    ),
    Case(
        "fresnel.amplitudes, r_p",
        ("cos_i", "eta"),
        lambda c, eta: fresnel.amplitudes(c, eta)[1:],
        lambda c, eta: amplitudes(c, eta)[1:],
        dielectric_grid,
        everyday_dielectric,
        covers=("fresnel.amplitudes",),
        signed=True,
        at_most_one=True,
    ),
    Case(
        "fresnel.refraction_cosine",
        ("cos_i", "eta"),
        lambda c, eta: (fresnel.refraction_cosine(c, eta),),
        refraction_cosine,
        dielectric_grid,
        everyday_dielectric,
        covers=("fresnel.refraction_cosine",),
        at_most_one=True,
    ),
    Case(
        "fresnel.conductor",
        ("cos_i", "eta", "k"),
        lambda c, eta, k: (fresnel.conductor(c, eta, k),),
        conductor,
        conductor_grid,
        lambda x: between("cos_i", *UNIT)(x) & between("eta", 0.1, 3.0)(x) & between("k", 0.5, 7.0)(x),
        covers=("fresnel.conductor", "Conductor"),
        outside_twice={"a vacuum up to a denormal k": lambda x: (x["eta"] == 1) & (x["k"] < x.working.smallest_normal)},
        at_most_one=True,
    ),
    Case(
        "fresnel.schlick",
        ("cos_i", "f0"),
        lambda c, f0: (fresnel.schlick(c, f0),),
        schlick,
        schlick_grid,
        between("cos_i", *UNIT),
        covers=("fresnel.schlick", "Schlick"),
        at_most_one=True,
    ),
)
