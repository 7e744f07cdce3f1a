"""Exact derivatives, which the package carries for its ledger: torchbrdf/ledger/exact.py."""

from torchbrdf.ledger.exact import BITS, Dual, Exact, atan2, erf, exp, inputs, inverse, log, pi, plain, power, set_precision, sqrt, where

__all__ = [
    "BITS",
    "Dual",
    "Exact",
    "atan2",
    "erf",
    "exp",
    "inputs",
    "inverse",
    "log",
    "pi",
    "plain",
    "power",
    "set_precision",
    "sqrt",
    "where",
]
