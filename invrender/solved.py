"""What solving a photo set yields: the result, and what predictions and reports need beside it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.photoset import Photo
from invrender.factorization import Factorization
from recon.lightfield import LightField

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Solved:
    """A result with its samples.

    fields : samples of each photograph, by label. residuals : (n, 3) each, photograph less prediction. radiance : of
    samples (n, 3) in a photograph, as predicted.
    """

    result: Factorization
    fields: Mapping[str, LightField]
    residuals: Mapping[str, Floats]
    radiance: Callable[[Photo, LightField], Floats]
