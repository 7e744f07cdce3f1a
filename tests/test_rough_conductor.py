"""Rough conductors: the sampler at hard roughness and views, derivatives with tangents, and roughness that needs them."""

import warnings

import pytest
import torch
from test_shade import sheet

import torchbrdf as tb
from torchbrdf.testing.partition import Partition
from torchbrdf.testing.sampling import SIGNIFICANCE, agreement, counted, of_several
from torchbrdf.testing.subject import at_angles, generator

VIEWS = (0.0, 45.0, 80.0, 89.0)
ROUGHNESS = [[0.02], [0.2], [1.0], [0.02, 0.4]]


@pytest.mark.parametrize("distribution", ["ggx", "beckmann", "blinn"])
@pytest.mark.parametrize("alpha", ROUGHNESS, ids=str)
def test_samples_follow_the_density(alpha, distribution):
    """Chi-square at normal and grazing views, all together at the usual level."""
    mirror, rng = tb.RoughConductor(alpha, None, distribution).to(torch.float64), generator(0)
    found = counted(mirror, Partition.of(mirror, at_angles(*VIEWS), rng), rng, 20_000)
    p = [agreement(o, e) for o, e in zip(found.observed, found.expected, strict=True)]
    assert min(p) > of_several(SIGNIFICANCE, len(p) * 3 * len(ROUGHNESS)), p


POINTS = 4


def inputs(axes):
    """wi, wo, n and tangents of any length, off the horizon; alpha of one number or two; f0."""
    rng = generator(1)
    frame = tb.Frame.from_normal(torch.randn(POINTS, 3, generator=rng, dtype=torch.float64))
    local = [torch.randn(POINTS, 3, generator=rng, dtype=torch.float64) for _ in range(3)]
    wi, wo = (frame.to_world(tb.normalize(w * torch.tensor([1.0, 1.0, 0.0]) + torch.tensor([0.0, 0.0, 1.0]))) for w in local[:2])
    alpha = torch.tensor([0.5, 0.2][:axes], dtype=torch.float64)
    f0 = torch.tensor([0.9, 0.6, 0.3], dtype=torch.float64)
    return [x.detach().requires_grad_() for x in (wi, wo, frame.normal, 2.0 * local[2], alpha, f0)]


@pytest.mark.parametrize("distribution", ["ggx", "beckmann", "blinn"])
@pytest.mark.parametrize("shadowing", ["smith_correlated", "smith_separable"])
@pytest.mark.parametrize("axes", [1, 2])
def test_derivatives_with_tangents(distribution, shadowing, axes):
    """By both directions, normal, tangent, roughness and colour, and all mixed second ones."""

    def f(wi, wo, n, tangent, alpha, f0):
        return tb.RoughConductor(alpha, tb.Schlick(f0), distribution, shadowing).evaluate(wi, wo, n, tangent)

    given = inputs(axes)
    assert torch.autograd.gradcheck(f, given)
    assert torch.autograd.gradgradcheck(f, given, torch.ones(POINTS, 3, dtype=torch.float64, requires_grad=True), fast_mode=True)
    by_tangent = torch.autograd.grad(f(*given).sum(), given[3], allow_unused=True, materialize_grads=True)[0]
    assert (by_tangent.abs().max() > 1e-3) == (axes == 2)


def test_the_tangent_turns_the_lobe():
    """alpha_x lies along the tangent: a tangent turned by 90 degrees is the two numbers exchanged; its length and sign do not matter."""
    wi, wo, n, tangent, *_ = inputs(2)
    across = torch.linalg.cross(n, tangent)
    f = tb.RoughConductor([0.5, 0.2]).evaluate(wi, wo, n, tangent)
    torch.testing.assert_close(tb.RoughConductor([0.2, 0.5]).evaluate(wi, wo, n, across), f)
    torch.testing.assert_close(tb.RoughConductor([0.5, 0.2]).evaluate(wi, wo, n, -3.0 * tangent), f)
    assert not torch.allclose(tb.RoughConductor([0.2, 0.5]).evaluate(wi, wo, n, tangent), f, rtol=1e-2)


SUN = tb.DirectionalLight([0.3, -0.2, 1.0], 1.0)
BRUSHED = tb.RoughConductor([0.4, 0.1])


def brushed_sheet(handedness=1.0):
    g = sheet()
    along = torch.tensor([1.0, 0.4, 0.2]).expand_as(g.position)
    return g.replace(tangent=along, handedness=torch.full_like(g.position[..., :1], handedness))


def test_shade_takes_the_tangents():
    """As evaluate does, whatever the handedness: both roughnesses are the same on either side of the tangent."""
    g = brushed_sheet()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        image = tb.shade(g, BRUSHED, SUN)
        mirrored = tb.shade(brushed_sheet(-1.0), BRUSHED, SUN)
    wi = tb.normalize(torch.tensor([0.3, -0.2, 1.0])).expand_as(g.position)
    torch.testing.assert_close(image, BRUSHED.evaluate(wi, g.view, g.normal, g.tangent, cosine=True))
    torch.testing.assert_close(mirrored, image)


NEEDS = r"alpha of two numbers needs tangents"


@pytest.mark.parametrize("material", [BRUSHED, tb.Lambert(0.5) + 0.3 * BRUSHED, tb.TwoSided(BRUSHED)], ids=lambda m: type(m).__name__)
def test_two_numbers_without_tangents_are_warned_of(material):
    with pytest.warns(UserWarning, match=NEEDS) as seen:
        tb.plan(sheet(), material, SUN)
    assert "\n" not in str(seen[0].message)
    with pytest.warns(UserWarning, match=NEEDS):
        tb.shade(brushed_sheet().replace(tangent=torch.zeros(3)), material, SUN)


def test_what_needs_no_tangents_is_let_pass():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tb.plan(sheet(), tb.RoughConductor(0.4), SUN)
        tb.plan(brushed_sheet(), BRUSHED, SUN)
