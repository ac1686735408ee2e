"""What the product makes of the real ball and the grey sphere, against truth, repeats and plain fits."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.gloss.peers import ball_pixels
from benchmarks.gloss.photosets import Lamps, write_photoset
from capture.photoset import load_photoset
from invrender.estimate.evidence import picture_error
from invrender.process.pipeline import process
from invrender.result.run import Run

Floats = NDArray[np.float64]

# The radius that the true normals have, pixels.
TRUE_RADIUS = 70.75


@dataclass(frozen=True, eq=False)
class Highlight:
    """The photograph with the worst highlight: photograph and prediction (h, w, 3), and its name."""

    name: str
    photo: Floats
    predicted: Floats


def measured_run(run: Run) -> tuple[dict[str, Any], Highlight]:
    """Errors of a run's pictures, as stated, and its worst highlight."""
    errors: dict[str, list[float]] = {"fitted": [], "held out": [], "brightest": []}
    worst, most = None, -1.0
    for prediction in run.predictions():
        error = prediction.error
        errors["held out" if prediction.photo.held_out else "fitted"].append(error.rms)
        errors["brightest"].append(error.brightest)
        if error.rms**2 * error.brightest > most:
            most = error.rms**2 * error.brightest
            inside = prediction.counted[..., None]
            worst = Highlight(
                prediction.photo.label,
                np.where(inside, prediction.observed.radiance, 0).astype(float),
                np.where(inside, prediction.predicted, 0).astype(float),
            )
    assert worst is not None
    return {name: float(np.mean(of)) if of else None for name, of in errors.items()}, worst


def seen_errors(run: Run, source: Path) -> dict[str, float]:
    """The same errors by the mask and the files alone, over every unsaturated pixel of the ball."""
    found: dict[str, list[float]] = {"fitted": [], "held out": []}
    for prediction in run.predictions():
        photo, mask, saturated = ball_pixels(source, Path(prediction.photo.label).stem)
        used = mask & ~saturated
        error = picture_error(photo[used], prediction.predicted[used].astype(float))
        found["held out" if prediction.photo.held_out else "fitted"].append(error.rms)
    return {name: float(np.mean(of)) for name, of in found.items() if of}


def run_ball(
    source: Path, fitted: Sequence[int], held_out: Sequence[int], samples: int, known: bool = True
) -> Run:
    """Process photographs of the ball, places in its lamps."""
    with tempfile.TemporaryDirectory() as folder:
        write_photoset(source, Path(folder), fitted, held_out, known)
        return process(load_photoset(Path(folder)), samples)


def numbers_of(run: Run) -> dict[str, Any]:
    """Value and standard deviation of a run's numbers, by name; None where undetermined."""
    return {
        name: None
        if quantity.value is None or quantity.std is None
        else [quantity.value.tolist(), quantity.std.tolist()]
        for name, quantity in run.solution.quantities.items()
    }


def repeats(runs: Sequence[dict[str, Any]]) -> dict[str, list[float]]:
    """Scatter of numbers over disjoint photographs, relative, and over their stated deviations, by name."""
    found = {}
    for name in ("kd", "ks", "sigma"):
        known = [numbers[name] for numbers in runs if numbers.get(name)]
        if len(known) > 1:
            values, std = (np.array([entry[place] for entry in known]) for place in (0, 1))
            scatter = values.std(axis=0, ddof=1)
            stated = np.sqrt((std**2).mean(axis=0))
            found[name] = [float((scatter / values.mean(axis=0)).mean()), float((scatter / stated).mean())]
    return found


def off_over_bar(runs: Sequence[dict[str, Any]], truth: Floats) -> float:
    """How far Kd is off from the true one (3,), over its stated deviation: RMS over runs and channels."""
    values, std = (np.array([numbers["kd"][place] for numbers in runs if numbers["kd"]]) for place in (0, 1))
    return float(np.sqrt(np.mean(((values - truth) / std) ** 2)))


def lamps_found(run: Run, lamps: Lamps, fitted: Sequence[int]) -> dict[str, Any]:
    """How many lamps unknown light has, and how far the nearest in each lighting is from the true one, degrees."""
    off, count = [], 0
    truth = {f"lamp {lamps.names[k]}": lamps.directions[k] for k in fitted}
    for entry in run.solution.lightings:
        directions = entry.lighting.directions
        if entry.lighting.name not in truth:
            continue
        count += len(directions)
        if len(directions):
            cos = np.clip(directions @ truth[entry.lighting.name], -1, 1)
            off.append(float(np.degrees(np.arccos(cos.max()))))
    return {
        "lamps": count,
        "true": len(truth),
        "off_deg": [float(np.median(off)), float(np.max(off))] if off else [],
    }
