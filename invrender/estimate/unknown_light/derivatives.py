"""Small steps of a state's numbers, whose differences stand for derivatives."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import LobeForm
from invrender.brdf.fresnel import normalised_fresnel

Floats = NDArray[np.float64]

# Of sources' directions, radians; log sigma; log(mu - 1).
STEP = 1e-6


def further(form: LobeForm, name: str) -> LobeForm:
    """A form with one of its numbers a small step further on, as `State` counts it."""
    value = form.numbers[name]
    return form.with_numbers({name: value * np.exp(STEP) if name == "spread" else value + STEP})


def denser(mu: float) -> float:
    """mu a small step further on in log(mu - 1)."""
    return float(1 + (mu - 1) * np.exp(STEP))


def fresnel_with_slope(mu: float | None, cos: Floats) -> tuple[Floats, Floats]:
    """Fresnel's factor at cosines (m,), and its slope in log(mu - 1)."""
    if mu is None:
        return np.ones_like(cos), np.zeros_like(cos)
    at, more = (normalised_fresnel(each, cos) for each in (mu, denser(mu)))
    return at, (more - at) / STEP
