"""What single added photograph would help most: from where, or under what further light."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from capture.arc.gantry import look_at
from capture.parallel import one_blas_thread, parallel_map
from capture.progress import Track, silent
from invrender.model.microfacet import Microfacet
from invrender.plan.experiment import View
from invrender.plan.photographs import Draw, Shown, steady, unexposed
from invrender.plan.planning import Plan
from invrender.plan.prospect import Expected
from invrender.plan.reflected import Reflected
from invrender.solve.identifiability import lighting_degree
from recon.harmonics import sphere_directions
from recon.sampling import samples_at

Floats = NDArray[np.float64]
Task = TypeVar("Task")

# Directions that are tried for views and for lights; views no closer than this to one that is there.
_DIRECTIONS = 100
_APART = np.radians(3.0)
# Of many lightings those with most photographs are tried for views; so many views are tried for a further light.
_LIGHTS, _VIEWPOINTS = 3, 4
_LOOKED_AT = 250


@dataclass(frozen=True, eq=False)
class Candidate:
    """One photograph more, and all that will be known with it.

    direction : (3,) unit, from the object to the camera, or to the further light. light : which lighting it is under.
    viewpoint : of a further light, which view is taken again under it; None for a new view. irradiance : (3,) of the
    further light; None for a new view.
    """

    direction: Floats
    light: int
    viewpoint: int | None
    irradiance: Floats | None
    expected: tuple[Expected, ...]

    def named(self, name: str) -> Expected:
        """One of the quantities."""
        return next(one for one in self.expected if one.name == name)

    def score(self, target: str) -> tuple[int, float]:
        """How many quantities stay undetermined, then how well the target is known; the smallest is best."""
        undetermined = sum(one.quantity.status == "undetermined" for one in self.expected)
        return undetermined, self.named(target).doubt


@dataclass(frozen=True, eq=False)
class Advice:
    """What one photograph more would bring.

    target : the quantity that is worst off now, by which candidates are judged: that is best which leaves fewest
    quantities undetermined, and among those the one that leaves the smallest `Expected.doubt` of the target.
    views, lights : all that was tried.
    """

    target: Expected
    views: tuple[Candidate, ...]
    lights: tuple[Candidate, ...]

    def best(self, candidates: Sequence[Candidate], above_horizon: bool = False) -> Candidate | None:
        """The best of some candidates; None if there is none. above_horizon : of those at elevations from 0 on."""
        possible = [one for one in candidates if one.direction[2] >= 0 or not above_horizon]
        return min(possible, key=lambda one: one.score(self.target.name), default=None)

    def gains(self, candidates: Sequence[Candidate]) -> tuple[Floats, Floats]:
        """Directions (n, 3) that were tried, and by what factor (n,) the target's doubt shrinks at best."""
        best: dict[tuple[float, ...], float] = {}
        for candidate in candidates:
            gain = self.target.doubt / max(candidate.named(self.target.name).doubt, 1e-300)
            direction = tuple(candidate.direction.tolist())
            best[direction] = max(gain, best.get(direction, 0.0))
        return np.array(list(best)).reshape(-1, 3), np.array(list(best.values()))


def advise(plan: Plan, track: Track = silent) -> Advice | None:
    """Try one photograph more from about a hundred directions, and under a further light from about a hundred.

    A view is tried with the first photograph's camera, at the cameras' distance. The light is small and known, and
    its irradiance the mean over all orientations that the lighting gives now. None where nothing is to be found out.
    """
    if not plan.expected:
        return None
    target = max(plan.expected, key=lambda one: one.rank)
    with one_blas_thread():
        return Advice(target, tuple(_new_views(plan, track)), tuple(_new_lights(plan, track)))


def _new_views(plan: Plan, track: Track) -> Iterator[Candidate]:
    experiment, bench = plan.experiment, plan.bench
    of_light = [view.light for view in experiment.views]
    most = sorted(set(of_light), key=lambda light: (-of_light.count(light), light))[:_LIGHTS]
    tasks: list[tuple[Floats, View, Draw, Shown]] = []
    for light in most:
        there = np.array([experiment.direction(view) for view in experiment.views if view.light == light])
        free = [one for one in sphere_directions(_DIRECTIONS) if (there @ one).max() < np.cos(_APART)]
        positions = [experiment.centre + experiment.distance * one for one in free]
        poses = [look_at(position, experiment.centre, [0, 0, 1]) for position in positions]
        views = [View(bench.posed(pose), light) for pose in poses]
        looking = bench.draws(views, _LOOKED_AT)
        draws = [next(looking) for _ in track(views, "Looking from further sides")]
        tasks += zip(free, views, draws, bench.shown(light, draws), strict=True)

    def candidate(task: tuple[Floats, View, Draw, Shown]) -> Candidate:
        direction, view, drawn, seen = task
        posterior = plan.posterior
        if len(drawn.field):
            posterior = posterior.with_information(view.light, bench.one_more(view.light, drawn, seen))
        expected = plan.outlook(posterior, plan.degree, [drawn.field])
        return Candidate(direction, view.light, None, None, expected)

    yield from _tracked(candidate, tasks, track, "Trying further views")


