"""The contract's judgement of samplers: right ones pass at the stated level, however sharp; wrong ones do not."""

import math

import pytest
import torch
from sampler_models import Ggx, RoughGlass, VisibleNormals, Ward
from torch import Tensor

import torchbrdf as tb
from torchbrdf import sampling
from torchbrdf.bsdf.lobe import Draw
from torchbrdf.testing import run
from torchbrdf.testing.partition import BINS, Partition
from torchbrdf.testing.sampling import (
    SIGNIFICANCE,
    agreement,
    chi_square,
    counted,
    of_several,
    p_value,
    pdf_integrates_to_one,
    samples_follow_pdf,
)
from torchbrdf.testing.sphere import from_square, sampling_density, to_square
from torchbrdf.testing.subject import at_angles, directions, generator
from torchbrdf.value import value

SHARP = {
    "Phong, exponent 1": tb.Phong(0.3, 1.0),
    "Phong, exponent 1e4": tb.Phong(0.3, 1e4),
    "Phong, exponent 1e6": tb.Phong(0.3, 1e6),
    "Blinn, exponent 40": tb.BlinnPhong(0.9, 40.0),
    "Blinn, exponent 300": tb.BlinnPhong(0.3, 300.0),
    "Blinn, exponent 1e4": tb.BlinnPhong(0.3, 1e4),
    "diffuse and two lobes": tb.Lambert(0.3) + tb.BlinnPhong(0.3, 1000.0) + tb.Phong(0.3, 30.0),
    "GGX by D, 0.02": Ggx(0.5, 0.02),
    "GGX by D, 1": Ggx(0.5, 1.0),
    "Ward, 0.1": Ward(0.5, 0.1),
    "visible normals, 0.02": VisibleNormals(0.02, 0.02),
    "visible normals, 1": VisibleNormals(1.0, 1.0),
    "visible normals, 0.02 and 1": VisibleNormals(0.02, 1.0),
    "refraction, 0.05": RoughGlass(0.05, 1.5),
    "refraction, 1": RoughGlass(1.0, 2.0),
    "refraction into the thinner side, 0.3": RoughGlass(0.3, 1 / 1.5),
}
FAIR = {"Lambert": tb.Lambert(0.5), "Phong": tb.Phong(0.5, 20.0), "BlinnPhong": tb.BlinnPhong(0.5, 40.0), "Ggx": Ggx(0.5, 0.2)}


def at_most(count: int, level: float, chance: float = 1e-3) -> int:
    """The most that one of ``count`` tests of a level rejects, but for ``chance``."""
    total, k = 0.0, -1
    while total < 1.0 - chance:
        k += 1
        total += math.comb(count, k) * level**k * (1.0 - level) ** (count - k)
    return k


@pytest.mark.parametrize("label", SHARP)
def test_sharp_samplers_pass(label):
    model = SHARP[label].map(lambda t: t.double())
    outcome = run(pdf_integrates_to_one, model, thorough=True)  # up to 89.9 degrees, from below, too
    assert outcome.ok, outcome
    assert outcome.figure < 5e-4, outcome
    outcome = run(samples_follow_pdf, model)
    assert outcome.ok, outcome


@pytest.mark.slow
@pytest.mark.parametrize("label", SHARP)
def test_sharp_samplers_pass_thoroughly(label):
    outcome = run(samples_follow_pdf, SHARP[label], seed=1, thorough=True)
    assert outcome.ok, outcome


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_the_sampler_that_was_refused(seed):
    outcome = run(samples_follow_pdf, tb.BlinnPhong(0.9, 40.0), seed, thorough=True)
    assert outcome.ok, outcome


@pytest.mark.parametrize("name", FAIR)
def test_p_values_are_even(name):
    """Of 100 sets of samples at each of three wo, by one partition: at the level of 1 in 20 and of the contract."""
    wo, rng = at_angles(0.0, 45.0, 80.0), generator(0)
    partition = Partition.of(FAIR[name], wo, rng)
    p, whole = [], []
    for _ in range(100):
        found = counted(FAIR[name], partition, rng, 5000)
        rows = list(zip(found.observed, found.expected, strict=True))
        p += [p_value(o[:BINS], e[:BINS]) for o, e in rows]
        whole += [agreement(o, e) for o, e in rows]
    assert sum(x < 0.05 for x in p) <= at_most(300, 0.05)
    assert sum(x > 0.95 for x in p) <= at_most(300, 0.05), "too good to be true: bins that are not independent"
    assert sum(x < SIGNIFICANCE for x in whole) <= at_most(300, SIGNIFICANCE)


@pytest.mark.slow
@pytest.mark.parametrize("name", FAIR)
def test_right_samplers_fail_as_seldom_as_stated(name):
    failed = [seed for seed in range(100) if not run(samples_follow_pdf, FAIR[name], seed).ok]
    assert len(failed) <= at_most(100, SIGNIFICANCE), failed


