"""Principled: lobes that are zero are not there, energy is not made, and the parts are what they are called."""

import math

import pytest
import torch
from test_per_call import POINT, dispatched
from test_shade import sheet

import torchbrdf as tb
from torchbrdf.testing.subject import above, generator

DOUBLE = torch.float64
GREEN = [0.2, 0.7, 0.1]
DIFFUSE, GLOSSY = tb.Lobe.DIFFUSE_REFLECTION, tb.Lobe.GLOSSY_REFLECTION
PLAIN = ("metal", "partial", "anisotropy", "coat", "sheen")


def number(x):
    return torch.tensor(x, dtype=DOUBLE)


def test_what_is_zero_is_not_there():
    assert tb.Principled(GREEN).lobes == (DIFFUSE, GLOSSY)
    assert tb.Principled(GREEN, metallic=1).lobes == (GLOSSY,)
    assert tb.Principled(GREEN, specular=0).lobes == (DIFFUSE,)
    assert tb.Principled(GREEN, metallic=0.5, coat=0.5).lobes == (DIFFUSE, GLOSSY, GLOSSY)
    assert tb.Principled(GREEN, metallic=torch.zeros(1), coat=torch.tensor(0.0)).off == PLAIN
    learned = torch.zeros(1, requires_grad=True)
    assert tb.Principled(GREEN, coat=learned).off == ("metal", "partial", "anisotropy", "sheen"), "what is learned stays"
    assert tb.Principled(GREEN, coat=torch.zeros(4, 1)).has("coat"), "maps are not looked at"
    assert torch.func.grad(lambda c: torch.tensor(float(tb.Principled(GREEN, coat=c).has("coat"))) * c.sum())(torch.zeros(1)).item() == 1.0


def test_derivatives_that_are_not_seen_by_autograd_stay():
    up = number([0.0, 0.0, 1.0])
    with torch.autograd.forward_ad.dual_level():
        coat = torch.autograd.forward_ad.make_dual(torch.zeros(1, dtype=DOUBLE), torch.ones(1, dtype=DOUBLE))
        f = tb.Principled(0.5, coat=coat).evaluate(up, up)
        assert torch.autograd.forward_ad.unpack_dual(f).tangent.item() > 1.0


def test_a_change_brings_lobes_back_and_takes_them_away():
    plastic = tb.Principled(GREEN)
    assert plastic.replace(coat=0.5).off == ("metal", "partial", "anisotropy", "sheen")
    assert set(plastic.replace(metallic=1.0).off) == {"anisotropy", "coat", "partial", "dielectric", "sheen"}
    assert set(plastic.replace(metallic=0.5).replace(metallic=0).off) == set(PLAIN)
    moved = plastic.replace(roughness=torch.rand(4, 1)).to(torch.float32)[2]
    assert moved.off == PLAIN


def test_saved_and_loaded(tmp_path):
    made = tb.Principled(GREEN, metallic=1, coat=0.3)
    made.save(tmp_path / "gold")
    found = tb.load_value(tmp_path / "gold")
    assert found.off == made.off == ("dielectric", "partial", "anisotropy", "sheen")
    wi, wo = above(9, generator(0)), above(9, generator(1))
    assert torch.equal(found.evaluate(wi, wo), made.evaluate(wi, wo))


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"metallic": 0.3, "coat": 0.6},
        {"metallic": 1.0},
        {"specular": 0.0, "coat": 1.0},
        {"specular": 0.5},
        {"anisotropy": 0.7},
        {"sheen": GREEN, "coat": 0.5},
    ],
)
def test_off_changes_nothing(given):
    """The same numbers with everything computed."""
    made = tb.Principled(GREEN, **given)
    whole = made.replace(off=())
    assert len(whole.lobes) == 4
    wi, wo = above(40, generator(2)), above(40, generator(3))
    torch.testing.assert_close(made.evaluate(wi, wo), whole.evaluate(wi, wo), rtol=1e-13, atol=0)
    parts = [made.replace(parts=(n,)) for n in made.names]
    torch.testing.assert_close(sum(p.evaluate(wi, wo) for p in parts), made.evaluate(wi, wo), rtol=1e-13, atol=0)
    assert made.select(tb.Lobe.SPREAD) is made
    assert made.select(tb.Lobe.DELTA) is None
    for wanted in (DIFFUSE, GLOSSY):
        part = made.select(wanted)
        assert part is None or set(part.lobes) == {wanted}


