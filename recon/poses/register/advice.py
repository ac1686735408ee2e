"""Advice for a photographer whose photographs could not be placed, or not all of them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from capture.photoset import PhotoSet
from capture.wording import some_of
from recon.poses.register.features import Matches

_REMEDY = (
    "Shiny or untextured objects show too few features that stay in place. Let a textured backdrop, printed paper for"
    " one, move with the object and register with --whole-image; or put a charuco board beside it (`lightfactor board`"
    " prints one) and register with --board; or give gantry angles in the manifest;"
    " or, where there is texture, take photos at smaller steps, 10 to 15 degrees apart"
)
# Features of a photograph that are few, and the share of matching pairs that are.
_FEW_FEATURES = 100
# Patches in reflections match each other well, but agree with nothing at rest: by how many of their standard
# deviations features are off beyond which that is in doubt, and beyond which poses mean nothing if features are also so
# many pixels off, and so large a share of a picture's width. Bodies at rest were 0.5 to 1.1 off, also glossy ones; a
# mirror ball 16 to 24 and 0.8 to 2 px, its poses being wrong by tens of degrees.
_DOUBTFUL, _UNSTEADY, _UNSTEADY_PX, _UNSTEADY_SHARE = 4.0, 8.0, 0.5, 1e-4
# Share of matching pairs without parallax from which on the camera did not move.
_STILL = 0.8


def nothing_matches(photoset: PhotoSet, matches: Matches, masked: bool) -> str:
    """Why no structure was found, what was seen, and what to do."""
    count = len(photoset.photos)
    pairs = count * (count - 1) // 2
    where = "within the masks" if masked else "in the whole pictures"
    middle = int(np.median(matches.keypoints))
    seen = (
        f"the median photo has {middle} features {where}, and {len(matches.pairs)} of {pairs} pairs of photos match"
        + (f" (median {int(np.median(matches.inliers))} features)" if len(matches.pairs) else "")
    )
    start = f"the photos could not be placed by their features: {seen}. "
    if len(matches.pairs) and matches.still.mean() >= _STILL:
        return (
            f"{start}What matches shows no parallax: all photos seem to be taken from one place, or to show the same"
            " view. Move the camera around the object, or turn object and backdrop together before it"
        )
    if masked and middle < _FEW_FEATURES:
        return f"{start}{_REMEDY}"
    if len(matches.pairs) >= count - 1:
        backdrop = "" if masked else ", or register with --masked where the object turned before a backdrop"
        return (
            f"{start}What matches agrees with no single object at rest: check the camera's parameters, and that nothing"
            f" but camera moved{backdrop}. {_REMEDY}"
        )
    return f"{start}{_REMEDY}"


def unsteady(disagreement: float, rms_px: float, width: int) -> str | None:
    """None if features agree with points at rest as well as they match each other; otherwise a warning.

    disagreement : as in `Structure`. rms_px : of features from their points. width : of the pictures.
    ValueError where the poses mean nothing.
    """
    if disagreement <= _DOUBTFUL:
        return None
    sentence = (
        f"features lie {rms_px:.2f} px (RMS) from where points at rest would be seen, {disagreement:.0f} times as far"
        " as they match each other: they are reflections, which move over the object, or the camera's parameters are"
        " wrong"
    )
    if disagreement > _UNSTEADY and rms_px > max(_UNSTEADY_PX, _UNSTEADY_SHARE * width):
        raise ValueError(f"the photos could not be placed by their features: {sentence}. {_REMEDY}")
    return sentence


def some_missing(photoset: PhotoSet, reasons: Mapping[int, str], placed: int) -> str:
    """A warning that names photographs without a pose."""
    names = [photoset.photos[place].label for place in sorted(reasons)]
    shown = some_of(names)
    first = min(reasons)
    return (
        f"{len(names)} of {placed + len(names)} photos have no pose: {shown}; {photoset.photos[first].label}:"
        f" {reasons[first]}. Take them out of the manifest, give them world_to_camera there, or take photos between"
    )
