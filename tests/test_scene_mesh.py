"""Meshes: what they refuse, what they read, their normals, and the ray caster that is kept outside of them."""

import copy
import gc
import pickle

import numpy as np
import pytest
import torch
import trimesh

import torchbrdf as tb
from torchbrdf.scene import raycast

TRIANGLE = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]


def sphere(subdivisions=3, dtype=torch.float32, scale=1.0, **fields):
    s = trimesh.creation.icosphere(subdivisions=subdivisions)
    return tb.Mesh(torch.tensor(s.vertices * scale, dtype=dtype), torch.tensor(s.faces), **fields)


def in_front(distance=3.0, size=(16, 16)):
    return tb.Camera.look_at([0.0, 0.0, distance], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], 40.0, size)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"faces": torch.zeros(0, 3, dtype=torch.int64)}, "no faces"),
        ({"faces": [[0, 1, 2, 2]]}, r"Mesh.faces: expected shape \[..., F, 3\]"),
        ({"vertices": torch.zeros(3, 2)}, r"Mesh.vertices: expected shape \[..., V, 3\]"),
        ({"vertices": torch.zeros(2, 3, 3)}, "no batch axes"),
        ({"normals": torch.ones(2, 3)}, r"Mesh.normals: expected shape \[..., V, 3\] with V = 3 as in vertices, found \[2, 3\]"),
        ({"uv": torch.ones(4, 2)}, "Mesh.uv: expected 3 rows"),
        ({"material": [[1], [2]]}, r"Mesh.material: expected shape \[..., F, 1\] with F = 1 as in faces, found \[2, 1\]"),
        ({"faces": [[0.0, 1.0, 2.0]]}, "ints"),
        ({"uv_faces": [[0, 1, 2]]}, "given without uv"),
    ],
)
def test_shapes_that_cannot_be_a_mesh(fields, message):
    with pytest.raises((ValueError, TypeError), match=message):
        tb.Mesh(**{"vertices": TRIANGLE, "faces": [[0, 1, 2]], **fields})


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"faces": [[0, 1, 3]]}, "Mesh.faces: legal are 0 to 2 .* found 0 to 3"),
        ({"faces": [[0, 1, -1]]}, "Mesh.faces: legal"),
        ({"vertices": [[0.0, 0.0, float("nan")], *TRIANGLE[1:]]}, "1 of 3 are NaN or infinite"),
        ({"uv": torch.zeros(2, 2), "uv_faces": [[0, 1, 2]]}, "Mesh.uv_faces: legal are 0 to 1"),
    ],
)
def test_values_that_cannot_be_a_mesh_are_found_by_from_mesh(fields, message):
    mesh = tb.Mesh(**{"vertices": TRIANGLE, "faces": [[0, 1, 2]], **fields})
    with pytest.raises(ValueError, match=message):
        tb.GBuffer.from_mesh(mesh, in_front())


def test_a_mesh_has_no_batch_axes():
    with pytest.raises(TypeError, match="Mesh: has no batch axes to index"):
        sphere(0)[0]


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(FileNotFoundError, match="no such file"):
        tb.load_mesh(tmp_path / "absent.obj")
    (tmp_path / "broken.ply").write_bytes(b"this is no mesh")
    with pytest.raises(ValueError, match=r"cannot read .*broken.ply"):
        tb.load_mesh(tmp_path / "broken.ply")
    (tmp_path / "mesh.unknown").write_text("?")
    with pytest.raises(ValueError, match=r"cannot read .*formats that can be read: .*obj"):
        tb.load_mesh(tmp_path / "mesh.unknown")
    trimesh.PointCloud(np.random.rand(5, 3)).export(tmp_path / "points.ply")
    with pytest.raises(ValueError, match=r"points.ply holds no faces"):
        tb.load_mesh(tmp_path / "points.ply")
    (tmp_path / "nan.obj").write_text("v 0 0 0\nv 1 0 0\nv nan 1 0\nf 1 2 3\n")
    with pytest.raises(ValueError, match=r"nan.obj: Mesh.vertices: 1 of 3 are NaN"):
        tb.load_mesh(tmp_path / "nan.obj")


def test_a_texture_seam_does_not_tear_the_surface(tmp_path):
    """Two triangles share an edge whose corners have different texture coordinates on either side."""
    (tmp_path / "seam.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nvt .5 .5\nvt .25 .5\nvt .5 .25\nf 1/1 2/2 3/3\nf 2/4 4/5 3/6\n"
    )
    mesh = tb.load_mesh(tmp_path / "seam.obj")
    assert mesh.vertices.shape == (4, 3)
    assert mesh.vertices.dtype == torch.float32
    expected = torch.tensor([[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], [[0.5, 0.5], [0.25, 0.5], [0.5, 0.25]]])
    assert torch.equal(mesh.uv[mesh.uv_faces], expected)
    corners = torch.tensor([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0], [0, 1, 0]]])
    assert torch.equal(mesh.vertices[mesh.faces], corners)


def test_a_scene_becomes_one_mesh_with_a_material_per_part(tmp_path):
    box, ball = trimesh.creation.box(), trimesh.creation.icosphere(subdivisions=1)
    scene = trimesh.Scene()
    scene.add_geometry(box)
    turn = trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0])
    turn[:3, 3] = [0.0, 0.0, 5.0]
    _ = ball.vertex_normals  # asked for, so that the export writes them
    scene.add_geometry(ball, transform=turn)
    scene.export(tmp_path / "scene.glb")
    mesh = tb.load_mesh(tmp_path / "scene.glb")
    assert mesh.faces.shape[0] == len(box.faces) + len(ball.faces)
    assert mesh.material.unique().tolist() == [0, 1]
    moved = mesh.vertices[mesh.faces[mesh.material[:, 0] == 1]]
    assert torch.allclose(moved.amax((0, 1)), torch.tensor([1.0, 1.0, 6.0]), atol=0.2)


