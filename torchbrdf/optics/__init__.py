"""Layer 1: one optical effect a file; the exact law first, its approximations below it."""
