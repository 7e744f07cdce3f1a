"""torchbrdf: batched, differentiable reflection models for inverse rendering in PyTorch.

One straight way for light: mesh -> G-buffer -> plan -> material -> effects -> radiance -> loss. Every public name is loaded
when it is first used, so that ``import torchbrdf`` costs little more than ``import torch``.
"""

import importlib
from typing import Any

from .registry import BSDFS, DISTRIBUTIONS, FRESNEL_TERMS
from .synonyms import UnknownName

__version__ = "0.1.0"

# Where each public name lives; the models have a registry of their own.
# (No public function bears a module's name: tb.plan lives in planning.py.)
_HOME = {
    "geometry": ("Geometry", "Layout", "Viewer"),
    "interval": ("Interval",),
    "constraint": ("Constraint",),
    "lookup": ("bilinear",),
    "vector": ("Frame", "normalize", "reflect", "refract", "is_planar", "planar"),
    "declaration": ("param",),
    "value": ("Value", "validate"),
    "loading": ("load_value",),
    "stacking": ("stack",),
    "io.pictures": ("read_image", "save_image"),
    "optics.fresnel": ("Fresnel",),
    "optics.distribution": ("Distribution", "alpha_from_exponent", "alpha_from_roughness", "exponent_from_alpha", "roughness_from_alpha"),
    "bsdf.base": ("Bsdf",),
    "bsdf.lobe": ("BSDFSample", "Lobe"),
    "light.base": ("Light", "LightKind", "LightSample"),
    "light.point": ("PointLight",),
    "light.directional": ("DirectionalLight",),
    "light.environment": ("EnvironmentMap",),
    "scene.mesh": ("Mesh", "load_mesh"),
    "scene.camera": ("Camera",),
    "scene.gbuffer": ("GBuffer",),
    "scene.visibility": ("visibility",),
    "effects.base": ("Contribution", "Decision", "Effect", "Prepared", "Scene", "Surface"),
    "planning": ("Plan", "plan", "shade"),
    "compiling": ("compile",),
    "training": ("value_and_grad",),
}
_MODULES = {"fresnel": "optics.fresnel", "microfacet": "optics.microfacet", "nn": "nn", "testing": "testing"}
_NAMES = {name: module for module, names in _HOME.items() for name in names} | BSDFS | FRESNEL_TERMS | DISTRIBUTIONS
__all__ = sorted([*_NAMES, *_MODULES])


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        found = importlib.import_module(f"{__name__}.{_MODULES[name]}")
    elif name in _NAMES:
        found = getattr(importlib.import_module(f"{__name__}.{_NAMES[name]}"), name)
    else:
        raise AttributeError(UnknownName(name, __all__, _MODULES, __name__), name=name, obj=None)  # no second guess by Python
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
