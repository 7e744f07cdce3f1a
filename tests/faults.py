"""Faults as code: each breaks a real model in one place, and names the property of the contract that must notice.

A fault is applied by ``fault.apply(monkeypatch)`` and shown by ``fault.subject()``. tests/test_faults.py holds both ends: every
fault is noticed by its property, and every property notices at least one fault.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import torch

import torchbrdf as tb
from torchbrdf import geometry, numerics, sampling, vector
from torchbrdf.bsdf import base, blinn_phong, coated, lambert, mirror, phong, rough_dielectric, sampler, smooth_dielectric, two_sided
from torchbrdf.bsdf.lobe import Delta, Draw
from torchbrdf.geometry import each
from torchbrdf.optics import fresnel
from torchbrdf.vector import Vec


class Fault(NamedTuple):
    name: str
    broken_by: str  # the property that must fail
    target: Any
    attribute: str
    make: Callable[[Any], Any]  # the original -> the faulty one
    subject: Callable[[], Any]

    def apply(self, monkeypatch: Any) -> None:
        owner = self.target
        original = owner[self.attribute] if isinstance(owner, dict) else getattr(owner, self.attribute)
        if isinstance(owner, dict):
            monkeypatch.setitem(owner, self.attribute, self.make(original))
        else:
            monkeypatch.setattr(owner, self.attribute, self.make(original))


def _lambert() -> Any:
    return tb.Lambert([0.8, 0.5, 0.2])


def _phong() -> Any:
    return tb.Phong([0.5, 0.3, 0.9], 20.0, fresnel=tb.Schlick([0.04, 0.3, 0.6]))


def _plain_phong() -> Any:
    return tb.Phong([0.5, 0.3, 0.9], 20.0)


def _blinn() -> Any:
    return tb.BlinnPhong([0.5, 0.3, 0.9], 20.0)


def _mirror() -> Any:
    return tb.Mirror([0.9, 0.8, 0.7], fresnel=tb.Schlick([0.3, 0.4, 0.5]))


def _with_mirror() -> Any:
    return tb.Lambert([0.5, 0.4, 0.3]) + 0.5 * tb.Mirror([0.9, 0.8, 0.7])


def _dielectric() -> Any:
    return tb.Dielectric([1.5, 1.3, 2.0])


def _narrow() -> Any:
    """Of a peak 40 minutes of arc wide."""
    return tb.Phong([0.5, 0.3, 0.9], 1e4, fresnel=tb.Schlick([0.04, 0.3, 0.6]))


def _narrow_blinn() -> Any:
    return tb.BlinnPhong(0.3, 300.0)


def _two_sides() -> Any:
    return tb.TwoSided(tb.BlinnPhong(0.4, 20.0), tb.Lambert(0.7))


def _coated() -> Any:
    return tb.Coated(_lambert(), 1.5)


def _glass() -> Any:
    return tb.SmoothDielectric(1.5)


def _frosted() -> Any:
    return tb.RoughDielectric(0.4, 1.5)


# --- the faulty pieces -------------------------------------------------------------------------------------------------


def lambert_without_pi(_: Any) -> Any:
    return lambda self, g: g.colour(self.albedo)


def phong_normalised_as_distribution(_: Any) -> Any:
    return lambda s: (s + 4.0) / (2.0 * math.pi)


def blinn_normalised_as_distribution(_: Any) -> Any:
    """The half vector's (s+2)/(2 pi) in place of the reflected light's factor: seven times too bright."""
    return lambda s: (s + 2.0) / (2.0 * math.pi)


def phong_without_fresnel_in_albedo(original: Any) -> Any:
    return lambda self, viewer, order: original(self.replace(fresnel=None), viewer, order)


def fresnel_at_viewer(_: Any) -> Any:
    return lambda g, k, f, lobe: each(lambda k, f: k * f * lobe, g.colour(k), f.terms(g.viewer.layout, g.cos_o))


def cosine_in_evaluate(original: Any) -> Any:
    """f times the cosine of the light, which belongs to the effects."""
    return lambda self, g: tuple(f * g.cos_i for f in original(self, g))


def sample_without_cosine(original: Any) -> Any:
    def spread(model: Any, viewer: Any, u: Any, share: Any) -> Any:
        found = original(model, viewer, u, share)
        return found._replace(weight=tuple(w / found.wi.z for w in found.weight))

    return spread


def lambert_density_of_viewer(_: Any) -> Any:
    """Swapped wi and wo."""
    return lambda self, g: numerics.positive(g.cos_o) * (1.0 / math.pi) + 0.0 * g.cos_i


def phong_pdf_exponent(_: Any) -> Any:
    """Normalised, but of the wrong exponent."""

    def density(self: Any, g: Any) -> Any:
        s = g.scalar(self.exponent) + 2.0
        return numerics.log1p_power(g.mirror_complement, s) * ((s + 1.0) / (2.0 * math.pi))

    return density


def half_vector_without_jacobian(_: Any) -> Any:
    def density(self: Any, g: Any) -> Any:
        s = g.scalar(self.exponent)
        return blinn_phong.half_vector_power(g, s + 1.0) * (s + 2.0) / (2.0 * math.pi)

    return density


def half_vector_jacobian_of_normal(_: Any) -> Any:
    """4 n.h in place of 4 wi.h."""

    def density(self: Any, g: Any) -> Any:
        s = g.scalar(self.exponent)
        return blinn_phong.half_vector_power(g, s) * (s + 2.0) / (8.0 * math.pi)

    return density


def peak_that_no_sample_finds(original: Any) -> Any:
    """A second lobe that was added to the density, and not to the sampler."""
    peak = tb.Phong(1.0, 2000.0)
    return lambda self, g: original(self, g) + peak.density(g)


def samples_into_the_dark(original: Any) -> Any:
    """One in two hundred goes where the density is 0, far from all others."""

    def draw(self: Any, viewer: Any, u: Any) -> Any:
        drawn = original(self, viewer, u)
        return drawn._replace(wi=Vec(drawn.wi.x, drawn.wi.y, torch.where(u.z < 0.005, -1.0, 1.0) * drawn.wi.z))

    return draw


def samples_not_unit(original: Any) -> Any:
    def draw(self: Any, viewer: Any, u: Any) -> Any:
        return original(self, viewer, u)._replace(wi=vector.scale(original(self, viewer, u).wi, 1.01))

    return draw


def sides_swapped(_: Any) -> Any:
    """The density of the model on the other side."""

    def density(self: Any, g: Any) -> Any:
        return self._by_side(g.viewer, [s.density(g.facing) for s in reversed(self.sides)])

    return density


def albedo_of_outside(_: Any) -> Any:
    """From below, too."""
    return lambda self, viewer, order: self.outside.albedo_at(viewer.facing, order)


def without_bound_at_grazing(original: Any) -> Any:
    """Ward's 1 / sqrt(cos_i cos_o): right at normal view, dimmer than the model at 60 degrees, infinite in the end."""

    def formula(self: Any, g: Any) -> Any:
        cosines = torch.where(g.above, g.cos_i * g.cos_o, 1.0)
        return tuple(f * g.cos_h**4 * torch.rsqrt(cosines) for f in original(self, g))

    return formula


