"""One photograph more: from another side, or under a further small light; and what will be known with it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from capture.parallel import parallel_map
from capture.progress import Track
from invrender.brdf.microfacet import Microfacet
from invrender.estimate.identifiability import lighting_degree
from invrender.plan.experiment import PlannedView
from invrender.plan.photographs import Draw, ShownSamples, steady, unexposed
from invrender.plan.planning import Plan
from invrender.plan.prospect import Expected
from invrender.plan.reflected import Reflected
from recon.sampling.draw import samples_at

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

    visible : (m, n), which rays see which of the n places' directions. irradiance : (3,) that each would give. degree :
    of all lightings with one of them, if its highlight is seen.
    """

    drawn: Draw
    seen: ShownSamples
    visible: NDArray[np.bool_]
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
        tasks += [(place, viewpoint, k) for k, place in enumerate(those)]

    def candidate(task: tuple[TrialPlace, _Viewpoint, int]) -> AddedPhoto:
        place, at, k = task
        field, light, visible = at.drawn.field, place.view.light, at.visible[:, k]
        further = plan.bench.optics.of_source(place.direction, field, visible).times(at.irradiance)
        keep = steady(field, place.direction[None], visible[:, None])
        both = replace(at.seen, reflected=at.seen.reflected + further)
        added = plan.bench.one_more(light, replace(at.drawn, field=field.where(keep)), both.where(keep))
        seen = _shows_highlight(further, at.irradiance, plan.experiment.brdf)
        posterior = plan.posterior.with_information(light, added)
        return AddedPhoto(
            place, at.irradiance, plan.outlook(posterior, at.degree if seen else plan.degree, [field])
        )

    return _tracked(candidate, tasks, track, what)


def _viewpoint(plan: Plan, places: Sequence[TrialPlace], looked_at: int) -> _Viewpoint:
    view, directions = places[0].view, np.array([place.direction for place in places])
    lights = plan.experiment.lights
    lighting, irradiance = lights[view.light].lighting, lights[view.light].total / 4
    (drawn,) = plan.bench.draws([view], looked_at)
    (seen,) = plan.bench.shown(view.light, [drawn])
    rows, columns = drawn.field.rows, drawn.field.columns
    rays = samples_at(plan.experiment.body, view.camera, unexposed(view.camera), rows, columns, directions)
    # Turning a light changes no degree of it: one direction speaks for all.
    added = replace(
        lighting,
        directions=np.vstack([lighting.directions, directions[:1]]),
        irradiances=np.vstack([lighting.irradiances, irradiance]),
    )
    degree = lighting_degree([*(light.lighting for light in lights), added])
    return _Viewpoint(drawn, seen, rays.sources_visible, irradiance, degree)


def _shows_highlight(further: Reflected, irradiance: Floats, brdf: Microfacet) -> bool:
    """Whether samples see a source's highlight up to where the lobe has fallen to 1/e of its peak, head-on."""
    if brdf.sigma is None:
        return False
    return bool((further.lobe > irradiance / (4 * np.pi * brdf.sigma**2) / np.e).any())


def _tracked(
    candidate: Callable[[Task], AddedPhoto], tasks: Sequence[Task], track: Track, what: str
) -> list[AddedPhoto]:
    found = parallel_map(candidate, tasks)
    return [next(found) for _ in track(range(len(tasks)), what)]
