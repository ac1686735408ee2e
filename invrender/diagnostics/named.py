"""What a diagnosis found, in words, and with what a picture of it needs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import Axis
from invrender.diagnostics.cause import CauseFit
from invrender.diagnostics.diagnosis import Diagnosis
from invrender.diagnostics.remainder import Remainders

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Radii of the object to a lamp from which on parallel light is off by less than 2%.
_FAR = 50
# Powers of radiance that files have which are encoded as sRGB, near enough; and their inverses.
_ENCODED, _DECODED = (0.33, 0.62), (1.6, 2.9)
# Cosine between axes that are one.
_ONE_AXIS = 0.9998
_ALIKE = {
    "near lamp": "a near lamp",
    "curve": "a wrong encoding",
    "offset": "a constant that is added",
    "lobe": "another form of highlights",
    "shading": "shading that isn't Lambert's",
    "place": "an object that lies elsewhere",
    "brightness": "photographs of other brightness",
    "direction": "light from elsewhere",
    "pose": "wrong poses",
    "stains": "stains",
}


@dataclass(frozen=True, eq=False)
class NamedCause:
    """A cause of what a fit leaves.

    name : its key. text : sentences on it. share : of what is left beyond noise, 0 to 1. numbers : how much, as its key
    has it. photo : label of the photograph that shows it best. rows, columns : (n,), of samples of that photograph.
    difference, explained : (n,) photograph less prediction, and what of it the causes named so far explain; means of
    channels.
    """

    name: str
    text: str
    share: float
    numbers: Floats
    photo: str
    rows: Ints
    columns: Ints
    difference: Floats
    explained: Floats


def named_causes(
    diagnosis: Diagnosis | None, exposure: str, brushing_axis: Axis | None = None
) -> tuple[NamedCause, ...]:
    """The findings of a diagnosis, the best first; exposure : how the set says its photographs were exposed.

    brushing_axis : about which brushed lobes were tried; None where none were.
    """
    if diagnosis is None:
        return ()
    found = []
    for place, finding in enumerate(diagnosis.findings):
        photo = diagnosis.scene.photos[finding.photo]
        what, remedy = _said(diagnosis.scene, finding.fit, exposure, brushing_axis)
        rest = "what is left unexplained" if place == 0 else "the rest"
        amount = f" ({diagnosis.unexplained:.1%} of the radiance, RMS, beyond noise)" if place == 0 else ""
        text = (
            f"{what}: this accounts for {finding.share:.0%} of {rest}{amount}; {photo.label} shows it best."
        )
        if finding.alike:
            others = " or ".join(dict.fromkeys(_alike(name) for name in finding.alike))
            text += f" These photographs hardly distinguish it from {others}."
        found.append(
            NamedCause(
                name=finding.fit.cause.name,
                text=f"{text} {remedy}",
                share=finding.share,
                numbers=finding.fit.numbers,
                photo=photo.label,
                rows=photo.field.rows,
                columns=photo.field.columns,
                difference=photo.residual.mean(axis=1),
                explained=(photo.residual - finding.fit.left[finding.photo]).mean(axis=1),
            )
        )
    return tuple(found)


def _alike(name: str) -> str:
    return _ALIKE.get(name, "highlights drawn out otherwise")


def _said(scene: Remainders, fit: CauseFit, exposure: str, brushing_axis: Axis | None) -> tuple[str, str]:
    """What is wrong, without a full stop, and what to do."""
    if fit.cause.name == "brightness":
        return _brightness(scene, fit, exposure)
    if fit.cause.name.startswith("brushed"):
        return _brushed(fit, brushing_axis)
    return _WORDS[fit.cause.name](scene, fit)


def _near_lamp(scene: Remainders, fit: CauseFit) -> tuple[str, str]:
    radii = 1 / float(fit.numbers[0])
    return (
        f"The lamps seem to be near, about {radii:.3g} radii of the object ({radii * scene.radius:.3g} m) from its"
        " centre, but the model takes their light for parallel",
        f"Put them {_FAR} radii away, photograph a smaller object, or give their places as `near`.",
    )


def _brushed(fit: CauseFit, tried: Axis | None) -> tuple[str, str]:
    stretch, axis = float(fit.numbers[0]), fit.cause.name[-1].upper()
    about = np.eye(3)["XYZ".index(axis)]
    remedy = "sigma is a mean of two widths; don't relight with it."
    if tried is None:
        remedy = f"None of the models is anisotropic: {remedy}"
    elif abs(about @ np.array(tried)) < _ONE_AXIS:
        remedy = f"No model is brushed about that axis: {remedy} Give brushed_about = {about.tolist()} in [object]."
    else:
        remedy = f"A brushed lobe doesn't predict unseen photographs better: {remedy}"
    along, across = f"along circles about the world's {axis} axis", "across them"
    if stretch < 0:
        along, across = f"across circles about the world's {axis} axis", "along them"
    return (
        f"Highlights are drawn out along one tangent, {np.exp(abs(stretch)):.2g} times as wide {along} as {across}, as"
        " of brushed metal",
        remedy,
    )


def _curve(_: Remainders, fit: CauseFit) -> tuple[str, str]:
    power = 1 + float(fit.numbers[0])
    hint = ""
    if _ENCODED[0] < power < _ENCODED[1]:
        hint = ' Files that are encoded as sRGB but read as linear look like that: try encoding = "srgb".'
    if _DECODED[0] < power < _DECODED[1]:
        hint = ' Linear files that are read as sRGB look like that: try encoding = "linear".'
    return (
        f"Photographs seem to hold not radiance but about its power {power:.2f} (at the usual brightness)",
        f"Check [radiometry] encoding and the camera's response.{hint}",
    )


def _offset(scene: Remainders, fit: CauseFit) -> tuple[str, str]:
    mean = np.mean([photo.field.radiance.mean(axis=0) for photo in scene.photos], axis=0)
    shares = ", ".join(f"{share:+.2%}" for share in fit.numbers / np.maximum(mean, 1e-30))
    values = ", ".join(f"{value:.3g}" for value in fit.numbers)
    lacks = fit.numbers.sum() < 0
    return (
        f"The same radiance seems to be {'missing' if lacks else 'added'} everywhere, in shadows too: {values} (red,"
        f" green, blue; {shares} of the mean)",
        "Check the black level: is it subtracted twice?"
        if lacks
        else "Check the black level, stray light and glare in the lens.",
    )


def _lobe(scene: Remainders, fit: CauseFit) -> tuple[str, str]:
    return (
        f"Highlights have another form than any of the models' lobes: it moves {_relative(scene, fit):.1%} of the"
        " radiance (RMS), the same in all photographs",
        "Ks and sigma describe the nearest of the models' lobes.",
    )


def _shading(scene: Remainders, fit: CauseFit) -> tuple[str, str]:
    return (
        f"Shading isn't Lambert's: towards grazing light and views it differs, by {_relative(scene, fit):.1%} of the"
        " radiance (RMS), the same in all photographs",
        "Rough, porous and translucent materials shade like that, and none of the models does; or is the light not what"
        " it is given as?",
    )


def _place(scene: Remainders, fit: CauseFit) -> tuple[str, str]:
    shift = ", ".join(f"{value:.2g}" for value in scene.radius * fit.numbers)
    return (
        f"The object seems to lie elsewhere, by [{shift}] m ({np.linalg.norm(fit.numbers):.1%} of its radius)",
        "Check [object] (centre, or mesh_to_world), the masks, and the poses.",
    )


def _brightness(scene: Remainders, fit: CauseFit, exposure: str) -> tuple[str, str]:
    factors = {photo.label: 1 + float(own) for photo, own in zip(scene.photos, fit.numbers, strict=True)}
    least, most = (choose(factors, key=factors.__getitem__) for choose in (min, max))
    return (
        f"Most of what is left unexplained is brightness: photographs are {factors[least]:.2f} ({least}) to"
        f" {factors[most]:.2f} ({most}) times as bright as the fit has them",
        f"Check [radiometry] exposure (now {exposure!r}), the photographs' exposures, and the strengths of their"
        " lights.",
    )


def _direction(scene: Remainders, fit: CauseFit) -> tuple[str, str]:
    angles = {}
    for k, photo in enumerate(scene.photos):
        turns = fit.numbers[fit.cause.touches[k]].reshape(-1, 2)
        if len(turns):
            angles[photo.lighting] = float(np.degrees(np.linalg.norm(turns, axis=1).max()))
    worst = sorted(angles, key=angles.__getitem__, reverse=True)[:3]
    listed = ", ".join(f"{name!r} {angles[name]:.1f}" for name in worst)
    usual = (
        f"; the median of {len(angles)} is {np.median(list(angles.values())):.1f}" if len(angles) > 3 else ""
    )
    return (
        f"Light seems to come from elsewhere than it is given, by these degrees: {listed}{usual}",
        "Check these directions, or photograph a mirror ball in their light.",
    )


def _pose(scene: Remainders, fit: CauseFit) -> tuple[str, str]:
    shifts = {}
    for k, photo in enumerate(scene.photos):
        shifts[photo.label] = float(np.linalg.norm(fit.numbers[fit.cause.touches[k]])) * scene.radius
    worst = sorted(shifts, key=shifts.__getitem__, reverse=True)[:3]
    listed = ", ".join(f"{label} {shifts[label]:.2g} m" for label in worst)
    return (
        f"The object seems to lie elsewhere before each camera: {listed}; the median of {len(shifts)} is"
        f" {np.median(list(shifts.values())):.2g} m",
        "Check the poses, or refine them (lightfactor refine).",
    )


def _stains(scene: Remainders, fit: CauseFit) -> tuple[str, str]:
    return (
        f"The albedo varies by {fit.numbers.std():.0%} (RMS) from place to place, the same in"
        " all photographs",
        "Recover a texture ([object] texture = true, of a mesh), or mask stains.",
    )


def _relative(scene: Remainders, fit: CauseFit) -> float:
    """RMS of a cause's radiance over that of all photographs."""
    own = sum(float((pattern**2).sum()) for pattern in fit.pattern)
    return float(np.sqrt(own / sum(float((photo.field.radiance**2).sum()) for photo in scene.photos)))


_WORDS: Mapping[str, Callable[[Remainders, CauseFit], tuple[str, str]]] = {
    "near lamp": _near_lamp,
    "curve": _curve,
    "offset": _offset,
    "lobe": _lobe,
    "shading": _shading,
    "place": _place,
    "direction": _direction,
    "pose": _pose,
    "stains": _stains,
}
