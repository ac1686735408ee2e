"""One photograph more: from another side, or under a further small light; and what will be known with it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from capture.parallel import parallel_map
from capture.progress import Track
from invrender.estimate.identifiability import lighting_degree
from invrender.plan.experiment import PlannedView
from invrender.plan.photographs import Draw, visible_sources
from invrender.plan.planning import Plan
from invrender.plan.prospect import Expected
from invrender.plan.shown import ShownSamples
from recon.sampling.lightfield import clear_of_terminators

Floats = NDArray[np.float64]
Task = TypeVar("Task")


@dataclass(frozen=True, eq=False)
class TrialPlace:
    """Where to try one photograph more.

    direction : (3,) unit, from the object to the camera, or to the further light. view : the photograph. viewpoint : of
    a further light, which of the experiment's views that is; None for a new view.
    """

    direction: Floats
    view: PlannedView
    viewpoint: int | None = None

    @property
    def above_horizon(self) -> bool:
        return bool(self.direction[2] >= 0)


@dataclass(frozen=True, eq=False)
class AddedPhoto:
    """One photograph more, and all that will be known with it.

    irradiance : (3,) of the further light; None for a new view.
    """

    place: TrialPlace
    irradiance: Floats | None
    expected: tuple[Expected, ...]

    def named(self, name: str) -> Expected:
        """One of the quantities."""
        return next(one for one in self.expected if one.name == name)

    def score(self, target: str) -> tuple[int, float]:
        """How many quantities stay undetermined, then how well the target is known; the smallest is best."""
        undetermined = sum(one.quantity.status == "undetermined" for one in self.expected)
        return undetermined, self.named(target).doubt


def view_candidates(
    plan: Plan, places: Sequence[TrialPlace], looked_at: int, track: Track, what: str
) -> list[AddedPhoto]:
    """What further views would bring, of each of which `looked_at` samples are looked at."""
    bench = plan.bench
    draws = list(bench.draws([place.view for place in places], looked_at))
    of_light: dict[int, list[Draw]] = {}
    for place, drawn in zip(places, draws, strict=True):
        of_light.setdefault(place.view.light, []).append(drawn)
    shows = {light: bench.shown(light, those) for light, those in of_light.items()}

    def candidate(task: tuple[TrialPlace, Draw, ShownSamples]) -> AddedPhoto:
        place, drawn, seen = task
        light, posterior = place.view.light, plan.posterior
        if len(drawn.field):
            posterior = posterior.with_information(light, bench.one_more(light, drawn, seen))
        return AddedPhoto(place, None, plan.outlook(posterior, plan.degree, [drawn.field]))

    tasks = [
        (place, drawn, next(shows[place.view.light])) for place, drawn in zip(places, draws, strict=True)
    ]
    return _tracked(candidate, tasks, track, what)


@dataclass(frozen=True, eq=False)
class _Viewpoint:
    """A view that is there, made ready for further lights.

    irradiance : (3,) that each would give. degree : of all lightings with one of them, if its highlight is seen.
    """

    drawn: Draw
    seen: ShownSamples
    irradiance: Floats
    degree: int | None


def lamp_candidates(
    plan: Plan, places: Sequence[TrialPlace], looked_at: int, track: Track, what: str
) -> list[AddedPhoto]:
    """What further lights would bring, small, known, as strong as the lighting's mean over all orientations."""
    of_viewpoint: dict[int | None, list[TrialPlace]] = {}
    for place in places:
        of_viewpoint.setdefault(place.viewpoint, []).append(place)
    tasks = []
    for those in of_viewpoint.values():
        viewpoint = _viewpoint(plan, those, looked_at)
        tasks += [(place, viewpoint) for place in those]

    def candidate(task: tuple[TrialPlace, _Viewpoint]) -> AddedPhoto:
        place, at = task
        bench, field, light = plan.bench, at.drawn.field, place.view.light
        further = bench.object.under_lamp(place.direction, at.irradiance, field)
        towards = place.direction[None]
        visible = visible_sources(plan.experiment.body, field, towards)
        keep = clear_of_terminators(replace(field, sources_visible=visible), towards)
        both = at.seen.under_more(further).where(keep)
        added = bench.one_more(light, replace(at.drawn, field=field.where(keep)), both)
        seen = _shows_highlight(further, at.irradiance, plan)
        posterior = plan.posterior.with_information(light, added)
        return AddedPhoto(
            place, at.irradiance, plan.outlook(posterior, at.degree if seen else plan.degree, [field])
        )

    return _tracked(candidate, tasks, track, what)


def _viewpoint(plan: Plan, places: Sequence[TrialPlace], looked_at: int) -> _Viewpoint:
    view = places[0].view
    lights = plan.experiment.lights
    lighting, irradiance = lights[view.light].lighting, lights[view.light].total / 4
    (drawn,) = plan.bench.draws([view], looked_at)
    (seen,) = plan.bench.shown(view.light, [drawn])
    # Turning a light changes no degree of it: one direction speaks for all.
    added = replace(
        lighting,
        directions=np.vstack([lighting.directions, places[0].direction]),
        irradiances=np.vstack([lighting.irradiances, irradiance]),
        direction_std_deg=None,
        closeness=None if lighting.closeness is None else np.append(lighting.closeness, 0),
    )
    degree = lighting_degree([*(light.lighting for light in lights), added])
    return _Viewpoint(drawn, seen, irradiance, degree)


def _shows_highlight(further: ShownSamples, irradiance: Floats, plan: Plan) -> bool:
    """Whether samples see a source's highlight up to where the lobe has fallen to 1/e of its peak, head-on."""
    sigma, places = plan.experiment.brdf.sigma, plan.bench.unknowns.brdf.places
    if sigma is None:
        return False
    lobe = np.stack([further.shared[channel][:, places["ks"]][:, channel] for channel in range(3)], axis=-1)
    return bool((lobe > irradiance / (4 * np.pi * sigma**2) / math.e).any())


def _tracked(
    candidate: Callable[[Task], AddedPhoto], tasks: Sequence[Task], track: Track, what: str
) -> list[AddedPhoto]:
    found = parallel_map(candidate, tasks)
    return [next(found) for _ in track(range(len(tasks)), what)]