def bright_at_one_angle(original: Any) -> Any:
    """Too bright about 65 degrees alone, and by 2 %: at 60 and at 72 it is within its bound."""

    def formula(self: Any, g: Any) -> Any:
        bumps = [torch.exp(-((c - math.cos(math.radians(65.0))) ** 2) / 0.02) for c in (g.cos_i, g.cos_o)]
        return tuple(f * (0.85 + 0.8 * bumps[0] * bumps[1]) for f in original(self, g))

    return formula


def draw_without_shapes(_: Any) -> Any:
    """The parameter as it is, whose last axis is in the way of the points' axes."""

    def draw(self: Any, viewer: Any, u: Any) -> Any:
        half = sampling.cosine_power(u.x, u.y, self.exponent.to(u.x.dtype) + 2.0)
        return Draw(vector.reflect_components(viewer.wo, half))

    return draw


def albedo_without_shapes(_: Any) -> Any:
    def albedo_at(self: Any, viewer: Any, order: int) -> Any:
        return tuple(a.mean() * (viewer.cos_o > 0).to(viewer.cos_o.dtype) for a in viewer.colour(self.albedo))

    return albedo_at


def nan_at_zero(_: Any) -> Any:
    """sqrt(-2 log u) as it is often pasted, at u = 0 and beyond."""

    def draw(self: Any, viewer: Any, u: Any) -> Any:
        slope = torch.log(u.x) * 0.0
        wi = sampling.cosine_hemisphere(u.x, u.y)
        return Draw(Vec(wi.x + slope, wi.y, wi.z))

    return draw


