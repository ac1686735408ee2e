"""What writing a format yields."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Below this share of texels, what is cut off is not worth a word.
_NOTABLE = 1e-3


@dataclass(frozen=True, eq=False)
class WrittenExport:
    """files : by their names in the folder. parameters : the format's own, as written. notes : sentences."""

    files: tuple[str, ...]
    parameters: Mapping[str, Any]
    notes: tuple[str, ...] = ()


def clipped(texels: Floats, ours: str, theirs: str) -> tuple[Floats, list[str]]:
    """Texels cut off at 1, and a sentence where more than a few are."""
    share = float((texels > 1).mean())
    notes = (
        []
        if share < _NOTABLE
        else [f"{ours} of {share:.1%} of the texels is more than a {theirs} of 1 gives."]
    )
    return np.minimum(texels, 1), notes
