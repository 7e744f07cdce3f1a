"""Values put side by side: what :func:`torchbrdf.stack` gives, and what it refuses."""

from typing import NamedTuple

import pytest
import torch
from torch.utils.data import DataLoader

import torchbrdf as tb
from torchbrdf import stacking
from torchbrdf.effects.base import Prepared

SUN = tb.DirectionalLight([0.3, 0.2, 1.0], 2.0)


def mixture(seed, *batch):
    gen = torch.Generator().manual_seed(seed)

    def colour():
        return torch.rand(*batch, 3, generator=gen)

    return tb.Lambert(colour()) + (0.2 + 0.1 * seed) * tb.Phong(
        colour(), 10 * torch.rand(*batch, 1, generator=gen), fresnel=tb.Schlick(colour())
    )


def surface(seed, *batch):
    gen = torch.Generator().manual_seed(seed)
    normal, view = (tb.normalize(torch.rand(*shape, 3, generator=gen) + torch.tensor([0.0, 0.0, 1.0])) for shape in (batch, ()))
    mask = torch.rand(*batch, 1, generator=gen) > 0.3
    return tb.GBuffer(torch.rand(*batch, 3, generator=gen), normal, view=view, mask=mask, material=mask.long())


def shown(v):
    return {path: t.clone() for path, t in v.named_tensors()}


def test_a_stacked_value_gives_its_parts_again():
    parts = [surface(k, 4, 5) for k in range(3)]
    found = tb.stack(parts)
    assert found.batch_shape == (3, 4, 5)
    assert found.view.shape == (3, 1, 1, 3), "what has no batch axes is not repeated"
    for k, part in enumerate(parts):
        assert (shown(found[k])["position"] == part.position).all()
        assert (found[k].mask == part.mask).all()
        assert (found[k].material == part.material).all()
        assert (found[k].material.dtype, found[k].mask.dtype) == (torch.int64, torch.bool)
        assert torch.equal(found[k].view, part.view.expand(4, 5, 3))
        brdf = mixture(1, 4, 5)
        assert torch.equal(tb.shade(found[k], brdf, SUN), tb.shade(part, brdf, SUN))


@pytest.mark.parametrize("batch", [(), (4,), (4, 5)])
def test_materials(batch):
    parts = [mixture(k, *batch) for k in range(3)]
    found = tb.stack(parts)
    assert found.batch_shape == (3, *batch)
    for k, part in enumerate(parts):
        wi, wo = (torch.rand(*batch, 3) for _ in range(2))
        assert torch.equal(found[k].evaluate(wi, wo), part.evaluate(wi, wo))


@pytest.mark.parametrize("dim", range(-3, 3))
def test_dim_counts_batch_axes(dim):
    parts = [surface(k, 4, 5) for k in range(3)]
    found = tb.stack(parts, dim)
    expected = torch.stack([p.mask.squeeze(-1) for p in parts], dim)
    assert torch.equal(found.mask.squeeze(-1), expected)
    assert found.view.shape == (*(3 if n == 3 else 1 for n in expected.shape), 3)
    with pytest.raises(IndexError, match="legal are -3 to 2"):
        tb.stack(parts, 3)


def test_results_are_planar():
    found = tb.stack([surface(0, 4, 5), surface(1, 4, 5)])
    assert tb.is_planar(found.position)
    assert tb.is_planar(tb.stack([mixture(0, 4), mixture(1, 4)], 1).terms[0].albedo)


def test_shapes_broadcast():
    a, b, c = tb.Lambert(torch.rand(4, 1, 3)), tb.Lambert(torch.rand(5, 1)), tb.Lambert(0.5)
    found = tb.stack([a, b, c])
    assert found.albedo.shape == (3, 4, 5, 3)
    assert torch.equal(found[0].albedo, a.albedo.expand(4, 5, 3))
    assert torch.equal(found[1].albedo, b.albedo.expand(4, 5, 3))
    assert found.albedo.dtype == torch.float32, "a number follows those with batch axes"


