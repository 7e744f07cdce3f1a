"""What is legal and most likely a mistake is warned of, where values can be seen; what is right is let pass in silence."""

import math
import warnings

import pytest
import torch
import trimesh
from test_shade import glossy, sheet, three_lights

import torchbrdf as tb

UP = torch.tensor([0.0, 0.0, 1.0])
SUN = tb.DirectionalLight([0.0, 0.0, 1.0], 1.0)


def silent(g, bsdf=None, lights=SUN):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tb.plan(g, tb.Lambert(0.5) if bsdf is None else bsdf, lights)


def rgba():
    return torch.cat([torch.rand(6, 6, 3), torch.ones(6, 6, 1)], -1)


def away():
    g = sheet()
    return g.replace(normal=-g.normal)


DOUBTS = {
    "alpha": (sheet(), tb.Lambert(rgba()), SUN, r"Lambert.albedo: the last of 4 channels is 0 or 1 everywhere; if it is alpha, take x\[..., :3\]"),
    "alpha of a learned texture": (sheet(), tb.Lambert(rgba() - 0.0003), SUN, "Lambert.albedo: the last of 4 channels is 0 or 1"),
    "alpha in a sum": (sheet(), tb.Lambert(0.5) + 0.5 * tb.BlinnPhong(rgba(), 5.0), SUN, "BlinnPhong.specular: the last of 4 channels"),
    "alpha of a sky": (sheet(), tb.Mirror(0.5), tb.EnvironmentMap(rgba()), "EnvironmentMap.texels: the last of 4 channels"),
    "one number a point": (sheet().map(lambda t: t.flatten(0, 1)), tb.Lambert(torch.rand(36)), SUN, r"Lambert.albedo: 36 channels beside a list of 36 points; one number for each point is x\[:, None\]"),
    "normals reversed": (away(), tb.Lambert(0.5), SUN, r"GBuffer: none of its 36 valid pixels faces the viewer \(n . view <= 0\).* turn what is reversed, or take tb.TwoSided"),
    "views reversed": (sheet().replace(view=-sheet().view), glossy(8), SUN, "none of its 36 valid pixels faces the viewer"),
    "reversed before a mirror": (away(), tb.Mirror(0.5), tb.EnvironmentMap(torch.rand(4, 8, 3)), "none of its 36 valid pixels faces the viewer"),
    "one flat normal map": (sheet().replace(normal=torch.tensor([0.5, 0.5, 1.0])), tb.Lambert(0.5), SUN, "GBuffer.normal: no component is negative, .*a normal map stored in"),
}  # fmt: skip


@pytest.mark.parametrize("case", DOUBTS)
def test_one_warning(case):
    g, bsdf, lights, message = DOUBTS[case]
    with pytest.warns(UserWarning, match=message) as seen:
        tb.plan(g, bsdf, lights)
    with pytest.warns(UserWarning, match=message) as again:
        tb.shade(g, bsdf, lights)
    assert [w.filename for w in (*seen, *again)] == [__file__] * 2
    assert "\n" not in str(seen[0].message)


def octant():
    """Unit normals and others, none with a negative component."""
    return torch.rand(6, 6, 3, generator=torch.Generator().manual_seed(3))


RIGHT = {
    "a sheet": (sheet(), glossy()),
    "many channels": (sheet(), tb.Lambert(torch.rand(6, 6, 31))),
    "as many channels as the picture is wide": (sheet(), tb.Lambert(torch.rand(6, 6, 6))),
    "as many channels as points, by colour": (sheet().map(lambda t: t.flatten(0, 1)), tb.Lambert(torch.rand(36, 36))),
    "four channels": (sheet(), tb.Lambert(torch.rand(6, 6, 4))),
    "a fourth channel without light": (sheet(), tb.Lambert(torch.cat([torch.rand(6, 6, 3), torch.zeros(6, 6, 1)], -1))),
    "one colour of four channels": (sheet(), tb.Lambert([0.5, 0.4, 0.3, 1.0])),
    "a colour by column of a tiny picture": (sheet(3), tb.Lambert(torch.rand(3, 3))),
    "a table of a few rows": (sheet(), tb.Lambert(tb.nn.Texture(torch.rand(3, 9, 31)).at(torch.rand(6, 6, 2)))),
    "parallel rays": (sheet().replace(view=UP), tb.Lambert(0.5)),
    "parallel rays, rounded": (sheet().replace(view=(1.003 * UP).expand(6, 6, 3)), tb.Lambert(0.5)),
    "views of any length": (sheet().replace(view=torch.tensor([0.2, -0.1, 4.0]) - sheet().position), tb.Lambert(0.5)),
    "one point": (sheet()[2, 3].replace(view=4 * UP), tb.Lambert(0.5)),
    "one position": (sheet().replace(position=torch.zeros(3), view=4 * UP), tb.Lambert(0.5)),
    "normals of any length": (sheet().replace(normal=3 * sheet().normal), tb.Lambert(0.5)),
    "unit normals of one octant": (sheet().replace(normal=tb.normalize(octant())), tb.Lambert(0.5)),
    "unit normals that are unit decoded, too": (sheet().replace(normal=tb.normalize(torch.tensor([0.704, 0.704, 0.0918]))), tb.Lambert(0.5)),
    "normals of one octant": (sheet().replace(normal=octant()), tb.Lambert(0.5)),
    "back faces, reflecting": (away(), tb.TwoSided(tb.Lambert(0.5))),
    "some back faces": (sheet().replace(normal=torch.where(torch.eye(6).bool()[..., None], 1.0, -1.0) * sheet().normal), tb.Lambert(0.5)),
    "no surface": (away().replace(mask=torch.zeros(6, 6, 1, dtype=torch.bool)), tb.Lambert(0.5)),
    "no pixels": (sheet()[:0], tb.Lambert(0.5)),
    "without numbers": (sheet().to("meta"), tb.Lambert(0.5)),
}  # fmt: skip


