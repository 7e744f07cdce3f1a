"""A shader: a material and a plan, from G-buffer to radiance in one module."""

from collections.abc import Callable
from typing import Any

from torch import Tensor, nn

from .. import arguments
from ..effects.base import Prepared
from ..planning import Lights, Plan
from ..scene.gbuffer import GBuffer
from .compiled import CompiledShader


class Shader(nn.Module):
    """``shader(g, lights, prepared=None) -> radiance``.

    The plan is made beforehand (``tb.plan(g, material(g), lights, mesh)``), so that the effects do not depend on data:
    compiles to one full graph (``tb.compile(shader)``), runs under ``vmap``, ``functional_call`` and DDP. Parameter ranges
    are not looked at here; learned fields keep theirs. What no graph can compute, such as shadows, comes in as ``prepared``: made by
    ``plan.prepare(g, lights, mesh=mesh)``, or a visibility.
    """

    def __init__(self, material: nn.Module, plan: Plan) -> None:
        super().__init__()
        arguments.of_kind(material, "material", nn.Module, "tb.nn.Material(tb.Lambert, albedo=...)")
        arguments.of_kind(plan, "plan", Plan, "tb.plan(g, material(g), lights)")
        self.material, self.plan = material, plan

    def forward(
        self,
        g: GBuffer,
        lights: Lights,
        prepared: Prepared | Tensor | None = None,
        per_light: bool = False,
        visibility: Tensor | None = None,
    ) -> Tensor:
        """Radiance ``[..., H, W, C]`` (``per_light=True``: ``[L, ..., H, W, C]``)."""
        return self.plan(g, self.material(g), lights, prepared, visibility=visibility, per_light=per_light)

    def compiled_with(self, make: Callable[[Any], Any]) -> nn.Module:
        """What ``tb.compile`` gives, by a compiler ``make``."""
        return CompiledShader(self, make)
