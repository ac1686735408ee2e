"""Options that hold several numbers, and the directions that they give."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


def numbers(text: str, option: str, what: str, counts: Sequence[int]) -> list[float]:
    """The numbers of "30,20,0.6"; ValueError says what an option takes, unless it has one of these counts."""
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in counts or not np.isfinite(values).all():
        raise ValueError(f"{option} {text}: cannot be read; give {what}")
    return values


def direction(azimuth_deg: float, elevation_deg: float, where: str) -> NDArray[np.float64]:
    """The unit vector (3,) at an azimuth from +X towards +Y and an elevation above the horizon, -90 to 90 degrees."""
    if not -90 <= elevation_deg <= 90:
        raise ValueError(f"{where}: the elevation is {elevation_deg:g} degrees; it must be -90 to 90")
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    level = np.cos(elevation)
    return np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
