"""How parameters, numbers, and what went wrong, are said to users."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from capture.radiance import CHANNELS

Floats = NDArray[np.float64]

PARAMETER_LABELS = {"kd": "Kd", "ks": "Ks", "spread": "haze / core width", "beyond": "share beyond sigma"}
PARAMETER_LABELS |= {f"beyond_{width}": f"of that, beyond {width} sigma" for width in (2, 4, 8)}
PARAMETER_LABELS |= {"stretch": "alpha_x / alpha_y"}
_UNITS = {"kd": " (1/sr)", **dict.fromkeys(("sigma", "alpha_x", "alpha_y"), " (rad)")}


def sentences(texts: Iterable[str]) -> list[str]:
    """Texts as they stand in errors, without capital and full stop, as sentences."""
    return [f"{text[0].upper()}{text[1:]}." for text in texts]


def with_error(value: float, std: float | None) -> str:
    """A value with its standard deviation, if it has one, to the two digits of the latter that mean something."""
    if std is None or not std > 0:
        return f"{value:.4g}"
    digits = min(max(1 - int(np.floor(np.log10(std))), 0), 8)
    return f"{value:.{digits}f} ± {std:.{digits}f}"


def parameter_lines(
    name: str, value: Floats | None, std: Floats | None, is_absolute: bool = True
) -> list[tuple[str, str]]:
    """Label and text of each number of a parameter; value, std : (k,), k = 1 or 3, or None."""
    unit = _UNITS.get(name, "") if is_absolute or name != "kd" else ""
    label = PARAMETER_LABELS.get(name, name)
    if value is None or std is None:
        return [(label + unit, "-")]
    texts = [with_error(one, its_std) for one, its_std in zip(value, std, strict=True)]
    if len(texts) == 1:
        return [(label + unit, texts[0])]
    return [(f"{label} {channel}{unit}", text) for channel, text in zip(CHANNELS, texts, strict=True)]
