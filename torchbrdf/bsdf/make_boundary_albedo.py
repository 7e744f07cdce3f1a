"""Make ``boundary_albedo_fit.py``: ``python -m torchbrdf.bsdf.make_boundary_albedo``, a minute.

The albedo by the quadrature of :mod:`~torchbrdf.bsdf.make_lost_energy`, with F at each facet; the cosine at which F is its mean by
bisection (F falls with the cosine, for eta up to 3); then p by least squares whose weights follow the error (Lawson 1961).
"""

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ..optics.dielectric import dielectric
from .boundary_albedo import DEGREE_A, DEGREE_INSIDE, DEGREE_N, DEGREE_X, REACH, index_argument, roughness_argument
from .make_lost_energy import CASES, facet_rule
from .rough_dielectric import RoughDielectric

ANGLES = 64  # of Mitsuba's tables
ETAS = (1.1, 1.14, 1.2, 1.28, 1.38, 1.5, 1.65, 1.8, 2.0, 2.25, 2.5, 2.75, 3.0)
ORDER, ORDER_THROUGH, CHUNK, ROUNDS = 80, 24, 16, 20
HEAD = '''"""Made by ``python -m torchbrdf.bsdf.make_boundary_albedo``: the coefficients of :mod:`~torchbrdf.bsdf.boundary_albedo`."""

# The largest error of E but for that of L (of "inside" that of the mean), over all cosines, alpha in [0.01, 1], eta in [1.1, 3]
ERRORS = {
%s
}
TEXT = """
%s
"""
'''


def boundary_albedos(distribution: str, shadowing: str, mu: Tensor, alpha: Tensor, etas: tuple[float, ...]) -> tuple[Tensor, Tensor]:
    """E ``[N, K]`` at cosines and roughnesses ``[N]`` and K indices, float64, and the albedo ``[N]`` of the same facets in white."""
    found = []
    for m, a in zip(mu.split(CHUNK), alpha.split(CHUNK), strict=True):
        cos, weight = facet_rule(distribution, shadowing, m, a, ORDER)
        seen = cos.clamp(0.0, 1.0)  # rounding takes it beyond 1
        found.append(torch.stack([(weight * (dielectric(seen, eta) if eta else 1.0)).sum((-1, -2)) for eta in (*etas, 0.0)], -1))
    table = torch.cat(found)
    return table[:, :-1], table[:, -1]


def fitted(distribution: str, shadowing: str) -> tuple[np.ndarray, float]:
    """Coefficients ``[X, A, N]``, and the largest error of E at other points."""
    mu, alpha = _grid(24, 13)
    reflected, white = boundary_albedos(distribution, shadowing, mu, alpha, ETAS)
    rows = _polynomial(mu, alpha, reflected / white[:, None], white)
    rng = np.random.default_rng(0)
    mu, alpha = torch.from_numpy(rng.uniform(0.0, 1.0, 400) ** 2), torch.from_numpy(0.01 ** rng.uniform(0.0, 1.0, 400))
    etas = (1.12, 1.33, 1.57, 2.1, 2.9)
    reflected, white = boundary_albedos(distribution, shadowing, mu, alpha, etas)
    return rows, float(_error(rows, mu, alpha, etas, reflected / white[:, None], white).max())


def _error(rows: np.ndarray, mu: Tensor, alpha: Tensor, etas: tuple[float, ...], mean: Tensor, white: Tensor) -> Tensor:
    columns, base, eta = _columns(mu, alpha, etas)
    cos = (mu[:, None] + base[:, None] * torch.from_numpy(columns @ rows.ravel()).reshape(len(mu), -1)).clamp(0.0, 1.0)
    return (white[:, None] * (dielectric(cos, eta) - mean)).abs()


def _columns(mu: Tensor, alpha: Tensor, etas: tuple[float, ...]) -> tuple[np.ndarray, Tensor, Tensor]:
    """Of the polynomial ``[N K, coefficients]``; what stands before it ``[N]``; the indices."""
    from numpy.polynomial.chebyshev import chebvander

    reach, eta = REACH * alpha, torch.tensor(etas, dtype=torch.float64)
    x = chebvander((2.0 * mu * (1.0 + reach) / (mu + reach) - 1.0).numpy(), DEGREE_X)
    a, n = chebvander(roughness_argument(alpha).numpy(), DEGREE_A), chebvander(index_argument(eta).numpy(), DEGREE_N)
    columns = np.einsum("mx,ma,kn->mkxan", x, a, n).reshape(len(mu) * len(etas), -1)
    return columns, reach / (mu + reach) * alpha / (alpha + 0.3), eta


def _grid(count_x: int, count_a: int) -> tuple[Tensor, Tensor]:
    x, a = (0.5 - 0.5 * np.cos(np.pi * (np.arange(n) + 0.5) / n) for n in (count_x, count_a))
    both = np.meshgrid(np.concatenate([x**2, [1e-4, 1.0]]), np.concatenate([0.01 + 0.99 * a**1.5, [0.01, 1.0]]), indexing="ij")
    return torch.from_numpy(both[0].ravel()), torch.from_numpy(both[1].ravel())


def _cosine_of(mean: Tensor, eta: Tensor) -> Tensor:
    """Where F is ``mean``."""
    low, high = torch.zeros_like(mean), torch.ones_like(mean)
    for _ in range(60):
        middle = 0.5 * (low + high)
        more = dielectric(middle, eta) > mean
        low, high = torch.where(more, middle, low), torch.where(more, high, middle)
    return 0.5 * (low + high)


