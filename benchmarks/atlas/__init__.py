"""Stability atlas: what the fit says on both sides of each boundary beyond which theory says that it must fail."""

from benchmarks.atlas.faults import NOISE, OUTLIERS, POSE, SATURATION
from benchmarks.atlas.filters import PAIRS, SOFT
from benchmarks.atlas.light import (
    LIGHT_DEGREE,
    NEAR_KNOWN,
    NEAR_UNKNOWN,
    SIGMA_KNOWN,
    SIGMA_UNKNOWN,
    TWO_SOURCES,
)
from benchmarks.atlas.views import STEEPEST, VIEWS

BOUNDARIES = (
    SIGMA_KNOWN,
    SIGMA_UNKNOWN,
    LIGHT_DEGREE,
    STEEPEST,
    VIEWS,
    NOISE,
    POSE,
    OUTLIERS,
    SATURATION,
    NEAR_KNOWN,
    NEAR_UNKNOWN,
    TWO_SOURCES,
    SOFT,
    PAIRS,
)
