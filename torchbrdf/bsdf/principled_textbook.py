"""``tb.Principled`` as its docstring prints it, isotropic, in the plainest way (torchbrdf/testing/textbook.py)."""

from typing import Any

from ..optics.ggx import textbook_d, textbook_lambda
from .shadowing import TEXTBOOK
from .sheen import DECAY, Sheen


def principled(m: Any, p: Any, v: Any) -> Any:
    """``v`` holds the parameters by name."""
    base, coat = dielectric(v["ior"], v["specular"]), dielectric(v["coat_ior"], v["coat"])
    metal = v["metallic"]
    rest = 1 - metal
    f = metal * (v["base_color"] + (1 - v["base_color"]) * fifth(p.wi_h)) + rest * base(p.wi_h)
    mean = 1 - v["specular"] * (f0(v["ior"]) + (1 - f0(v["ior"])) / 23)
    diffuse = rest * v["base_color"] / m.pi * (1 - base(p.cos_i)) * (1 - base(p.cos_o)) / mean
    below = f * facets(m, p, v["roughness"], v["shadowing"]) + diffuse
    coated = (1 - coat(p.cos_i)) * (1 - coat(p.cos_o)) * below + coat(p.wi_h) * facets(m, p, v["coat_roughness"], v["shadowing"])
    bound_i, bound_o = (v["sheen"] * m.exp(-DECAY * m.where(p.above, c, 1) / v["sheen_roughness"]) for c in (p.cos_i, p.cos_o))
    return (1 - bound_i) * (1 - bound_o) * coated + Sheen.textbook(m, p, v["sheen"], v["sheen_roughness"])


def fifth(cos: Any) -> Any:
    """(1 - cos)^5"""
    return (1 - cos) * (1 - cos) * (1 - cos) * (1 - cos) * (1 - cos)


def f0(index: Any) -> Any:
    """Reflectance at normal incidence."""
    return (index - 1) * (index - 1) / ((index + 1) * (index + 1))


def dielectric(index: Any, strength: Any) -> Any:
    """Schlick's law."""
    return lambda cos: strength * (f0(index) + (1 - f0(index)) * fifth(cos))


def facets(m: Any, p: Any, roughness: Any, shadowing: str) -> Any:
    """D G / (4 cos_i cos_o) of GGX."""
    alpha = roughness * roughness
    ci, co = m.where(p.above, p.cos_i, 1), m.where(p.above, p.cos_o, 1)
    g = TEXTBOOK[shadowing](m, p, lambda c: textbook_lambda(m, m.where(p.above, c, 1), alpha))
    return textbook_d(m, m.where(p.above, p.cos2_h, 1), alpha) * g / (4 * ci * co)