def test_whole_numbers_stay_whole():
    parts = [surface(k, 4, 5).replace(material=torch.tensor([k])) for k in range(2)]
    assert (tb.stack(parts).material.dtype, tb.stack(parts).material.shape) == (torch.int64, (2, 1, 1, 1))


def test_every_tensor_gets_the_axis_that_vmap_takes():
    views, materials = [surface(k, 4, 5) for k in range(3)], [tb.Lambert(0.1), tb.Lambert(0.2), tb.Lambert(0.3)]
    lights = [tb.PointLight([[0.0, 0.0, 3.0 + k], [1.0, 0.0, 3.0]], 5.0) for k in range(3)]
    images = torch.vmap(tb.shade)(tb.stack(views), tb.stack(materials), tb.stack(lights))
    for k in range(3):
        assert torch.allclose(images[k], tb.shade(views[k], materials[k], lights[k]), rtol=1e-6)


def test_stacked_lights_light_the_views_one_by_one():
    lights = [tb.PointLight([[0.0, 0.0, z], [1.0, 0.0, z]], [[5.0], [3.0]]) for z in (3.0, 4.0)]
    views = [surface(k, 4, 5) for k in range(2)]
    images = tb.shade(tb.stack(views), tb.Lambert(0.5), [SUN, tb.stack(lights)])
    for k in range(2):
        assert torch.allclose(images[k], tb.shade(views[k], tb.Lambert(0.5), [SUN, lights[k]]), rtol=1e-6)
    assert tb.shade(views[0], tb.Lambert(0.5), [SUN, tb.stack(lights)[1]]).shape == (4, 5, 1)
    with pytest.raises(ValueError, match=r"PointLight.*\[2, 2\]"):
        tb.shade(views[0], tb.Lambert(0.5), [SUN, tb.stack(lights)])


def test_stacked_skies_are_several():
    skies = tb.stack([tb.EnvironmentMap(torch.rand(4, 8, 3)), tb.EnvironmentMap(torch.rand(4, 8, 3))])
    with pytest.raises(ValueError, match=r"lights\[0\]: EnvironmentMap of batch shape \[2\].*torch.vmap"):
        tb.shade(surface(0, 4, 5), tb.Mirror(0.5), skies)
    assert tb.shade(surface(0, 4, 5), tb.Mirror(0.5), skies[1]).shape == (4, 5, 3)


def test_cameras_and_prepared_shadows():
    cameras = [tb.Camera.look_at([x, 0.0, 3.0], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], size=(4, 6)) for x in (0.0, 1.0)]
    rays = tb.stack(cameras).rays()[1]
    assert torch.equal(rays[1], cameras[1].rays()[1])
    shadows = [Prepared(("shadow",), (torch.rand(2, 4, 5, 1),)) for _ in range(2)]
    assert torch.equal(tb.stack(shadows).of("shadow")[1], shadows[1].of("shadow"))


def test_gradients_reach_every_value():
    leaves = [torch.rand(4, 3, requires_grad=True), torch.rand(3, requires_grad=True)]
    (tb.stack([tb.Lambert(x) for x in leaves]).albedo * torch.tensor([1.0, 2.0]).reshape(2, 1, 1)).sum().backward()
    assert torch.equal(leaves[0].grad, torch.ones(4, 3))
    assert torch.equal(leaves[1].grad, torch.full((3,), 8.0))


def brightness(a, b):
    found = tb.stack([tb.Lambert(a) + tb.Phong(b, 10.0), tb.Lambert(b) + tb.Phong(a, 20.0)])
    up = torch.tensor([0.0, 0.0, 1.0])
    return found.evaluate(up, up)


def test_transforms_and_compile():
    a, b = torch.rand(4, 3), torch.rand(4, 3)
    expected = brightness(a, b)
    assert torch.equal(torch.compile(brightness, backend="aot_eager", fullgraph=True)(a, b), expected)
    assert torch.allclose(torch.vmap(brightness, out_dims=1)(a[:, None], b[:, None]).squeeze(2), expected)


