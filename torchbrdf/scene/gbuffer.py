"""What a camera sees of a surface, pixel by pixel: the shading points that every effect works on."""

from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from .. import arguments, vector
from ..interval import REAL, Interval
from ..value import PAIR, SCALAR, VECTOR, Value, param, validate, value
from .camera import Camera
from .mesh import Mesh

INDEX = Interval(0.0)


@value
class GBuffer(Value):
    """Shading points ``[..., H, W]`` (or any batch shape), made here from a mesh or elsewhere (nvdiffrast, a NeRF, EXR passes).

    Only ``position`` and ``normal`` are required; shading also needs ``view``, shadows take ``geometric_normal``, textures ``uv``.
    Normals point where the surface's outside is and are not turned to the viewer: back faces are black unless two-sided.
    """

    position: Tensor = param(REAL, VECTOR, "world position")
    normal: Tensor = param(REAL, VECTOR, "shading normal, unit; zero or NaN masks the pixel out")
    view: Tensor | None = param(REAL, VECTOR, "unit, from the surface to the viewer", default=None)
    geometric_normal: Tensor | None = param(REAL, VECTOR, "unit normal of the true surface, by winding", default=None)
    uv: Tensor | None = param(REAL, PAIR, "texture coordinates, v upwards", default=None)
    tangent: Tensor | None = param(REAL, VECTOR, "unit, along growing u; 0 where there is none", default=None)
    depth: Tensor | None = param(REAL, SCALAR, "distance along the ray", default=None)
    mask: Tensor | None = param(REAL, SCALAR, "where there is a surface; None: wherever the normal is usable", default=None, kind="bool")
    triangle: Tensor | None = param(REAL, SCALAR, "face index, -1 for none", default=None, kind="int")
    barycentric: Tensor | None = param(REAL, VECTOR, "weights of the face's three vertices", default=None)
    material: Tensor | None = param(INDEX, SCALAR, "material id, 0 where there is no surface", default=None, kind="int")

    @staticmethod
    def from_mesh(mesh: Mesh, camera: Camera) -> "GBuffer":
        """What ``camera`` sees of ``mesh`` through its pixel centres, ``[..., H, W]``, in the dtype and on the device of the vertices.

        Derivatives w.r.t. vertices and camera are those at a fixed pixel and triangle: true inside a triangle, blind to what
        moves across its edges. Pixels without a surface, or on a degenerate triangle, are 0 with gradient 0 and masked out.
        """
        from .intersect import gbuffer_fields

        arguments.of_kind(mesh, "mesh", Mesh, "tb.load_mesh(path)")
        validate(arguments.of_kind(camera, "camera", Camera, "tb.Camera.look_at(eye, target, up)"))
        if any(t.is_meta for _, t, _ in camera.own_tensors()):
            raise TypeError("camera: on the meta device, where there are no values; move it with .to(...)")
        return GBuffer(**gbuffer_fields(mesh, camera))

    @property
    def valid(self) -> Tensor:
        """``[..., 1]`` bool: ``mask``, and a finite, nonzero normal."""
        n = vector.components(self.normal.detach())
        size = torch.maximum(torch.maximum(n.x.abs(), n.y.abs()), n.z.abs())  # their sum may overflow
        usable = ((size > 0) & (size < torch.inf)).unsqueeze(-1)  # NaN fails both
        return usable if self.mask is None else usable & self.mask

    def require_view(self) -> Tensor:
        """``view``, or an error that says how to get it."""
        if self.view is None:
            raise ValueError(
                "GBuffer.view is missing: shading needs the unit direction [..., 3] from each point to the viewer; make the G-buffer "
                "with GBuffer.from_mesh(mesh, camera) or GBuffer.load(path, camera=camera), or set it: "
                "g.replace(view=tb.normalize(camera.origin - g.position)) for a pinhole camera"
            )
        return self.view

    def save(self, path: str | Path) -> None:
        """Write an EXR file with float32 channels X/Y/Z, that :meth:`load` reads."""
        from .exr import save_gbuffer

        save_gbuffer(self, path)

    @staticmethod
    def load(path: str | Path, camera: Camera | None = None, names: Any = None) -> "GBuffer":
        """Read the passes of an EXR file (this package's own, Mitsuba's, Blender's); ``camera`` gives ``view``."""
        from .exr import load_gbuffer

        return load_gbuffer(path, camera, names)
