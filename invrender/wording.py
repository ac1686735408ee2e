"""How numbers, and what went wrong, are said to users."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np


def sentences(texts: Iterable[str]) -> list[str]:
    """Texts as they stand in errors, without capital and full stop, as sentences."""
    return [f"{text[0].upper()}{text[1:]}." for text in texts]


def with_error(value: float, std: float | None) -> str:
    """A value with its standard deviation, if it has one, to the two digits of the latter that mean something."""
    if std is None or not std > 0:
        return f"{value:.4g}"
    digits = min(max(1 - int(np.floor(np.log10(std))), 0), 8)
    return f"{value:.{digits}f} ± {std:.{digits}f}"
