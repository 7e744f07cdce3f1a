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
    """(cos_t or 1, whether anything is refracted)."""
    cos2 = 1 - (1 - c * c) / (eta * eta)
    through = np.asarray(plain(cos2) > 0, dtype=bool)
    return sqrt(where(through, cos2, 1)), through


def dielectric(c, eta):
    """1 under total reflection; 0 between matched media, also where both say so: at grazing."""
    c = held(c)
    t, through = refracted(c, eta)
    r_s, r_p = ((c * x - y * t) / where(through, c * x + y * t, 1) for x, y in ((1, eta), (eta, 1)))
    return (where(through, (r_s * r_s + r_p * r_p) / 2, where(plain(eta) == 1, 0, 1)),)


def refraction_cosine(c, eta):
    t, through = refracted(held(c), eta)
    return (where(through, t, 0),)


def root(c, eta, k):
    """a + ib, the root of (eta + ik)^2 - sin^2 (1 where the root is 0), and where it is 0."""
    real = eta * eta - k * k - (1 - c * c)
    imag = 2 * eta * k
    nothing = np.asarray((plain(real) == 0) & (plain(imag) == 0), dtype=bool)
    real = where(nothing, 1, real)
    forward = np.asarray(plain(real) >= 0, dtype=bool)
    large = sqrt((sqrt(real * real + imag * imag) + where(forward, real, -1 * real)) / 2)
    small = imag / (2 * large)
    return where(forward, large, small), where(forward, small, large), nothing


def amplitudes(c, eta, k=0):
    """((re, im) of r_s, of r_p), by complex division. At the critical angle 1; grazing between matched media 0."""
    c = held(c)
    a, b, nothing = root(c, eta, k)
    edge = where((plain(eta) == 1) & (plain(k) == 0), 0, 1)
    found = []
    for re, im in ((c, 0), ((eta * eta - k * k) * c, 2 * eta * k * c)):
        below = (re + a) * (re + a) + (im + b) * (im + b)
        parts = ((re - a) * (re + a) + (im - b) * (im + b), (im - b) * (re + a) - (re - a) * (im + b))
        found.append((where(nothing, edge, parts[0] / below), where(nothing, 0, parts[1] / below)))
    return found


def conductor(c, eta, k):
    (s_re, s_im), (p_re, p_im) = amplitudes(c, eta, k)
    return ((s_re * s_re + s_im * s_im + p_re * p_re + p_im * p_im) / 2,)


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
    def etas(n):
        near = 1 + draw.rng.choice([-1, 1], n) * draw.spread(n, max(1e-6, draw.info.eps), 0.5)
        kind = draw.rng.integers(0, 64, n)
        return np.select([kind == 0, kind < 22], [1.0, near], draw.spread(n, 0.25, 4.0))

    return etas


def dielectric_grid(draw: Draw) -> np.ndarray:
    angles = critical(draw, [1e-2, 0.25, 0.4, 0.5, 2 / 3, 0.75, 0.95, 0.999, 1 - 1e-4])
    grazing = draw.product(draw.info.tiny**0.5 * np.array([0.1, 0.5, 1.0, 2.0, 1e3]), draw.near(1.0, 1))  # their squares underflow
    special = np.concatenate([draw.product(draw.cosines(), etas(draw)), angles, grazing])
    return draw.fill(special, draw.cosine_bulk, eta_bulk(draw))


def least(draw: Draw) -> list[float]:
    """Of the indices."""
    return [1e-3] if draw.half else [draw.info.tiny]


def underflowing(draw: Draw) -> np.ndarray:
    """Indices whose squares underflow, or nearly, at normal incidence and beside it."""
    tiny = draw.rounded([draw.denormal, draw.info.tiny, draw.info.tiny**0.5, 1e-20, 1e-10, 1e-3])
    tiny = tiny[tiny > 0]
    grazing = draw.product(draw.info.tiny**0.5 * np.array([0.1, 1.0, 1e3]), [1.0], [0.0, draw.denormal])
    return np.concatenate([draw.product([0.0, draw.info.tiny, *draw.near(1.0, 1)], tiny, tiny), grazing])


def conductor_grid(draw: Draw) -> np.ndarray:
    small = [*least(draw), 1e-2, 0.05]
    special = draw.product(draw.cosines(), [*small, 0.2, 0.5, 1.0, 1.5, 3.0, 10.0], [0.0, draw.denormal, 1e-3, 0.5, 2.0, 7.0, 1e3])
    angle = critical(draw, [0.25, 0.5, 0.75, 0.95])
    special = np.concatenate(
        [special, underflowing(draw), *[np.column_stack([angle, np.full(len(angle), k)]) for k in draw.rounded([0.0, 1e-3, 0.1])]]
    )
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
    eta = between("eta", 1.2, 2.5)(x) | (x["eta"] == 1) | between("eta", 0.4, 0.83)(x) & (g2 > 0.05)
    return between("cos_i", *UNIT)(x) & eta


