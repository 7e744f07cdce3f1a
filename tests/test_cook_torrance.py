"""The model of 1982: what is printed, and what its constant does to energy."""

import math

import pytest
import torch

import torchbrdf as tb
from torchbrdf.testing.subject import above, generator

DOUBLE = torch.float64
COPPER = tb.Conductor.named("Cu")


def number(x):
    return torch.tensor(x, dtype=DOUBLE)


def printed(wi, wo, m, f):
    """R_s of the paper, with two slopes at 0.4 and 0.6."""
    h = tb.normalize(wi + wo)
    nl, nv, nh, vh = wi[:, 2:], wo[:, 2:], h[:, 2:], (wo * h).sum(-1, keepdim=True)
    tan2 = 1 / nh**2 - 1
    d = sum(w / (s**2 * nh**4) * torch.exp(-tan2 / s**2) for w, s in zip((0.4, 0.6), m, strict=True))
    g = torch.minimum(torch.ones_like(nl), 2 * nh / vh * torch.minimum(nl, nv))
    return f(vh) / math.pi * d * g / (nl * nv)


def test_it_is_what_is_printed():
    wi, wo = above(200, generator(0)), above(200, generator(1))
    model = tb.CookTorrance([0.3, 0.2, 0.1], 0.7, [0.2, 0.5], COPPER, weights=[2.0, 3.0])
    expected = 0.7 * printed(wi, wo, (0.2, 0.5), COPPER.reflectance) + 0.3 * number([0.3, 0.2, 0.1]) / math.pi
    torch.testing.assert_close(model.evaluate(wi, wo), expected, rtol=1e-12, atol=1e-15)
    torch.testing.assert_close(model.select(tb.Lobe.GLOSSY).evaluate(wi, wo), 0.7 * printed(wi, wo, (0.2, 0.5), COPPER.reflectance))
    torch.testing.assert_close(model.select(tb.Lobe.DIFFUSE).evaluate(wi, wo)[0], 0.3 * number([0.3, 0.2, 0.1]) / math.pi)
    assert model.select(tb.Lobe.DELTA) is None


def test_the_printed_constant_is_four_times_the_modern_one():
    up = number([0.0, 0.0, 1.0])
    old, new = (tb.CookTorrance(0.0, 1.0, 0.1, normalization=n) for n in ("1982", "modern"))
    assert old.energy_bound is None
    assert new.energy_bound.tolist() == [1.0]
    albedo = new.directional_albedo(up).item()
    assert 0.97 < albedo <= 1.0, "mirrors lose what the grooves hide"
    assert old.directional_albedo(up).item() == pytest.approx(4 * albedo, rel=1e-12)
    facets = tb.RoughConductor(0.1, distribution="beckmann", shadowing="v_cavity")
    wi, wo = above(50, generator(2)), above(50, generator(3))
    torch.testing.assert_close(new.evaluate(wi, wo), facets.evaluate(wi, wo), rtol=1e-12, atol=0)


def test_equal_weights_are_said_by_none():
    wi, wo = above(50, generator(4)), above(50, generator(5))
    some, none = (tb.CookTorrance(0.5, 0.5, [0.1, 0.3, 0.7], weights=w) for w in ([2.0, 2.0, 2.0], None))
    torch.testing.assert_close(some.evaluate(wi, wo), none.evaluate(wi, wo), rtol=1e-14, atol=0)
    assert tb.testing.check(none).ok


def test_what_is_wrong():
    with pytest.raises(ValueError, match=r"CookTorrance\.normalization: found '1981', legal are \['1982', 'modern'\]"):
        tb.CookTorrance(0.5, 0.5, 0.3, normalization="1981")
    with pytest.raises(ValueError, match=r"CookTorrance\.weights: expected shape \[\.\.\., K\] with K = 1 as in alpha, found \[2\]"):
        tb.CookTorrance(0.5, 0.5, 0.3, weights=[0.5, 0.5])


def test_samples_name_their_lobe():
    s = tb.CookTorrance(0.9, 0.5, [0.05, 0.1], normalization="modern").sample(
        number([0.0, 0.0, 1.0]).expand(400, 3), torch.rand(400, 3, dtype=DOUBLE, generator=generator(6))
    )
    assert set(s.lobe.flatten().tolist()) == {0, 1}
    assert bool((s.wi[s.lobe.squeeze(-1) == 0][:, 2] > 0.8).float().mean() > 0.95), "lobe 0 are the facets"


def test_slopes_are_learned():
    """Share, two slopes and their weights from noisy reflectances."""
    wi, wo = above(3000, generator(7)), above(3000, generator(8))
    truth = tb.CookTorrance(0.4, 0.6, [0.15, 0.5], COPPER, weights=[0.3, 0.7])
    seen = truth.evaluate(wi, wo) * (1 + 0.01 * torch.randn(3000, 3, dtype=DOUBLE, generator=generator(9)))
    raw = [number(x).requires_grad_() for x in ([0.0], [-2.0, -0.3], [0.0])]

    def made():
        share = torch.cat([torch.sigmoid(raw[2]), 1 - torch.sigmoid(raw[2])])
        return tb.CookTorrance(0.4, torch.sigmoid(raw[0]), torch.sigmoid(raw[1]), COPPER, weights=share)

    optimizer = torch.optim.LBFGS(raw, max_iter=200, line_search_fn="strong_wolfe", tolerance_change=1e-14)

    def closure():
        optimizer.zero_grad()
        loss = (torch.log(made().evaluate(wi, wo)) - torch.log(seen)).square().mean()
        loss.backward()
        return loss

    optimizer.step(closure)
    found = made()
    assert found.specular.item() == pytest.approx(0.6, rel=0.02)
    assert found.alpha.tolist() == pytest.approx([0.15, 0.5], rel=0.02)
    assert found.weights.tolist() == pytest.approx([0.3, 0.7], rel=0.03)
