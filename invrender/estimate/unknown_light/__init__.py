"""Factorization under wholly unknown lighting."""

from invrender.estimate.unknown_light.factorize import ORDERS, blind_steps, factorize_blind
from invrender.estimate.unknown_light.solution import (
    BlindLight,
    BlindSolution,
    BlindSources,
    predict_blind,
    predict_parts,
)

__all__ = [
    "ORDERS",
    "BlindLight",
    "BlindSolution",
    "BlindSources",
    "blind_steps",
    "factorize_blind",
    "predict_blind",
    "predict_parts",
]
