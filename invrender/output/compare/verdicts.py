"""Numbers side by side: difference, difference over the combined standard deviation, and what that means."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from capture.radiance import CHANNELS
from invrender.result.side import Number, Side

# Within so many standard deviations two numbers agree; of right ones, one in twenty does not.
AGREEMENT = 2.0

_ABSOLUTE = {"kd": "Kd (1/sr)", "ks": "Ks", "mu": "mu", "sigma": "sigma (rad)"}
_SHARES = {
    "kd_normalised": "Kd / (Kd + Ks)",
    "ks_normalised": "Ks / (Kd + Ks)",
    "mu": "mu",
    "sigma": "sigma (rad)",
}
# Of brushed lobes only.
_WIDTHS = {"alpha_x": "alpha_x (rad)", "alpha_y": "alpha_y (rad)"}
# What doesn't vary over a surface.
_ALL_OVER = ("mu", "sigma", *_WIDTHS)
_UNLIKE = "of different parts"


@dataclass(frozen=True)
class Row:
    """One number on both sides. first, second : (value, std), None where there is none.

    difference : second minus first. z : that over the combined standard deviation; infinite where both are exact and
    differ. verdict : in words.
    """

    label: str
    first: tuple[float, float] | None
    second: tuple[float, float] | None
    difference: float | None
    z: float | None
    verdict: str

    @property
    def agrees(self) -> bool | None:
        """Whether the two agree; None where they can't be compared."""
        return None if self.z is None else abs(self.z) <= AGREEMENT


def compared_by_shares(first: Side, second: Side) -> bool:
    """Whether Kd and Ks can be compared by their shares only, one side being in a relative gauge."""
    return not (first.is_absolute and second.is_absolute)


def number_rows(first: Side, second: Side, unlike: bool = False) -> tuple[Row, ...]:
    """All numbers of the BRDF side by side, channel by channel; in shares where a gauge is relative.

    unlike : Kd and Ks are means over different parts of a surface, and so not judged.
    """
    labels = dict(_SHARES if compared_by_shares(first, second) else _ABSOLUTE)
    labels |= {name: label for name, label in _WIDTHS.items() if {name} & {*first.numbers, *second.numbers}}
    rows: list[Row] = []
    unknown = Number(None, None, "not in its model")
    for name, label in labels.items():
        found = _rows(label, first.numbers.get(name, unknown), second.numbers.get(name, unknown))
        if unlike and name not in _ALL_OVER:
            found = [row if row.z is None else replace(row, z=None, verdict=_UNLIKE) for row in found]
        rows += found
    return tuple(rows)


def verdict(rows: Sequence[Row]) -> str:
    """What the rows say together, in a sentence."""
    judged = [row for row in rows if row.agrees is not None]
    apart = [row for row in judged if not row.agrees]
    if not judged:
        return "Nothing can be compared: no number is determined on both sides."
    if not apart:
        return f"All {len(judged)} numbers agree within {AGREEMENT:g} standard deviations."
    return (
        f"{len(apart)} of {len(judged)} numbers differ by more than {AGREEMENT:g} standard deviations:"
        f" {', '.join(row.label for row in apart)}. Of numbers that are right, one in twenty does."
    )


def _rows(label: str, first: Number, second: Number) -> list[Row]:
    if first.value is None and second.value is None:
        same = first.absence == second.absence
        words = f"{first.absence} on both sides" if same else f"{first.absence} in A, {second.absence} in B"
        return [Row(label, None, None, None, None, words)]
    width = len(first.value if first.value is not None else second.value)  # type: ignore[arg-type]
    names = [label] if width == 1 else [_of_channel(label, channel) for channel in CHANNELS]
    rows = []
    for k, name in enumerate(names):
        pair = [
            None if n.value is None or n.std is None else (float(n.value[k]), float(n.std[k]))
            for n in (first, second)
        ]
        rows.append(_row(name, pair[0], pair[1], first.absence, second.absence))
    return rows


def _of_channel(label: str, channel: str) -> str:
    """The label with the channel before its unit."""
    name, bracket, unit = label.partition(" (1/sr)")
    return f"{name} {channel}{bracket}{unit}"


def _row(
    label: str,
    first: tuple[float, float] | None,
    second: tuple[float, float] | None,
    first_absence: str,
    second_absence: str,
) -> Row:
    if first is None:
        return Row(label, None, second, None, None, f"{first_absence} in A")
    if second is None:
        return Row(label, first, None, None, None, f"{second_absence} in B")
    difference = second[0] - first[0]
    combined = float(np.hypot(first[1], second[1]))
    # Exact numbers that differ at all do so beyond any doubt.
    exact = 0.0 if difference == 0 else float(np.copysign(np.inf, difference))
    z = difference / combined if combined > 0 else exact
    words = "agree" if abs(z) <= AGREEMENT else "differ"
    return Row(label, first, second, difference, z, words)
