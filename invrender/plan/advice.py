"""What single added photograph would help most: from where, or under what further light."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.arc.gantry import look_at
from capture.parallel import one_blas_thread
from capture.progress import Track, silent
from invrender.plan.candidates import AddedPhoto, TrialPlace, lamp_candidates, view_candidates
from invrender.plan.experiment import PlannedView
from invrender.plan.planning import Plan
from invrender.plan.prospect import Expected
from recon.harmonics.basis import sphere_directions

Floats = NDArray[np.float64]

# Directions that are tried for views and for lights; views no closer than this to one that is there.
_DIRECTIONS = 100
_APART = np.radians(3.0)
# Of many lightings those with most photographs are tried for views; so many views are tried for a further light.
_LIGHTS, _VIEWPOINTS = 3, 4
# Samples of each, and of those few that do best.
_LOOKED_AT, _LOOKED_AT_AGAIN, _FINALISTS = 250, 2000, 4


@dataclass(frozen=True, eq=False)
class TriedPhotos:
    """All photographs of one kind that were tried; `best`, and `best_above` the horizon, looked at more closely."""

    tried: tuple[AddedPhoto, ...]
    best: AddedPhoto
    best_above: AddedPhoto

    def gains(self, target: Expected) -> tuple[Floats, Floats]:
        """Directions (n, 3) that were tried, and by what factor (n,) the target's doubt shrinks at best."""
        best: dict[tuple[float, ...], float] = {}
        for candidate in self.tried:
            gain = target.doubt / max(candidate.named(target.name).doubt, 1e-300)
            direction = tuple(candidate.place.direction.tolist())
            best[direction] = max(gain, best.get(direction, 0.0))
        return np.array(list(best)), np.array(list(best.values()))


@dataclass(frozen=True, eq=False)
class Advice:
    """What one photograph more would bring.

    target : the quantity that is worst off now, by which photographs are judged: that is best which leaves fewest
    quantities undetermined, and among those the one that leaves the smallest `Expected.doubt` of the target.
    """

    target: Expected
    view: TriedPhotos
    lamp: TriedPhotos


def advise(plan: Plan, track: Track = silent) -> Advice:
    """Try one photograph more from about a hundred directions, and under a further light from about a hundred.

    A view is tried with the first photograph's camera, at the cameras' distance. The light is small and known, and
    its irradiance the mean over all orientations that the lighting gives now.
    """
    target = max(plan.expected, key=lambda one: one.rank)

    def trial(
        places: Sequence[TrialPlace],
        ask: Callable[[Plan, Sequence[TrialPlace], int, Track, str], list[AddedPhoto]],
        what: str,
    ) -> TriedPhotos:
        tried = ask(plan, places, _LOOKED_AT, track, f"Trying further {what}")
        ranked = [one.place for one in sorted(tried, key=lambda one: one.score(target.name))]
        above = [place for place in ranked if place.above_horizon]
        # A few samples flatter some of many: the best are looked at again.
        again = list({id(place): place for place in ranked[:_FINALISTS] + above[:_FINALISTS]}.values())
        finalists = ask(plan, again, _LOOKED_AT_AGAIN, track, f"Comparing the best {what}")
        finalists.sort(key=lambda one: one.score(target.name))
        high = [one for one in finalists if one.place.above_horizon]
        return TriedPhotos(tuple(tried), finalists[0], (high or finalists)[0])

    with one_blas_thread():
        return Advice(
            target,
            trial(_new_views(plan), view_candidates, "views"),
            trial(_new_lamps(plan), lamp_candidates, "lamps"),
        )


def _new_views(plan: Plan) -> list[TrialPlace]:
    experiment = plan.experiment
    camera, centre = experiment.views[0].camera, experiment.centre
    of_light = [view.light for view in experiment.views]
    directions = sphere_directions(_DIRECTIONS)
    places = []
    for light in sorted(set(of_light), key=lambda light: (-of_light.count(light), light))[:_LIGHTS]:
        there = np.array([experiment.direction(view) for view in experiment.views if view.light == light])
        # Where views are everywhere, one more may stand beside another.
        free = [one for one in directions if (there @ one).max() < np.cos(_APART)] or list(directions)
        for direction in free:
            pose = look_at(centre + experiment.distance * direction, centre, [0, 0, 1])
            places.append(TrialPlace(direction, PlannedView(camera.posed(pose), light)))
    return places


def _new_lamps(plan: Plan) -> list[TrialPlace]:
    views = plan.experiment.views
    evenly = np.linspace(0, len(views) - 1, min(len(views), _VIEWPOINTS)).round()
    directions = sphere_directions(_DIRECTIONS)
    return [
        TrialPlace(direction, views[k], k) for k in evenly.astype(int).tolist() for direction in directions
    ]