def everyday_amplitudes(x):
    """Those, and total reflection."""
    g2 = (x["eta"] - 1) * (x["eta"] + 1) + x["cos_i"] ** 2
    return everyday_dielectric(x) | between("cos_i", *UNIT)(x) & between("eta", 0.4, 0.83)(x) & (g2 < -0.05)


def everyday_conductor(x):
    return between("cos_i", *UNIT)(x) & between("eta", 0.1, 3.0)(x) & between("k", 0.5, 7.0)(x)


def ratio(which: str) -> Case:
    """Of a dielectric, one amplitude: a complex number, whose error is one of its modulus."""
    at = ("s", "p").index(which)
    return Case(
        f"fresnel.amplitudes, r_{which}",
        ("cos_i", "eta"),
        lambda c, eta: fresnel.amplitudes(c, eta)[2 * at : 2 * at + 2],
        lambda c, eta: amplitudes(c, eta)[at],
        dielectric_grid,
        everyday_amplitudes,
        covers=("fresnel.amplitudes", "fresnel.Amplitudes"),
        error="length",
        signed=True,
        at_most_one=True,
    )


def conductor_ratio(which: str) -> Case:
    """The same of a conductor."""
    at = ("s", "p").index(which)
    return Case(
        f"fresnel.amplitudes, r_{which} of a conductor",
        ("cos_i", "eta", "k"),
        lambda c, eta, k: fresnel.amplitudes(c, eta, k)[2 * at : 2 * at + 2],
        lambda c, eta, k: amplitudes(c, eta, k)[at],
        conductor_grid,
        everyday_conductor,
        covers=("fresnel.amplitudes",),
        error="length",
        outside_twice=UNDERFLOWS,
        signed=True,
        at_most_one=True,
    )


UNDERFLOWS = {
    "a vacuum up to a denormal k": lambda x: (x["eta"] == 1) & (x["k"] > 0) & (x["k"] < x.working.smallest_normal),
    "an index whose square underflows, at normal incidence": lambda x: (
        (x["cos_i"] >= 1) & (np.maximum(x["eta"], x["k"]) < 4 * x.working.smallest_normal**0.5)
    ),
}


PLAIN = 1 / 16  # of |g^2|, of |z^2|: nearer to the critical angle a plain sum loses digits, and so is its claim


def off_critical_dielectric(draw: Draw) -> np.ndarray:
    grid = dielectric_grid(Draw(draw.dtype, 2 * draw.points))
    c, eta = grid.T
    return grid[(eta >= 1) | (np.abs((eta - 1) * (eta + 1) + c * c) > PLAIN)]


def off_critical_conductor(draw: Draw) -> np.ndarray:
    grid = conductor_grid(Draw(draw.dtype, 2 * draw.points))
    c, eta, k = grid.T
    return grid[np.hypot((eta - 1) * (eta + 1) - k * k + c * c, 2 * eta * k) > PLAIN]


def dielectric_by(method: str, name: str, grid=dielectric_grid) -> Case:
    return Case(
        name,
        ("cos_i", "eta"),
        lambda c, eta: (fresnel.dielectric(c, eta, method),),
        dielectric,
        grid,
        everyday_dielectric,
        covers=("fresnel.dielectric", "Dielectric", f"dielectric by {method}"),
        at_most_one=True,
    )


def conductor_by(method: str, name: str, grid=conductor_grid) -> Case:
    return Case(
        name,
        ("cos_i", "eta", "k"),
        lambda c, eta, k: (fresnel.conductor(c, eta, k, method),),
        conductor,
        grid,
        everyday_conductor,
        covers=("fresnel.conductor", "Conductor", f"conductor by {method}"),
        outside_twice=UNDERFLOWS,
        at_most_one=True,
    )


CASES = (
    dielectric_by("standard", "fresnel.dielectric"),
    dielectric_by("extended", "fresnel.dielectric, extended"),
    dielectric_by("plain", "fresnel.dielectric, plain", off_critical_dielectric),
    ratio("s"),
    ratio("p"),
    conductor_ratio("s"),
    conductor_ratio("p"),
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
    conductor_by("standard", "fresnel.conductor"),
    conductor_by("extended", "fresnel.conductor, extended"),
    conductor_by("plain", "fresnel.conductor, plain", off_critical_conductor),
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
