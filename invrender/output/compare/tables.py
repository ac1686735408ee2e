"""What a comparison found, in words and cells: the same on the terminal and on the page."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from invrender.output.compare.lightings import LightPair
from invrender.output.compare.verdicts import Row, compared_by_shares
from invrender.result.side import Side
from invrender.wording import with_error


def comparison_notes(first: Side, second: Side, lights: Sequence[LightPair]) -> list[str]:
    """What a reader should know of the comparison, in sentences."""
    notes = [*first.notes, *second.notes]
    if compared_by_shares(first, second):
        which = [name for name, side in (("A", first), ("B", second)) if not side.is_absolute]
        notes.append(
            f"The gauge of {' and '.join(which)} is relative: Kd and Ks are compared by their shares, lightings up to a"
            " factor per channel."
        )
    if first.form is not None and second.form is not None and first.form.family is not second.form.family:
        notes.append(
            f"The lobe of A is of the form {first.form.name!r}, that of B {second.form.name!r}: sigma and Ks mean the"
            " same near normal incidence only, and numbers may differ by more than their standard deviations."
        )
    if set(first.inputs.values()) & set(second.inputs.values()):
        notes.append(
            "Both are made from some of the same files, so part of their errors is common, and z is too small."
        )
    compared = {id(pair.first) for pair in lights} | {id(pair.second) for pair in lights}
    for name, side in (("A", first), ("B", second)):
        lone = [entry.lighting.name for entry in side.lightings if id(entry) not in compared]
        if lone:
            notes.append(f"Lightings of {name} without a counterpart: {', '.join(lone)}.")
    return notes


def error_summary(side: Side) -> str:
    """Mean relative RMS of a side's photographs, in words; empty where it has none."""
    parts = []
    for words, labels in (
        ("fitted", [label for label in side.photo_errors if label not in side.held_out]),
        ("held out", sorted(side.held_out)),
    ):
        if labels:
            parts.append(
                f"{np.mean([side.photo_errors[label] for label in labels]):.2%} ({len(labels)} {words})"
            )
    return ", ".join(parts)


def texts(row: Row) -> tuple[str, str, str, str]:
    """A row's numbers for a table: A, B, difference, z."""
    pair = ["-" if number is None else _with_error(*number) for number in (row.first, row.second)]
    difference = "" if row.difference is None else f"{row.difference:+.2g}" if row.difference else "0"
    z = "" if row.z is None else f"{row.z:+.1f}" if row.z else "0"
    return pair[0], pair[1], difference, z


def _with_error(value: float, std: float) -> str:
    """As the report has it; of an exact number more digits, since nothing else limits them."""
    return with_error(value, std) if std > 0 else f"{value:.6g}"


def light_text(pair: LightPair) -> str:
    """A pair of lightings in a sentence."""
    text = f"Lighting {pair.name}: the first nine coefficients differ by {pair.difference:.2%}"
    if (pair.factor != 1).any():
        text += f", B taken times {', '.join(f'{f:.4g}' for f in pair.factor)} (red, green, blue)"
    for source in pair.sources:
        ratio = ", ".join(f"{r:.4g}" for r in source.ratio)
        text += (
            f"; source {source.numbers[0]}: {source.angle_deg:.2f} degrees apart, irradiance B / A {ratio}"
        )
        if source.z is not None:
            text += f" (at most {source.z:.1f} standard deviations)"
        if any(source.distances):
            a, b = (f"{far:.4g} m" if far else "far" for far in source.distances)
            text += f", {a} away in A, {b} in B"
    for side, count in zip("AB", pair.lone, strict=True):
        if count:
            text += f"; {count} source(s) of {side} without a counterpart"
    return text + "."