def _polynomial(mu: Tensor, alpha: Tensor, mean: Tensor, white: Tensor) -> np.ndarray:
    columns, base, eta = _columns(mu, alpha, ETAS)
    cos = _cosine_of(mean, eta)
    slope = (dielectric((cos + 1e-5).clamp_max(1.0), eta) - dielectric((cos - 1e-5).clamp_min(0.0), eta)).abs() / 2e-5
    scale = (white[:, None] * slope + 1e-3).numpy().ravel()
    target, before = (cos - mu[:, None]).numpy().ravel(), base[:, None].expand_as(cos).numpy().ravel()
    doubt, best = np.ones_like(scale), (np.inf, np.zeros(columns.shape[1]))
    for _ in range(ROUNDS):
        w = scale * np.sqrt(doubt)
        weighted = columns * (w * before)[:, None]
        gram = weighted.T @ weighted
        gram += 1e-13 * np.trace(gram) / len(gram) * np.eye(len(gram))
        c = np.linalg.solve(gram, weighted.T @ (target * w))
        error = _error(c, mu, alpha, ETAS, mean, white).numpy().ravel()
        best = min(best, (error.max(), c), key=lambda pair: pair[0])
        doubt = doubt * (error / error.max() + 0.02)
        doubt /= doubt.max()
    return best[1].reshape(DEGREE_X + 1, DEGREE_A + 1, DEGREE_N + 1)


def inside(distribution: str) -> tuple[np.ndarray, float]:
    """Coefficients ``[A, N]`` of Mitsuba's ``internal_reflectance``, and their largest error.

    It is twice the plain mean of E mu over 64 cosines from 0 to 1, E that of the boundary from inside with separable shadowing.
    """
    from numpy.polynomial.chebyshev import chebvander

    alphas = torch.tensor(0.01 + 0.99 * (0.5 - 0.5 * np.cos(np.pi * (np.arange(20) + 0.5) / 20)) ** 1.5)
    mu = torch.linspace(0.0, 1.0, ANGLES, dtype=torch.float64).clamp_min(1e-6)
    pairs = [x.flatten() for x in torch.meshgrid(alphas, mu, indexing="ij")]
    reflected, _ = boundary_albedos(distribution, "smith_separable", pairs[1], pairs[0], tuple(1.0 / eta for eta in ETAS))
    mean = 2.0 * (reflected.unflatten(0, (-1, ANGLES)) * mu[:, None]).mean(1)
    a = chebvander(roughness_argument(alphas).numpy(), DEGREE_INSIDE)
    n = chebvander(index_argument(torch.tensor(ETAS, dtype=torch.float64)).numpy(), DEGREE_N)
    columns = np.einsum("ma,kn->mkan", a, n).reshape(mean.numel(), -1)
    c = np.linalg.lstsq(columns, mean.numpy().ravel(), rcond=None)[0]
    return c.reshape(DEGREE_INSIDE + 1, DEGREE_N + 1), float(np.abs(columns @ c - mean.numpy().ravel()).max())


def through(distribution: str, rows: np.ndarray) -> tuple[np.ndarray, float]:
    """Coefficients ``[X, A, N]`` of what single refraction at facets lets through, over 1 - F at the mean cosine, and the largest error."""
    mu, alpha = _grid(16, 11)
    eta = torch.tensor(ETAS, dtype=torch.float64)
    w = torch.stack([torch.sqrt((1.0 - mu) * (1.0 + mu)), 0.0 * mu, mu], -1)
    model = RoughDielectric(alpha[:, None, None], eta[:, None], distribution, "smith_separable", mode="flux", part="transmission")
    wanted = model.directional_albedo(w[:, None, :], order=ORDER_THROUGH).squeeze(-1)
    columns, base, _ = _columns(mu, alpha, ETAS)
    cos = (mu[:, None] + base[:, None] * torch.from_numpy(columns @ rows.ravel()).reshape(wanted.shape)).clamp(0.0, 1.0)
    before = (1.0 - dielectric(cos, eta)).numpy().ravel()
    target, scaled = wanted.numpy().ravel(), columns * before[:, None]
    c = np.linalg.lstsq(scaled, target, rcond=1e-10)[0]
    return c.reshape(rows.shape), float(np.abs(scaled @ c - target).max())


def main() -> None:
    """Write the file, and print the errors."""
    errors, blocks = [], []
    made = [(case, fitted(*case)) for case in CASES] + [((d, "inside"), inside(d)) for d in ("ggx", "beckmann")]
    separable = {case[0]: found[0] for case, found in made if case[1] == "smith_separable"}
    made += [((d, "through"), through(d, rows)) for d, rows in separable.items()]
    for (distribution, shadowing), (rows, error) in made:
        errors.append(f'    ("{distribution}", "{shadowing}"): {error:.1e},')
        numbers = [f"{c:.8g}" for c in rows.ravel()]
        lines = [" ".join(numbers[k : k + 8]) for k in range(0, len(numbers), 8)]
        blocks.append("\n".join([f"{distribution}+{shadowing}", *lines]))
        print(errors[-1].strip(), flush=True)
    Path(__file__).with_name("boundary_albedo_fit.py").write_text(HEAD % ("\n".join(errors), "\n\n".join(blocks)), encoding="utf-8")


if __name__ == "__main__":
    main()
