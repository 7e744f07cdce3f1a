"""The formulas, one room a file, as the package has them."""

from . import derived, fresnel, interfaces, lobes, lookups, microfacet, models, refraction, rough, vectors

CASES = (
    *fresnel.CASES,
    *lobes.CASES,
    *microfacet.CASES,
    *vectors.CASES,
    *derived.CASES,
    *models.CASES,
    *rough.CASES,
    *interfaces.CASES,
    *refraction.CASES,
    *lookups.CASES,
)