def test_given_normals_move_with_their_part(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=2)
    _ = ball.vertex_normals
    scene = trimesh.Scene()
    scene.add_geometry(ball, transform=np.diag([1.0, 2.0, 1.0, 1.0]) @ trimesh.transformations.rotation_matrix(1.0, [1, 2, 3]))
    scene.export(tmp_path / "ball.glb")
    mesh = tb.load_mesh(tmp_path / "ball.glb")
    assert mesh.normals is not None
    # An ellipsoid x^2 + y^2 / 4 + z^2 = 1: its normals lie along the gradient.
    expected = tb.normalize(mesh.vertices * torch.tensor([1.0, 0.25, 1.0]))
    assert (tb.normalize(mesh.normals) * expected).sum(-1).min() > 0.999  # the icosphere's own vertex normals are not exactly radial


def test_angle_weighted_normals_do_not_depend_on_how_faces_are_cut():
    """At a cube's corner each side counts 90 degrees, whether one or two of its triangles meet there."""
    cube = trimesh.creation.box()
    mesh = tb.Mesh(torch.tensor(cube.vertices), torch.tensor(cube.faces))
    expected = tb.normalize(mesh.vertices)
    assert torch.allclose(mesh.shading_normals(), expected, atol=1e-14)  # float64, a handful of roundings


def test_normals_have_gradients_and_degenerate_triangles_contribute_nothing():
    mesh = sphere(1, torch.float64)
    extra = torch.tensor([[0, 0, 1], [3, 3, 3]])
    spoiled = mesh.replace(faces=torch.cat([mesh.faces, extra]))
    v = mesh.vertices[:9].clone().requires_grad_()

    def normals(head, m=spoiled):
        return m.replace(vertices=torch.cat([head, m.vertices[9:]])).shading_normals()

    assert torch.equal(normals(v), normals(v, mesh))
    assert torch.autograd.gradcheck(normals, v, fast_mode=True)


def test_a_vertex_without_faces_gets_a_zero_normal_and_finite_gradients():
    v = torch.tensor([*TRIANGLE, [5.0, 5.0, 5.0]], requires_grad=True)
    n = tb.Mesh(v, [[0, 1, 2]]).shading_normals()
    assert n[3].tolist() == [0.0, 0.0, 0.0]
    n.square().sum().backward()
    assert torch.isfinite(v.grad).all()


def test_normals_under_vmap_and_in_a_full_graph():
    mesh = sphere(1, torch.float64)
    batch = mesh.vertices + 0.1 * torch.randn(3, *mesh.vertices.shape, dtype=torch.float64)
    looped = torch.stack([mesh.replace(vertices=v).shading_normals() for v in batch])
    mapped = torch.vmap(lambda v: mesh.replace(vertices=v).shading_normals())(batch)
    assert torch.allclose(mapped, looped, atol=1e-15)
    compiled = torch.compile(lambda m: m.shading_normals(), backend="eager", fullgraph=True)
    tb.GBuffer.from_mesh(mesh, in_front())  # the caster exists by now
    assert torch.allclose(compiled(mesh), mesh.shading_normals(), atol=1e-15)


def test_the_caster_stays_outside_of_the_value():
    mesh = sphere(1)
    tb.GBuffer.from_mesh(mesh, in_front())
    assert raycast.caster_of(mesh) is raycast.caster_of(mesh)
    for twin in (pickle.loads(pickle.dumps(mesh)), copy.deepcopy(mesh), mesh.detach()):
        assert torch.equal(twin.vertices, mesh.vertices)
        assert twin not in raycast._CASTERS
    count = len(raycast._CASTERS)
    del mesh, twin
    gc.collect()
    assert len(raycast._CASTERS) == count - 1


def test_the_caster_follows_the_vertices():
    """Both ways of moving them: a new value, and an optimiser that changes the leaf in place."""
    leaf = sphere(2).vertices.clone().requires_grad_()
    mesh = sphere(2).replace(vertices=leaf)
    before = tb.GBuffer.from_mesh(mesh, in_front()).mask.sum()
    assert tb.GBuffer.from_mesh(mesh.replace(vertices=0.5 * leaf), in_front()).mask.sum() < before
    with torch.no_grad():
        leaf.mul_(0.5)
    assert tb.GBuffer.from_mesh(mesh, in_front()).mask.sum() < before
    with torch.inference_mode():
        frozen = mesh.replace(vertices=leaf.clone())
        small = tb.GBuffer.from_mesh(frozen, in_front()).mask.sum()
        frozen.vertices.mul_(2.0)
        assert tb.GBuffer.from_mesh(frozen, in_front()).mask.sum() == before > small


@pytest.mark.parametrize("mirror", [[-1.0, 1.0, 1.0], [-1.0, -2.0, -3.0], [-1.0, 1.0, -1.0]])
def test_a_mirrored_part_keeps_its_outside_outside(tmp_path, mirror):
    """The volume by the divergence theorem has the sign of the winding."""
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.box(), transform=np.diag([*mirror, 1.0]))
    scene.export(tmp_path / "box.glb")
    mesh = tb.load_mesh(tmp_path / "box.glb")
    assert (torch.linalg.det(mesh.vertices[mesh.faces]).sum() / 6).item() == pytest.approx(abs(np.prod(mirror)))
