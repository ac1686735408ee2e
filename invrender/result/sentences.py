"""What a result says in a sentence, on the terminal and in reports."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from capture.polarisation import Extinction
from invrender.estimate.quantities import ReferenceScore
from invrender.wording import with_error


def filters_in_words(extinction: Extinction) -> str:
    """What filters pass, in a sentence."""
    if extinction.origin == "unused":
        return "Photographs were taken through parallel polarising filters, which double highlights beside the rest."
    percent = with_error(100 * extinction.value, 100 * extinction.std)
    told = {
        "given": f"pass {percent}% of highlights, as given",
        "found": f"pass {percent}% of highlights, as these photographs show",
        "free": "pass an unknown share of highlights: these photographs show none",
    }[extinction.origin]
    return f"Photographs were taken through polarising filters, of which crossed ones {told}."


def reference_in_words(score: ReferenceScore) -> str:
    """How well a reference says how much light there is, in a sentence."""
    words = {"reflectance": "its reflectance", "tilt": "its tilt", "evenness": "how evenly it is lit"}
    told = [f"{words[cause]} {std.mean():.1%}" for cause, std in score.stds.items() if std.mean() >= 5e-4]
    off = score.over_shown.mean() - 1
    way = "brighter" if off > 0 else "darker"
    differs = f"; by the result it would be {abs(off):.1%} {way} than it is" if abs(off) >= 5e-4 else ""
    return (
        f"{score.name[0].upper()}{score.name[1:]} says how bright the light is to {score.std.mean():.1%}"
        f" ({', '.join(told) or 'all that is known of it is exact'}){differs}."
    )


def errors_in_words(fit: Mapping[str, Any]) -> str:
    """How far predicted pictures are off, in a sentence; `fit` as result.json has it."""
    bright = fit["error_in_brightest_2_percent"]
    parts = [f"{fit['rms_relative']:.2%} in the photographs that were fitted"]
    if fit["cross_validated_rms_relative"] is not None:
        parts.append(f"{fit['cross_validated_rms_relative']:.2%} in each by a fit without it")
    if fit["held_out_rms_relative"] is not None:
        parts.append(f"{fit['held_out_rms_relative']:.2%} in those held out")
    seen = bright["held_out"] is None
    share, whose = (bright["fitted"], "fitted") if seen else (bright["held_out"], "held-out")
    return (
        f"Predicted pictures are off by {', '.join(parts)} (RMS over all unsaturated pixels of the object, relative to"
        f" the photograph's). In {whose} photographs {share:.0%} of the squared error lies in the brightest 2% of the"
        " pixels."
    )
