"""A first answer from nothing: trial BRDFs, the light that they imply, and its sharp peaks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from capture.source_region import SourceRegion
from invrender.estimate.clusters import outstanding
from invrender.estimate.unknown_light.lighting_design import LightingDesign
from invrender.estimate.unknown_light.projection import (
    ITERATIONS,
    BlindFit,
    predicted,
    refine,
    solve_lighting,
)
from invrender.estimate.unknown_light.state import FIRST_MU, BlindState
from recon.harmonics.basis import degree_of, degrees, evaluate_harmonics, sphere_directions
from recon.sampling.lightfield import LightField, pools

Floats = NDArray[np.float64]

_ROUGHNESSES, _SHARES, _TRIED = (0.08, 0.15, 0.3), (0.1, 0.6), 2
# Where there are lamps only, whose highlights may be narrow: the roughnesses of narrow lobes, and those of wide ones.
_IN_THE_DARK = (0.02, 0.05), (0.1, 0.3)
_GRID = 20000
# A diffuse body without sources.
NOTHING = BlindState(np.zeros(3), None, None, np.zeros((0, 3)))
# Width, radians, of the peaks that are looked for, and how far apart they are.
PEAK_WIDTH, _APART = 0.08, 0.35
_PEAKS = 4
# Of the samples that are taken, what small highlights may add is one in so many.
_BRIGHT = 10


@dataclass(frozen=True, eq=False)
class Search:
    """Photographs as searches take them.

    weights, trust : (n, 3) per design, as in `noise.Weights`. scales : (3,) of each lighting by its number, that
    the prior goes by. regions : where a lighting's sources may be, by its number; anywhere for those it lacks.
    """

    designs: Sequence[LightingDesign]
    weights: Sequence[Floats]
    trust: Sequence[Floats]
    scales: Mapping[int, Floats]
    regions: Mapping[int, SourceRegion] = field(default_factory=dict)

    @property
    def problem(self) -> tuple[Sequence[LightingDesign], Sequence[Floats], Mapping[int, Floats]]:
        """What the solvers take: designs, weights, and the lightings' scales."""
        return self.designs, self.weights, self.scales

    @property
    def numbers(self) -> int:
        return sum(weight.size for weight in self.weights)

    @property
    def lightings(self) -> list[int]:
        """Numbers of the lightings that photographs are under."""
        return sorted(self.scales)

    def only(self, lighting: int) -> Search:
        """The same with the photographs under one lighting only."""
        mine = [k for k, design in enumerate(self.designs) if design.lighting == lighting]
        return Search(
            [self.designs[k] for k in mine],
            [self.weights[k] for k in mine],
            [self.trust[k] for k in mine],
            {lighting: self.scales[lighting]},
            self.regions,
        )

    def may_hold(self, lighting: int, directions: Floats) -> NDArray[np.bool_]:
        """Whether a lighting's sources may be in directions (k, 3)."""
        region = self.regions.get(lighting)
        return np.ones(len(directions), bool) if region is None else region.holds(directions)

    def fit(self, state: BlindState, l_max: int, iterations: int = ITERATIONS) -> BlindFit:
        """The best fit near a state, without sources that leave their region on the way."""
        found = refine(*self.problem, state, l_max, iterations)
        astray = self._astray(found.state)
        return self.fit(found.state.without_source(astray), l_max, iterations) if len(astray) else found

    def _astray(self, state: BlindState) -> NDArray[np.int64]:
        """Which of a state's sources lie where none may be."""
        astray = np.zeros(len(state.directions), bool)
        for lighting in self.lightings:
            own = state.owners == lighting
            astray[own] = ~self.may_hold(lighting, state.directions[own])
        return np.flatnonzero(astray)

    def residuals(self, fit: BlindFit) -> list[Floats]:
        """What a fit to these leaves, (n, 3) per design."""
        return [
            design.radiance - predicted(design, fit, rows)
            for design, rows in zip(self.designs, fit.rows, strict=True)
        ]

    def less(self, radiance: Sequence[Floats]) -> Search:
        """The same without a part (n, 3) of each design's radiance."""
        designs = [
            replace(design, field=design.field.less(off))
            for design, off in zip(self.designs, radiance, strict=True)
        ]
        return replace(self, designs=designs)

    def at(self, state: BlindState, l_max: int) -> BlindFit:
        """The best lightings at a state."""
        return solve_lighting(*self.problem, state, l_max)


