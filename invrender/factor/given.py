"""What a set knows of the light and the BRDF that were to be found, to hold a result against; no fit sees it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.files.documents import numbers
from capture.lighting import Lighting
from capture.photoset import PhotoSet
from invrender.estimate.quantities import FittedLighting
from invrender.estimate.solution import Solution
from invrender.inverse_lighting.given import given_lights
from invrender.output.compare.lightings import first_coefficients
from invrender.result.truth import TRUTH_NAME, truth_side
from recon.harmonics.basis import to_degree
from recon.harmonics.complex import project_sources

Floats = NDArray[np.float64]

_L_MAX = 2
_NAMES = ("kd_normalised", "ks_normalised", "mu", "sigma")


@dataclass(frozen=True, eq=False)
class Given:
    """numbers : shares, mu and sigma, (3,) or (1,), as far as they are known. light : None where it isn't.

    brdf_from, light_from : where from, "truth.json" or the manifest's name; empty where not known.
    """

    numbers: Mapping[str, Floats]
    light: Lighting | None
    brdf_from: str
    light_from: str


@dataclass(frozen=True, eq=False)
class LightError:
    """How far recovered light is off. nine : largest error of the first nine coefficients over that of degree 0.

    sources_deg : (k,) of each recovered source to the nearest given one; NaN where none is given. given_sources : how
    many are.
    """

    nine: float
    sources_deg: Floats
    given_sources: int


def read_given(photoset: PhotoSet) -> Given:
    """What the manifest says of the light, and a truth.json beside it of all; ValueError where either is unreadable."""
    path = photoset.folder / TRUTH_NAME
    known: dict[str, Floats | None] = {}
    if path.is_file():
        numbers = truth_side(path).numbers
        known = {key: numbers[key].value for key in _NAMES if key in numbers}
    light = given_lights(photoset).get(photoset.photos[0].lighting)
    return Given(
        {key: value for key, value in known.items() if value is not None},
        None if light is None else light.lighting,
        TRUTH_NAME if known else "",
        "" if light is None else light.given_by,
    )


def light_error(given: Given, solution: Solution) -> LightError | None:
    """How far recovered light is from the given one, each over its mean; None where none is given."""
    if given.light is None:
        return None
    (entry,) = solution.lightings
    true, found = first_coefficients(given.light), recovered_coefficients(entry)
    directions = entry.lighting.directions
    angles = np.full(len(directions), np.nan)
    if len(given.light.directions) and len(directions):
        # From the chord, which is exact for small angles.
        chords = np.linalg.norm(directions[:, None] - given.light.directions[None], axis=2).min(axis=1)
        angles = np.degrees(2 * np.arcsin(chords / 2))
    nine = float(np.abs(found / found[0] - true / true[0]).max())
    return LightError(nine, angles, len(given.light.directions))


def recovered_coefficients(entry: FittedLighting) -> Floats:
    """The first nine coefficients (9, 3) of recovered light, its sources included."""
    assert entry.harmonics is not None
    slow = to_degree(entry.harmonics.coefficients, _L_MAX)
    return np.asarray(
        slow + project_sources(entry.lighting.directions, entry.lighting.irradiances, _L_MAX), float
    )


def given_document(given: Given, error: LightError | None) -> dict[str, Any] | None:
    """What was given, and how far the light is off, as JSON-ready data; None where nothing was."""
    if not given.numbers and error is None:
        return None
    return {
        "brdf_from": given.brdf_from or None,
        "light_from": given.light_from or None,
        "numbers": {name: numbers(value) for name, value in given.numbers.items()},
        "light": None
        if error is None
        else {
            "first_nine_error": error.nine,
            "sources_off_deg": numbers(error.sources_deg),
            "sources": error.given_sources,
        },
    }
