"""The package's formulas against exact arithmetic, on hard grids: what is measured, published and bounded.

A formula joins with one :class:`~stability.case.Case` in ``cases/``: its truth on :mod:`~stability.dual` numbers, its hard grid, its claims.
"""
