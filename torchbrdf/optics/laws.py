"""Fresnel's laws and the ways to compute them, one method each (torchbrdf/method.py); the ledger measures them."""

from collections.abc import Callable
from typing import Any

import numpy as np
from torch import Tensor

from ..method import Law, Method
from . import approximations, dielectric_average, fresnel


def critical_angle(rng: Any, count: int) -> dict[str, Any]:
    """Cosines about that of the critical angle, from inside the denser medium."""
    eta = rng.uniform(0.4, 0.99, count)
    away = np.exp(rng.uniform(np.log(1e-7), np.log(0.1), count)) * rng.choice([-1.0, 1.0], count)
    return {"cos_i": np.sqrt((1.0 - eta) * (1.0 + eta)) * (1.0 + away), "eta": eta}


def exactly(law: Callable[..., Tensor], call: str, source: str, plain: str) -> tuple[Method, ...]:
    """The law by its three arithmetics."""

    def by(name: str, how: str, claim: str) -> Method:
        asked = "" if name == "standard" else f', method="{name}"'
        return Method(name, lambda *x: law(*x, method=name), call.format(asked), f"{source}; {how}", claim)

    return (
        by("standard", "g^2 by float64", "16 ulp everywhere"),
        by("extended", "g^2 by compensated sums (Ogita, Rump & Oishi 2005), both amplitudes", "16 ulp everywhere"),
        by("plain", "g^2 as it comes", plain),
    )


LAWS: tuple[Law, ...] = (
    Law(
        "dielectric",
        {"cos_i": (0.05, 1.0), "eta": (1.2, 2.5)},
        fresnel.Dielectric.textbook,
        (
            *exactly(fresnel.dielectric, "tb.Dielectric(eta{})", "Cook & Torrance 1982", "16 ulp from |g^2| = 1/16 on, or for eta >= 1"),
            Method(
                "Schlick",
                approximations.dielectric_schlick,
                "tb.Schlick(((eta - 1) / (eta + 1)) ** 2)",
                "Schlick 1994, eq. 15",
                "0.12 for eta in [1.2, 2.5], 0.07 in [1.3, 1.8]",
                exact=False,
            ),
            Method(
                "constant",
                approximations.dielectric_constant,
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
        fresnel.Conductor.textbook,
        (
            *exactly(fresnel.conductor, "tb.Conductor(eta, k{})", "Born & Wolf 1999, sec. 14.2", "16 ulp from |g^2| = 1/16 on"),
            Method(
                "F82 tint",
                approximations.conductor_f82,
                "torchbrdf.optics.approximations.conductor_f82(cos_i, eta, k)",
                "Hoffman 2019; Kutz et al. 2021; of Lazanyi & Szirmay-Kalos 2005",
                "0.25 over the whole domain, 0.024 of the measured metals",
                exact=False,
            ),
            Method(
                "Schlick",
                approximations.conductor_schlick,
                "tb.Schlick(((eta - 1) ** 2 + k**2) / ((eta + 1) ** 2 + k**2))",
                "Schlick 1994, eq. 15",
                "0.35 over the whole domain, 0.2 of the measured metals",
                exact=False,
            ),
            Method(
                "constant",
                approximations.conductor_constant,
                "no Fresnel term: f0 times the strength",
                "the reflectance at normal incidence",
                "0.8 at grazing",
                exact=False,
            ),
        ),
        hard=lambda rng, count: critical_angle(rng, count) | {"k": np.exp(rng.uniform(np.log(1e-6), np.log(0.1), count))},
        hard_where="k from 1e-6 to 0.1, about the critical angle, from 1e-7 to 0.1 of its cosine",
    ),
    Law(
        "dielectric_average",
        {"eta": (1.2, 2.5)},
        dielectric_average.textbook,
        (
            Method(
                "standard",
                fresnel.dielectric_average,
                "tb.fresnel.dielectric_average(eta)",
                "Walsh 1926; Duntley 1942, eq. 14; poles divided out",
                "16 ulp everywhere",
            ),
            Method(
                "d'Eon & Irving",
                approximations.average_deon,
                "torchbrdf.optics.approximations.average_deon(eta)",
                "d'Eon & Irving 2011, twice C_1",
                "5e-5 for eta in [1.2, 2.5], 2.1e-4 from 1 on",
                exact=False,
            ),
            Method(
                "Egan & Hilgeman",
                approximations.average_egan,
                "torchbrdf.optics.approximations.average_egan(eta)",
                "Egan & Hilgeman 1973, of the light inside",
                "0.033 for eta in [1.2, 2.5], 0.0012 in [1.3, 1.8]",
                exact=False,
            ),
        ),
        hard=lambda rng, count: {"eta": 1.0 + np.exp(rng.uniform(np.log(1e-6), np.log(0.1), count)) * rng.choice([-1.0, 1.0], count)},
        hard_where="from 1e-6 to 0.1 of 1, to either side",
    ),
)
