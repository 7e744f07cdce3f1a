"""The formulas, one room a file, as the package has them."""

from . import fresnel, lobes, lookups, microfacet, models, vectors

CASES = (*fresnel.CASES, *lobes.CASES, *microfacet.CASES, *vectors.CASES, *models.CASES, *lookups.CASES)
