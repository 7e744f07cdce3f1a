"""Point and directional lights: the inverse square law, shapes, edges, gradients, and what they refuse."""

import pytest
import torch
from torch.autograd import gradcheck

import torchbrdf as tb


def draw(*shape, dtype=torch.float64):
    return torch.randn(*shape, dtype=dtype)


def test_inverse_square_law():
    light = tb.PointLight([[0.0, 0.0, 0.0]], [[8.0, 4.0, 2.0]])
    for distance in (0.5, 1.0, 3.0, 1e-3, 1e3):
        _, _, irradiance, _ = light.sample(torch.tensor([[0.0, distance, 0.0]], dtype=torch.float64))
        torch.testing.assert_close(irradiance[0, 0] * distance**2, torch.tensor([8.0, 4.0, 2.0], dtype=torch.float64))


def test_a_point_light_is_seen_along_the_connecting_line():
    points, position = draw(5, 7, 3), draw(2, 3)
    wi, _, irradiance, _ = tb.PointLight(position, torch.rand(2, 3, dtype=torch.float64) + 0.1).sample(points)
    towards = position[:, None, None] - points
    length = towards.norm(dim=-1, keepdim=True)
    torch.testing.assert_close(wi, towards / length)
    torch.testing.assert_close(irradiance / irradiance[..., :1], (irradiance / irradiance[..., :1])[:, :1, :1].expand_as(irradiance))


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float32, torch.float64])
@pytest.mark.parametrize("pixels", [(), (4,), (2, 5, 6)])
@pytest.mark.parametrize("colours", [1, 3, 8])
def test_a_sample_has_the_shape_and_dtype_of_the_points(pixels, colours, dtype):
    points = draw(*pixels, 3).to(dtype)
    for kind in (tb.PointLight, tb.DirectionalLight):
        wi, _, strength, _ = kind(draw(2, 3), torch.rand(2, colours)).sample(points)
        assert wi.shape == (2, *pixels, 3)
        assert strength.shape == (2, *pixels, colours)
        assert wi.dtype == strength.dtype == dtype
        assert tb.is_planar(wi)
        assert tb.is_planar(strength)
        # Half types round once, so the unit length is that of a rounded vector.
        assert (wi.double().norm(dim=-1) - 1).abs().max() < 4 * torch.finfo(dtype).eps


def test_direction_is_normalised_and_irradiance_is_not_changed_by_it():
    short = tb.DirectionalLight([[0.0, 3.0, 4.0]], 2.0)
    wi, _, irradiance, _ = short.sample(draw(4, 3))
    torch.testing.assert_close(wi[0], torch.tensor([0.0, 0.6, 0.8], dtype=torch.float64).expand(4, 3))
    assert (irradiance == 2.0).all()
    tiny = tb.DirectionalLight(torch.tensor([0.0, 3e-30, 4e-30]), 2.0)  # its square underflows in float32
    torch.testing.assert_close(tiny.sample(torch.zeros(3)).wi, torch.tensor([[0.0, 0.6, 0.8]]))


@pytest.mark.parametrize(
    "make", [lambda p: tb.PointLight(p, 1.0), lambda p: tb.DirectionalLight(p - p, 1.0)], ids=["on the point", "no direction"]
)
def test_light_without_a_direction_gives_nothing_and_no_gradient(make):
    at = torch.tensor([0.3, -0.2, 1.0], dtype=torch.float64, requires_grad=True)
    g = tb.GBuffer(at.expand(2, 2, 3), torch.tensor([0.0, 0.0, 1.0]).double().expand(2, 2, 3), torch.tensor([0.0, 0.0, 1.0]).double())
    light = make(at)
    image = tb.shade(g, tb.Lambert(0.5), light)
    assert (image == 0).all()
    (gradient,) = torch.autograd.grad(image.sum(), at)
    assert (gradient == 0).all()
    wi, _, irradiance, _ = light.sample(at)
    assert (wi == 0).all()
    assert (irradiance == 0).all()