@pytest.mark.parametrize("case", RIGHT)
def test_what_is_right_is_let_pass(case):
    silent(*RIGHT[case])


def test_a_rendered_mesh_is_let_pass():
    box = trimesh.creation.box()
    mesh = tb.Mesh(torch.tensor(box.vertices).float(), torch.tensor(box.faces))
    for eye in ([3.0, 2.0, 4.0], [0.0, 0.0, 4.0]):  # three faces of the box, and one alone
        silent(tb.GBuffer.from_mesh(mesh, tb.Camera.look_at(eye, [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], 40.0, (24, 24))))


def test_what_a_thin_grid_shows_is_looked_at_in_full():
    """One pixel that faces the viewer, one true normal in ten, views that differ off the grid: enough to be let pass."""
    n = 100
    g = sheet(n)
    facing = -g.normal.clone()
    facing[41, 53] *= -1.0
    silent(g.replace(normal=facing))
    encoded = 0.5 * g.normal + 0.5
    encoded[1::2] = g.normal[1::2]
    silent(g.replace(normal=encoded.clone()))
    with pytest.raises(ValueError, match="a normal map stored in"):
        tb.plan(g.replace(normal=0.5 * g.normal + 0.5), tb.Lambert(0.5), SUN)
    with pytest.raises(ValueError, match="one view, of length 4"):
        tb.plan(g.replace(view=4 * UP), tb.Lambert(0.5), SUN)


def test_the_border_of_a_view_and_the_background_do_not_hide_a_mistake():
    g = sheet(40)
    encoded = 0.5 * g.normal + 0.5
    encoded[:5] = 0.5
    with pytest.raises(ValueError, match="a normal map stored in"):
        tb.plan(g.replace(normal=encoded), tb.Lambert(0.5), SUN)
    eyes = torch.cat([(4 * UP).expand(800, 3), torch.tensor([0.0, 3.0, 3.0]).expand(800, 3)])
    with pytest.raises(ValueError, match="one view, of length 4"):
        tb.plan(g.map(lambda t: t.flatten(0, 1)).replace(view=eyes), tb.Lambert(0.5), SUN)


def test_nothing_is_looked_at_in_graphs_and_transforms():
    g, lights = sheet().replace(view=4 * UP.expand(6, 6, 3)), three_lights()
    torch.compiler.reset()
    compiled = torch.compile(tb.shade, fullgraph=True, backend="eager")
    for image in (compiled(g, tb.Lambert(0.5), lights), torch.vmap(lambda g: tb.shade(g, tb.Lambert(0.5), lights))(g[None])[0]):
        torch.testing.assert_close(image, tb.shade(g.replace(view=UP), tb.Lambert(0.5), lights))


def test_the_encoding_that_is_refused_shades_rightly_once_decoded():
    g = sheet()
    decoded = tb.normalize(2 * (0.5 * g.normal + 0.5) - 1)
    torch.testing.assert_close(tb.shade(g.replace(normal=decoded), glossy(), SUN), tb.shade(g, glossy(), SUN))
    assert math.isfinite(float(decoded.sum()))


def test_several_materials_at_once_by_the_recipe_of_the_error():
    g, albedo = sheet(), torch.rand(5, 6, 6, 3)
    bsdf, lights = tb.Lambert(albedo), three_lights()
    with pytest.raises(ValueError, match=r"torch.vmap\(lambda b: tb.shade\(g, b, lights\)\)\(bsdf\)"):
        tb.shade(g, bsdf, lights)
    images = torch.vmap(lambda b: tb.shade(g, b, lights))(bsdf)
    torch.testing.assert_close(images[3], tb.shade(g, tb.Lambert(albedo[3]), lights))
