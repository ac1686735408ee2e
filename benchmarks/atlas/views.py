"""Boundaries of the views: mu without grazing ones, and how many photographs there are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.atlas.stage import QUANTITIES, TOLD, Finding, Stage, expected, fitted
from benchmarks.atlas.sweep import Boundary
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

_REFUSED = Finding(None, None, "undetermined")
_STEEP = replace(TOLD, samples=1500)


def steepest_draw(limit_deg: float, number: int) -> dict[str, Finding]:
    """The fit to what is seen at exitant angles up to a limit."""
    photos = _STEEP.drawn(number)
    return fitted(_STEEP, [photo.where(_seen(photo, limit_deg)) for photo in photos])


def steepest_theory(limit_deg: float) -> dict[str, Finding]:
    return expected(_STEEP, lambda field, _: _seen(field, limit_deg))


def _seen(field: LightField, limit_deg: float) -> NDArray[np.bool_]:
    return np.asarray(field.cos_exitant >= np.cos(np.radians(limit_deg)))


def views_draw(count: float, number: int) -> dict[str, Finding]:
    """The fit to so many photographs, which share the samples; a single one is refused."""
    stage = Stage(views=int(count))
    photos = stage.drawn(number)
    if len(photos) == 1:
        try:
            fitted(stage, photos)
        except ValueError:
            return dict.fromkeys(QUANTITIES, _REFUSED)
    return fitted(stage, photos)


def views_theory(count: float) -> dict[str, Finding]:
    return expected(Stage(views=int(count)))


STEEPEST = Boundary(
    "mu-steepest-view",
    "Refractive index: it shows at grazing angles",
    "steepest exitant angle among the samples [degrees]",
    (20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0),
    (0, 6),
    steepest_draw,
    steepest_theory,
    "Fresnel factors of different indices part at grazing angles only [RH01, section 6.1].",
)
VIEWS = Boundary(
    "number-of-views",
    "Number of photographs in unknown light, 1500 samples in all",
    "photographs",
    (1.0, 2.0, 3.0, 4.0, 6.0, 10.0),
    (0, 2),
    views_draw,
    views_theory,
    "One photograph can't tell light from reflectance; from two or three on, what counts is samples.",
    edge=1.5,
    edge_label="any one image is a mirror ball's in some light",
)
