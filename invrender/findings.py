"""What a user should know before using a result, in plain words."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting
from capture.photoset import PhotoSet
from capture.wording import some_of
from invrender.solve.evidence import MISFIT_REMEDY, outlying, relative_rms
from invrender.solve.factorize import Solution
from invrender.specimen import Specimen
from recon.bodies import SphereBody

Floats = NDArray[np.float64]

# Relative RMS on unseen photographs above which a warning is due; RH01 report 5 to 10% for real objects.
POOR = 0.12
# Share of what is left unexplained (RMS) that own factors of brightness must leave at most to be worth a warning.
_MENDED = 0.5
# Structured residual, and share of stray samples, above which a warning is due.
_STRUCTURED, _STRAYS = 0.005, 0.02
# Photographs or lightings that a warning names before it counts the rest.
_NAMED = 8


def find_warnings(
    photoset: PhotoSet, solution: Solution, specimen: Specimen, lightings: Mapping[str, Lighting]
) -> tuple[str, ...]:
    """Sentences on all that a user should know before using the numbers; empty if there is nothing."""
    warnings = list(specimen.warnings)
    rung = solution.rungs[solution.chosen]
    if rung.error > POOR:
        warnings.append(
            f"No model explains these photographs well: {rung.error:.0%} of the radiance (RMS) is left on unseen"
            f" photographs. Before using any number, {MISFIT_REMEDY}."
        )
    elif solution.structured > max(_STRUCTURED, 0.5 * solution.noise.relative):
        warnings.append(
            f"What is left unexplained is not only noise: {solution.structured:.1%} of the radiance (RMS) hangs"
            " together over parts of the photographs (a material that is none of the models, stains, a wrong black"
            " level or curve, light that isn't in the model). The error bars are widened by as much, since nothing"
            " tells in which direction it pulls."
        )
    strays = np.mean([np.mean(weights.trust < 1) for weights in solution.weights])
    if strays > _STRAYS:
        warnings.append(
            f"{strays:.1%} of the samples stray from the fit as noise does not, and count for less; look at the"
            " difference pictures."
        )
    fitted = [photo for photo in photoset.photos if not photo.held_out]
    usual = float(np.median(rung.photo_errors))
    worse = {
        photo.label: error
        for photo, wrong, error in zip(fitted, outlying(rung.photo_errors), rung.photo_errors, strict=True)
        if wrong
    }
    warnings += [] if not worse else [_far_worse(worse, usual)]
    body = specimen.body
    outlines = body.sphere.residual_px if isinstance(body, SphereBody) else ()
    if max(outlines, default=0) > 0.6:
        warnings.append(
            f"The masks' outlines stray up to {max(outlines):.1f} px from the sphere; normals near the rim are"
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
    albedo = solution.quantities.get("albedo")
    if albedo is not None and albedo.value is not None and (albedo.value > 1).any():
        warnings.append(
            f"The albedo is {np.round(albedo.value, 2).tolist()}, more than 1: photographs and lighting are not in"
            " the same unit of radiance, so only the ratios of Kd and Ks are meaningful."
        )
    return tuple(warnings)


def _far_worse(errors: Mapping[str, float], usual: float) -> str:
    """A sentence on photographs with their errors by label; usual : the median of all."""
    worst = sorted(errors, key=lambda label: -errors[label])
    if len(worst) == 1:
        return (
            f"{worst[0]} is explained far worse than the others (RMS {errors[worst[0]]:.1%}, median {usual:.1%}) and"
            " counts for less: check its pose, light and mask."
        )
    named = some_of([f"{label} {errors[label]:.1%}" for label in worst], _NAMED)
    return (
        f"{len(worst)} photographs are explained far worse than the others (RMS, median {usual:.1%}) and count for"
        f" less: {named}. Check their poses, lights and masks."
    )


def brightness_warning(
    exposure: str, observed: Mapping[str, Floats], residuals: Mapping[str, Floats]
) -> str | None:
    """A sentence if most of what is left unexplained is that photographs as a whole are too bright or too dark.

    exposure : how the set says its photographs were exposed. observed, residuals : (n, 3) of each fitted photograph's
    samples, by its label.
    """
    factors, left, before = {}, [], []
    for label, radiance in observed.items():
        predicted = radiance - residuals[label]
        power = float((predicted**2).sum())
        factors[label] = float((radiance * predicted).sum()) / power if power > 0 else 1.0
        before.append(relative_rms(residuals[label], radiance))
        left.append(relative_rms(radiance - factors[label] * predicted, radiance))
    if np.mean(left) > _MENDED * np.mean(before):
        return None
    least, most = (choose(factors, key=factors.__getitem__) for choose in (min, max))
    return (
        f"Most of what is left unexplained is brightness: photographs are {factors[least]:.2f} ({least}) to"
        f" {factors[most]:.2f} ({most}) times as bright as the fit has them, and with these factors"
        f" {np.mean(left):.1%} of the radiance (RMS) would be left instead of {np.mean(before):.1%}. Check [radiometry]"
        f" exposure (now {exposure!r}), the photographs' exposures, and the strengths of their lights."
    )
