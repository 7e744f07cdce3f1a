"""Shading points from the output of a rasteriser: triangle ids and barycentric weights, such as nvdiffrast's."""

import torch
from torch import Tensor

from .. import arguments, vector
from ..vector import subtract
from .camera import Camera
from .interpolate import attributes, interpolate, masked, triangles
from .mesh import Mesh

_WHOLE = (torch.int64, torch.int32, torch.int16, torch.int8, torch.uint8)


def viewpoint(triangle: Tensor, camera: Camera | None, origin: Tensor | None) -> Tensor | None:
    """Where the viewer of ``triangle [..., 1]`` stands, ``[..., 3]``: the camera's batch axes are the leading ones."""
    if camera is None:
        return None if origin is None else arguments.floats(origin, "origin", 3)
    if origin is not None:
        raise ValueError("from_triangles: camera and origin both say where the viewer stands; pass one of them")
    batch = camera.batch_shape
    extra = _ids(triangle).dim() - 1 - len(batch)
    if extra < 0:
        raise ValueError(f"camera: {list(batch)} cameras for triangle {list(triangle.shape)}; a camera's batch axes lead: [B, H, W, 1]")
    return camera.origin.expand(*batch, 3).reshape(*batch, *(1,) * extra, 3)


def triangle_fields(mesh: Mesh, triangle: Tensor, barycentric: Tensor, eye: Tensor | None) -> dict[str, Tensor]:
    """The fields of :class:`GBuffer` at points of triangles, seen from ``eye [..., 3]`` (None: from nowhere)."""
    _check(mesh, triangle, barycentric)
    kind, device = mesh.vertices.dtype, mesh.vertices.device
    shapes = {"triangle": triangle.shape[:-1], "barycentric": barycentric.shape[:-1]} | ({} if eye is None else {"viewer": eye.shape[:-1]})
    shape = arguments.broadcast(shapes, "from_triangles: batch shapes")
    face = triangle.to(device, torch.int64).squeeze(-1).expand(shape)
    given = [w.to(torch.float64).expand(shape) for w in barycentric.to(device).unbind(-1)]
    known = (face >= 0) & torch.isfinite(torch.stack(given)).all(0)
    given = [torch.where(known, w, 0.0) for w in given]
    weights = given[0], given[1], given[2] if len(given) == 3 else 1.0 - given[0] - given[1]
    at = triangles(mesh, torch.where(known, face, 0))
    hit = known & torch.stack(at.plane).ne(0).any(0)  # a triangle without area has no normal
    position = interpolate(at.corners, weights)
    fields = {"position": masked(position, hit, kind), **attributes(mesh, at, hit, weights)}
    if eye is not None:
        towards = subtract(vector.components(eye.to(device, torch.float64)), vector.Vec(*position))
        valid = hit & torch.isfinite(torch.stack(towards)).all(0)
        view, distance = vector.direction_and_length(vector.Vec(*(torch.where(valid, c, 0.0) for c in towards)))
        fields |= {"view": vector.stack(view).to(kind), "depth": distance.unsqueeze(-1).to(kind)}
    return fields


def _ids(triangle: Tensor) -> Tensor:
    if not isinstance(triangle, Tensor) or triangle.dtype not in _WHOLE:
        found = triangle.dtype if isinstance(triangle, Tensor) else type(triangle).__name__
        remedy = "nvdiffrast's float ids become (rast[..., 3:] - 1).to(torch.int64)"
        raise TypeError(f"triangle: expected a tensor of whole numbers, found {found}; {remedy}")
    if triangle.shape[-1:] != (1,):
        raise ValueError(f"triangle: expected shape [..., 1], found {list(triangle.shape)}; did you mean triangle.unsqueeze(-1)?")
    return triangle


def _check(mesh: Mesh, triangle: Tensor, barycentric: Tensor) -> None:
    """Kinds and shapes; ids and indices, too, where values can be seen."""
    _ids(triangle)
    if arguments.floats(barycentric, "barycentric").shape[-1:] not in ((2,), (3,)):
        raise ValueError(
            f"barycentric: expected shape [..., 2], the weights of vertices 0 and 1, or [..., 3], found {list(barycentric.shape)}"
        )
    if arguments.values_hidden(mesh.vertices, mesh.faces, triangle):
        return
    mesh.check()
    low, high = (int(x) for x in torch.aminmax(triangle)) if triangle.numel() else (-1, -1)
    if low < -1 or high >= mesh.faces.shape[0]:
        legal = f"0 to {mesh.faces.shape[0] - 1}, the faces of the mesh, and -1 for none"
        remedy = "pass the mesh that was rasterised; nvdiffrast counts from 1, with 0 for none: subtract 1"
        raise ValueError(f"triangle: found {low if low < -1 else high}, legal are {legal}; {remedy}")
