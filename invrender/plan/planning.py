"""The plan: an experiment in, what its photographs will determine out. No terminal, no files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from capture.parallel import one_blas_thread, parallel_map
from capture.progress import Track, silent
from invrender.estimate.identifiability import lighting_degree
from invrender.plan.calibration import planned_scores
from invrender.plan.experiment import Experiment
from invrender.plan.information import Marginal, Posterior, Tally
from invrender.plan.light_prospect import LightProspect
from invrender.plan.photographs import Draw
from invrender.plan.prepared import FEWEST, Bench
from invrender.plan.prospect import Expected
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

DEFAULT_DEGREE, DEFAULT_SAMPLES = 10, 20_000


@dataclass(frozen=True, eq=False)
class Plan:
    """What the photographs of an experiment will determine.

    found : per light, the information in its photographs. draws : the samples looked at, in the order of the views.
    scores : of errors of calibration, as `Posterior` has them.
    """

    bench: Bench
    found: tuple[Tally, ...]
    draws: tuple[Draw, ...]
    scores: Mapping[str, Floats]

    @property
    def experiment(self) -> Experiment:
        return self.bench.experiment

    @property
    def fit_samples(self) -> int:
        """How many samples a fit would take."""
        count = sum(drawn.stands_for * len(drawn.field) for drawn in self.draws)
        return round(count) * self.experiment.sensor.exposures

    @cached_property
    def degree(self) -> int | None:
        """Of `lighting_degree`, of all lights."""
        return lighting_degree([light.lighting for light in self.experiment.lights])

    @cached_property
    def posterior(self) -> Posterior:
        """What all of it leaves uncertain."""
        return self._posterior(1.0)

    @cached_property
    def expected(self) -> tuple[Expected, ...]:
        """All quantities, those of unknown lightings after those of the BRDF."""
        return self.outlook(self.posterior, self.degree)

    @cached_property
    def repeated(self) -> tuple[Expected, ...]:
        """The same with every photograph taken twice."""
        return self.outlook(self._posterior(2.0), self.degree)

    @cached_property
    def lights(self) -> tuple[LightProspect, ...]:
        """How much of each unknown light is determined."""
        return tuple(
            light.prospect(self.posterior, self._fields(k)) for k, light in self.bench.unknown_lights.items()
        )

    def outlook(
        self, posterior: Posterior, degree: int | None, more: Sequence[LightField] = ()
    ) -> tuple[Expected, ...]:
        """All quantities under a posterior, in lightings of a degree as `degree` is, with `more` samples."""
        fields = [self._most_grazing, *(field for field in more if len(field))]
        found = self.bench.asked_brdf.quantities(posterior, degree, fields)
        for light in self.bench.unknown_lights.values():
            found += light.quantities(posterior)
        return tuple(found)

    @cached_property
    def _most_grazing(self) -> LightField:
        return min((drawn.field for drawn in self.draws), key=lambda field: float(field.cos_exitant.min()))

    def _fields(self, light: int) -> list[LightField]:
        views = self.experiment.views
        return [drawn.field for drawn, view in zip(self.draws, views, strict=True) if view.light == light]

    def _posterior(self, times: float) -> Posterior:
        bench, marginals = self.bench, []
        for k, (light, found) in enumerate(zip(bench.unknowns.lights, self.found, strict=True)):
            none = np.zeros((0, 3 * light.size + len(bench.unknowns.std)))
            rows = bench.unknown_lights[k].asked if k in bench.unknown_lights else none
            marginals.append(Marginal(light, found.times(times), rows))
        # One pose has one error, however often it is photographed.
        return Posterior(marginals, {cause: times * columns for cause, columns in self.scores.items()})


def make_plan(
    experiment: Experiment,
    degree: int = DEFAULT_DEGREE,
    samples: int = DEFAULT_SAMPLES,
    track: Track = silent,
) -> Plan:
    """Plan an experiment.

    degree : highest degree of unknown light, >= 0. samples : pixels of all photographs together that are looked at;
    their information is scaled to those that `process` takes. ValueError where a photograph shows nothing usable.
    """
    if samples < 1:
        raise ValueError(f"samples is {samples}; at least one pixel must be looked at")
    with one_blas_thread():
        bench = Bench(experiment, degree, samples)
        views = experiment.views
        drawn = bench.draws(views)
        draws = [next(drawn) for _ in track(views, "Looking through the cameras")]
        _check_usable(experiment, draws)
        brightness = list(parallel_map(bench.brightness, views))
        if not any(one.any() for one in brightness):
            raise ValueError(
                f"{experiment.name}: no light reaches what the photographs show; turn the lights"
            )
        exposure_s = experiment.sensor.exposure_s(brightness)
        found = [bench.nothing(light) for light in range(len(experiment.lights))]
        seen = {
            light: bench.shown(
                light, [one for one, view in zip(draws, views, strict=True) if view.light == light]
            )
            for light in {view.light for view in views}
        }
        steps, weighted = list(zip(views, draws, brightness, strict=True)), []
        for view, one, bright in track(steps, "Adding up their information"):
            shown = next(seen[view.light])
            weights = bench.weights(one, shown, bright, exposure_s)
            found[view.light] += bench.information(view.light, one, shown, weights)
            if experiment.errors.stated:
                weighted.append(bench.weighted(view.light, shown, weights))
        scores: Mapping[str, Floats] = {}
        if experiment.errors.stated:
            scores = planned_scores(experiment, bench.object, [one.field for one in draws], weighted)
        return Plan(bench, tuple(found), tuple(draws), scores)


def _check_usable(experiment: Experiment, draws: Sequence[Draw]) -> None:
    for view, one in zip(experiment.views, draws, strict=True):
        usable = round(one.stands_for * len(one.field))
        if usable < FEWEST:
            raise ValueError(
                f"{experiment.name}: photograph {view.name} shows {usable} usable pixels of the object, and {FEWEST}"
                " are needed: it must be larger in the picture, or in it at all"
            )
