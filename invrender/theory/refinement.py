"""Quadrature rules, refined until they stand still."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Array = TypeVar("Array", bound=NDArray[Any])


def interval_rule(nodes: int, low: float, high: float) -> tuple[Floats, Floats]:
    """Nodes and weights (nodes,) of Gauss-Legendre on an interval."""
    node, weight = _rule(nodes)
    half = (high - low) / 2
    return (low + high) / 2 + half * node, half * weight


@cache
def _rule(nodes: int) -> tuple[Floats, Floats]:
    """Gauss-Legendre on -1 to 1: found as eigenvalues, which takes longer than most integrals by it."""
    return np.polynomial.legendre.leggauss(nodes)


def refined(at: Callable[[int], Array], tolerance: float, what: str, first: int, last: int) -> Array:
    """Integrals with as many nodes as it takes for twice as many to change nothing.

    at : the integrals with so many nodes. tolerance : of each, relative to the largest. first, last : the fewest nodes
    and the most. what : subject of the sentence of the ValueError that says that the most aren't enough.
    """
    nodes, found = first, at(first)
    while nodes < last:
        nodes, before = 2 * nodes, found
        found = at(nodes)
        change, largest = np.abs(found - before).max(initial=0), np.abs(found).max(initial=0)
        if change <= tolerance * largest:
            return found
    raise ValueError(
        f"{what} still change by {change / largest:.1g} of the largest from {nodes // 2} to {nodes} nodes;"
        f" {tolerance:.1g} is asked: the function is too narrow, kinked or unbounded, or the degree too high"
    )
