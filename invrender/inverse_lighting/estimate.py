"""Inverse lighting of a photo set: photographs in, lighting by both methods out. No terminal, no files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from capture.lighting import Lighting
from capture.parallel import one_blas_thread
from capture.photoset import PhotoSet
from capture.progress import Track, silent
from capture.tasks.stage import kept_result
from capture.wording import some_of
from invrender.brdf.microfacet import Microfacet
from invrender.estimate.evidence import relative_rms
from invrender.inverse_lighting.coefficients import (
    DETERMINED,
    HIGHEST_DEGREE,
    UNDETERMINED,
    LightCoefficients,
    candidate_degree,
    check_samples,
    estimate_coefficients,
)
from invrender.inverse_lighting.dual import DualLight, estimate_dual
from invrender.inverse_lighting.maps import TrueLight, true_light
from invrender.transport.harmonic_rows import PhotoRows, photo_rows
from invrender.transport.lobe_table import Transfer
from recon.sampling.draw import NO_SOURCES
from recon.sampling.find import check_has_body, check_unfiltered, find_body
from recon.sampling.stream import light_fields

# The dual method's coefficients.
_LEAST_DEGREE = 2
# Degrees above the highest of interest that are fitted as well, so that they don't pass for lower ones.
_SPARE_DEGREES = 4
# A structured residual that widens the error bars notably.
_STRUCTURED = 0.005
# Times the usual error of fitted photographs beyond which one that was held out calls for words.
_FAR_WORSE = 2.0


@dataclass(frozen=True, eq=False)
class LightResult:
    """What was found of one lighting.

    direct : coefficients [RH01, eq. 25]. dual : map and nine coefficients; None where a channel has no specular part.
    photos, held_out : (label, relative RMS of the direct answer's prediction) of the photographs fitted, and of others;
    None for a black one.
    truth : the light, where it is given. brdf : by which it was seen.
    """

    name: str
    direct: LightCoefficients
    dual: DualLight | None
    samples: int
    photos: tuple[tuple[str, float | None], ...]
    held_out: tuple[tuple[str, float | None], ...]
    truth: TrueLight | None
    brdf: Microfacet
    warnings: tuple[str, ...]

    @property
    def rms(self) -> float:
        """Relative RMS over the photographs that were fitted, black ones aside."""
        return float(np.sqrt(np.mean([rms**2 for _, rms in self.photos if rms is not None])))

    @property
    def statuses(self) -> list[str]:
        """Of each degree: determined, weak or undetermined."""
        return [
            "determined" if share >= DETERMINED else "weak" if share >= UNDETERMINED else "undetermined"
            for share in self.direct.share_per_degree
        ]


@dataclass(frozen=True)
class LightingChoices:
    """How to solve. degree : of the coefficients, None for what the samples determine. samples : of all photographs."""

    degree: int | None = None
    transfer: Transfer = "exact"
    samples: int = 20_000


def estimate_light(
    photoset: PhotoSet,
    brdf: Microfacet,
    choices: LightingChoices,
    truths: Mapping[str, Lighting] | None = None,
    track: Track = silent,
) -> tuple[LightResult, ...]:
    """Every lighting of a photo set of a sphere of known BRDF, each from the photographs under it.

    truths : lights by the photographs' names for them, to hold the results against; no fit sees them.
    """
    _check_scope(photoset, choices)
    found = find_body(photoset, track)
    names = list(dict.fromkeys(photo.lighting for photo in photoset.fitted))
    degree = candidate_degree(brdf, choices.samples) if choices.degree is None else choices.degree
    l_max = min(max(degree, _LEAST_DEGREE) + _SPARE_DEGREES, HIGHEST_DEGREE)
    sources = {photo.lighting: NO_SOURCES for photo in photoset.photos}
    streamed = light_fields(photoset, found.body, sources, choices.samples, found.mask_of)
    rows: list[PhotoRows] = []
    for photo in track(photoset.photos, "Reading photographs"):
        field = next(streamed)
        if not (field.weight > 0).any():
            raise ValueError(
                f"{photo.file}: no pixel of the object is usable: not saturated, within the mask, not at the rim; leave"
                " the photograph out, or expose it shorter"
            )
        rows.append(photo_rows(field, brdf, l_max, choices.transfer))
    results = []
    for name in track(names, "Solving for the light"):
        fitted = [
            k for k, photo in enumerate(photoset.photos) if photo.lighting == name and not photo.held_out
        ]
        other = [k for k, photo in enumerate(photoset.photos) if photo.lighting == name and photo.held_out]
        mine = [rows[k] for k in fitted]
        if not any(photo.field.radiance.any() for photo in mine):
            raise ValueError(
                f"{photoset.manifest}: the object is black in every photograph under {name or 'its light'}; expose"
                " longer"
            )
        with one_blas_thread():
            direct, dual = kept_result(
                "lights",
                partial(_solved, mine, brdf, choices),
                ([photo.field for photo in mine], brdf, choices),
            )
        scores = [_scores(photoset, rows, which, brdf, direct) for which in (fitted, other)]
        result = LightResult(
            name=name or photoset.name,
            direct=direct,
            dual=dual,
            samples=sum(len(photo.field) for photo in mine),
            photos=scores[0],
            held_out=scores[1],
            truth=true_light(truths[name]) if truths and name in truths else None,
            brdf=brdf,
            warnings=(*found.warnings, *_warnings(brdf, direct, dual), *_held_out_warnings(*scores)),
        )
        results.append(result)
    return tuple(results)


def _solved(
    photos: Sequence[PhotoRows], brdf: Microfacet, choices: LightingChoices
) -> tuple[LightCoefficients, DualLight | None]:
    direct = estimate_coefficients(photos, brdf, choices.degree)
    return direct, estimate_dual(photos, brdf, direct, choices.transfer) if brdf.ks.all() else None


def _check_scope(photoset: PhotoSet, choices: LightingChoices) -> None:
    where = photoset.manifest
    check_has_body(photoset)
    check_unfiltered(photoset)
    if photoset.object.shape != "sphere":
        raise ValueError(
            f"{where}: [object] shape = 'mesh': light is recovered from spheres only, which don't shadow themselves;"
            " with unknown = true `lightfactor process` recovers it together with the BRDF of a mesh"
        )
    if photoset.object.texture:
        raise ValueError(
            f"{where}: [object] texture = true: light is recovered from objects of one BRDF only"
        )
    if all(photo.held_out for photo in photoset.photos):
        raise ValueError(f"{where}: every photo is held out; none is left to recover the light from")
    if choices.degree is not None:
        check_samples(choices.degree, choices.samples)


def _scores(
    photoset: PhotoSet,
    rows: Sequence[PhotoRows],
    which: Sequence[int],
    brdf: Microfacet,
    direct: LightCoefficients,
) -> tuple[tuple[str, float | None], ...]:
    """Relative RMS of the samples of some photographs, each counting by how much of its variance is noise.

    None of a black photograph, of which nothing is a share.
    """
    scores = []
    for k in which:
        seen, predicted = rows[k].field.radiance, rows[k].predict(brdf, direct.values)
        noise = direct.noise.variance(predicted)
        hidden = direct.hidden_power * rows[k].power_beyond(brdf, direct.degree)
        trust = rows[k].field.weight[:, None] * noise / (noise + hidden)
        error = relative_rms(seen - predicted, seen, trust) if seen.any() else None
        scores.append((photoset.photos[k].label, error))
    return tuple(scores)


def _warnings(brdf: Microfacet, direct: LightCoefficients, dual: DualLight | None) -> list[str]:
    """Sentences on what isn't determined, and on what isn't explained."""
    warnings = []
    lost = [str(l) for l, share in enumerate(direct.share_per_degree) if share < UNDETERMINED]
    if lost:
        reason = (
            "blurred away by the highlight, hidden by noise, or out of the photographs' view"
            if brdf.ks.any()
            else "a diffuse object hardly shows degrees above 2, and odd ones not at all"
        )
        warnings.append(f"Light of degree {', '.join(lost)} is undetermined: {reason}.")
    if dual is None:
        warnings.append("Without a specular part in each channel there is no mirrored light, so no dual map.")
    elif dual.coverage < 0.995:
        warnings.append(
            f"No reflection reaches {1 - dual.coverage:.0%} of all directions; there the dual map shows what the"
            " coefficients say, with their standard deviation."
        )
    if direct.structured > max(_STRUCTURED, 0.5 * direct.noise.relative):
        warnings.append(
            f"{direct.structured:.1%} of the radiance (RMS) is left unexplained and is correlated over parts of the"
            " photographs: light of higher degrees, such as lamps, or another BRDF. The error bars are widened by it."
        )
    return warnings


def _held_out_warnings(
    fitted: Sequence[tuple[str, float | None]], held_out: Sequence[tuple[str, float | None]]
) -> list[str]:
    """A sentence on the photographs that were held out and are explained far worse than those fitted."""
    usual = float(np.median([error for _, error in fitted if error is not None]))
    worse = [(label, error) for label, error in held_out if error is not None and error > _FAR_WORSE * usual]
    if not worse:
        return []
    worse.sort(key=lambda entry: -entry[1])
    named = some_of([f"{label} by {error:.1%} of its radiance" for label, error in worse], 8)
    return [
        f"Held-out photographs are off: {named}; up to {worse[0][1] / usual:.0f} times as much as what was fitted: the"
        " light is sharper than its degree, such as a lamp; raise --degree, or let `lightfactor process` find lamps."
    ]
