"""Measured light that the papers rendered with: Grace Cathedral, the Uffizi, and Pisa, from light probes."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.papers.entry import Workplace
from capture.lighting import read_latlong

Floats = NDArray[np.float64]

_FILES = {"Grace Cathedral": "Grace_Cathedral.hdr", "Uffizi": "uffizi.hdr", "Pisa": "pisa.hdr"}


def probe(place: Workplace, name: str, rows: int | None = None) -> Floats:
    """A probe's light (rows, 2 rows, 3), up at the top, of mean radiance 1; as fine as it is if rows is None.

    Probes are panoramas as one sees them, and so mirrored. MissingMeansError where there is no real data.
    """
    light = read_latlong(place.real("probes", _FILES[name]))[:, ::-1].astype(float)
    if rows is not None:
        light = cv2.resize(light, (2 * rows, rows), interpolation=cv2.INTER_AREA)
    theta = (np.arange(len(light)) + 0.5) * np.pi / len(light)
    return np.asarray(light / np.average(light.mean(axis=(1, 2)), weights=np.sin(theta)))
