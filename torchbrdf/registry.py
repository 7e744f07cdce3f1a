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
    "Sum": "bsdf.combine",
    "Scaled": "bsdf.combine",
    "TwoSided": "bsdf.two_sided",
}
FRESNEL_TERMS = {
    "Dielectric": "optics.fresnel",
    "Conductor": "optics.fresnel",
    "Schlick": "optics.fresnel",
}

# Laws that have several methods (torchbrdf/method.py): the name of each, and the file whose LAWS hold it.
LAWS: dict[str, str] = {}


def registered(table: dict[str, str]) -> tuple[type[Any], ...]:
    """The classes of one of the tables above, in order."""
    return tuple(getattr(importlib.import_module(f"{__package__}.{module}"), name) for name, module in table.items())
