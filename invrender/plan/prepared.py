"""An experiment made ready, so that the information of any photograph of it can be computed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from capture.parallel import parallel_map
from invrender.plan.experiment import Experiment, PlannedView
from invrender.plan.information import Tally, in_prior_units, photograph_tally
from invrender.plan.light_prospect import UnknownLight
from invrender.plan.photographs import Draw, draw, picture
from invrender.plan.prospect import AskedBrdf
from invrender.plan.shown import PlannedObject, ShownSamples
from invrender.plan.unknowns import unknowns_of
from invrender.process.pipeline import DEFAULT_SAMPLES as FIT_SAMPLES

Floats = NDArray[np.float64]

# Samples of a photograph below which `process` refuses it.
FEWEST = 20
# No noise is below this share of the radiance (RMS): the fit believes in none.
_LEAST_NOISE = 1e-4


class Bench:
    """An experiment made ready.

    unknown_lights : by their index, those that are not given. budget : samples that a fit takes of a photograph.
    looked_at : how many of them are looked at here.
    """

    def __init__(self, experiment: Experiment, degree: int, samples: int) -> None:
        self.experiment = experiment
        lights = experiment.lights
        self.unknowns = unknowns_of(experiment.brdf, lights, degree, experiment.gauge_light)
        self.object = PlannedObject(experiment.body, lights, self.unknowns, degree)
        self.unknown_lights = {
            k: UnknownLight.of(light, self.unknowns, k, self.object.frame.radius)
            for k, light in enumerate(lights)
            if not light.known
        }
        self.asked_brdf = AskedBrdf.of(self.unknowns, absolute=experiment.gauge_light is None)
        count = len(experiment.views)
        self.budget = max(FIT_SAMPLES // (count * experiment.sensor.exposures), 4 * FEWEST)
        self.looked_at = max(samples // count, 4 * FEWEST)

    def draws(self, views: Sequence[PlannedView], looked_at: int | None = None) -> Iterator[Draw]:
        """Samples of photographs; as many of each as `looked_at` says."""

        def one(numbered: tuple[int, PlannedView]) -> Draw:
            # Seeded by place, so that threads don't change what is drawn.
            rng = np.random.default_rng(numbered[0])
            view, count = numbered[1], looked_at or self.looked_at
            sources = self.experiment.lights[view.light].lighting.sources
            return draw(self.experiment.body, view.camera, sources, self.budget, count, rng)

        return parallel_map(one, enumerate(views))

    def brightness(self, view: PlannedView) -> Floats:
        """Radiance (k, 3) of the object's pixels in a photograph."""
        return self.object.radiance(view.light, picture(self.experiment.body, view.camera))

    def shown(self, light: int, draws: Sequence[Draw]) -> Iterator[ShownSamples]:
        """What photographs under a light show."""
        return self.object.shown(light, [one.field for one in draws])

    def weights(self, drawn: Draw, seen: ShownSamples, brightness: Floats, exposure_s: float) -> Floats:
        """Inverse variances (n, 3) of a photograph's samples, all the files of its bracket together.

        brightness : (k, 3), its radiance.
        """
        sensor = self.experiment.sensor
        weights = sensor.information(seen.radiance, brightness, exposure_s)
        least = _LEAST_NOISE * float(np.sqrt(np.mean(brightness**2)))
        weights = np.minimum(weights, 1 / max(least, 1e-150) ** 2)
        return np.asarray(drawn.stands_for * sensor.exposures * weights)

    def information(self, light: int, drawn: Draw, seen: ShownSamples, weights: Floats) -> Tally:
        """The information in a photograph; weights : of `weights`."""
        return photograph_tally(self.unknowns, light, drawn.field, seen, weights)

    def weighted(self, light: int, seen: ShownSamples, weights: Floats) -> tuple[Floats, Floats]:
        """Derivatives (3, n, p) and (3, n, t), as `ShownSamples` has them, in units of the prior, times weights."""
        lit, shared = in_prior_units(self.unknowns, light, seen)
        return lit * weights.T[..., None], shared * weights.T[..., None]

    def nothing(self, light: int) -> Tally:
        """The information of no photograph under a light."""
        return Tally.none(self.unknowns.lights[light].size, len(self.unknowns.std))

    def one_more(self, light: int, drawn: Draw, seen: ShownSamples) -> Tally:
        """The information in one more photograph, exposed for itself, by the samples that are looked at."""
        brightness = seen.radiance
        if not brightness.any():
            return self.nothing(light)
        exposure_s = self.experiment.sensor.exposure_s([brightness])
        return self.information(light, drawn, seen, self.weights(drawn, seen, brightness, exposure_s))
