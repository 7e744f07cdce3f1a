"""Shading normals of a mesh that comes without them."""

import torch
from torch import Tensor

from .. import vector
from ..vector import Vec, dot, stack


def gather(table: Tensor, index: Tensor) -> tuple[Tensor, ...]:
    """Rows ``table [N, k]`` at ``index [...]`` as k tensors ``[...]``, each one run of memory."""
    return table.t().index_select(1, index.reshape(-1)).reshape(table.shape[1], *index.shape).unbind(0)


def gather_vectors(table: Tensor, index: Tensor) -> Vec:
    """:func:`gather` of ``[N, 3]``."""
    return Vec(*gather(table, index))


def angle_weighted(vertices: Tensor, faces: Tensor) -> Tensor:
    """Unit normals ``[V, 3]``: face normals summed with the angle of each corner as weight (Thürmer & Wüthrich 1998).

    Independent of how a flat patch is cut into triangles. Differentiable w.r.t. ``vertices``; degenerate triangles contribute 0
    with gradient 0, and a vertex without a proper triangle gets 0.
    """
    index = faces.t().to(torch.int64)
    a, b, c = (gather_vectors(vertices, i) for i in index.unbind(0))
    plane = vector.cross(vector.subtract(b, a), vector.subtract(c, a))
    normal = vector.normalize_components(plane)
    doubled_area = dot(plane, normal)  # the length of plane, and 0 with gradient 0 where there is none
    total = vertices.new_zeros(3, vertices.shape[0])
    for corner, (at, left, right) in zip(index.unbind(0), ((a, b, c), (b, c, a), (c, a, b)), strict=True):
        angle = _corner_angle(doubled_area, dot(vector.subtract(left, at), vector.subtract(right, at)))
        total = total.index_add(1, corner, torch.stack(vector.scale(normal, angle)))
    return stack(vector.normalize_components(Vec(*total.unbind(0))))


def _corner_angle(doubled_area: Tensor, cosine_part: Tensor) -> Tensor:
    """The angle between two edges from the length of their cross product and their inner product; 0 for a degenerate triangle."""
    proper = doubled_area > 0
    return torch.where(proper, torch.atan2(torch.where(proper, doubled_area, 1.0), torch.where(proper, cosine_part, 1.0)), 0.0)
