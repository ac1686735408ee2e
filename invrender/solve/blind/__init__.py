"""Factorization under wholly unknown lighting."""

from invrender.solve.blind.factorize import ORDERS, factorize_blind
from invrender.solve.blind.solution import BlindSolution, BlindSources, predict_blind
from invrender.solve.blind.start import Region

__all__ = ["ORDERS", "BlindSolution", "BlindSources", "Region", "factorize_blind", "predict_blind"]
