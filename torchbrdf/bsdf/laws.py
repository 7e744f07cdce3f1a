"""The lobes of Phong and Blinn, of strength 1, and the ways to compute them (torchbrdf/method.py)."""

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from ..method import Law, Method
from .blinn_phong import BlinnPhong, normal_view_factor
from .phong import NORMALIZATIONS, Phong

EXPONENTS, DIMMEST, GRAZING = (1.0, 200.0), 1e-3, 0.05  # everyday: the lobe over its peak, and the cosines of both directions
WHERE = "where the lobe is above 1e-3 of its peak, exponents up to 200"


def phong(wi: Tensor, wo: Tensor, n: Tensor, s: Tensor) -> Tensor:
    """``N(s) max(0, wi.R(wo))^s`` as the model computes it."""
    return _phong(s).evaluate(wi, wo, n)


def phong_unit(wi: Tensor, wo: Tensor, n: Tensor, s: Tensor) -> Tensor:
    """The same of directions that are not normalised again."""
    return _phong(s).evaluate(wi, wo, n, assume_unit=True)


def phong_pow(wi: Tensor, wo: Tensor, n: Tensor, s: Tensor) -> Tensor:
    """The same complement of the cosine, and torch's ``pow``."""
    return _modified(s) * _above(1.0 - _phong(s).geometry(wi, wo, n).mirror_complement) ** s


def phong_dot(wi: Tensor, wo: Tensor, n: Tensor, s: Tensor) -> Tensor:
    """As pasted: a dot product to the power of s."""
    wi, wo, n = (functional.normalize(w, dim=-1) for w in (wi, wo, n))
    mirror = 2.0 * _dot(n, wo).unsqueeze(-1) * n - wo
    return _modified(s) * _above(_dot(wi, mirror)) ** s


def blinn(wi: Tensor, wo: Tensor, n: Tensor, s: Tensor) -> Tensor:
    """``N(s) (n.h)^s`` as the model computes it."""
    return _blinn(s).evaluate(wi, wo, n)


def blinn_unit(wi: Tensor, wo: Tensor, n: Tensor, s: Tensor) -> Tensor:
    """The same of directions that are not normalised again."""
    return _blinn(s).evaluate(wi, wo, n, assume_unit=True)


def blinn_pow(wi: Tensor, wo: Tensor, n: Tensor, s: Tensor) -> Tensor:
    """The same half vector, and torch's ``pow``."""
    return normal_view_factor(s) * _blinn(s).geometry(wi, wo, n).cos_h ** s


def blinn_dot(wi: Tensor, wo: Tensor, n: Tensor, s: Tensor) -> Tensor:
    """As pasted: normalise everything, a dot product to the power of s."""
    wi, wo, n = (functional.normalize(w, dim=-1) for w in (wi, wo, n))
    return normal_view_factor(s) * _above(_dot(n, functional.normalize(wi + wo, dim=-1))) ** s


def _phong(s: Tensor) -> Phong:
    return Phong(torch.ones_like(s[:1]), s.unsqueeze(-1))


def _blinn(s: Tensor) -> BlinnPhong:
    return BlinnPhong(torch.ones_like(s[:1]), s.unsqueeze(-1))


def _modified(s: Tensor) -> Tensor:
    return NORMALIZATIONS["modified"](s)


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return (a * b).sum(-1)


def _above(cos: Tensor) -> Tensor:
    return cos.clamp_min(0.0)


def draw(rng: Any, count: int, about_half: bool) -> dict[str, Any]:
    """Directions at which the lobe is bright, for exponents spread over their logarithm, in frames turned anyhow."""
    found: list[Any] = []
    while sum(map(len, found)) < count:
        found.append(_candidates(rng, 4 * count, about_half))
    rows = np.concatenate(found)[:count]
    return {"wi": rows[:, :3], "wo": rows[:, 3:6], "n": rows[:, 6:9], "exponent": rows[:, 9]}


def _candidates(rng: Any, count: int, about_half: bool) -> Any:
    exponent = np.exp(rng.uniform(*np.log(EXPONENTS), count))
    cosine = np.exp(rng.uniform(np.log(DIMMEST), 0.0, count) / exponent)
    wo, n = (directions(rng.normal(size=(count, 3))) for _ in range(2))
    wo *= np.sign(inner(wo, n))
    middle = n if about_half else 2.0 * inner(n, wo) * n - wo
    lobe = turned(rng, middle, cosine)
    wi = 2.0 * inner(lobe, wo) * lobe - wo if about_half else lobe
    keep = (inner(wi, n) > GRAZING) & (inner(wo, n) > GRAZING)
    return np.concatenate([wi, wo, n, exponent[:, None]], 1)[keep[:, 0]]


def turned(rng: Any, axis: Any, cosine: Any) -> Any:
    """Directions at this cosine to the axis, on any side of it."""
    across = rng.normal(size=axis.shape)
    across = directions(across - inner(across, axis) * axis)
    return cosine[:, None] * axis + np.sqrt((1.0 - cosine) * (1.0 + cosine))[:, None] * across


def directions(v: Any) -> Any:
    """Rows to unit length."""
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def inner(a: Any, b: Any) -> Any:
    """Of rows ``[N, 3]``, as ``[N, 1]``."""
    return (a * b).sum(1, keepdims=True)


LAWS = (
    Law(
        "phong_lobe",
        {"exponent": EXPONENTS},
        lambda m, p, s: Phong.textbook(m, p, 1, s, lambda cos: 1, "modified"),
        (
            # At 1e-3 of the peak and an exponent of 1 the cosine is 1e-3, of which the rounding of a dot product, 2 to 3 eps, is 3e-4.
            Method("log1p", phong, "tb.Phong(k, s)", "this package", f"3e-4 of the value {WHERE}"),
            Method(
                "assume_unit",
                phong_unit,
                "tb.Phong(k, s).evaluate(wi, wo, n, assume_unit=True)",
                "this package; directions are not normalised",
                f"3e-4 of the value {WHERE}",
            ),
            Method("pow", phong_pow, "(1 - m).clamp_min(0) ** s of the complement m", "torch's pow", f"3e-4 of the value {WHERE}"),
            Method("dot and pow", phong_dot, "(wi . R(wo)).clamp_min(0) ** s", "Phong 1975, as pasted", f"3e-4 of the value {WHERE}"),
        ),
        ("wi", "wo", "n"),
        lambda rng, count: draw(rng, count, about_half=False),
    ),
    Law(
        "blinn_lobe",
        {"exponent": EXPONENTS},
        lambda m, p, s: BlinnPhong.textbook(m, p, 1, s, lambda cos: 1),
        (
            Method("log1p", blinn, "tb.BlinnPhong(k, s)", "this package", f"2e-5 of the value {WHERE}"),
            Method(
                "assume_unit",
                blinn_unit,
                "tb.BlinnPhong(k, s).evaluate(wi, wo, n, assume_unit=True)",
                "this package; directions are not normalised",
                f"2e-5 of the value {WHERE}",
            ),
            Method("pow", blinn_pow, "cos_h ** s", "torch's pow", f"1e-4 of the value {WHERE}"),
            Method(
                "dot and pow",
                blinn_dot,
                "(n . normalize(wi + wo)).clamp_min(0) ** s",
                "Blinn 1977, as pasted",
                f"1e-4 of the value {WHERE}",
            ),
        ),
        ("wi", "wo", "n"),
        lambda rng, count: draw(rng, count, about_half=True),
    ),
)