def interleaved_vector(_: Any) -> Any:
    return lambda self, v: torch.stack(torch.broadcast_tensors(*v), -1)


def sampler_of_other_exponent(original: Any) -> Any:
    return lambda x, y, power: original(x, y, power - 5.0)


def horizon_not_masked(_: Any) -> Any:
    return property(lambda self: self.cos_o > -2.0)


def one_sided_density(original: Any) -> Any:
    """Nobody masks the pdf of samples that leave the domain."""

    def spread(model: Any, viewer: Any, u: Any, share: Any) -> Any:
        found = original(model, viewer, u, share)
        return found._replace(pdf=model.density(geometry.Geometry(viewer, found.wi)))

    return spread


def mirror_through_normal(_: Any) -> Any:
    """Reflects back where the light came from."""
    return lambda self, viewer: [Delta(viewer.wo, viewer.cos_o, self.reflectance(viewer))]


def delta_weight_without_share(original: Any) -> Any:
    """A sum that forgets how seldom it chose the delta lobe."""

    def delta(model: Any, viewer: Any, d: Any, share: Any, u: Any) -> Any:
        found = original(model, viewer, d, share, u)
        return found._replace(weight=tuple(w * share for w in found.weight))

    return delta


def wrong_side(_: Any) -> Any:
    """Only the viewer is asked where it stands."""
    return lambda self, g: g.cos_o > 0


def albedo_without_swap(_: Any) -> Any:
    """The light that arrives at w, not along it: the same for reciprocal models alone."""
    return property(lambda self: self)


def clamp_kills_gradient(_: Any) -> Any:
    return lambda self, g: tuple(a.clamp(0.0, 0.5) * (1.0 / math.pi) for a in g.colour(self.albedo))


def exponent_detached(original: Any) -> Any:
    return lambda m, exponent: original(m, exponent.detach())


def second_derivative_lost(original: Any) -> Any:
    """Right value and first derivative; the Fresnel factor is a constant to the second."""

    class Linearised(torch.autograd.Function):
        generate_vmap_rule = True

        @staticmethod
        def forward(ctx: Any, m: Any) -> Any:
            ctx.save_for_backward(m)
            return original(m)

        @staticmethod
        def backward(ctx: Any, grad: Any) -> Any:
            (m,) = ctx.saved_tensors
            return grad * 5.0 * m.detach() ** 4

    return Linearised.apply


def albedo_of_first_pixel(original: Any) -> Any:
    """Broadcasts the first material of a batch to all of them."""

    def formula(self: Any, g: Any) -> Any:
        return tuple(a.flatten()[0] * (1.0 / math.pi) + 0.0 * a for a in g.colour(self.albedo))

    return formula


def interleaved(_: Any) -> Any:
    def join(self: Any, channels: Any) -> Any:
        return torch.stack(torch.broadcast_tensors(*channels), -1)

    return join


def computed_in_half(_: Any) -> Any:
    return lambda x: x


def float32_cosine(_: Any) -> Any:
    """1 - cos by subtraction: at the peak no digit is left."""

    def complement(self: Any) -> Any:
        r = vector.subtract(vector.scale(self.n, 2.0 * self.cos_o), self.wo)
        return (1.0 - vector.dot(r, self.wi)) + torch.finfo(self.cos_o.dtype).eps * 1e3

    return property(complement)


def branches_on_data(original: Any) -> Any:
    def formula(self: Any, g: Any) -> Any:
        lit = bool((g.cos_i > 0).any())
        return tuple(f * (1.0 if lit else 0.0) for f in original(self, g))

    return formula


def naive_normalise(_: Any) -> Any:
    """Divides by the norm: 0/0 for a zero vector."""

    return lambda v: vector.components(v / torch.linalg.vector_norm(v, dim=-1, keepdim=True))


def naive_sqrt(_: Any) -> Any:
    return lambda x, least=0.0: torch.sqrt(x)


def textbook_dielectric(_: Any) -> Any:
    """NaN gradients under total internal reflection: the dead branch is not masked at its input."""

    def dielectric(c: Any, n: Any) -> Any:
        g = torch.sqrt(n * n - 1.0 + c * c)
        r = (c - g) / (c + g)
        r_p = (n * n * c - g) / (n * n * c + g)
        return torch.where(n * n - 1.0 + c * c > 0, 0.5 * (r * r + r_p * r_p), 1.0)

    return dielectric


