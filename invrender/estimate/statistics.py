"""Sufficient statistics: all that the search needs of the samples, added up over photographs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.parallel import parallel_map
from invrender.transport.columns import PhotoColumns, pooled_columns

Floats = NDArray[np.float64]


# The one element of a lighting of which nothing is to be recovered.
_KNOWN = "known"


@dataclass(frozen=True, eq=False)
class Statistics:
    """Weighted normal equations of the photographs under one lighting.

    lighting, elements : as in `PhotoColumns`.
    gram : (3, elements, q, elements, q). right : (3, elements, q). energy : (3,), the data's own square.
    count : samples times channels. merged : names of wholly known lightings that are one here; empty for one lighting.
    """

    lighting: str
    elements: tuple[str, ...]
    gram: Floats
    right: Floats
    energy: Floats
    count: int
    merged: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the lightings that these are statistics of."""
        return self.merged or (self.lighting,)

    def __add__(self, other: Statistics) -> Statistics:
        return Statistics(
            self.lighting,
            self.elements,
            self.gram + other.gram,
            self.right + other.right,
            self.energy + other.energy,
            self.count + other.count,
            tuple(dict.fromkeys((*self.merged, *other.merged))),
        )


def photo_statistics(photo: PhotoColumns, weights: Floats) -> Statistics:
    """Statistics of one photograph; weights (n, 3), inverse variances up to a scale."""
    channels, count, elements, size = photo.columns.shape
    total = elements * size
    gram, right, energy = np.empty((3, total, total)), np.empty((3, total)), np.empty(3)
    # Columns and radiance side by side, so that one symmetric product holds all.
    scaled = np.empty((count, total + 1))
    for c in range(3):
        root = np.sqrt(weights[:, c])
        np.multiply(photo.columns[min(c, channels - 1)].reshape(count, -1), root[:, None], out=scaled[:, :-1])
        np.multiply(photo.radiance[:, c], root, out=scaled[:, -1])
        products = scaled.T @ scaled
        gram[c], right[c], energy[c] = products[:-1, :-1], products[:-1, -1], products[-1, -1]
    return Statistics(
        photo.lighting,
        photo.elements,
        gram.reshape(3, elements, size, elements, size),
        right.reshape(3, elements, size),
        energy,
        3 * count,
    )


@dataclass(frozen=True, eq=False)
class Subsets:
    """Statistics of subsets of the photographs, each of them all but some.

    everything : of all photographs, one per lighting. left_out : of what each subset is without, one per lighting.
    """

    everything: tuple[Statistics, ...]
    left_out: tuple[tuple[Statistics, ...], ...] = ((),)

    def __len__(self) -> int:
        return len(self.left_out)

    def take(self, places: Iterable[int]) -> Subsets:
        """Some of the subsets, by their numbers."""
        return Subsets(self.everything, tuple(self.left_out[k] for k in places))

    def lightings(self, subset: int) -> set[str]:
        """The names of the lightings that some photograph of a subset is under."""
        counts = {entry.lighting: entry.count for entry in self.everything}
        for entry in self.left_out[subset]:
            counts[entry.lighting] -= entry.count
        return {name for name, count in counts.items() if count}


def weighted_statistics(photos: Iterable[tuple[PhotoColumns, Floats]]) -> Iterator[Statistics]:
    """Statistics of each photograph with its weights (n, 3) in turn, computed on all cores."""
    return parallel_map(lambda pair: photo_statistics(*pair), photos)


def total_statistics(photos: Sequence[PhotoColumns], weights: Sequence[Floats]) -> tuple[Statistics, ...]:
    """Statistics of all photographs, one per lighting; those with few samples are worked on together."""
    return by_lighting(weighted_statistics(pooled_columns(photos, weights)))


def by_lighting(statistics: Iterable[Statistics]) -> tuple[Statistics, ...]:
    """Statistics added up per lighting, in order of first appearance."""
    sums: dict[str, Statistics] = {}
    for entry in statistics:
        sums[entry.lighting] = sums[entry.lighting] + entry if entry.lighting in sums else entry
    return tuple(sums.values())


def with_known_as_one(statistics: Iterable[Statistics]) -> tuple[Statistics, ...]:
    """The statistics, those of all wholly known lightings added up: a fit distinguishes nothing among these."""
    found: list[Statistics] = []
    known: Statistics | None = None
    for entry in statistics:
        if entry.elements != (_KNOWN,):
            found.append(entry)
            continue
        own = replace(entry, lighting=_KNOWN, merged=entry.names)
        known = own if known is None else known + own
    return tuple(found) if known is None else (known, *found)