def test_the_parts_are_other_models():
    wi, wo = above(60, generator(4)), above(60, generator(5))
    rho, f0 = number(GREEN), 0.04
    gloss = tb.RoughConductor(0.16, tb.Schlick(f0)).evaluate(wi, wo)
    through = [1 - tb.fresnel.schlick(w[:, 2:], number(f0)) for w in (wi, wo)]
    base = rho / math.pi * through[0] * through[1] / (1 - f0 - (1 - f0) / 23)
    torch.testing.assert_close(tb.Principled(GREEN, roughness=0.4).evaluate(wi, wo), gloss + base, rtol=1e-12, atol=0)
    metal = tb.RoughConductor(0.16, tb.Schlick(GREEN)).evaluate(wi, wo)
    torch.testing.assert_close(tb.Principled(GREEN, metallic=1, roughness=0.4).evaluate(wi, wo), metal, rtol=1e-12, atol=0)
    torch.testing.assert_close(tb.Principled(GREEN, specular=0).evaluate(wi, wo), tb.Lambert(GREEN).evaluate(wi, wo), rtol=1e-12, atol=0)
    mixed = tb.Principled(GREEN, metallic=0.25, roughness=0.4)
    torch.testing.assert_close(mixed.evaluate(wi, wo), 0.25 * metal + 0.75 * (gloss + base), rtol=1e-12, atol=0)
    f0c = (0.8 / 2.8) ** 2
    over = [1 - 0.6 * tb.fresnel.schlick(w[:, 2:], number(f0c)) for w in (wi, wo)]
    coat = 0.6 * tb.RoughConductor(0.04, tb.Schlick(f0c)).evaluate(wi, wo)
    coated = mixed.replace(coat=0.6, coat_roughness=0.2, coat_ior=1.8)
    torch.testing.assert_close(coated.evaluate(wi, wo), over[0] * over[1] * mixed.evaluate(wi, wo) + coat, rtol=1e-12, atol=0)
    sheen = tb.Sheen([0.9, 0.5, 0.1], 0.7)
    rest = [1 - number([0.9, 0.5, 0.1]) * torch.exp(-1.39 * w[:, 2:] / 0.7) for w in (wi, wo)]
    cloth = coated.replace(sheen=sheen.color, sheen_roughness=0.7)
    torch.testing.assert_close(
        cloth.evaluate(wi, wo), rest[0] * rest[1] * coated.evaluate(wi, wo) + sheen.evaluate(wi, wo), rtol=1e-12, atol=0
    )
    brushed = tb.Principled(GREEN, metallic=1, roughness=0.4, anisotropy=0.75)
    aspect = math.sqrt(1 - 0.9 * 0.75)
    torch.testing.assert_close(
        brushed.evaluate(wi, wo), tb.RoughConductor([0.16 / aspect, 0.16 * aspect], tb.Schlick(GREEN)).evaluate(wi, wo), rtol=1e-12, atol=0
    )


COSINES = torch.cat([torch.linspace(0.02, 1.0, 25, dtype=DOUBLE), number([1e-4])])
VIEWS = torch.stack([torch.sqrt(1 - COSINES**2), 0 * COSINES, COSINES], -1)


@pytest.mark.parametrize("sheen", [0.0, 1.0])
@pytest.mark.parametrize("coat", [0.0, 1.0])
@pytest.mark.parametrize("ior", [1.0, 1.1, 1.5])
def test_white_makes_no_energy(ior, coat, sheen):
    """At every roughness, and little is lost where facets hide little: without a coat at most 0.45 % of the base."""
    for roughness in (0.03, 0.1, 0.32, 0.45, 0.7, 1.0):
        white = tb.Principled(
            1.0, roughness=roughness, ior=ior, coat=coat, coat_roughness=roughness, coat_ior=ior, sheen=sheen, sheen_roughness=roughness
        )
        albedo = white.directional_albedo(VIEWS, order=64)
        assert albedo.max() <= 1.0 + (2e-4 if sheen else 0.0), "the rule of 64 nodes at grazing"
        if roughness == 0.03 and coat == sheen == 0:
            assert albedo[:-1].min() >= 0.9955


def test_few_operations():
    """Beside Lambert and facets written by hand; metal, coat and anisotropy that are off cost nothing, those that are on a few."""
    g = sheet(8)
    by_hand = tb.Lambert(GREEN) + tb.RoughConductor(0.25, tb.Schlick(0.04))
    counts = {}
    for name, model in {
        "by hand": by_hand,
        "plastic": tb.Principled(GREEN),
        "all off": tb.Principled(GREEN, metallic=0, anisotropy=0, coat=0),
        "gold": tb.Principled(GREEN, metallic=1),
        "facets": tb.RoughConductor(0.25, tb.Schlick(GREEN)),
        "coated": tb.Principled(GREEN, coat=0.5),
    }.items():
        plan = tb.plan(g, model, POINT)
        counts[name] = len(dispatched(lambda plan=plan, model=model: plan(g, model, POINT)))
    assert counts["all off"] == counts["plastic"]
    assert counts["plastic"] <= counts["by hand"] + 24, counts  # the interface takes its part of light and view
    assert counts["gold"] <= counts["facets"] + 4, counts
    assert counts["plastic"] < counts["coated"]