def lobe_of_another_exponent(original: Any) -> Any:
    """Reciprocal, smooth, no brighter, sampled as before: nothing but the source says that it is wrong."""

    def faulty(self: Any, g: Any) -> Any:
        lobe = blinn_phong.half_vector_power(g, g.scalar(self.exponent) + 1.0) * blinn_phong.normal_view_factor(g.scalar(self.exponent))
        return phong.tinted(g, self.specular, self.fresnel, lobe)

    return faulty


def coat_without_solid_angle(original: Any) -> Any:
    """Without 1/eta^2: the cone into which refraction gathers light is taken for the hemisphere."""

    def faulty(self: Any, g: Any) -> Any:
        eta = g.scalar(self.eta)
        return tuple(f * eta * eta for f in original(self, g))

    return faulty


def radiance_the_other_way(original: Any) -> Any:
    """Grows where it should shrink."""

    def faulty(self: Any, viewer: Any) -> Any:
        return [d._replace(weight=tuple(w * d.eta**4 for w in d.weight)) for d in original(self, viewer)]

    return faulty


def without_the_index(original: Any) -> Any:
    """As if both sides were one medium."""
    return lambda self, g: torch.ones_like(g.cos_i)


def jacobian_of_the_viewer(original: Any) -> Any:
    """n_o^2 where n_i^2 belongs."""

    def faulty(self: Any, g: Any, by: Any) -> Any:
        at = self._facet(g)
        return original(self, g, by) * (at.n_o / at.n_i) ** 2

    return faulty


