"""The formulas, one room a file, as the package has them."""

from . import fresnel, lobes, lookups, models, vectors

CASES = (*fresnel.CASES, *lobes.CASES, *vectors.CASES, *models.CASES, *lookups.CASES)