def test_one_light_and_one_intensity_serve_many():
    assert len(tb.PointLight([0.0, 0.0, 1.0], 1.0)) == 1
    assert len(tb.PointLight(draw(4, 3), 1.0)) == 4
    assert len(tb.PointLight([0.0, 0.0, 1.0], torch.rand(5, 3))) == 5
    points = draw(3, 3)
    wi, _, strength, _ = tb.PointLight([0.0, 0.0, 1.0], torch.tensor([[1.0], [2.0]]).double()).sample(points)
    torch.testing.assert_close(strength[1], 2 * strength[0])
    torch.testing.assert_close(wi[1], wi[0])


def test_lights_are_picked_from_a_list_one_by_one():
    lights = tb.PointLight(draw(3, 3), torch.rand(3, 2, dtype=torch.float64))
    points = draw(4, 3)
    one_by_one = list(lights)
    assert [len(light) for light in one_by_one] == [1, 1, 1]
    for part in range(4):
        torch.testing.assert_close(torch.cat([light.sample(points)[part] for light in one_by_one]), lights.sample(points)[part])
        torch.testing.assert_close(lights[1:].sample(points)[part], lights.sample(points)[part][1:])


@pytest.mark.parametrize("dtype", [torch.float16, torch.float32, torch.float64])
def test_distances(dtype):
    points = draw(4, 5, 3).to(dtype)
    position, direction = draw(2, 3), draw(3, 3)
    wi, distance, _, _ = tb.PointLight(position, 1.0).sample(points)
    assert wi.shape == (2, 4, 5, 3)
    assert distance.shape == (2, 4, 5, 1)
    # From the point along the direction by the distance stands the light.
    reached = points.double() + wi.double() * distance.double()
    torch.testing.assert_close(
        reached, position[:, None, None].expand_as(reached), atol=16 * torch.finfo(dtype).eps, rtol=0
    )  # roundings of a few units
    wi, distance, _, _ = tb.DirectionalLight(direction, 1.0).sample(points)
    assert wi.shape == (3, 4, 5, 3)
    assert torch.isinf(distance).all()
    assert distance.shape == (3, 4, 5, 1)
    torch.testing.assert_close(
        wi[:, 1, 2].double(), torch.nn.functional.normalize(direction, dim=-1), atol=4 * torch.finfo(dtype).eps, rtol=0
    )


@pytest.mark.parametrize(
    ("kind", "names"), [(tb.PointLight, ("position", "intensity")), (tb.DirectionalLight, ("direction", "irradiance"))]
)
def test_gradients_reach_every_parameter(kind, names):
    place, colour = draw(2, 3).requires_grad_(), (torch.rand(2, 2, dtype=torch.float64) + 0.5).requires_grad_()
    points = (draw(3, 3) + 3.0).requires_grad_()

    def irradiance(*given):
        return torch.cat([x.flatten() for x in kind(**dict(zip(names, given[:2], strict=True))).sample(given[2])[::2]])

    assert gradcheck(irradiance, (place, colour, points))

    def radiance(*given):
        up = torch.tensor([0.1, 0.2, 1.0], dtype=torch.float64)
        g = tb.GBuffer(given[2], up.expand(3, 3), up.expand(3, 3))
        return tb.shade(g, tb.Lambert([0.3, 0.6]), kind(**dict(zip(names, given[:2], strict=True))))

    lifted = place.detach() * 0.2 + torch.tensor([3.0, 3.0, 7.0])  # above every point's horizon
    assert gradcheck(radiance, (lifted.requires_grad_(), colour, points))


KINDS = {"point": tb.PointLight, "sun": tb.DirectionalLight}


def views(channels=3, count=2):
    """Three views of 4 x 5 points, and ``count`` lights for each."""
    up = torch.tensor([0.0, 0.0, 1.0]).double()
    g = tb.GBuffer(draw(3, 4, 5, 3), tb.normalize(up + 0.3 * draw(3, 4, 5, 3)), tb.normalize(up + 0.3 * draw(3, 4, 5, 3)))
    return g, draw(3, count, 3) + 4 * up, torch.rand(3, count, channels).double() + 0.1


