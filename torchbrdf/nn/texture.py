"""Textures: a picture of a parameter, looked up at ``g.uv``."""

from typing import Any

from torch import Tensor

from .. import arguments
from ..lookup import WRAPS, bilinear
from ..scene.gbuffer import GBuffer
from .fields import Stored


class Texture(Stored):
    """Texels ``[Ht, Wt, C]`` looked up bilinearly at ``g.uv``.

    Texel centres at (i + 1/2)/n; row 0 is the top of the picture, v = 0 its bottom edge; ``wrap`` is "repeat" or "clamp";
    no mip levels. ``srgb=True`` decodes the texels, which are then sRGB-encoded values in [0, 1], of 1 or 3 channels.
    Gradients reach the texels and ``g.uv`` (not smooth where uv crosses a texel centre). A uv that is not finite reads a texel
    of the border, with gradient 0.
    """

    def __init__(self, texels: Any, learned: bool = True, srgb: bool = False, wrap: str = "repeat") -> None:
        super().__init__(texels, learned)
        arguments.picture(self.raw, "Texture.texels", "[Ht, Wt, C]")
        if wrap not in WRAPS:
            raise ValueError(f"Texture.wrap: found {wrap!r}, legal are {WRAPS}")
        if srgb and self.raw.shape[-1] not in (1, 3):
            raise ValueError(
                f"Texture.srgb: decodes 1 or 3 channels, found {self.raw.shape[-1]}; put the others into a texture of their own"
            )
        self.srgb, self.wrap = srgb, wrap

    def forward(self, g: GBuffer) -> Tensor:
        arguments.of_kind(g, "g", GBuffer, "tb.GBuffer.from_mesh(mesh, camera)")
        if g.uv is None:
            raise ValueError("Texture: this G-buffer has no uv; give the mesh texture coordinates, or use tb.nn.Learned")
        return self.at(g.uv).to(g.position.dtype)

    @property
    def texels(self) -> Tensor:
        """Linear texels ``[Ht, Wt, C]``."""
        if not self.srgb:
            return self.value
        from kornia.color import rgb_to_linear_rgb

        planes = self.value.movedim(-1, 0)
        return rgb_to_linear_rgb(planes.expand(3, -1, -1))[: len(planes)].movedim(0, -1)

    def at(self, uv: Tensor) -> Tensor:
        """Bilinear look-up ``[..., C]`` at ``uv [..., 2]``, in its dtype (float32 for half types) and on its device."""
        return bilinear(self.texels, uv, self.wrap)

    def extra_repr(self) -> str:
        return f"{super().extra_repr()}, wrap {self.wrap}" + (", srgb" if self.srgb else "")
