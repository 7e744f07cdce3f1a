"""Triangle meshes: values of tensors, with the ray caster kept outside of them.

To optimise geometry, ``mesh.replace(vertices=leaf, normals=None)``: shading normals then follow the vertices.
"""

from pathlib import Path

import torch
from torch import Tensor

from .. import arguments
from ..interval import REAL, Interval
from ..io import files
from ..value import Value, param, value
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

    vertices: Tensor = param(REAL, ("V", 3), "positions")
    faces: Tensor = param(INDEX, ("F", 3), "vertex indices", kind="int")
    normals: Tensor | None = param(REAL, ("V", 3), "shading normals, any length", default=None)
    uv: Tensor | None = param(REAL, ("T", 2), "texture coordinates, v upwards; T is V without uv_faces", default=None)
    material: Tensor | None = param(INDEX, ("F", 1), "material id per face", default=None, kind="int")
    uv_faces: Tensor | None = param(INDEX, ("F", 3), "indices into uv, where they differ from faces", default=None, kind="int")

    def check_shapes(self) -> None:
        """Row counts must fit together (values are looked at by :meth:`check`)."""
        super().check_shapes()
        for name, t, spec in self.own_tensors():
            if spec.batch(t):
                shape = spec.shape.replace("..., ", "")
                raise ValueError(f"Mesh.{name}: expected shape {shape}, found {list(t.shape)}; a mesh has no batch axes")
        if self.faces.shape[0] == 0:
            raise ValueError("Mesh.faces: found no faces; a mesh needs at least one triangle (a point cloud has no surface to shade)")
        if self.uv_faces is not None and self.uv is None:
            raise ValueError("Mesh.uv_faces: given without uv, which it would index; pass uv [T, 2] too")
        points = self.vertices.shape[0]
        if self.uv is not None and self.uv_faces is None and self.uv.shape[0] != points:
            raise ValueError(f"Mesh.uv: expected {points} rows, one for each vertex, found {list(self.uv.shape)}; or pass uv_faces, too")

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

    def shading_normals(self) -> Tensor:
        """The given normals, or angle-weighted ones (differentiable w.r.t. the vertices), ``[V, 3]``."""
        if not arguments.values_hidden(self.vertices, self.faces):
            self.check()
        return angle_weighted(self.vertices, self.faces) if self.normals is None else self.normals


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
