"""Triangle meshes: values of tensors, with the ray caster kept outside of them.

To optimise geometry, ``mesh.replace(vertices=leaf, normals=None)``: shading normals then follow the vertices.
"""

from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from .. import arguments
from ..interval import REAL, Interval
from ..io import files
from ..value import PAIR, SCALAR, VECTOR, Value, param, value
from .vertex_normals import angle_weighted

INDEX = Interval(0.0)


@value
class Mesh(Value):
    """Triangles ``faces [F, 3]`` over ``vertices [V, 3]``, wound counter-clockwise seen from outside.

    ``normals [V, 3]`` are shading normals; without them angle-weighted ones are made. ``uv [V, 2]`` belongs to the vertices, or,
    with ``uv_faces [F, 3]``, to corners: ``uv [T, 2]`` then has its own indices, so that a texture may be cut along seams where the
    surface is not. ``material [F, 1]`` is an id per face. A normal that is not finite masks its faces out, such a uv counts as 0. A mesh
    has no batch axes.
    """

    vertices: Tensor = param(REAL, VECTOR, "positions [V, 3]")
    faces: Tensor = param(INDEX, VECTOR, "vertex indices [F, 3]", kind="int")
    normals: Tensor | None = param(REAL, VECTOR, "shading normals [V, 3], any length", default=None)
    uv: Tensor | None = param(REAL, PAIR, "texture coordinates [V, 2], v upwards", default=None)
    material: Tensor | None = param(INDEX, SCALAR, "material id per face [F, 1]", default=None, kind="int")
    uv_faces: Tensor | None = param(INDEX, VECTOR, "indices into uv [F, 3], where they differ from faces", default=None, kind="int")

    def check_shapes(self) -> None:
        """Row counts must fit together (values are looked at by :meth:`check`)."""
        for name, t, spec in self.own_tensors():
            if t.dim() != 2:
                raise ValueError(f"Mesh.{name}: expected shape [N, {spec.size}], found {list(t.shape)}; a mesh has no batch axes")
        if self.faces.shape[0] == 0:
            raise ValueError("Mesh.faces: found no faces; a mesh needs at least one triangle (a point cloud has no surface to shade)")
        if self.uv_faces is not None and self.uv is None:
            raise ValueError("Mesh.uv_faces: given without uv, which it would index; pass uv [T, 2] too")
        points, faces = self.vertices.shape[0], self.faces.shape[0]
        rows = {"normals": points, "uv": points if self.uv_faces is None else None, "material": faces, "uv_faces": faces}
        for name, expected in rows.items():
            t = getattr(self, name)
            if isinstance(t, Tensor) and expected is not None and t.shape[0] != expected:
                raise ValueError(f"Mesh.{name}: expected {expected} rows, one for each {_owner(name)}, found {list(t.shape)}")

    def check(self) -> None:
        """Raise ``ValueError`` if a vertex is not finite or an index points outside. Looks at values: not for graphs or transforms."""
        if self.vertices.is_meta or self.faces.is_meta:
            raise TypeError("Mesh.vertices: on the meta device, where there are no values; move the mesh with .to(...)")
        bad = int((~torch.isfinite(self.vertices)).any(-1).sum())
        if bad:
            raise ValueError(
                f"Mesh.vertices: {bad} of {self.vertices.shape[0]} are NaN or infinite; remove them and the faces that use them"
            )
        for name, index, table in (("faces", self.faces, self.vertices), ("uv_faces", self.uv_faces, self.uv)):
            if index is not None and table is not None:
                low, high = (int(x) for x in torch.aminmax(index))
                if low < 0 or high >= table.shape[0]:
                    what = "vertices" if name == "faces" else "uv"
                    raise ValueError(
                        f"Mesh.{name}: legal are 0 to {table.shape[0] - 1} ({what} has {table.shape[0]} rows), found {low} to {high}"
                    )
        if self.material is not None and int(self.material.amin()) < 0:
            raise ValueError(f"Mesh.material: ids count from 0, found {int(self.material.amin())}")

    @property
    def batch_shape(self) -> torch.Size:
        """A mesh has no batch axes."""
        return torch.Size([])

    def __getitem__(self, index: Any) -> Any:
        raise TypeError("a Mesh has no batch axes to index; index its tensors (mesh.vertices, mesh.faces, ...) instead")

    def shading_normals(self) -> Tensor:
        """The given normals, or angle-weighted ones (differentiable w.r.t. the vertices), ``[V, 3]``."""
        if not arguments.hidden(self.vertices, self.faces):
            self.check()
        return angle_weighted(self.vertices, self.faces) if self.normals is None else self.normals


def _owner(name: str) -> str:
    return "vertex" if name in ("normals", "uv") else "face"


def load_mesh(path: str | Path) -> Mesh:
    """Read a mesh file (anything trimesh reads, but archives) as float32, in the file's order of faces.

    A scene of several parts becomes one mesh whose ``material`` numbers the parts in the file's order. Vertices that the reader split along
    texture seams are joined again (see :class:`Mesh`, ``uv_faces``), so that they move together.
    """
    from .mesh_file import read_mesh

    fields = read_mesh(files.existing(path, "load_mesh"))
    try:
        mesh = Mesh(**fields)
        mesh.check()
    except (TypeError, ValueError) as error:
        raise ValueError(f"load_mesh: {path}: {error}") from None
    return mesh