def test_all_small_bins_are_pooled():
    observed, expected = torch.tensor([3.0, 3, 4, 9000, 0]), torch.tensor([3.0, 3.5, 4, 4500, 4500])
    assert p_value(observed, expected) < 1e-300
    assert p_value(torch.tensor([3.0, 3, 4, 4520, 4480]), expected) > 0.1
    three = torch.tensor([[10.0, 4520, 4480], [10.5, 4500, 4500]], dtype=torch.float64)
    assert p_value(*torch.tensor([[3.0, 3, 4, 4520, 4480], [3.0, 3.5, 4, 4500, 4500]], dtype=torch.float64)) == chi_square(*three)


def test_few_expected_are_judged_by_poisson():
    assert p_value(torch.tensor([1.0, 0, 999]), torch.tensor([0.0, 0.0, 1000])) == 0.0, "one sample where none may be"
    assert p_value(torch.tensor([30.0, 480, 490]), torch.tensor([1.0, 500, 500])) < 1e-20
    assert p_value(torch.tensor([2.0, 498, 500]), torch.tensor([1.0, 500, 500])) > 0.3
    assert 0.02 < p_value(torch.tensor([5.0, 995]), torch.tensor([2.0, 998])) < 0.1, "P(5 or more | 2) = 0.053"


def test_one_bin_tells_nothing():
    with pytest.raises(ValueError, match="one bin tells nothing"):
        p_value(torch.tensor([900.0]), torch.tensor([1000.0]))


def test_the_chart_there_and_back():
    wi, wo = directions(1000, generator(0)), torch.cat([at_angles(0.0, 60.0, 89.9), -at_angles(0.0)])
    of = torch.arange(1000) % 4
    back, _ = from_square(to_square(wi, wo, of).unsqueeze(1), wo, of)
    torch.testing.assert_close(back.squeeze(1), wi)


@pytest.mark.parametrize("name", FAIR)
def test_bins_hold_what_they_should(name):
    """Against a plain midpoint sum over the square, in which bins are looked up point by point."""
    wo = at_angles(45.0)
    partition = Partition.of(FAIR[name], wo, generator(0))
    n = 1024  # cell borders lie between its points
    x = torch.cartesian_prod(*[(torch.arange(n, dtype=torch.float64) + 0.5) / n] * 2).unsqueeze(0)
    wi, area = (t.squeeze(0) for t in from_square(x, wo, torch.tensor([0])))
    mass = sampling_density(FAIR[name], wi, wo.expand_as(wi)) * area / n**2
    of = torch.zeros(n * n, dtype=torch.int64)
    bins = partition.bin[partition.cells.locate(to_square(wi, wo, of), of)]
    plain = torch.zeros(BINS + 1, dtype=mass.dtype).index_add_(0, bins, mass[:, 0])
    torch.testing.assert_close(partition.integrals[0], plain, atol=3e-4, rtol=0.0)
    assert float(partition.integrals[0, BINS]) < 1e-4
    assert int((partition.integrals[0] > 0.25 / BINS).sum()) > 0.7 * BINS


@value
class Lossy(tb.Lambert):
    """A quarter of the samples is lost."""

    def density(self, g):
        return 0.75 * super().density(g)

    def draw(self, viewer, u):
        w = sampling.cosine_hemisphere(u.x, u.y)
        return Draw(type(w)(*(torch.where(u.x < 0.25, 0.0, c) for c in w)))


def test_lost_samples_count():
    assert run(pdf_integrates_to_one, tb.Lambert(0.5)).ok

    class Right(Lossy):
        def draw(self, viewer: object, u: Tensor) -> Draw:
            w = sampling.cosine_hemisphere(u.x, u.y)
            return Draw(type(w)(*(torch.where(u.z < 0.25, 0.0, c) for c in w)))

    assert run(pdf_integrates_to_one, Right(0.5)).ok
    assert run(samples_follow_pdf, Right(0.5)).ok
    assert run(pdf_integrates_to_one, Lossy(0.5)).ok, "a quarter is lost, and a quarter is missing"
    wrong = run(samples_follow_pdf, Lossy(0.5))
    assert not wrong.ok, "but they are lost in one place"


def test_a_failure_says_where():
    class Shifted(tb.Lambert):
        def draw(self, viewer: object, u: Tensor) -> Draw:
            return Draw(sampling.cosine_power(u.x, u.y, torch.tensor(2.2, dtype=u.x.dtype)))

    outcome = run(samples_follow_pdf, Shifted(0.5))
    assert outcome.ok is False
    for words in ("for wo at ", " of 20000 samples about wi at ", " expected"):
        assert words in outcome.detail
    assert "\n" not in outcome.detail


@pytest.mark.parametrize("tests", [1, 3, 12])
def test_several_tests_fail_as_seldom_as_one(tests):
    assert 1 - (1 - of_several(0.01, tests)) ** tests == pytest.approx(0.01)
