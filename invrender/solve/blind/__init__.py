"""Factorization under wholly unknown lighting."""

from invrender.solve.blind.factorize import ORDERS, blind_steps, factorize_blind
from invrender.solve.blind.solution import (
    BlindLight,
    BlindSolution,
    BlindSources,
    predict_blind,
    predict_parts,
)
from invrender.solve.blind.start import Region

__all__ = [
    "ORDERS",
    "BlindLight",
    "BlindSolution",
    "BlindSources",
    "Region",
    "blind_steps",
    "factorize_blind",
    "predict_blind",
    "predict_parts",
]
