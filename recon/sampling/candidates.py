"""Pixels of a photograph that are looked at before some of them are taken as samples."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from capture.radiance import RadianceImage
from recon.mesh.bodies import Body, body_coverage, body_window, larger_pixels
from recon.sampling.highlights import LOOKED_AT, highlights_of

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# How many times the budget is looked at in choosing it, of all pixels and of small highlights beside these.
_SPARE, _SPARE_HIGHLIGHTS = 8, 2
# Pixels around one that is looked at in which the mask must be whole.
_BORDER = 1
# Coverage from which on a pixel counts as wholly the object's: renderers' alpha and JPEG masks are hardly ever quite
# white. Next to the border, where less would matter, neighbours must be as white.
WHOLE = 0.98


@dataclass(frozen=True, eq=False)
class Candidates:
    """Pixels of a photograph that are looked at: some drawn at random, and more of its small highlights.

    rows, columns : (n,). at_random, bright : (n,), whether the random draw has it, and whether a small highlight has.
    chance, found : with which the random draw takes a pixel, and with which one of a highlight is taken beside it.
    """

    rows: Ints
    columns: Ints
    at_random: NDArray[np.bool_]
    bright: NDArray[np.bool_]
    chance: float
    found: float

    @property
    def stands_for(self) -> Floats:
        """What each pixel (n,) stands for: the chance with which the random draw takes it over that of being here."""
        either = self.chance + (1 - self.chance) * self.found
        return np.where(self.bright, self.chance / either, 1.0)

    def where(self, index: Ints | NDArray[np.bool_]) -> Candidates:
        """Some of the pixels."""
        return replace(
            self,
            rows=self.rows[index],
            columns=self.columns[index],
            at_random=self.at_random[index],
            bright=self.bright[index],
        )


def candidates(
    body: Body,
    camera: Camera,
    image: RadianceImage,
    coverage: NDArray[np.float32] | None,
    budget: int | None,
    highlights: bool,
    rng: np.random.Generator,
) -> Candidates:
    """Pixels that the body may be sampled at, a few times the budget of them.

    highlights : whether those of small highlights are looked at beside these: a random draw among millions misses them.
    """
    top, left, bottom, right = body_window(body, camera)
    good = ~image.saturated[top:bottom, left:right]
    if coverage is not None:
        good &= coverage[top:bottom, left:right] >= WHOLE
    bright = np.zeros_like(good)
    if highlights:
        on_body = good
        if coverage is None:
            # Coarsely: what is beside the body is left out later.
            side = larger_pixels(body, camera, LOOKED_AT)
            covered = body_coverage(body, camera, side).repeat(side, axis=0).repeat(side, axis=1)
            on_body = good & covered[top:bottom, left:right]
        bright = highlights_of(image.radiance[top:bottom, left:right], on_body)
    chosen, chance, found = np.flatnonzero(good), 1.0, 1.0
    at_random = np.ones(len(chosen), bool)
    if budget is not None and len(chosen) > _SPARE * budget:
        chance = _SPARE * budget / len(chosen)
        drawn = np.sort(rng.choice(chosen, _SPARE * budget, replace=False))
        more = np.setdiff1d(np.flatnonzero(bright), drawn)
        found = min(_SPARE_HIGHLIGHTS * budget / max(len(more), 1), 1.0)
        if found < 1:
            more = rng.choice(more, _SPARE_HIGHLIGHTS * budget, replace=False)
        chosen = np.sort(np.concatenate([drawn, more]))
        at_random = np.isin(chosen, drawn)
    rows, columns = np.divmod(chosen, max(right - left, 1))
    looked_at = Candidates(rows + top, columns + left, at_random, bright.ravel()[chosen], chance, found)
    if coverage is None:
        return looked_at
    return looked_at.where(within_mask(coverage, looked_at.rows, looked_at.columns))


def within_mask(coverage: NDArray[np.float32], rows: Ints, columns: Ints) -> NDArray[np.bool_]:
    """Whether a mask (h, w) is whole in given pixels and in those around them."""
    return ~any_within(coverage < WHOLE, rows, columns, _BORDER)


def any_within(marked: NDArray[np.bool_], rows: Ints, columns: Ints, reach: int) -> NDArray[np.bool_]:
    """Whether any pixel within `reach` of given ones, to the sides and corners, is marked; outside none is."""
    height, width = marked.shape
    found = np.zeros(len(rows), bool)
    if not marked.any():
        return found
    for down in range(-reach, reach + 1):
        for along in range(-reach, reach + 1):
            found |= marked[np.clip(rows + down, 0, height - 1), np.clip(columns + along, 0, width - 1)]
    return found
