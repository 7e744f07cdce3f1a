"""Make ``lost_energy_fit.py``: ``python -m torchbrdf.bsdf.make_lost_energy``, half a minute.

E(mu, alpha) of a white surface by quadrature, over the slopes of the facets that send light above the horizon: a disk that holds the
origin, :math:`|p + (\\tan\\theta, 0)| < 1/\\cos\\theta`, at whose edge the integrand ends. In polar coordinates its radius is
:math:`e^{-v}` with :math:`\\sinh v = \\tan\\theta\\cos\\phi`, and v and atan(radius/alpha) are the arguments of Gauss's rule. Then a fit
of p to the largest error in L, by least squares whose weights follow the error (Lawson 1961).
"""

import math
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ..quadrature import gauss_legendre
from .lost_energy import DEGREE_A, DEGREE_LOG, DEGREE_MEAN, DEGREE_X, REACH, Fit, Lost, Rough, centred, chebyshev, shape_of
from .rough_conductor import RoughConductor

CASES = (
    *((d, s) for d in ("ggx", "beckmann") for s in ("smith_correlated", "smith_separable", "v_cavity")),
    ("blinn", "v_cavity"),
)
ORDER, CHUNK, ROUNDS = 128, 16, 60
RIDGE = 1e-4  # keeps the two parts of the average from growing large and cancelling
FLOOR = {"ggx": 0.002}  # what an error of p counts beside one of L, so that averages at small alpha are right, too; else 0.015
HEAD = '''"""Made by ``python -m torchbrdf.bsdf.make_lost_energy``: the coefficients of :mod:`~torchbrdf.bsdf.lost_energy`."""

# The largest error of L, that of the albedo of a white surface, over all cosines and alpha in [0.005, 1]
ERRORS = {
%s
}
TEXT = """
%s
"""
'''


def single_albedo(distribution: str, shadowing: str, mu: Tensor, alpha: Tensor, order: int = ORDER) -> Tensor:
    """E ``[N]`` at cosines and roughnesses ``[N]``, float64, of a white surface that is isotropic; to about 1e-5 (1e-9 for Beckmann)."""
    pairs = zip(mu.split(CHUNK), alpha.split(CHUNK), strict=True)
    return torch.cat([_albedo(distribution, shadowing, m, a, order) for m, a in pairs])


def _albedo(distribution: str, shadowing: str, mu: Tensor, alpha: Tensor, order: int) -> Tensor:
    model = RoughConductor(alpha[:, None, None, None], distribution=distribution, shadowing=shadowing)
    mu, alpha = mu.clamp_max(1.0 - 1e-9)[:, None, None], alpha[:, None, None]
    sin, (x, weight) = torch.sqrt((1.0 - mu) * (1.0 + mu)), gauss_legendre(order)
    psi, tan = math.pi * (x - 0.5)[:, None], sin / mu
    end = torch.asinh(tan)
    v = end * torch.sin(psi)
    cos_phi = torch.sinh(v) / tan
    sin_phi = torch.sqrt(torch.sinh(end - v) * torch.sinh(end + v)) / tan
    around = math.pi * weight[:, None] * torch.cosh(v) * end * torch.cos(psi) / (tan * sin_phi)  # d phi
    chi_end = torch.atan(torch.exp(-v) / alpha)
    chi = chi_end * x
    r = alpha * torch.tan(chi)
    along = weight * chi_end * alpha * r / torch.cos(chi) ** 2  # r d r
    cos_h = 1.0 / torch.sqrt(1.0 + r * r)
    wo = torch.stack([-sin, torch.zeros_like(sin), mu], -1)
    half = torch.stack([r * cos_phi, r * sin_phi, torch.ones_like(r * cos_phi)], -1) * cos_h[..., None]
    wo_h = (half * wo).sum(-1)
    wi = 2.0 * wo_h[..., None] * half - wo
    f = model.evaluate(wi, wo.expand_as(wi), assume_unit=True).squeeze(-1)
    return (f * wi[..., 2] * 4.0 * wo_h * cos_h**3 * 2.0 * around * along).sum((-1, -2))


