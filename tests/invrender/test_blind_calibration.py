"""Errors of calibration in unknown light: what they move of BRDF, lamps and light that is found with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from capture.calibrationerrors import CalibrationErrors, SharedError
from capture.lighting import Lighting, latlong_directions
from invrender.estimate.unknown_light import factorize_blind
from invrender.estimate.unknown_light.calibration import with_calibration

from .test_calibration_errors import ALL, BALL, LAMPS, NOT_FOUND, PAINT, ROUND, part, photographed

Floats = NDArray[np.float64]

LAMP = replace(LAMPS, directions=LAMPS.directions[:1], irradiances=LAMPS.irradiances[:1])
SHARE = PAINT.ks / (PAINT.kd + PAINT.ks)
NAMES = ["lamps"] * len(ROUND)


def sky() -> Floats:
    """A map (16, 32, 3) of degrees 0 to 2."""
    x, y, z = np.moveaxis(latlong_directions(16), -1, 0)
    return np.stack([1 + 0.5 * z, 1 + 0.4 * x + 0.3 * y * z, 0.9 + 0.3 * y], axis=-1)


@pytest.mark.parametrize(
    ("lighting", "degree", "longer", "step"),
    [
        pytest.param(LAMP, 0, [0.4, 0, 0], 1, marks=pytest.mark.sweep),
        (LAMP, 0, [0, 0.03, -0.02], 1),
        (replace(LAMP, radiance_map=sky()), 2, [1.6, 0, 0], 2),
    ],
)
def test_error_bars_hold_what_a_lens_moves(
    lighting: Lighting, degree: int, longer: list[float], step: int
) -> None:
    # Of every other pixel some photograph has nothing lit under the lamp alone, and no level to be judged by.
    told = [replace(by, params=by.params + longer) for by in ROUND]
    photos = photographed((BALL, BALL), (ROUND, told), lighting, step)
    without = factorize_blind(photos, NAMES, orders=[degree], ladder=False)
    errors = CalibrationErrors(lenses=(SharedError(ALL, np.outer(longer, longer)),))
    found = with_calibration(without, photos, ALL, told, NAMES, BALL, NOT_FOUND, errors, None)
    exact_photos = photographed((BALL, BALL), (told, told), lighting, step)
    exact = factorize_blind(exact_photos, NAMES, orders=[degree], ladder=False)
    # Of second order are some percent, of a lobe's width, which highlights out of place seem to widen, up to a fifth.
    for name, close in (("kd_normalised", 0.1), ("mu", 0.1), ("sigma", 0.2)):
        number = found.quantities[name]
        moved = np.sqrt(np.mean((number.value - exact.quantities[name].value) ** 2))
        assert part(number.std, number.shares, "lenses") == pytest.approx(moved, rel=close), name
        assert sum(number.shares.values()) == pytest.approx(1)
    light, before, truth = found.light, without.light, exact.light
    stated = np.sqrt(light.sources.irradiance_std**2 - before.sources.irradiance_std**2)
    assert_allclose(stated, np.abs(light.sources.irradiances - truth.sources.irradiances), rtol=0.1)
    # A coefficient of no light moves by next to nothing.
    stated = np.sqrt(light.coefficients_std**2 - before.coefficients_std**2)
    moved = np.abs(light.coefficients - truth.coefficients)
    assert_allclose(stated, moved, rtol=0.1, atol=0.1 * moved.max())