def first_state(search: Search, l_max: int, known: BlindState = NOTHING) -> BlindState:
    """The likeliest of a few shares and roughnesses, with each lighting's source at a peak that they imply.

    known : the sources to begin with.
    """
    trials = []
    for sigma, share in product(_ROUGHNESSES, _SHARES):
        bare = replace(known, specular_share=np.full(3, share), mu=FIRST_MU, sigma=sigma)
        state, cost = bare, 0.0
        for lighting in search.lightings:
            own = search.only(lighting)
            fits = [own.at(bare, l_max)]
            peaks = light_peaks(fits[0].slow(lighting), search.regions.get(lighting))[:_TRIED]
            fits += [own.at(bare.with_source(peak, lighting), l_max) for peak in peaks]
            best = min(fits, key=lambda fit: fit.cost)
            cost += best.cost
            for direction in best.state.directions[len(known.directions) :]:
                state = state.with_source(direction, lighting)
        trials.append((cost, state))
    return min(trials, key=lambda trial: trial[0])[1]


def first_states(search: Search, lamps: BlindState) -> list[BlindState]:
    """The likelier share and roughness of a narrow lobe, and of a wide one, for given lamps in the dark and form."""
    found = []
    for roughnesses in _IN_THE_DARK:
        trials = [
            replace(lamps, specular_share=np.full(3, share), mu=FIRST_MU, sigma=sigma).with_form(lamps.form)
            for sigma, share in product(roughnesses, _SHARES)
        ]
        found.append(min(trials, key=lambda state: search.at(state, 0).cost))
    return found


def light_peaks(light: Floats, region: SourceRegion | None) -> Floats:
    """Directions (k, 3) of the sharpest peaks of light ((l_max + 1)^2, 3), highest first."""
    l_max = degree_of(len(light))
    l = degrees(l_max)
    # Area lights have little power in the degrees that the Laplacian raises.
    sharpened = light.sum(axis=1) * l * (l + 1) * np.exp(-((PEAK_WIDTH * l) ** 2))
    grid = sphere_directions(_GRID)
    if region is not None:
        grid = grid[region.holds(grid)]
    height = evaluate_harmonics(grid, l_max) @ sharpened
    peaks: list[Floats] = []
    while len(peaks) < _PEAKS and len(grid) and height.max() > 0:
        peaks.append(grid[height.argmax()])
        away = grid @ peaks[-1] < np.cos(_APART)
        grid, height = grid[away], height[away]
    return np.array(peaks).reshape(-1, 3)


def of_degree(search: Search, l_max: int, settled: bool = False) -> Search:
    """The same, prepared for lighting of another degree; settled : as of `LightingDesign`."""
    designs = [
        design
        if (design.l_max, design.settled) == (l_max, settled)
        else design.like(design.photos, l_max, settled)
        for design in search.designs
    ]
    return replace(search, designs=designs)


def forget_rows(search: Search) -> None:
    """Leave the memory of rows that designs keep from step to step; they are made again when asked for."""
    for design in search.designs:
        design.forget_rows()


def thinned(search: Search, l_max: int, most: int, per_lighting: int) -> Search:
    """The same with at most about `most` samples, or `per_lighting` of each if that is more, evenly taken.

    Of small highlights that the even choice would leave a few samples of, more are taken, up to a tenth of all: they
    determine lamps and lobe best, and few that stand alone look like dust. Of a part of a mesh's samples few rays do:
    what is chosen there is fitted to all of them in the end.
    """
    total = sum(len(design.field) for design in search.designs)
    every = max(1, int(np.ceil(total / max(most, per_lighting * len(search.lightings)))))
    if every == 1 and all(design.l_max == l_max for design in search.designs):
        return search
    owners = [design for design in search.designs for _ in design.photos]
    photos = [photo for design in search.designs for photo in design.photos]
    keeps = [_evenly(photo, every, k) for k, photo in enumerate(photos)]
    photos = [photo.where(keep) for photo, keep in zip(photos, keeps, strict=True)]
    if every > 1:
        photos = [photo.with_few_rays() for photo in photos]
    kept = np.concatenate(keeps)
    # Lightings come one after the other, and so do photographs in their pools.
    together = pools(photos, [design.lighting for design in owners])
    designs = [owners[pool[0]].like([photos[k] for k in pool], l_max) for pool in together]
    ends = np.cumsum([len(design.field) for design in designs])[:-1]
    weights, trust = (np.split(np.concatenate(of)[kept], ends) for of in (search.weights, search.trust))
    return replace(search, designs=designs, weights=weights, trust=trust)


def _evenly(photo: LightField, every: int, first: int) -> NDArray[np.bool_]:
    """One in so many samples (n,) of a photograph, and some of its small highlights'; of one in so many places, all."""
    if photo.place is not None:
        return np.asarray(photo.place % every == 0)
    keep = np.arange(len(photo)) % every == first % every
    bright = np.flatnonzero(outstanding(photo))
    keep[bright[:: max(1, _BRIGHT * every * len(bright) // len(keep))]] = True
    return keep
