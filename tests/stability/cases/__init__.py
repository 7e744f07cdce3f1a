"""The formulas, one room a file, as the package has them."""

from . import derived, fresnel, interfaces, lobes, lookups, microfacet, models, rough, vectors

CASES = (
    *fresnel.CASES,
    *lobes.CASES,
    *microfacet.CASES,
    *vectors.CASES,
    *derived.CASES,
    *models.CASES,
    *rough.CASES,
    *interfaces.CASES,
    *lookups.CASES,
)
