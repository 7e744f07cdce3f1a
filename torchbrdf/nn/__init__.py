"""Layer 4: learning. Fields give parameters at pixels, a material turns them into a BSDF, a shader into radiance."""

from .fields import Channel, Constant, Field, Learned, PerMaterial
from .material import Material, MaterialSum
from .shader import Shader
from .texture import Texture

__all__ = ["Channel", "Constant", "Field", "Learned", "Material", "MaterialSum", "PerMaterial", "Shader", "Texture"]