@dataclass(frozen=True, eq=False)
class _Lit:
    """A further light on a view that is there. degree : of all lightings, if its highlight is seen."""

    viewpoint: int
    drawn: Draw
    seen: Shown
    direction: Floats
    visible: NDArray[np.bool_]
    irradiance: Floats
    degree: int | None


def _new_lights(plan: Plan, track: Track) -> Iterator[Candidate]:
    experiment, bench = plan.experiment, plan.bench

    def candidate(task: _Lit) -> Candidate:
        field, light = task.drawn.field, experiment.views[task.viewpoint].light
        further = bench.optics.of_source(task.direction, field, task.visible).times(task.irradiance)
        keep = steady(field, task.direction[None], task.visible[:, None])
        both = replace(task.seen, reflected=task.seen.reflected + further)
        told = bench.one_more(light, replace(task.drawn, field=field.where(keep)), both.where(keep))
        shows = _shows_highlight(further, task.irradiance, experiment.brdf)
        posterior = plan.posterior.with_information(light, told)
        expected = plan.outlook(posterior, task.degree if shows else plan.degree, [field])
        return Candidate(task.direction, light, task.viewpoint, task.irradiance, expected)

    yield from _tracked(candidate, _lit_views(plan), track, "Trying further lights")


def _lit_views(plan: Plan) -> list[_Lit]:
    experiment = plan.experiment
    count = len(experiment.views)
    viewpoints = sorted({int(k) for k in np.linspace(0, count - 1, min(count, _VIEWPOINTS)).round()})
    directions = sphere_directions(_DIRECTIONS)
    others = [one.lighting for one in experiment.lights]
    tasks = []
    for viewpoint in viewpoints:
        view = experiment.views[viewpoint]
        lighting, irradiance = experiment.lights[view.light].lighting, experiment.lights[view.light].total / 4
        drawn = _fewer(plan.draws[viewpoint])
        (seen,) = plan.bench.shown(view.light, [drawn])
        # Asked once for all: which rays see which of the directions.
        rows, columns = drawn.field.rows, drawn.field.columns
        lit = samples_at(experiment.body, view.camera, unexposed(view.camera), rows, columns, directions)
        # Turning a light changes no degree of it: one direction speaks for all.
        added = replace(
            lighting,
            directions=np.vstack([lighting.directions, directions[:1]]),
            irradiances=np.vstack([lighting.irradiances, irradiance]),
        )
        degree = lighting_degree([*others, added])
        for direction, visible in zip(directions, lit.sources_visible.T, strict=True):
            tasks.append(_Lit(viewpoint, drawn, seen, direction, visible, irradiance, degree))
    return tasks


def _shows_highlight(further: Reflected, irradiance: Floats, brdf: Microfacet) -> bool:
    """Whether samples see a source's highlight up to where the lobe has fallen to 1/e of its peak, head-on."""
    if brdf.sigma is None:
        return False
    return bool((further.lobe > irradiance / (4 * np.pi * brdf.sigma**2) / np.e).any())


def _fewer(drawn: Draw) -> Draw:
    """Fewer samples of a photograph, evenly picked, that stand for more each."""
    count = len(drawn.field)
    if count <= _LOOKED_AT:
        return drawn
    keep = np.zeros(count, bool)
    keep[np.linspace(0, count - 1, _LOOKED_AT).round().astype(int)] = True
    return Draw(drawn.field.where(keep), drawn.stands_for * count / int(keep.sum()))


def _tracked(
    candidate: Callable[[Task], Candidate], tasks: Sequence[Task], track: Track, what: str
) -> Iterator[Candidate]:
    found = parallel_map(candidate, tasks)
    for _ in track(range(len(tasks)), what):
        yield next(found)