class Scenes(torch.utils.data.Dataset):
    """Views with their pictures."""

    def __len__(self):
        return 4

    def __getitem__(self, k):
        return surface(k, 4, 5), {"image": torch.full((4, 5, 3), float(k)), "name": f"view {k}", "exposure": 0.5 * k}


def test_data_loader():
    (g, rest), _ = DataLoader(Scenes(), batch_size=2, collate_fn=tb.stack)
    assert torch.equal(g.position, torch.stack([surface(0, 4, 5).position, surface(1, 4, 5).position]))
    assert (rest["image"].shape, rest["name"], rest["exposure"].tolist()) == ((2, 4, 5, 3), ["view 0", "view 1"], [0.0, 0.5])


class Pair(NamedTuple):
    """A named tuple."""

    g: tb.GBuffer
    nothing: None


def test_containers_keep_their_kind():
    found = tb.stack([Pair(surface(0, 2), None), Pair(surface(1, 2), None)])
    assert isinstance(found, Pair)
    assert (found.g.batch_shape, found.nothing) == ((2, 2), None)
    assert isinstance(tb.stack([[torch.zeros(1)], [torch.zeros(1)]]), list)


V = torch.rand(4, 3)
PHONG = tb.Phong(V, 10.0)
WRONG = {
    "no list": (PHONG, TypeError, r"values: expected a list of values, found Phong; pass \[a, b\]"),
    "a number": (3, TypeError, "found int"),
    "none": ([], ValueError, "found none"),
    "a flag": ([PHONG, tb.Phong(V, 10.0, normalization="bound")], ValueError, r"values\[1\].normalization: found bound, .* has modified"),
    "a class": ([0.5 * PHONG, 0.5 * tb.Lambert(V)], TypeError, r"values\[1\].inner: found Lambert, .* has Phong"),
    "terms": ([PHONG + PHONG, PHONG + PHONG + PHONG], ValueError, r"values\[1\].terms: found 3, .* has 2"),
    "an absent field": ([tb.GBuffer(V, V), tb.GBuffer(V, V, view=V)], TypeError, r"values\[1\].view: found a tensor, .* has None"),
    "a dtype": ([tb.Lambert(V), tb.Lambert(V.double())], TypeError, r"values\[1\].albedo: found float64 on cpu, .*float32.*\.to\("),
    "channels": ([tb.Lambert(V), tb.Lambert(V[:, :2])], ValueError, r"values\[1\].albedo: found \[2\], .* has \[3\]"),
    "batch axes": ([tb.Lambert(V), tb.Lambert(V[:3])], ValueError, r"do not broadcast: \{'values\[0\]': \(4,\), 'values\[1\]': \(3,\)\}"),
    "vertices": ([tb.Mesh(torch.rand(n, 3), [[0, 1, 2]]) for n in (3, 4)], ValueError, r"values\[1\].vertices: found \[4, 3\]"),
    "a size": (
        [tb.Camera(V, torch.eye(3), [1.0, 1.0], [1.0, 1.0], (n, 2)) for n in (2, 3)],
        ValueError,
        r"size\[0\]: found 3, but values\[0\].size\[0\] has 2",
    ),
    "an entry": ([(PHONG, V), (PHONG, V[:3])], ValueError, r"values\[1\]\[1\]: found \[3, 3\], but values\[0\]\[1\] has \[4, 3\]"),
    "a value in an entry": ([{"a": PHONG}, {"a": tb.Mirror(0.5)}], TypeError, r"values\[1\]\['a'\]: found Mirror"),
    "keys": ([{"a": V}, {"b": V}], ValueError, r"values\[1\]: found \['b'\]"),
    "kinds": ([PHONG, 3], TypeError, r"values\[1\]: found int, but values\[0\] has Phong"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_does_not_fit_is_named(case):
    values, error, message = WRONG[case]
    with pytest.raises(error, match=message):
        tb.stack(values)


def test_errors_stay_short():
    assert len(stacking._shown("x" * 1000)) < 70