def fitted(distribution: str, shadowing: str) -> tuple[Fit, float]:
    """The fit, and its largest error at other points."""
    root, vanishes = shape_of(distribution, shadowing)
    x, alpha = _grid(32, 18)
    mu = REACH * alpha * x / (1.0 + REACH * alpha - x)
    lost = 1.0 - single_albedo(distribution, shadowing, mu, alpha)
    base = (REACH * alpha / (mu + REACH * alpha)) ** 2 * (x if vanishes else 1.0)
    p = torch.sqrt(lost.clamp_min(0.0) / base)
    z = 2.0 * (torch.sqrt(x) if root else x) - 1.0
    rows = _polynomial(base.numpy(), p.numpy(), z.numpy(), centred(alpha).numpy(), FLOOR.get(distribution, 0.015))
    bare = Fit(rows, (0.0,) * (DEGREE_MEAN + 1), (0.0,) * (DEGREE_LOG + 1), root, vanishes)
    mean, log = _mean(bare)
    fit = bare._replace(mean=mean, log=log)
    rng = torch.Generator().manual_seed(0)
    alpha = 0.005 ** torch.rand(2000, generator=rng, dtype=torch.float64)
    x = torch.rand(2000, generator=rng, dtype=torch.float64) ** 1.5
    x[:200], alpha[-200:] = 1.0, 1.0  # along the edges, too
    mu = REACH * alpha * x / (1.0 + REACH * alpha - x)
    found = single_albedo(distribution, shadowing, mu, alpha) + Lost.of(fit, Rough(alpha, alpha, True)).at(mu, None)
    return fit, float((found - 1.0).abs().max())


def _grid(count_x: int, count_a: int) -> tuple[Tensor, Tensor]:
    x, a = (0.5 - 0.5 * torch.cos(math.pi * (torch.arange(n, dtype=torch.float64) + 0.5) / n) for n in (count_x, count_a))
    ends = torch.tensor([1e-4, 2e-3, 1.0], dtype=torch.float64)
    found = torch.meshgrid(torch.cat([x**1.5, ends]), torch.cat([a**1.5, ends]), indexing="ij")
    return found[0].flatten(), found[1].flatten()


def _polynomial(base: np.ndarray, p: np.ndarray, z: np.ndarray, t: np.ndarray, floor: float) -> tuple[tuple[float, ...], ...]:
    """Rows of p, by degree in z and t."""
    from numpy.polynomial.chebyshev import chebvander

    parts = chebvander(z, DEGREE_X), chebvander(t, DEGREE_A)
    columns = np.einsum("np,nq->npq", *parts).reshape(len(p), -1)
    doubt, best = np.ones(len(p)), (np.inf, np.zeros(columns.shape[1]))
    for _ in range(ROUNDS):
        w = (base * p + floor) * np.sqrt(doubt)
        c = np.linalg.lstsq(columns * w[:, None], p * w, rcond=None)[0]
        found = columns @ c
        error = base * np.abs(found**2 - p**2) + floor * np.abs(found - p)
        best = min(best, (error.max(), c), key=lambda pair: pair[0])
        doubt = doubt * (error / error.max() + 0.02)
        doubt /= doubt.max()
    return tuple(map(tuple, best[1].reshape(DEGREE_X + 1, DEGREE_A + 1)))


def _mean(bare: Fit) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """The average of the fit itself over diffuse light, so that the lobe returns L whatever the error of L."""
    alpha = torch.from_numpy(np.concatenate([np.geomspace(1e-5, 1.0, 100), np.linspace(0.01, 1.0, 120)]))
    average = exact_mean(bare, alpha)
    basis = chebyshev(centred(alpha), DEGREE_MEAN)
    both = torch.stack([*basis, *(torch.log(alpha) * t for t in basis[: DEGREE_LOG + 1])], -1)
    weight = 0.1 + alpha  # the rougher, the more is lost
    columns = torch.cat([both * (weight * alpha * alpha / average)[:, None], RIDGE * torch.eye(both.shape[1], dtype=both.dtype)])
    c = np.linalg.lstsq(columns.numpy(), np.pad(weight.numpy(), (0, both.shape[1])), rcond=None)[0]
    return tuple(c[: DEGREE_MEAN + 1]), tuple(c[DEGREE_MEAN + 1 :])


def exact_mean(fit: Fit, alpha: Tensor) -> Tensor:
    """The average ``[N]`` over diffuse light of a fit of L at roughnesses ``[N]``, by quadrature in asinh(mu / alpha)."""
    q, weight = gauss_legendre(300)
    end = torch.asinh(1.0 / alpha)[:, None]
    mu, a = alpha[:, None] * torch.sinh(end * q), alpha[:, None]
    lost = Lost.of(fit, Rough(a, a, True)).at(mu, None)
    return (lost * 2.0 * mu * a * torch.cosh(end * q) * end * weight).sum(-1)


def main() -> None:
    """Write the file, and print the errors."""
    errors, blocks = [], []
    for distribution, shadowing in CASES:
        fit, error = fitted(distribution, shadowing)
        errors.append(f'    ("{distribution}", "{shadowing}"): {error:.1e},')
        numbers = [f"{c:.9g}" for row in (*fit.rows, fit.mean, fit.log) for c in row]
        lines = [" ".join(numbers[k : k + 8]) for k in range(0, len(numbers), 8)]
        blocks.append("\n".join([f"{distribution}+{shadowing}", *lines]))
        print(errors[-1].strip())
    Path(__file__).with_name("lost_energy_fit.py").write_text(HEAD % ("\n".join(errors), "\n\n".join(blocks)), encoding="utf-8")


if __name__ == "__main__":
    main()
