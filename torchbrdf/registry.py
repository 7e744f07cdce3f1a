"""Which models there are: one line each, ``name: file``.

This is the one line that a new model adds. The public face offers the names here as ``tb.<name>``, and the contract of
``torchbrdf.testing`` runs over all of them. Nothing is imported before it is asked for.
"""

import importlib
from typing import Any

BSDFS = {
    "Lambert": "bsdf.lambert",
    "Phong": "bsdf.phong",
    "BlinnPhong": "bsdf.blinn_phong",
    "Mirror": "bsdf.mirror",
    "RoughConductor": "bsdf.rough_conductor",
    "RoughDielectric": "bsdf.rough_dielectric",
    "SmoothDielectric": "bsdf.smooth_dielectric",
    "Sum": "bsdf.combine",
    "Scaled": "bsdf.combine",
    "TwoSided": "bsdf.two_sided",
    "Coated": "bsdf.coated",
    "CookTorrance": "bsdf.cook_torrance",
    "Principled": "bsdf.principled",
    "Sheen": "bsdf.sheen",
}
FRESNEL_TERMS = {
    "Dielectric": "optics.fresnel",
    "Conductor": "optics.fresnel",
    "Schlick": "optics.fresnel",
    "F82Tint": "optics.f82",
}
DISTRIBUTIONS = {
    "GGX": "optics.ggx",
    "Beckmann": "optics.beckmann",
    "Blinn": "optics.blinn",
}

# Laws that have several methods (torchbrdf/method.py): the name of each, and the file whose LAWS hold it.
LAWS = {
    "dielectric": "optics.laws",
    "conductor": "optics.laws",
    "dielectric_average": "optics.laws",
    "phong_lobe": "bsdf.laws",
    "blinn_lobe": "bsdf.laws",
    "beckmann_g1": "bsdf.facet_laws",
    "ggx_visibility": "bsdf.facet_laws",
    "ggx_d": "bsdf.facet_laws",
}


def registered(table: dict[str, str]) -> tuple[type[Any], ...]:
    """The classes of one of the tables above, in order."""
    return tuple(getattr(importlib.import_module(f"{__package__}.{module}"), name) for name, module in table.items())


def laws() -> dict[str, Any]:
    """The laws of the table above, by name."""
    found = {law.name: law for module in dict.fromkeys(LAWS.values()) for law in importlib.import_module(f"{__package__}.{module}").LAWS}
    if found.keys() != LAWS.keys():
        raise LookupError(f"registry.LAWS: {sorted(found.keys() ^ LAWS.keys())} stand in one of the table and the files, not in both")
    return {name: found[name] for name in LAWS}
