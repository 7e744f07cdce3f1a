"""Hypothesis looks for trouble: any legal material, any direction, any dtype gives finite, non-negative light and finite slopes. (Pixels are shaded in test_fuzz_scenes.)"""

import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import torchbrdf as tb

DTYPES = (torch.float64, torch.float32, torch.bfloat16, torch.float16)
numbers = st.one_of(
    st.floats(-1.0, 1.0, width=16),
    st.sampled_from([0.0, -0.0, 1.0, -1.0, 6e-8, 1.0 - 2**-10, 6e4, -6e4]),
)
vectors = hnp.arrays("float64", (3,), elements=numbers)
unit = st.one_of(st.floats(0.0, 1.0), st.sampled_from([0.0, 1.0]))
exponents = st.one_of(st.floats(0.0, 1e3), st.sampled_from([0.0, 1e-3, 1.0, 1e4]))
etas = st.one_of(st.floats(0.25, 4.0), st.sampled_from([1.0, 1.0 + 1e-7, 1.5, 1 / 1.5]))
fresnel = st.one_of(
    st.none(),
    st.builds(tb.Dielectric, etas),
    st.builds(tb.Conductor, etas, st.one_of(st.floats(0.0, 10.0), st.just(0.0))),
    st.builds(tb.Schlick, unit),
)
leaves = st.one_of(
    st.builds(tb.Lambert, st.lists(unit, min_size=3, max_size=3)),
    st.builds(tb.Phong, unit, exponents, fresnel, st.sampled_from(["none", "bound", "modified"])),
    st.builds(tb.BlinnPhong, unit, exponents, fresnel),
    st.builds(tb.Mirror, unit, fresnel),
)
materials = st.recursive(
    leaves, lambda m: st.one_of(st.builds(lambda a, b: a + b, m, m), st.builds(lambda a, k: k * a, m, unit)), max_leaves=3
)
quietly = settings(deadline=None, max_examples=120, suppress_health_check=[HealthCheck.too_slow], derandomize=True)


def as_leaf(v, dtype):
    return torch.tensor(v).to(dtype).requires_grad_()


@quietly
@given(materials, vectors, vectors, vectors, st.sampled_from(DTYPES))
def test_evaluate_is_finite_and_so_are_its_slopes(brdf, wi, wo, n, dtype):
    leaves = [as_leaf(v, dtype) for v in (wi, wo, n)]
    f = brdf.evaluate(*leaves)
    assert f.dtype == dtype
    assert bool((f >= 0).all())
    assert bool(torch.isfinite(f).all())
    for slope in torch.autograd.grad(f.float().sum(), leaves, allow_unused=True) if f.requires_grad else ():
        # A direction of length 1e-7 turns by 1e7 for a step of 1: slopes that overflow a half type are true, NaN never is.
        assert slope is None or not bool(torch.isnan(slope).any())


@quietly
@given(materials, vectors, vectors, st.tuples(*[st.floats(0, 1, exclude_max=True)] * 3))
def test_samples_carry_no_more_than_finite_light(brdf, wo, n, u):
    s = brdf.sample(torch.tensor(wo), torch.tensor(u, dtype=torch.float64), torch.tensor(n))
    assert all(bool(torch.isfinite(x).all()) for x in (s.wi, s.weight, s.pdf))
    assert bool((s.weight >= 0).all())
    assert bool((s.pdf >= 0).all())
