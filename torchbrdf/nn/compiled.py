"""What ``tb.compile`` makes of a shader: one graph for one light, called again for each of many."""

from collections.abc import Callable
from functools import partial
from typing import Any

import torch
from torch import Tensor, nn

from ..effects import check, single
from ..effects.base import Prepared
from ..planning import Lights
from ..scene.gbuffer import GBuffer
from .fields import Channel, Constant, Given, Learned
from .material import Held, Material, MaterialSum

# What costs next to nothing to ask again for every light. Networks and look-ups are asked once, by a graph of their own.
CHEAP = (Material, MaterialSum, nn.ModuleList, Held, Constant, Given, Learned, Channel)


class CompiledShader(nn.Module):
    """A compiled :class:`~torchbrdf.nn.Shader`, called as that is; its parameters have the names that ``torch.compile`` gives them.

    Several point and directional lights go through the graph of one, one after the other. A material with a network or
    a look-up in it is then computed once, by another graph.
    """

    def __init__(self, shader: Any, make: Callable[[Any], Any]) -> None:
        super().__init__()
        self._orig_mod = shader
        # Not registered: they hold the same parameters.
        self._graphs = {"whole": make(shader), "material": make(shader.material), "plan": make(shader.plan)}

    def __getattr__(self, name: str) -> Any:
        """What the shader has: ``material``, ``plan``."""
        try:
            return super().__getattr__(name)
        except AttributeError:
            return getattr(super().__getattr__("_orig_mod"), name)

    def forward(
        self,
        g: GBuffer,
        lights: Lights,
        prepared: Prepared | Tensor | None = None,
        per_light: bool = False,
        visibility: Tensor | None = None,
    ) -> Tensor:
        """Radiance ``[..., H, W, C]`` (``per_light=True``: ``[L, ..., H, W, C]``)."""
        shader, whole = self._orig_mod, self._graphs["whole"]
        if torch.compiler.is_compiling():
            return shader(g, lights, prepared, per_light, visibility)
        sources = check.as_list(lights)
        ready = shader.plan.ready(g, sources, prepared, visibility=visibility)
        render = partial(whole, g, per_light=per_light)
        if not shader.plan.takes_apart():
            return render(sources, ready)
        if sum(map(len, sources)) > 1 and not all(type(m) in CHEAP for m in shader.material.modules()):
            render = partial(self._graphs["plan"], g, self._graphs["material"](g), per_light=per_light)
        return single.one_by_one(render, sources, ready, per_light)
