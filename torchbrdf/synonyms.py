"""What others call the things that this package names: the one place for hints on unknown arguments and unknown public names."""

import importlib
from collections.abc import Mapping, Sequence
from typing import Any

_COLOUR, _BRIGHTNESS = ("albedo", "base_color", "specular", "tint", "f0", "intensity", "irradiance"), ("intensity", "irradiance", "texels")
# What is meant by an argument, the likeliest first; the first that is legal where it was given is named.
ARGUMENTS: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("color", "colour", "base_color", "basecolor", "reflectance", "texture", "rgb"), _COLOUR),
    **dict.fromkeys(("kd", "diffuse", "diffuse_reflectance", "rho"), ("albedo",)),
    **dict.fromkeys(("ks", "specular", "specular_color", "specular_reflectance", "tint"), ("specular", "tint", "f0")),
    **dict.fromkeys(
        ("shininess", "glossiness", "ns", "sharpness", "roughness", "alpha", "specular_roughness"), ("alpha", "exponent", "roughness")
    ),
    **dict.fromkeys(("ior", "int_ior", "index", "refractive_index", "n", "specular_ior", "eta"), ("eta", "ior")),
    **dict.fromkeys(("metalness", "base_metalness", "metal"), ("metallic",)),
    **dict.fromkeys(("anisotropic", "specular_roughness_anisotropy"), ("anisotropy",)),
    **dict.fromkeys(("clearcoat", "coat_weight"), ("coat",)),
    **dict.fromkeys(("clearcoat_roughness", "clearcoat_gloss"), ("coat_roughness",)),
    **dict.fromkeys(("specular_weight",), ("specular",)),
    **dict.fromkeys(("extinction", "kappa"), ("k",)),
    **dict.fromkeys(("r0", "f_0"), ("f0",)),
    **dict.fromkeys(("intensity", "irradiance", "radiance", "power", "strength", "emission", "energy", "brightness"), _BRIGHTNESS),
    **dict.fromkeys(("pos", "location", "points", "xyz", "origin"), ("position",)),
    **dict.fromkeys(("dir", "wi", "to_light"), ("direction",)),
    **dict.fromkeys(("image", "envmap", "map", "pixels"), ("texels",)),
    **dict.fromkeys(("verts", "v"), ("vertices",)),
    **dict.fromkeys(("triangles", "indices", "f"), ("faces",)),
    **dict.fromkeys(("wo", "view_dir", "viewdir", "to_viewer"), ("view",)),
    **dict.fromkeys(("texcoords", "uvs", "st"), ("uv",)),
}
_SCALES = {"roughness", "alpha", "glossiness"}  # names of another scale than exponent
# Public names: another public name, or words.
NAMES: dict[str, str] = {
    **dict.fromkeys(("Pinhole", "PinholeCamera", "PerspectiveCamera", "FoVPerspectiveCameras", "Sensor"), "Camera"),
    **dict.fromkeys(("Diffuse", "Lambertian", "LambertianBRDF"), "Lambert"),
    **dict.fromkeys(("Specular", "SmoothConductor"), "Mirror"),
    **dict.fromkeys(("EnvMap", "Envmap", "EnvironmentLight", "SkyLight", "Sky"), "EnvironmentMap"),
    **dict.fromkeys(("Sun", "SunLight", "DistantLight", "DirectionalLights"), "DirectionalLight"),
    **dict.fromkeys(("PointLights", "OmniLight", "PointEmitter"), "PointLight"),
    **dict.fromkeys(("render", "relight"), "shade"),
    **dict.fromkeys(("imread", "load_image"), "read_image"),
    **dict.fromkeys(("imwrite", "write_image"), "save_image"),
    **dict.fromkeys(("Meshes", "TriangleMesh"), "Mesh"),
    **dict.fromkeys(("Ggx", "TrowbridgeReitz"), "GGX"),
    **dict.fromkeys(("Microfacet", "MicrofacetBRDF", "TorranceSparrow"), "RoughConductor"),
    **dict.fromkeys(("Disney", "PrincipledBSDF", "DisneyBSDF", "PrincipledBRDF", "OpenPBR", "StandardSurface"), "Principled"),
    **dict.fromkeys(("CookTorranceBRDF", "Cooktorrance"), "CookTorrance"),
}


def argument(made: Any, name: str) -> str:
    """``"did you mean ...? "`` for a name that is no argument of a value, or nothing."""
    legal = made._fields
    found = next((n for n in ARGUMENTS.get(name.lower(), ()) if n in legal), None) or _nearest(name, legal)
    if found is None:
        return ""
    meaning = [made._params[found].doc] if found in made._params else []
    if name.lower() in _SCALES and found == "exponent":
        meaning.append("another scale: see Roughness, alpha, exponent in docs/conventions.md")
    return f"did you mean {found}{' (' + '; '.join(meaning) + ')' if meaning else ''}? "


def unknown_argument(made: Any, name: str) -> str:
    """What to say of an argument that a value does not have."""
    return f"{made.__name__}: unknown argument {name!r}; {argument(made, name)}legal are {', '.join(made._fields)}"


class UnknownName:
    """The message of an ``AttributeError`` on the package, made when it is read: importing a submodule asks for its name first."""

    def __init__(self, name: str, public: Sequence[str], modules: Mapping[str, str], package: str) -> None:
        self.name, self.public, self.modules, self.package = name, public, modules, package

    def __str__(self) -> str:
        return f"module {self.package!r} has no attribute {self.name!r}{self._hint()}"

    __repr__ = __str__

    def _hint(self) -> str:
        if self.name.startswith("_"):
            return ""
        for short, module in self.modules.items():
            if hasattr(importlib.import_module(f"{self.package}.{module}"), self.name):
                return f"; did you mean tb.{short}.{self.name}?"
        meant = NAMES.get(self.name)
        if meant is not None and " " in meant:
            return f"; {meant}"
        meant = meant or _nearest(self.name, self.public)
        return "" if meant is None else f"; did you mean tb.{meant}?"


def _nearest(name: str, legal: Sequence[str]) -> str | None:
    import difflib

    by_lower = {one.lower(): one for one in legal}
    found = difflib.get_close_matches(name.lower(), by_lower, n=1)
    return by_lower[found[0]] if found else None
