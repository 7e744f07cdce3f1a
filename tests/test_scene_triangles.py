"""G-buffers from the output of a rasteriser: triangle ids and barycentric weights, such as nvdiffrast's."""

import math

import pytest
import torch
from test_scene_gbuffer import FIELDS, ball, camera

import torchbrdf as tb

REAL = torch.float64


def seamed(dtype=REAL):
    """A ball whose uv have indices of their own, with materials."""
    mesh = ball(dtype, subdivisions=2)
    gen = torch.Generator().manual_seed(0)
    uv = torch.rand(50, 2, generator=gen, dtype=dtype)
    return mesh.replace(uv=uv, uv_faces=torch.randint(50, (320, 3), generator=gen), material=torch.arange(320).unsqueeze(-1))


@pytest.mark.parametrize("dtype", [torch.float32, REAL])
def test_triangles_and_weights_give_the_same_as_rays(dtype):
    mesh, view = seamed(dtype), camera((24, 30))
    g = tb.GBuffer.from_mesh(mesh, view)
    tight = 1e-12 if dtype == REAL else 1e-5
    for weights in (g.barycentric, g.barycentric[..., :2]):
        again = tb.GBuffer.from_triangles(mesh, g.triangle, weights, view)
        assert {n for n, _, _ in again.own_tensors()} == {n for n, _, _ in g.own_tensors()}
        for name, t, spec in again.own_tensors():
            assert tb.is_planar(t), name
            assert t.dtype == getattr(g, name).dtype
            expected = getattr(g, name)
            expected = torch.where(g.mask, expected, 0.0) if name == "view" else expected  # no ray passes the background
            torch.testing.assert_close(t, expected, rtol=0, atol=tight if spec.kind == "float" else 0)
    lights = tb.PointLight([[0.0, 3.0, 2.0], [3.0, 1.0, 3.0]], 1.0)
    assert torch.equal(tb.visibility(again, lights, mesh), tb.visibility(g, lights, mesh))


def test_the_output_of_nvdiffrast_is_taken_as_it_is():
    """rast [B, H, W, 4] = (u, v, z/w, id + 1); u and v are the weights of vertices 0 and 1, id 0 is the background."""
    mesh = seamed(torch.float32)
    rast = torch.zeros(1, 2, 3, 4)
    rast[0, 0, 1] = torch.tensor([0.2, 0.5, 0.9, 7.0 + 1.0])
    g = tb.GBuffer.from_triangles(mesh, (rast[..., 3:] - 1).long(), rast[..., :2], camera())
    a, b, c = mesh.vertices[mesh.faces[7]]
    torch.testing.assert_close(g.position[0, 0, 1], 0.2 * a + 0.5 * b + 0.3 * c)
    assert g.mask.flatten().tolist() == [False, True, False, False, False, False]
    assert g.triangle.flatten().tolist() == [-1, 7, -1, -1, -1, -1]
    assert g.material[0, 0, 1] == 7
    eye = camera().origin.float()
    torch.testing.assert_close(g.view[0, 0, 1], tb.normalize(eye - g.position[0, 0, 1]))
    torch.testing.assert_close(g.depth[0, 0, 1, 0], (eye - g.position[0, 0, 1]).norm())


def test_derivatives_to_vertices_weights_and_viewpoint():
    mesh = ball()
    gen = torch.Generator().manual_seed(0)
    ids = torch.tensor([[3], [-1], [40], [79]])
    eye = torch.tensor([0.7, 0.9, 3.0], dtype=REAL)
    for size in (2, 3):
        w = 0.2 + 0.2 * torch.rand(4, size, generator=gen, dtype=REAL)

        def fields(v, weights, o, ids=ids):
            g = tb.GBuffer.from_triangles(mesh.replace(vertices=v), ids, weights, origin=o)
            return tuple(getattr(g, name) for name in FIELDS)

        leaves = tuple(t.clone().requires_grad_() for t in (mesh.vertices, w, eye))
        assert all(x.requires_grad for x in fields(*leaves)), "gradcheck passes over what is cut off"
        assert torch.autograd.gradcheck(fields, leaves, fast_mode=True)
        assert torch.autograd.gradcheck(lambda a, b: fields(mesh.vertices, a, b), leaves[1:])
    moved = camera().origin.clone().requires_grad_()
    g = tb.GBuffer.from_triangles(mesh, ids, w, camera().replace(origin=moved))
    truth = tb.normalize(moved - g.position)
    w = torch.randn(4, 3, generator=gen, dtype=REAL) * g.mask
    slopes = [torch.autograd.grad(x.sum(), moved, retain_graph=True)[0] for x in (g.depth, w * g.view, w * truth)]
    assert slopes[0].any()
    torch.testing.assert_close(slopes[1], slopes[2])


