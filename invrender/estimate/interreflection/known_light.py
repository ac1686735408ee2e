"""Light that bounces between an object's parts where its light is known, and with it the albedo."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from invrender.estimate.clusters import tiles_of
from invrender.estimate.evidence import climb_ladder
from invrender.estimate.explanation import Explanation, refitted
from invrender.estimate.interreflection.correction import MATTERS, Correction, Sent, corrected, settled
from invrender.estimate.interreflection.statement import Interreflection, asked_for, of_all, rms, stated
from invrender.estimate.models import Estimate
from invrender.transport.columns import PhotoColumns
from invrender.transport.predict import predict_columns
from invrender.transport.radiosity import ConcaveMesh, albedo
from invrender.transport.transfer import LightElement

Floats = NDArray[np.float64]
Elements = Mapping[str, Sequence[LightElement]]

# The albedo at which its size is stated where none is known.
SUPPOSED = 0.5


@dataclass(frozen=True, eq=False)
class KnownLightEvidence:
    """An explanation's columns of photographs as they are; fit : the estimate of its chosen model."""

    parts: ConcaveMesh
    elements: Elements
    known: Explanation
    fit: Estimate

    @property
    def shown(self) -> list[Floats]:
        return [photo.radiance for photo in self.known.photos]

    def sent(self, fit: Estimate) -> Sent:
        """What bounces by an estimate."""
        bounced = {
            name: self.parts.bounced(self.elements[name], strengths, fit.brdf)
            for name, strengths in fit.strengths.items()
        }
        return Sent(self.parts, bounced, fit.brdf)

    def radiance(self, light: Sent) -> list[Floats]:
        return [light.radiance(photo.lighting, photo.field) for photo in self.known.photos]

    def agreed(self) -> Sent | None:
        fit = settled(
            self.fit,
            lambda fit: self.radiance(self.sent(fit)),
            partial(refitted, self.known),
            self.shown,
            lambda fit: fit.cost > self.fit.cost,
        )
        light = None if fit is None else self.sent(fit)
        # Where the model at hand says that there is none, the ladder isn't climbed again.
        return light if light is not None and self.judged(light).taken_off else None

    def judged(self, light: Sent) -> Interreflection:
        photos, weights, less = self.known.photos, self.known.weights, self.radiance(light)
        taken, without = _less(photos, less), refitted(self.known, less)
        (as_they_are,) = climb_ladder(photos, weights, models=[self.fit.model])
        ladder = climb_ladder(taken, weights, models=[without.model])
        (better,) = of_all(ladder, self.shown, [own.trust for own in weights], less)
        asked = asked_for(
            [tiles_of([photo.field]) for photo in photos],
            [own.weight for own in weights],
            _residuals(photos, self.fit),
            _residuals(taken, without),
        )
        errors = as_they_are.error, better.error
        return stated(self.shown, less, asked, errors, (self.fit.brdf, without.brdf))


def correct_known_light(
    parts: ConcaveMesh,
    photos: Sequence[PhotoColumns],
    known: Explanation,
    elements: Elements,
    explained: Callable[[list[PhotoColumns]], Explanation],
) -> Correction[Explanation, Sent, KnownLightEvidence] | None:
    """`correction.corrected` in known light.

    photos : columns of RH01's form. known : their explanation without bounced light, whose scale must be absolute.
    explained : that of photographs without it.
    """

    def solved(light: Sent, _: Explanation | None) -> tuple[Explanation, KnownLightEvidence]:
        less = [light.radiance(photo.lighting, photo.field) for photo in photos]
        better = explained(_less(photos, less))
        back = [-radiance for radiance in less]
        as_they_are = replace(better, photos=tuple(_less(better.photos, back)))
        shown, trust = [photo.radiance for photo in photos], [own.trust for own in better.weights]
        fit = refitted(better, back)
        candidates = of_all(better.candidates, shown, trust, less)
        return replace(better, candidates=candidates), KnownLightEvidence(parts, elements, as_they_are, fit)

    photographs = KnownLightEvidence(parts, elements, known, known.best.estimate)
    return corrected(known, photographs, photographs.sent(photographs.fit), solved)


def unknown_scale(parts: ConcaveMesh, known: Explanation, elements: Elements) -> list[str]:
    """A sentence on light that bounces where no light's strength is known and so no albedo; none if it can't matter."""
    estimate = known.best.estimate
    scale = SUPPOSED / float(albedo(estimate.brdf).mean())
    brdf = replace(estimate.brdf, kd=scale * estimate.brdf.kd, ks=scale * estimate.brdf.ks)
    photographs = KnownLightEvidence(parts, elements, known, replace(estimate, brdf=brdf))
    less = photographs.radiance(photographs.sent(photographs.fit))
    relative = rms(less) / (scale * rms(photographs.shown))
    if relative < MATTERS:
        return []
    return [
        "Light that bounces between the object's parts isn't taken off: no light of known strength fixes the albedo"
        f" while it is fitted. At an albedo of {SUPPOSED} it would be {relative:.1%} of the radiance (RMS), and Kd too"
        " high by about as much where it is even; the irradiance of one source would settle it."
    ]


def _less(photos: Sequence[PhotoColumns], less: Sequence[Floats]) -> list[PhotoColumns]:
    return [photo.less(radiance) for photo, radiance in zip(photos, less, strict=True)]


def _residuals(photos: Sequence[PhotoColumns], estimate: Estimate) -> list[Floats]:
    return [
        photo.radiance - predict_columns(photo, estimate.brdf, estimate.strengths[photo.lighting])
        for photo in photos
    ]
