"""What to tell a photographer whose photographs could not be placed, or not all of them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from capture.photoset import PhotoSet
from recon.register.features import Matches

_REMEDY = (
    "Shiny or untextured objects show too few features that stay in place. Let a textured backdrop, printed paper for"
    " one, move with the object and register with --whole-image; or put a charuco board beside it (`lightfactor board`"
    " prints one) and register with --board; or give gantry angles in the manifest"
)
# Features of a photograph that are few, and the share of matching pairs that are.
_FEW_FEATURES = 100
# RMS distance of features from their points beyond which they don't stay in place, and beyond which that is in doubt:
# pixels, and the same for large pictures as a share of their width. Honest ones reach a tenth of a pixel or so.
_UNSTEADY, _DOUBTFUL = (1.0, 8e-4), (0.5, 4e-4)
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
        return (
            f"{start}What matches agrees with no single object at rest: check the camera's parameters, and that nothing"
            f" but camera moved, or register with --masked where the object turned before a backdrop. {_REMEDY}"
        )
    return f"{start}{_REMEDY}; or take photos at smaller steps, 10 to 15 degrees apart"


def unsteady(rms_px: float, width: int) -> str | None:
    """None if features lie as close to their points as they should, RMS in pictures of that width; otherwise a warning.

    ValueError where they lie so far off that the poses mean nothing.
    """
    for (pixels, share), hopeless in ((_UNSTEADY, True), (_DOUBTFUL, False)):
        if rms_px > max(pixels, share * width):
            sentence = (
                f"features lie {rms_px:.2f} px (RMS) from where points at rest would be seen: they are reflections,"
                " which move over the object, or the camera's parameters are wrong"
            )
            if hopeless:
                raise ValueError(f"the photos could not be placed by their features: {sentence}. {_REMEDY}")
            return sentence
    return None


def some_missing(photoset: PhotoSet, reasons: Mapping[int, str], placed: int) -> str:
    """A warning that names photographs without a pose."""
    names = [photoset.photos[place].label for place in sorted(reasons)]
    shown = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
    first = min(reasons)
    return (
        f"{len(names)} of {placed + len(names)} photos have no pose: {shown}; {photoset.photos[first].label}:"
        f" {reasons[first]}. Take them out of the manifest, give them world_to_camera there, or take photos between"
    )
