"""The ray caster behind a mesh: embree on the CPU, called directly.

It answers only *which* triangle a ray meets; everything that carries gradients or digits is recomputed from that triangle.
Values hold no ray caster: it is kept here, beside the mesh it belongs to, and goes when the mesh goes.
"""

import functools
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

import numpy as np
import torch
from torch import Tensor

from .. import vector

if TYPE_CHECKING:
    from .mesh import Mesh

# mesh -> (copies of its tensors, caster). Weak keys: copies, pickles and transforms of a mesh never see this.
_CASTERS: "WeakKeyDictionary[Mesh, tuple[tuple[Tensor, ...], RayCaster]]" = WeakKeyDictionary()

NOTHING = -1  # the triangle of a ray that meets none


class RayCaster:
    """Rays against the triangles ``faces [F, 3]`` over ``vertices [V, 3]``.

    embree works in float32, so triangles and rays are moved to the mesh's own centre and size (half diagonal 1) in float64
    first: accuracy then depends neither on the unit of length nor on where the mesh stands.
    """

    def __init__(self, vertices: Tensor, faces: Tensor) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        points = vertices.detach().to("cpu", torch.float64).numpy()
        corners = faces.detach().cpu().numpy()
        used = points[np.unique(corners)]
        low, high = used.min(0), used.max(0)
        self.centre = 0.5 * (low + high)
        half_diagonal = 0.5 * float(np.linalg.norm(high - low))
        self.scale = half_diagonal if half_diagonal > 0 else 1.0
        self._scene = EmbreeScene(robust=True)
        self._corners = points[corners.T]
        self._points = np.ascontiguousarray((points - self.centre) / self.scale, dtype=np.float32)
        self._mesh = TriangleMesh(self._scene, self._points, np.ascontiguousarray(corners, dtype=np.int32))
        self.first_hit(torch.zeros(1, 3), torch.ones(1, 3))  # the tree is built by the first ray

    def first_hit(self, origin: Tensor, direction: Tensor) -> Tensor:
        """Index ``[...]`` (int64) of the first triangle along ``origin + t direction``, t > 0; -1 for none. Unit directions."""
        start, along, shape = self._to_unit(origin, direction)
        # A far camera would lose digits of its rays: they start where they reach the sphere around the mesh.
        reach = np.maximum(-(start * along).sum(-1, keepdims=True) - 2.0, 0.0)
        start += reach * along
        found = self._scene.run(_single(start), _single(along))
        return torch.from_numpy(np.asarray(found, dtype=np.int64)).reshape(shape).to(origin.device)

    def occluded(self, origin: Tensor, direction: Tensor, distance: Tensor) -> Tensor:
        """Whether ``[...]`` (bool) a triangle lies within ``distance [...]`` along unit ``direction [..., 3]`` from ``origin [..., 3]``."""
        start, along, shape = self._to_unit(origin, direction)
        limit = distance.detach().to("cpu", torch.float64).expand(shape).reshape(-1).numpy() / self.scale
        # Beyond the sphere around the mesh there is nothing to meet.
        limit = np.minimum(limit, np.linalg.norm(start, axis=-1) + 2.0)
        found = self._scene.run(_single(start), _single(along), dists=_single(limit))
        return torch.from_numpy(np.asarray(found) != NOTHING).reshape(shape).to(origin.device)

    @functools.cached_property
    def planes(self) -> Tensor:
        """Planes ``[4, F]`` (float64, in the space of the mesh): unit normal n, and n.p of their points; 0 where a triangle has no area."""
        a, b, c = self._corners
        normal = vector.normalize(torch.from_numpy(np.cross(b - a, c - a)))
        return torch.cat([normal.t(), (normal * torch.from_numpy(a)).sum(-1).unsqueeze(0)])

    def _to_unit(self, origin: Tensor, direction: Tensor) -> tuple[np.ndarray, np.ndarray, torch.Size]:
        shape = torch.broadcast_shapes(origin.shape, direction.shape)
        o, d = (t.detach().to("cpu", torch.float64).expand(shape).reshape(-1, 3).numpy() for t in (origin, direction))
        return (o - self.centre) / self.scale, d, shape[:-1]


def _single(x: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(x, dtype=np.float32)


def caster_of(mesh: "Mesh") -> RayCaster:
    """The caster of ``mesh``, made when first asked for, and again when its tensors hold other numbers.

    The numbers are compared with a copy: torch's count of changes does not see those through ``tensor.data``.
    """
    kept = _CASTERS.get(mesh)
    if kept is None or not all(map(_same, kept[0], (mesh.vertices, mesh.faces))):
        mesh.check()
        copy = tuple(t.detach().clone() for t in (mesh.vertices, mesh.faces))
        kept = (copy, RayCaster(mesh.vertices, mesh.faces))
        _CASTERS[mesh] = kept
    return kept[1]


def _same(a: Tensor, b: Tensor) -> bool:
    return a.dtype == b.dtype and a.device == b.device and torch.equal(a, b)