def test_viewpoints_and_shapes_of_triangles():
    mesh, gen = ball(), torch.Generator().manual_seed(0)
    ids = torch.randint(80, (2, 4, 5, 1), generator=gen, dtype=torch.int32)
    w = torch.rand(2, 4, 5, 2, generator=gen)
    eyes = torch.tensor([[0.7, 0.9, 3.0], [-2.0, 0.5, 2.5]], dtype=REAL)
    two = tb.Camera.look_at(eyes, [0.0, 0.1, 0.0], [0.0, 1.0, 0.0], 45.0, (4, 5))
    g = tb.GBuffer.from_triangles(mesh, ids, w, two)
    assert g.view.shape == (2, 4, 5, 3)
    torch.testing.assert_close(g.view[1], tb.normalize(eyes[1] - g.position[1]))
    torch.testing.assert_close(tb.GBuffer.from_triangles(mesh, ids, w, origin=eyes[:, None, None]).view, g.view)
    flat = tb.GBuffer.from_triangles(mesh, ids[0].reshape(-1, 1), w[0].reshape(-1, 2), camera())
    torch.testing.assert_close(flat.view.reshape(4, 5, 3), g.view[0])
    none = tb.GBuffer.from_triangles(mesh, ids, w)
    assert none.view is None
    assert none.depth is None
    assert torch.equal(none.position, g.position)
    assert tb.GBuffer.from_triangles(mesh, ids[:0], w[:0], origin=eyes[0]).position.shape == (0, 4, 5, 3)
    assert tb.GBuffer.from_triangles(mesh, ids[0, 0, 0], w).position.shape == (2, 4, 5, 3)


def test_points_that_are_none_are_zero_without_a_slope():
    mesh = ball()
    mesh = mesh.replace(vertices=mesh.vertices.clone().requires_grad_(), faces=torch.cat([mesh.faces, torch.tensor([[0, 0, 1]])]))
    ids = torch.tensor([[-1], [80], [5], [6]])
    w = torch.tensor([[0.3, 0.3], [0.3, 0.3], [math.nan, 0.1], [math.inf, 0.1]], dtype=REAL, requires_grad=True)
    eye = torch.tensor([0.7, math.nan, 3.0], dtype=REAL, requires_grad=True)
    g = tb.GBuffer.from_triangles(mesh, ids, w, origin=eye)
    assert not g.mask.any()
    assert (g.triangle == -1).all()
    total = sum(getattr(g, name).sum() for name in (*FIELDS, "handedness"))
    assert total == 0
    assert all((s == 0).all() for s in torch.autograd.grad(total, (mesh.vertices, w, eye)))
    blind = tb.GBuffer.from_triangles(mesh, torch.tensor([[5]]), torch.tensor([[0.3, 0.3]], dtype=REAL), origin=eye)
    assert blind.mask.all()
    assert not blind.view.any()


def test_from_triangles_is_one_graph():
    mesh, view = seamed(), camera((6, 7))
    g = tb.GBuffer.from_mesh(mesh, view)

    def bright(v, w):
        made = tb.GBuffer.from_triangles(mesh.replace(vertices=v, normals=None), g.triangle, w, view)
        return tb.shade(made, tb.Lambert(0.5), tb.PointLight([1.0, 2.0, 4.0], 3.0)).sum()

    leaves = [t.clone().requires_grad_() for t in (mesh.vertices, g.barycentric)]
    expected = bright(*leaves)
    found = torch.compile(bright, fullgraph=True, backend="aot_eager")(*leaves)
    torch.testing.assert_close(found, expected)
    for ours, theirs in zip(torch.autograd.grad(found, leaves), torch.autograd.grad(expected, leaves), strict=True):
        torch.testing.assert_close(ours, theirs)


def test_what_is_wrong_with_triangles_is_named():
    mesh, ids, w = ball(), torch.zeros(4, 1, dtype=torch.int64), torch.rand(4, 2)
    make = tb.GBuffer.from_triangles
    with pytest.raises(ValueError, match=r"triangle: found 80, legal are 0 to 79, the faces of the mesh, and -1 for none; .*nvdiffrast"):
        make(mesh, ids + 80, w)
    with pytest.raises(ValueError, match=r"triangle: found -2, legal are 0 to 79"):
        make(mesh, ids - 2, w)
    with pytest.raises(TypeError, match=r"triangle: expected a tensor of whole numbers, found torch.float32; .*\(rast\[\.\.\., 3:\] - 1\)"):
        make(mesh, ids.float(), w)
    with pytest.raises(TypeError, match=r"triangle: expected a tensor of whole numbers, found list"):
        make(mesh, [1, 2], w)
    with pytest.raises(ValueError, match=r"triangle: expected shape \[\.\.\., 1\], found \[4\]; did you mean triangle.unsqueeze\(-1\)"):
        make(mesh, ids[:, 0], w)
    with pytest.raises(ValueError, match=r"barycentric: expected shape \[\.\.\., 2\].*or \[\.\.\., 3\], found \[4, 4\]"):
        make(mesh, ids, torch.rand(4, 4))
    with pytest.raises(TypeError, match=r"barycentric: expected a tensor of floats, found torch.int64"):
        make(mesh, ids, ids.expand(4, 3))
    with pytest.raises(ValueError, match=r"from_triangles: batch shapes do not broadcast"):
        make(mesh, ids, w[:3])
    with pytest.raises(ValueError, match=r"camera and origin both"):
        make(mesh, ids, w, camera(), origin=torch.zeros(3))
    with pytest.raises(ValueError, match=r"camera: \[2, 3\] cameras for triangle \[4, 1\]"):
        make(mesh, ids, w, camera().replace(origin=torch.zeros(2, 3, 3)))
    with pytest.raises(ValueError, match=r"origin: expected shape \[\.\.\., 3\]"):
        make(mesh, ids, w, origin=torch.zeros(2))
    with pytest.raises(TypeError, match=r"camera: expected a Camera"):
        make(mesh, ids, w, 5)
    with pytest.raises(ValueError, match=r"Mesh.faces: legal are 0 to 41"):
        make(mesh.replace(faces=mesh.faces + 1), ids + mesh.faces.amax(-1).argmax(), w)
