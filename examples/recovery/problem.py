"""What a recovery is made of: photographs, one light at a time, and the shading points that they show."""

from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor, nn

import torchbrdf as tb


@dataclass
class View:
    """One camera: its G-buffer, one image per light, and which pixels of each image count."""

    g: tb.GBuffer  # [H, W, ...]
    images: Tensor  # [L, H, W, C] linear radiance
    weights: Tensor  # [L, H, W, 1] bool: what the fit may look at
    visibility: Tensor | None  # [L, H, W, 1]; None: nothing casts shadows

    def points(self) -> list["Points"]:
        """For each light, only the pixels that count and that it can reach: what is black whatever the material teaches nothing."""
        found = []
        for light, image in enumerate(self.images):
            used = (self.weights[light] & self.g.valid).squeeze(-1)
            if self.visibility is not None:
                used = used & (self.visibility[light].squeeze(-1) > 0)
            found.append(Points(self.g[used], light, image[used]))
        return found


@dataclass
class Points:
    """Shading points [N, ...] of one photograph, and its radiance [N, C] there."""

    g: tb.GBuffer
    light: int
    image: Tensor


@dataclass
class Problem:
    """All views, the lights they share, and, where the scene is a test, the truth."""

    views: list[View]
    lights: nn.Module  # lights(g) -> list of lights
    truth: dict[str, Tensor] = field(default_factory=dict)
    start: dict[str, Any] = field(default_factory=dict)
    noise: float | None = None


class Lights(nn.Module):
    """Fixed lights as they are; learned ones as `tb.nn.Material`s. Photograph k is lit by light k alone."""

    def __init__(self, *lights: tb.Light | nn.Module) -> None:
        super().__init__()
        self.entries = list(lights)
        self.learned = nn.ModuleDict({f"light {k}": m for k, m in enumerate(lights) if isinstance(m, nn.Module)})

    def forward(self, g: tb.GBuffer) -> list[tb.Light]:
        return [entry(g) if isinstance(entry, nn.Module) else entry for entry in self.entries]

    def one(self, g: tb.GBuffer, row: int) -> tb.Light:
        """The light of photograph ``row``."""
        return [light[k : k + 1] for light in self(g) for k in range(len(light))][row]


def uniform_or_texture(start: float, texels: int) -> tb.nn.Field:
    """A single learned colour, or a texture of ``texels`` x ``texels``."""
    return tb.nn.Texture(torch.full((texels, texels, 3), start)) if texels else tb.nn.Learned([start] * 3)


MODELS = ("lambert", "glossy", "conductor")


def make_material(model: str, texels: int, start: dict[str, Any]) -> nn.Module:
    """``lambert``; ``glossy``: Lambert + Phong with the exact Fresnel term of a dielectric; ``conductor``: a rough metal.

    A metal's colour is its reflectance at normal incidence, ``f0``, under Schlick's law: photographs fix that, not the index n + ik.
    """
    if model == "conductor":
        fresnel = tb.nn.Material(tb.Schlick, f0=uniform_or_texture(start["f0"], texels))
        return tb.nn.Material(tb.RoughConductor, alpha=tb.nn.Learned(start["alpha"]), fresnel=fresnel)
    diffuse = tb.nn.Material(tb.Lambert, albedo=uniform_or_texture(start["albedo"], texels))
    if model == "lambert":
        return diffuse
    fresnel = tb.nn.Material(tb.Dielectric, eta=tb.nn.Learned(start["eta"]))
    glossy = tb.nn.Material(tb.Phong, specular=tb.nn.Learned(start["specular"]), exponent=tb.nn.Learned(start["exponent"]), fresnel=fresnel)
    return diffuse + glossy