FAULTS = (
    Fault("lobe of another exponent", "textbook", blinn_phong.BlinnPhong, "formula", lobe_of_another_exponent, _blinn),
    Fault("Lambert without 1/pi", "lambert", lambert.Lambert, "formula", lambert_without_pi, _lambert),
    Fault("Lambert without 1/pi", "albedo", lambert.Lambert, "formula", lambert_without_pi, _lambert),
    Fault("wrong normalisation of Phong", "energy_bound", phong.NORMALIZATIONS, "modified", phong_normalised_as_distribution, _plain_phong),
    Fault(
        "half-vector normalisation of Blinn", "energy_bound", blinn_phong, "normal_view_factor", blinn_normalised_as_distribution, _blinn
    ),
    Fault("albedo forgets Fresnel", "albedo", phong.Phong, "albedo_at", phong_without_fresnel_in_albedo, _phong),
    Fault("F(n.wo) instead of F(wi.h)", "reciprocity", phong, "tinted", fresnel_at_viewer, _phong),
    Fault("a cosine too many", "reciprocity", phong.Phong, "formula", cosine_in_evaluate, _plain_phong),
    Fault("sample without cosine", "weights_match", sampler, "_spread", sample_without_cosine, _plain_phong),
    Fault("sample without cosine", "mean_weight", sampler, "_spread", sample_without_cosine, _lambert),
    Fault("density of wo", "samples_follow_pdf", lambert.Lambert, "density", lambert_density_of_viewer, _lambert),
    Fault("density of wo", "pdf_integrates_to_one", lambert.Lambert, "density", lambert_density_of_viewer, _lambert),
    Fault("wrong pdf exponent", "samples_follow_pdf", phong.Phong, "density", phong_pdf_exponent, _plain_phong),
    Fault("sampler of another exponent", "samples_follow_pdf", sampling, "cosine_power", sampler_of_other_exponent, _blinn),
    Fault("dropped Jacobian", "pdf_integrates_to_one", blinn_phong.BlinnPhong, "density", half_vector_without_jacobian, _blinn),
    Fault(
        "dropped Jacobian, narrow", "pdf_integrates_to_one", blinn_phong.BlinnPhong, "density", half_vector_without_jacobian, _narrow_blinn
    ),
    Fault("another Jacobian", "samples_follow_pdf", blinn_phong.BlinnPhong, "density", half_vector_jacobian_of_normal, _blinn),
    Fault("a peak that is never sampled", "pdf_integrates_to_one", lambert.Lambert, "density", peak_that_no_sample_finds, _lambert),
    Fault("samples into the dark", "samples_follow_pdf", lambert.Lambert, "draw", samples_into_the_dark, _lambert),
    Fault("samples that are no directions", "samples_follow_pdf", lambert.Lambert, "draw", samples_not_unit, _lambert),
    Fault("density of the other side", "samples_follow_pdf", two_sided.TwoSided, "density", sides_swapped, _two_sides),
    Fault("albedo of one side", "albedo", two_sided.TwoSided, "albedo_at", albedo_of_outside, _two_sides),
    Fault("albedo of one side", "mean_weight", two_sided.TwoSided, "albedo_at", albedo_of_outside, _two_sides),
    Fault("albedo forgets Fresnel, narrow", "albedo", phong.Phong, "albedo_at", phong_without_fresnel_in_albedo, _narrow),
    Fault("no bound at grazing", "energy_bound", blinn_phong.BlinnPhong, "formula", without_bound_at_grazing, _blinn),
    Fault("bright at one angle", "energy_bound", blinn_phong.BlinnPhong, "formula", bright_at_one_angle, lambda: tb.BlinnPhong(0.9, 0.0)),
    Fault("unshaped parameter in a sampler", "broadcasting", blinn_phong.BlinnPhong, "draw", draw_without_shapes, _blinn),
    Fault("unshaped parameter in the albedo", "broadcasting", lambert.Lambert, "albedo_at", albedo_without_shapes, _lambert),
    Fault("interleaved samples", "planar_memory", geometry.Layout, "join_vector", interleaved_vector, _lambert),
    Fault("NaN of u = 0", "hard_cases", lambert.Lambert, "draw", nan_at_zero, _lambert),
    Fault("no horizon", "dark_outside_domain", geometry.Geometry, "above", horizon_not_masked, _lambert),
    Fault("domain of the viewer alone", "dark_outside_domain", base.Bsdf, "domain", wrong_side, _lambert),
    Fault("pdf beyond the domain", "dark_outside_domain", sampler, "_spread", one_sided_density, _blinn),
    Fault("mirror sends light back", "delta_lobes", mirror.Mirror, "deltas", mirror_through_normal, _mirror),
    Fault("share of a delta lobe", "mean_weight", sampler, "_delta", delta_weight_without_share, _with_mirror),
    Fault("clamp kills a gradient", "gradients", lambert.Lambert, "formula", clamp_kills_gradient, lambda: tb.Lambert([0.5, 0.5, 0.5])),
    Fault("exponent detached", "gradients", numerics, "log1p_power", exponent_detached, _plain_phong),
    Fault("second derivative lost", "second_gradients", fresnel, "_fifth_power", second_derivative_lost, _phong),
    Fault("first material for all", "broadcasting", lambert.Lambert, "formula", albedo_of_first_pixel, _lambert),
    Fault("branches on data", "vmap", lambert.Lambert, "formula", branches_on_data, _lambert),
    Fault("interleaved result", "planar_memory", geometry.Layout, "join", interleaved, _lambert),
    Fault("computes in half precision", "dtypes", numerics, "widen", computed_in_half, _phong),
    Fault("bias on the cosine", "dtypes", geometry.Geometry, "mirror_complement", float32_cosine, lambda: tb.Phong(1.0, 200.0)),
    Fault("branches on data", "compiles", lambert.Lambert, "formula", branches_on_data, _lambert),
    Fault("0/0 for a zero normal", "hard_cases", vector, "unit_components", naive_normalise, _lambert),
    Fault("sqrt at 0", "hard_cases", numerics, "safe_sqrt", naive_sqrt, _phong),
    Fault("a coat without the solid angle", "albedo", coated.Coated, "formula", coat_without_solid_angle, _coated),
    Fault("a coat without the solid angle", "mean_weight", coated.Coated, "formula", coat_without_solid_angle, _coated),
    Fault("radiance the other way", "mean_weight", smooth_dielectric.SmoothDielectric, "deltas", radiance_the_other_way, _glass),
    Fault("no index in reciprocity", "reciprocity", rough_dielectric.RoughDielectric, "exchange", without_the_index, _frosted),
    Fault(
        "Jacobian of the viewer's side",
        "pdf_integrates_to_one",
        rough_dielectric.RoughDielectric,
        "_drawn_through",
        jacobian_of_the_viewer,
        _frosted,
    ),
    Fault("textbook dielectric", "hard_cases", fresnel, "dielectric", textbook_dielectric, _dielectric),
)