@pytest.mark.parametrize("channels", [1, 3, 8])
@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize("kind", KINDS)
def test_lights_by_view_are_those_of_each_view(kind, count, channels):
    g, place, colour = views(channels, count)
    brdf = tb.Lambert(0.3) + tb.Phong(torch.rand(channels).double(), 9.0)
    lights = KINDS[kind](place, colour)
    assert len(lights) == count
    both = [lights, tb.DirectionalLight([0.1, 0.2, 1.0], 0.5)]
    rows = tb.shade(g, brdf, both, per_light=True)
    image = tb.shade(g, brdf, both)
    assert rows.shape == (count + 1, 3, 4, 5, channels)
    torch.testing.assert_close(rows.sum(0), image)
    for b in range(3):
        own = [KINDS[kind](place[b], colour[b]), both[1]]
        torch.testing.assert_close(image[b], tb.shade(g[b], brdf, own))
        torch.testing.assert_close(rows[:, b], tb.shade(g[b], brdf, own, per_light=True))
        torch.testing.assert_close(lights[b].position if kind == "point" else lights[b].direction, place[b])
        for whole, mine in zip(lights.sample(g.position), own[0].sample(g.position[b]), strict=True):
            torch.testing.assert_close(whole[:, b], mine)
    at_once = torch.vmap(lambda g, light: tb.shade(g, brdf, light))(g, lights)
    torch.testing.assert_close(at_once, tb.shade(g, brdf, lights))


def test_one_of_two_parameters_may_be_by_view():
    g, place, colour = views()
    brdf = tb.Lambert(0.5)
    for light in (tb.PointLight(place, [2.0, 1.0, 0.5]), tb.PointLight(place[0], colour[:, :1]), tb.PointLight(place[:, :1], colour[0])):
        image = tb.shade(g, brdf, light)
        for b in range(3):
            torch.testing.assert_close(image[b], tb.shade(g[b], brdf, light[b]))
    # Nothing but the view may differ from view to view, and a list of pixels may have views, too.
    shared = tb.GBuffer(g.position[0], g.normal[0], g.view)
    pixels = g.map(lambda t: t.flatten(1, 2))
    lights = tb.PointLight(place, colour)
    torch.testing.assert_close(tb.shade(shared, brdf, lights)[1], tb.shade(shared[1], brdf, lights[1]))
    torch.testing.assert_close(tb.shade(pixels, brdf, lights)[2], tb.shade(pixels[2], brdf, lights[2]))


def test_without_views_a_batch_of_positions_is_a_list_of_lights():
    g, place, _ = views()
    four = tb.PointLight(place[:, 0], 1.0)
    assert tb.shade(g, tb.Lambert(0.5), four, per_light=True).shape == (3, 3, 4, 5, 1)


def test_many_lights_by_view_come_in_groups(monkeypatch):
    from torchbrdf.effects import direct

    g, place, colour = views(count=5)
    whole = tb.shade(g, tb.Lambert(0.5), tb.PointLight(place, colour), per_light=True)
    monkeypatch.setattr(direct, "GROUP", 130)  # two lights at a time
    torch.testing.assert_close(tb.shade(g, tb.Lambert(0.5), tb.PointLight(place, colour), per_light=True), whole)


