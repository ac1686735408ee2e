"""Whether a bracket's exposures can be true: the longer, the brighter, everywhere; and some of it is seen twice."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from capture.bracket.bracketsample import BracketSample
from capture.radiance import CHANNELS

Floats = NDArray[np.float64]
# Pixels from which on something can be said of them together.
_FEWEST = 30
# Exposures that differ by this logarithm change every value above the darkest of any response by more than a code.
_PLAIN = 0.2
# A response that falls does so wherever its values are seen; what falls in fewer patches than this may have moved.
_WIDE = 1 / 6


def check_exposures(sample: BracketSample, nominal: Floats, names: Sequence[str]) -> None:
    """ValueError if the exposures are equal, or contradict the pictures, or the pictures cannot be compared."""
    if np.ptp(nominal) < 1e-6:
        raise ValueError(
            f"{names[0]} and the others: all exposures are equal; a bracket needs photographs with different exposures"
        )
    for index, name in enumerate(CHANNELS):
        if (sample.usable[index].sum(axis=1) > 1).sum() < _FEWEST:
            raise ValueError(_nothing_to_compare(sample, index, name, names))
    order = np.argsort(nominal, kind="stable")
    reversed_pairs, folded = [], []
    for first, second in pairwise(order):
        if nominal[second] - nominal[first] < 0.05:
            continue
        usable = sample.usable[..., first] & sample.usable[..., second]
        before, after = sample.values[..., first][usable], sample.values[..., second][usable]
        if len(before) < _FEWEST:
            continue
        # By their mean, in which the noise of both has the same part: neither is favoured.
        falls, rises, same = _falls_and_rises((before + after) / 2, after - before, max(sample.step, 1 / 255))
        if same and not falls and not rises and nominal[second] - nominal[first] > _PLAIN:
            raise ValueError(
                f"{names[second]} is as bright as {names[first]}, although its exposure is given as"
                f" {np.exp(nominal[second] - nominal[first]):.3g} times as long: check the exposure times, and that"
                " these are different photographs, without automatic brightness"
            )
        if falls and len(falls) > rises:
            reversed_pairs.append((first, second))
        elif (
            falls
            and _share_of_patches(falls, (before + after) / 2, after - before, sample.patch, usable) > _WIDE
        ):
            folded.append((first, second, min(falls), max(falls)))
    if reversed_pairs:
        first, second = reversed_pairs[0]
        more = f" (and {len(reversed_pairs) - 1} more pairs)" if len(reversed_pairs) > 1 else ""
        raise ValueError(
            f"{names[second]} is darker than {names[first]}, although its exposure is given as"
            f" {np.exp(nominal[second] - nominal[first]):.3g} times as long{more}: the exposure times look reversed"
            " or wrong; check them, and their order"
        )
    if folded:
        first, second, low, high = folded[0]
        raise ValueError(
            f"{names[second]} is darker than {names[first]} where values are about {255 * low:.0f} to {255 * high:.0f}"
            " of 255, and brighter elsewhere: the response isn't monotonic (solarised, or processed locally) and"
            " cannot be inverted, or much of the scene moved; photograph what is static, without such processing"
        )


def _falls_and_rises(values: Floats, change: Floats, step: float) -> tuple[list[float], int, int]:
    """Values at which a longer exposure is typically darker by two codes; how many where it is brighter; and how
    many, of those above a sixteenth, where it is neither."""
    bins = np.clip((values * 32).astype(int), 0, 31)
    falls, rises, same = [], 0, 0
    for index in np.unique(bins):
        here = change[bins == index]
        if len(here) >= _FEWEST:
            middle = float(np.median(here))
            falls += [(index + 0.5) / 32] if middle < -2 * step else []
            rises += middle > 0
            same += index > 1 and -2 * step <= middle <= 0
    return falls, rises, same


def _share_of_patches(
    falls: list[float], values: Floats, change: Floats, patch: NDArray[np.intp], usable: NDArray[np.bool_]
) -> float:
    """Share of the patches of the picture in which most pixels whose values are among `falls` fall."""
    pixel = np.nonzero(usable)[1]
    among = np.isin(np.clip((values * 32).astype(int), 0, 31), (np.array(falls) * 32).astype(int))
    down = np.bincount(patch[pixel[among]], np.sign(change[among]), int(patch.max()) + 1) < 0
    return float(down.sum() / len(np.unique(patch)))


def _nothing_to_compare(sample: BracketSample, index: int, channel: str, names: Sequence[str]) -> str:
    below = (sample.values[index] <= sample.clip[index, 0]).mean()
    above = (sample.values[index] >= sample.clip[index, 1]).mean()
    why = (
        "nearly all of it is black" if below > 0.9 else "nearly all of it is saturated" if above > 0.9 else ""
    )
    why = why or "what one photograph shows well is black or saturated in the others"
    return (
        f"{names[0]} and the others: in {channel}, no part of the scene is well exposed in two photographs ({why});"
        " photograph the bracket again with exposures that overlap"
    )
