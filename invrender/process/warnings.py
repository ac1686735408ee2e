"""What a user should know before using a result, in plain words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from capture.lighting import Lighting
from capture.photoset import PhotoSet
from capture.wording import some_of
from invrender.diagnostics.named import NamedCause
from invrender.estimate.evidence import MISFIT_REMEDY, outlying
from invrender.estimate.quantities import CALIBRATION
from invrender.estimate.solution import Solution
from invrender.observation.geometry import SceneGeometry
from recon.mesh.bodies import SphereBody

# Relative RMS on unseen photographs above which a warning is due; RH01 report 5 to 10% for real objects.
POOR = 0.12
NO_CAUSE = (
    "No single cause stands out: it may be a material that is none of the models, light that isn't in the model, or"
    " several faults at once."
)
# Structured residual, and share of outliers, above which a warning is due.
_STRUCTURED, _OUTLIERS = 0.005, 0.02
# With fewer photographs, what a fit to the others misses may be their number's fault as well as the model's.
_FEW = 5
# Photographs or lightings that a warning names before it counts the rest.
_NAMED = 8
# What crossed filters may pass of highlights before something is wrong with them.
_HARDLY_CROSSED = 0.15


def find_warnings(
    photoset: PhotoSet,
    solution: Solution,
    geometry: SceneGeometry,
    lightings: Mapping[str, Lighting],
    causes: Sequence[NamedCause] = (),
    published: bool = False,
) -> tuple[str, ...]:
    """Sentences on all that a user should know before using the numbers; empty if there is nothing.

    causes : of what the solution leaves, the best supported first. published : whether it is a published procedure's,
    which may fail on photographs without a fault.
    """
    warnings = [*geometry.warnings, *(cause.text for cause in causes)]
    numbers = solution.quantities.values()
    if photoset.errors.stated and not any(number.shares.keys() & CALIBRATION.keys() for number in numbers):
        warnings.append(
            "Error bars don't hold what [uncertainty] states: `process` carries it, but not with --published, nor for a"
            " texture under unknown light."
        )
    candidate = solution.model
    if candidate.error > POOR and published:
        warnings.append(
            f"The published procedure leaves {candidate.error:.0%} of the radiance (RMS) on photographs that it has not"
            " seen; a lamp's highlights are where it is off most. Leave out --published to see whether another model"
            " explains the photographs."
        )
    elif candidate.error > POOR:
        remedy = "see to its cause" if causes else MISFIT_REMEDY
        count = len(photoset.fitted)
        too_few, more = (
            (f", or {count} are too few to settle it", "take more photographs, or ")
            if count < _FEW
            else ("", "")
        )
        warnings.append(
            f"No model explains these photographs well{too_few}: {candidate.error:.0%} of the radiance (RMS) is left on"
            f" unseen photographs. Before using any number, {more}{remedy}."
        )
    elif solution.structured > max(_STRUCTURED, 0.5 * solution.noise.relative):
        unknown = "" if causes else f" {NO_CAUSE}"
        warnings.append(
            f"What is left unexplained is not only noise: {solution.structured:.1%} of the radiance (RMS) is"
            f" correlated over parts of the photographs.{unknown} The error bars hold what it moves between"
            " photographs, and between forms of the lobe."
        )
    outliers = np.mean([np.mean(weights.trust < 1) for weights in solution.weights])
    if outliers > _OUTLIERS:
        warnings.append(
            f"{outliers:.1%} of the samples lie farther from the fit than noise explains, and count for less; look at"
            " the difference pictures."
        )
    fitted = photoset.fitted
    usual = float(np.median(candidate.photo_errors))
    worse = {
        photo.label: error
        for photo, wrong, error in zip(
            fitted, outlying(candidate.photo_errors), candidate.photo_errors, strict=True
        )
        if wrong
    }
    warnings += [] if not worse else [_far_worse(worse, usual, photoset.extinction is not None)]
    body = geometry.body
    outlines = body.sphere.residual_px if isinstance(body, SphereBody) else ()
    if max(outlines, default=0) > 0.6:
        warnings.append(
            f"The masks' outlines deviate up to {max(outlines):.1f} px from the sphere; normals near the rim are"
            " uncertain by as much. If masks are better than that, check the poses, the camera's focal length, and"
            " [object] centre and radius where they are given."
        )
    said: dict[str, list[str]] = {}
    for table in photoset.lightings:
        lighting = lightings.get(table.name)
        for text in () if lighting is None else lighting.warnings:
            said.setdefault(f"{text}.", []).append(repr(table.name))
        if lighting is not None and table.mirror_ball and table.recover is None and lighting.recovers:
            text = (
                "the highlight on the mirror ball is saturated, so its direction is used"
                f" but {' and '.join(lighting.recovers)} are fitted; expose the ball shorter to measure them."
            )
            said.setdefault(text, []).append(repr(table.name))
    warnings += [f"Lighting {some_of(names, _NAMED)}: {text}" for text, names in said.items()]
    negative = [
        repr(fitted.lighting.name)
        for fitted in solution.lightings
        if fitted.ambient is not None
        and fitted.ambient_std is not None
        and (fitted.ambient < -3 * fitted.ambient_std).any()
    ]
    if negative:
        warnings.append(
            f"The recovered ambient is negative beyond its error in {some_of(negative, _NAMED)}: the source,"
            " the pose or the black level is not what the model takes it for."
        )
    filters = photoset.extinction
    if filters is not None and filters.origin == "found" and filters.value > _HARDLY_CROSSED:
        warnings.append(
            f"Crossed filters pass {filters.value:.0%} of the highlights that parallel ones do; a good pair passes 2%"
            " or less. Were they turned fully across, has every lamp its filter, is each photograph called what it is?"
        )
    albedo = solution.quantities.get("albedo")
    if albedo is not None and albedo.value is not None and (albedo.value > 1).any():
        warnings.append(
            f"The albedo is {np.round(albedo.value, 2).tolist()}, more than 1: photographs and lighting are not in"
            " the same unit of radiance, so only the ratios of Kd and Ks are meaningful."
        )
    return tuple(warnings)


def _far_worse(errors: Mapping[str, float], usual: float, filtered: bool) -> str:
    """A sentence on photographs with their errors by label; usual : the median of all. filtered : by polarisers."""
    exchanged = " Were the two of a pair exchanged?" if filtered else ""
    worst = sorted(errors, key=lambda label: -errors[label])
    if len(worst) == 1:
        return (
            f"{worst[0]} is explained far worse than the others (RMS {errors[worst[0]]:.1%}, median {usual:.1%}) and"
            f" counts for less: check its pose, light and mask.{exchanged}"
        )
    named = some_of([f"{label} {errors[label]:.1%}" for label in worst], _NAMED)
    return (
        f"{len(worst)} photographs are explained far worse than the others (RMS, median {usual:.1%}) and count for"
        f" less: {named}. Check their poses, lights and masks.{exchanged}"
    )
