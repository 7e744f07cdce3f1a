"""Plans: what is on, what is off and why, in the words that are printed; and what a plan refuses to be called with."""

import pytest
import torch
import trimesh

import torchbrdf as tb
from torchbrdf.effects.direct import Direct

POINT = tb.PointLight([0.0, 0.0, 5.0], 1.0)
SUNS = tb.DirectionalLight([[0.0, 0.0, 1.0], [0.0, 1.0, 1.0]], 1.0)
SKY = tb.EnvironmentMap(torch.ones(2, 4, 3))
GLOSSY = tb.Lambert(0.5) + tb.Phong(0.3, 20.0)


def plate(n=4):
    axis = torch.linspace(-1, 1, n)
    y, x = torch.meshgrid(axis, axis, indexing="ij")
    up = torch.tensor([0.0, 0.0, 1.0])
    return tb.GBuffer(torch.stack([x, y, 0 * x], -1), up.expand(n, n, 3), up.expand(n, n, 3))


def box():
    b = trimesh.creation.box()
    return tb.Mesh(torch.tensor(b.vertices, dtype=torch.float32), torch.tensor(b.faces))


GOLDEN = {
    "direct": (
        lambda g: tb.plan(g, GLOSSY, [POINT, SUNS]),
        "plan\n"
        "  direct       on   diffuse reflection, glossy reflection under 3 point or directional lights: a sum, exact\n"
        "  shadow       off  no mesh to cast them; pass mesh= or visibility=\n"
        "  mirror       off  no mirror lobe",
    ),
    "shadows": (
        lambda g: tb.plan(g, tb.Lambert(0.5), POINT, box()),
        "plan\n"
        "  direct       on   diffuse reflection under 1 point or directional light: a sum, exact\n"
        "  shadow       on   a mesh (or a visibility) is given: one ray per pixel and light, outside the graph, no gradient\n"
        "  mirror       off  no mirror lobe",
    ),
    "shadows off": (
        lambda g: tb.plan(g, tb.Lambert(0.5), POINT, box(), shadow="off"),
        "plan\n"
        "  direct       on   diffuse reflection under 1 point or directional light: a sum, exact\n"
        "  shadow       off  switched off by shadow='off'\n"
        "  mirror       off  no mirror lobe",
    ),
    "mirror of the sky": (
        lambda g: tb.plan(g, tb.Mirror(), SKY),
        "plan\n"
        "  direct       off  the material has delta lobes alone, and those never meet a point or a direction\n"
        "  shadow       off  no direct light to be blocked\n"
        "  mirror       on   mirror reflection of the environment map: one look-up, exact; the mesh itself is not reflected",
    ),
    "mirror under a point": (
        lambda g: tb.plan(g, tb.Mirror() + tb.Lambert(0.5), POINT),
        "plan\n"
        "  direct       on   diffuse reflection under 1 point or directional light: a sum, exact\n"
        "  shadow       off  no mesh to cast them; pass mesh= or visibility=\n"
        "  mirror       off  no environment to be seen in the mirror; points and directions are met with probability 0",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", GOLDEN)
def test_the_printed_plan(case):
    make, text = GOLDEN[case]
    assert str(make(plate())) == text


def test_a_plan_is_static_and_equal_plans_are_equal():
    a, b = (tb.plan(plate(n), GLOSSY, [POINT, SUNS]) for n in (4, 7))
    assert a == b
    assert hash(a) == hash(b)
    assert a.calls_for("direct")
    assert not a.calls_for("mirror")


def test_shade_is_plan_and_run():
    g = plate()
    assert torch.equal(tb.plan(g, GLOSSY, [POINT, SUNS])(g, GLOSSY, [POINT, SUNS]), tb.shade(g, GLOSSY, [POINT, SUNS]))


@pytest.mark.parametrize("material", [GLOSSY, GLOSSY + tb.Mirror()])
def test_an_environment_for_a_glossy_lobe_is_refused(material):
    with pytest.raises(
        ValueError,
        match=r"lights: in this version an EnvironmentMap lights mirror lobes alone, .*diffuse reflection, glossy reflection; shade the parts apart",
    ):
        tb.plan(plate(), material, [SKY, POINT])


def test_shadows_that_would_be_lost():
    g = plate()
    blind = tb.plan(g, GLOSSY, POINT)
    free = torch.ones(1, 4, 4, 1)
    with pytest.raises(ValueError, match=r"visibility: this plan was made without shadows; make it with"):
        blind(g, GLOSSY, POINT, visibility=free)
    with pytest.warns(UserWarning, match=r"mesh: this plan was made without shadows"):
        blind(g, GLOSSY, POINT, mesh=box())
    # Where the plan gives another reason, there is nothing to lose, or it was asked for.
    tb.plan(g, GLOSSY, POINT, shadow="off")(g, GLOSSY, POINT, visibility=free, mesh=box())
    tb.plan(g, tb.Mirror(), SKY)(g, tb.Mirror(), SKY, visibility=free[:0])
    with pytest.raises(ValueError, match=r"mesh: the plan casts shadows; pass mesh=\.\.\. or visibility="):
        tb.plan(g, GLOSSY, POINT, box())(g, GLOSSY, POINT)


def test_an_effect_of_the_same_name_takes_the_place_of_the_built_in_one():
    g, seen = plate(), []

    class Double(Direct):
        def prepare(self, scene, generator):
            seen.append(torch.is_grad_enabled())

        def run(self, bsdf, surface, lights, prepared):
            return [part._replace(radiance=[2 * c for c in part.radiance]) for part in super().run(bsdf, surface, lights, prepared)]

    torch.testing.assert_close(tb.shade(g, GLOSSY, POINT, effects=[Double()]), 2 * tb.shade(g, GLOSSY, POINT))
    assert seen == [False], "what is prepared has no gradient"
