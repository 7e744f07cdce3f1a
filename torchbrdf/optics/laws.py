"""Fresnel's laws and the ways to compute them, one method each (torchbrdf/method.py); the ledger measures them."""

from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..method import Law, Method
from . import fresnel
from .fresnel import Dielectric

SCHLICK = "Schlick 1994, eq. 15"


def conductor_textbook(m: Any, cos: Any, eta: Any, k: Any) -> Any:
    """Born & Wolf 1999, sec. 14.2: the refracted direction's a + ib = sqrt((eta + ik)^2 - sin^2), and both amplitudes."""
    real, imag = eta * eta - k * k - (1 - cos * cos), 2 * eta * k
    forward = m.positive(real)
    modulus = m.sqrt(real * real + imag * imag)
    large = m.sqrt((modulus + m.where(forward, real, -1 * real)) / 2)
    small = imag / (2 * large)
    a, b = m.where(forward, large, small), m.where(forward, small, large)
    re, im = (eta * eta - k * k) * cos, imag * cos
    r_s = ((cos - a) * (cos - a) + b * b) / ((cos + a) * (cos + a) + b * b)
    r_p = ((re - a) * (re - a) + (im - b) * (im - b)) / ((re + a) * (re + a) + (im + b) * (im + b))
    return (r_s + r_p) / 2


def dielectric_f0(eta: Tensor) -> Tensor:
    """Reflectance at normal incidence."""
    amplitude = (eta - 1.0) / (eta + 1.0)
    return amplitude * amplitude


def conductor_f0(eta: Tensor, k: Tensor) -> Tensor:
    """Reflectance at normal incidence."""
    less, more = eta - 1.0, eta + 1.0
    return (less * less + k * k) / (more * more + k * k)


def constant(cos: Tensor, f0: Tensor) -> Tensor:
    """The same at every angle."""
    return torch.broadcast_tensors(f0, cos)[0]


def critical_angle(rng: Any, count: int) -> dict[str, Any]:
    """Cosines about that of the critical angle, from inside the denser medium."""
    eta = rng.uniform(0.4, 0.99, count)
    away = np.exp(rng.uniform(np.log(1e-7), np.log(0.1), count)) * rng.choice([-1.0, 1.0], count)
    return {"cos_i": np.sqrt((1.0 - eta) * (1.0 + eta)) * (1.0 + away), "eta": eta}


LAWS = (
    Law(
        "dielectric",
        {"cos_i": (0.05, 1.0), "eta": (1.2, 2.5)},
        Dielectric.textbook,
        (
            Method("standard", fresnel.dielectric, "tb.Dielectric(eta)", "this package, after Cook & Torrance 1982", "16 ulp everywhere"),
            Method(
                "Schlick",
                lambda cos, eta: fresnel.schlick(cos, dielectric_f0(eta)),
                "tb.Schlick(((eta - 1) / (eta + 1)) ** 2)",
                SCHLICK,
                "0.12 for eta in [1.2, 2.5], 0.07 in [1.3, 1.8]",
                exact=False,
            ),
            Method(
                "constant",
                lambda cos, eta: constant(cos, dielectric_f0(eta)),
                "no Fresnel term: f0 = ((eta - 1) / (eta + 1)) ** 2 times the strength",
                "the reflectance at normal incidence",
                "0.75 at grazing",
                exact=False,
            ),
        ),
        hard=critical_angle,
        hard_where="about the critical angle, from 1e-7 to 0.1 of its cosine",
    ),
    Law(
        "conductor",
        {"cos_i": (0.05, 1.0), "eta": (0.1, 3.0), "k": (0.5, 7.0)},
        conductor_textbook,
        (
            Method("standard", fresnel.conductor, "tb.Conductor(eta, k)", "this package, after Born & Wolf 1999", "16 ulp everywhere"),
            Method(
                "Schlick",
                lambda cos, eta, k: fresnel.schlick(cos, conductor_f0(eta, k)),
                "tb.Schlick(((eta - 1) ** 2 + k**2) / ((eta + 1) ** 2 + k**2))",
                SCHLICK,
                "0.35 over the whole domain",
                exact=False,
            ),
            Method(
                "constant",
                lambda cos, eta, k: constant(cos, conductor_f0(eta, k)),
                "no Fresnel term: f0 times the strength",
                "the reflectance at normal incidence",
                "0.75 at grazing",
                exact=False,
            ),
        ),
        hard=lambda rng, count: critical_angle(rng, count) | {"k": np.exp(rng.uniform(np.log(1e-6), np.log(0.1), count))},
        hard_where="k from 1e-6 to 0.1, about the critical angle, from 1e-7 to 0.1 of its cosine",
    ),
)