def test_shadows_of_lights_by_view():
    up = torch.tensor([0.0, 0.0, 1.0])
    g = tb.GBuffer(torch.tensor([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), up, up.expand(2, 1, 3))  # two views of two points
    plate = tb.Mesh([[-0.5, -0.5, 1.0], [0.5, -0.5, 1.0], [0.5, 0.5, 1.0], [-0.5, 0.5, 1.0]], [[0, 1, 2], [0, 2, 3]])
    light = tb.PointLight(torch.tensor([[[-1.0, 0.0, 2.0]], [[1.0, 0.0, 2.0]]]), 1.0)  # behind the plate, seen from the other point
    lights = [tb.DirectionalLight(up, 1.0), light]
    found = tb.visibility(g, lights, plate)
    assert found[..., 0].tolist() == [[[1, 1], [1, 1]], [[1, 0], [0, 1]]]
    image = tb.shade(g, tb.Lambert(0.5), lights, mesh=plate, per_light=True)
    assert torch.equal(image, tb.shade(g, tb.Lambert(0.5), lights, per_light=True) * found)


def test_rows_of_lights_by_view_and_of_others_have_one_shape():
    """Points that lie on their own triangles are not repeated for each view, where a field that no ray needs has the views."""
    floor = tb.Mesh([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.0]], [[0, 1, 2]])
    g = tb.GBuffer.from_triangles(floor, torch.zeros(5, 1, dtype=torch.int64), torch.full((5, 3), 1 / 3))
    by_view = g.replace(uv=torch.zeros(2, 1, 2))
    lights = [tb.DirectionalLight([0.0, 0.0, 1.0], 1.0), tb.PointLight(torch.tensor([[[0.0, 0.0, 1.0]], [[0.0, 0.0, -1.0]]]), 1.0)]
    assert tb.visibility(by_view, lights, floor)[..., 0, 0].tolist() == [[1, 1], [1, 0]]


def test_lights_by_view_make_one_full_graph():
    g, place, colour = views()
    torch.compiler.reset()

    def image(g, place, colour):
        return tb.shade(g, tb.Lambert(0.5) + tb.Phong(0.2, 5.0), tb.PointLight(place, colour))

    compiled = torch.compile(image, fullgraph=True, backend="eager")
    torch.testing.assert_close(compiled(g, place, colour), image(g, place, colour))
    assert gradcheck(lambda p, c: image(g[:, :1, :1], p, c), (place.requires_grad_(), colour.requires_grad_()))


WRONG = {
    "batches": (lambda: tb.PointLight(torch.zeros(2, 3), torch.ones(3, 3)), r"PointLight: batch shapes do not broadcast: .*position.*\(2,\).*intensity.*\(3,\)"),
    "size": (lambda: tb.PointLight(torch.zeros(2, 2), 1.0), r"PointLight.position: expected shape \[..., 3\], found \[2, 2\]"),
    "views": (lambda: tb.PointLight(torch.zeros(4, 1, 3), 1.0).sample(torch.zeros(3, 5, 3)), r"PointLight: batch shape \[4, 1\], read as \[4\] views with 1 lights each, does not fit points of \[3, 5\].*\[B, L, 3\] by view"),
    "views of colours": (lambda: tb.DirectionalLight([0.0, 0.0, 1.0], torch.ones(2, 2, 3)).sample(torch.zeros(3)), r"DirectionalLight: batch shape \[2, 2\], .*does not fit points of \[\]"),
    "views that would grow the points": (lambda: tb.PointLight(torch.zeros(4, 1, 3), 1.0).sample(torch.zeros(1, 5, 3)), r"does not fit points of \[1, 5\]"),
    "none": (lambda: tb.PointLight(torch.zeros(0, 3), 1.0), r"PointLight.position: expected shape \[L, 3\], found \[0, 3\]; leave out"),
    "direction size": (lambda: tb.DirectionalLight([1.0, 0.0], 1.0), r"DirectionalLight.direction: expected shape \[..., 3\], found \[2\]"),
    "negative": (lambda: tb.validate(tb.PointLight([0.0, 0.0, 1.0], -2.0)), r"PointLight.intensity \[1, 1\]: legal range \[0, inf\), found -2"),
    "NaN": (lambda: tb.validate(tb.DirectionalLight([0.0, float("nan"), 1.0], 2.0)), r"DirectionalLight.direction \[1, 3\]: .* found nan"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_wrong_lights(case):
    call, message = WRONG[case]
    with pytest.raises(ValueError, match=message):
        call()