def learned():
    return tb.nn.Material(
        tb.Principled,
        base_color=tb.nn.Learned([0.5, 0.5, 0.5]),
        roughness=tb.nn.Learned([0.6]),
        metallic=0,
        coat=torch.zeros(1),
        anisotropy=tb.nn.Learned([0.0]),
    )


def test_a_material_decides_when_it_is_made():
    material, g = learned(), sheet(6)
    assert {n for n, _ in material.named_parameters()} == {"base_color.raw", "roughness.raw", "anisotropy.raw"}
    assert material.fixed == {"metallic": 0, "coat": 0}
    assert material(g).off == ("metal", "partial", "coat", "sheen")
    assert tb.nn.Material(tb.Principled, base_color=0.5, metallic=1)(g).lobes == (GLOSSY,)
    assert tb.nn.Material(tb.Principled, base_color=0.5, metallic=0.5)(g).has("metal")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "off"),
    [
        (lambda a: tb.Principled(a, metallic=0, coat=0.0), PLAIN),
        (lambda a: tb.Principled(a, 1, coat=0.5), ("dielectric", "partial", "anisotropy", "sheen")),
    ],
    ids=["plastic", "coated gold"],
)
def test_in_a_graph_too(make, off):
    g, seen, albedo = sheet(6), [], torch.rand(6, 6, 3, requires_grad=True)
    plan = tb.plan(g, make(albedo), POINT)

    def image(albedo):
        made = make(albedo)
        seen.append(made.off)
        return plan(g, made, POINT)

    torch.testing.assert_close(torch.compile(image, backend="aot_eager", fullgraph=True)(albedo), image(albedo))
    assert seen == [off, off]


@pytest.mark.parametrize("coat", [0, 0.5])
def test_a_material_in_a_graph(coat):
    g = sheet(6)
    material = tb.nn.Material(tb.Principled, base_color=tb.nn.Learned([0.5, 0.5, 0.5]), metallic=0, coat=coat)
    shader = tb.nn.Shader(material, tb.plan(g, material(g), POINT))
    torch.testing.assert_close(torch.compile(shader, backend="aot_eager", fullgraph=True)(g, POINT), shader(g, POINT))


def test_maps_and_vmap():
    wi, wo = above(5, generator(6)), above(5, generator(7))
    maps = [torch.rand(5, n, dtype=DOUBLE, generator=generator(11)) for n in (3, 1, 1)]
    made = tb.Principled(maps[0], maps[1], coat=maps[2])
    each = torch.vmap(lambda c, m, coat, i, o: tb.Principled(c, m, coat=coat).evaluate(i, o))(*maps, wi, wo)
    torch.testing.assert_close(made.evaluate(wi, wo), each, rtol=1e-12, atol=0)


def test_what_is_wrong():
    with pytest.raises(ValueError, match=r"Principled\.shadowing: found 'v_cavity', legal are"):
        tb.Principled(0.5, shadowing="v_cavity")
    with pytest.raises(ValueError, match=r"Principled\.parts: found \('coat',\), of this material there are \('diffuse', 'specular'\)"):
        tb.Principled(0.5, parts=("coat",))
    with pytest.raises(ValueError, match=r"Principled\.off: found 'gloss', legal are"):
        tb.Principled(0.5, off=("gloss",))
    with pytest.raises(TypeError, match=r"Principled: unknown argument 'metalness'; did you mean metallic \(share of metal\)"):
        tb.Principled(0.5, metalness=1.0)
    with pytest.raises(ValueError, match=r"legal range \[1, inf\), found 0\.5"):
        tb.validate(tb.Principled(0.5, ior=0.5))


def test_recovered_from_reflectances():
    """Colour, metallic, roughness and coat from noisy values."""
    wi, wo = above(4000, generator(8)), above(4000, generator(9))
    truth = tb.Principled([0.8, 0.5, 0.2], 0.4, 0.45, coat=0.7, coat_roughness=0.2)
    seen = torch.log(truth.evaluate(wi, wo)) + 0.01 * torch.randn(4000, 3, dtype=DOUBLE, generator=generator(10))
    raw = [number(x).requires_grad_() for x in ([0.0, 0.0, 0.0], [0.0], [0.5], [0.0], [-1.0])]
    optimizer = torch.optim.LBFGS(raw, max_iter=150, line_search_fn="strong_wolfe", tolerance_change=1e-13)

    def made():
        colour, metallic, roughness, coat, coat_roughness = map(torch.sigmoid, raw)
        return tb.Principled(colour, metallic, roughness, coat=coat, coat_roughness=coat_roughness)

    def closure():
        optimizer.zero_grad()
        loss = (torch.log(made().evaluate(wi, wo)) - seen).square().mean()
        loss.backward()
        return loss

    optimizer.step(closure)
    found = made()
    for name in ("base_color", "metallic", "roughness", "coat", "coat_roughness"):
        assert getattr(found, name).tolist() == pytest.approx(getattr(truth, name).tolist(), rel=0.05), name
