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
SIGN = Interval(-1.0, 1.0)


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
    handedness: Tensor | None = param(SIGN, SCALAR, "1, or -1 where v grows against n x tangent (mirrored uv); 0: none", default=None)

    def check(self) -> None:
        """Views are no camera's position, normals no normal map that was not decoded (:mod:`~torchbrdf.scene.orientation`)."""
        from .orientation import check

        check(self)

    @staticmethod
    def from_mesh(mesh: Mesh, camera: Camera) -> "GBuffer":
        """What ``camera`` sees of ``mesh`` through its pixel centres, ``[..., H, W]``, in the dtype and on the device of the vertices.

        Derivatives w.r.t. vertices and camera are those at a fixed pixel and triangle: true inside a triangle, blind to what
        moves across its edges. Pixels without a surface, or on a degenerate triangle, are 0 with gradient 0 and masked out.
        """
        from .intersect import ray_fields

        arguments.of_kind(mesh, "mesh", Mesh, "tb.load_mesh(path)")
        _check_camera(camera)
        return GBuffer(**ray_fields(mesh, *camera.to_double(mesh.vertices.device).rays()))

    @staticmethod
    def from_rays(mesh: Mesh, origin: "Tensor | GBuffer", direction: Tensor) -> "GBuffer":
        """What rays from ``origin [..., 3]`` along ``direction [..., 3]`` (any length) first meet of ``mesh``: a G-buffer ``[...]``.

        The shapes broadcast. All fields are those of :meth:`from_mesh`, in the dtype and on the device of the vertices; ``view``
        is ``-direction``, ``depth`` the distance from the origin. Rays that start on a surface would meet it again by rounding:
        pass the G-buffer of that surface as ``origin``, and they leave it, on the side that ``direction`` points to. A mirror, for
        example, shows ``GBuffer.from_rays(mesh, g, tb.reflect(g.view, g.normal))``. Pixels of such a G-buffer that are not valid
        send no ray; positions that are off the mesh are corrected as :func:`visibility` does.

        Derivatives w.r.t. vertices, origin (or ``g.position``) and direction are those at a fixed triangle. A ray that meets nothing
        gives 0 with gradient 0, masked out, and so does one whose direction is zero or not finite, or whose origin is not finite.
        """
        from .intersect import ray_fields, usable_rays
        from .start import leave

        arguments.of_kind(mesh, "mesh", Mesh, "tb.load_mesh(path)")
        surface = origin if isinstance(origin, GBuffer) else None
        points = origin if surface is None else surface.position.expand(*surface.batch_shape, 3)
        points = _with_values(arguments.floats(points, "origin", 3), "origin")
        o, d = usable_rays(mesh, points, _with_values(arguments.floats(direction, "direction", 3), "direction"))
        return GBuffer(**ray_fields(mesh, *((o, d) if surface is None else leave(surface, mesh, o, d))))

    @staticmethod
    def from_triangles(
        mesh: Mesh, triangle: Tensor, barycentric: Tensor, camera: Camera | None = None, origin: Tensor | None = None
    ) -> "GBuffer":
        """Points that a rasteriser found: ``triangle [..., 1]``, whole numbers, -1 for none, and ``barycentric [..., 2]`` or ``[..., 3]``.

        The weights are those of the face's vertices 0 and 1, and 1 minus both that of vertex 2; or those of all three. nvdiffrast's
        ``rast`` holds them so: ``from_triangles(mesh, (rast[..., 3:] - 1).long(), rast[..., :2], camera)``; its rows stay as they are
        (nvdiffrast's first row is the bottom one). ``camera``, whose batch axes are the leading ones, or the viewpoint
        ``origin [..., 3]`` gives ``view`` and ``depth``; without, both are None. All else is as in :meth:`from_mesh`, and
        differentiable w.r.t. vertices, weights and viewpoint. Points on a degenerate triangle, and those of weights that are not
        finite, are 0 with gradient 0 and masked out. Ids beyond the mesh, floats as ids and other shapes are each one error.
        """
        from .rasterized import triangle_fields, viewpoint

        arguments.of_kind(mesh, "mesh", Mesh, "tb.load_mesh(path)")
        if camera is not None:
            _check_camera(camera)
        return GBuffer(**triangle_fields(mesh, triangle, barycentric, viewpoint(triangle, camera, origin)))

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


def _check_camera(camera: Any) -> None:
    """Ranges are looked at where values can be seen: not in graphs."""
    arguments.of_kind(camera, "camera", Camera, "tb.Camera.look_at(eye, target, up)")
    tensors = [_with_values(t, "camera") for _, t, _ in camera.own_tensors()]
    if not arguments.values_hidden(*tensors):
        validate(camera)


def _with_values(t: Tensor, name: str) -> Tensor:
    """A tensor that has values: rays are cast from there."""
    if t.is_meta:
        raise TypeError(f"{name}: on the meta device, where there are no values; move it with .to(...)")
    return t
