"""Floor 4: learning. Fields give parameters at pixels, a material turns them into a BSDF, a shader into radiance."""

from .fields import Channel, Constant, Field, Learned, PerMaterial, Texture
from .material import Material, MaterialSum
from .shader import Shader

__all__ = ["Channel", "Constant", "Field", "Learned", "Material", "MaterialSum", "PerMaterial", "Shader", "Texture"]
