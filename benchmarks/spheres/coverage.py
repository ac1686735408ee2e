"""Errors over many draws of the noise in their own standard deviations: their RMS, and how many 95% intervals hold.

Beside them, where `lightfactor plan` knows it, errors in units of the least that such noise allows [Cramer and Rao].
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.atlas.stage import expected
from benchmarks.kept import Kept
from benchmarks.spheres.bench import MATERIALS, area_coefficients, noisy, photographs, stage_of
from benchmarks.spheres.methods import LIGHT, source_z
from invrender.estimate.quantities import Quantity
from invrender.estimate.solution import factorize
from invrender.estimate.unknown_light import BlindSolution, factorize_blind
from invrender.transport.columns import all_columns
from invrender.transport.transfer import light_elements
from synthetic.materials.microfacet import MicrofacetMaterial

Floats = NDArray[np.float64]

_CHANNELS = "rgb"
_NINE = 9
# What the bound is known of, by its names and by ours.
_BOUNDED = {"Ks share": "ks_normalised g", "mu": "mu", "sigma": "sigma"}
_OF_BOUND = ", of the bound"
# Within which errors and intervals are as stated.
RMS_BAND, _COVERED = (0.8, 1.3), (0.90, 0.99)


def draw(kept: Kept, material: str, light: str, views: int, samples: int, draws: int) -> None:
    """Fit as many draws as are not kept yet; z per number, None where it is undetermined."""
    missing = [k for k in range(draws) if f"{k}" not in kept]
    if not missing:
        return
    clean = photographs(material, light == "known", views, samples)
    truth = MATERIALS[material]
    told = expected(stage_of(material, light == "known", views, samples))
    bounds = {label: told[name].std for name, label in _BOUNDED.items() if told[name].std}
    if light == "known":
        elements = light_elements(LIGHT)
        columns = all_columns([LIGHT.name] * len(clean), {LIGHT.name: elements}, clean)
        for k in missing:
            photos = [replace(c, field=f) for c, f in zip(columns, noisy(clean, k), strict=True)]
            kept[f"{k}"] = _z(factorize(photos, [LIGHT]).quantities, truth, bounds)
    else:
        for k in missing:
            solution = factorize_blind(noisy(clean, k))
            kept[f"{k}"] = _z(solution.quantities, truth, bounds) | _light_z(solution, truth)


def _z(
    quantities: Mapping[str, Quantity], truth: MicrofacetMaterial, bounds: Mapping[str, float]
) -> dict[str, float | None]:
    total = truth.kd + truth.ks
    true = {"kd": truth.kd, "ks": truth.ks, "ks_normalised": truth.ks / total}
    true |= {name: np.array([getattr(truth, name)]) for name in ("mu", "sigma") if getattr(truth, name)}
    z: dict[str, float | None] = {}
    for name, values in true.items():
        quantity = quantities.get(name)
        if quantity is None and name in ("kd", "ks"):
            continue
        for k, value in enumerate(values):
            label = name if len(values) == 1 else f"{name} {_CHANNELS[k]}"
            z[label] = None
            if quantity is not None and quantity.value is not None and quantity.std is not None:
                error = float(np.atleast_1d(quantity.value)[k] - value)
                z[label] = error / float(np.atleast_1d(quantity.std)[k])
                if label in bounds:
                    z[f"{label}{_OF_BOUND}"] = error / bounds[label]
    return z


def _light_z(solution: BlindSolution, truth: MicrofacetMaterial) -> dict[str, float | None]:
    """Of the source, and RMS of the first nine coefficients of the light without it."""
    # In this gauge the light is that in the photographs' unit times Kd + Ks.
    true = area_coefficients(2) * (truth.kd + truth.ks)
    off = (solution.light.coefficients[:_NINE] - true) / solution.light.coefficients_std[:_NINE]
    return {"source": source_z(solution), "light, RMS of nine": float(np.sqrt(np.mean(off**2)))}


def rms_and_covered(z: Floats) -> tuple[float, float]:
    """RMS of errors in their standard deviations (n,), and the share whose 95% interval holds the truth."""
    return float(np.sqrt(np.mean(z**2))), float((np.abs(z) < 1.96).mean())


def print_coverage(kept: Kept, title: str) -> None:
    """RMS, mean, share of 95% intervals that hold the truth, and how often there was no number."""
    entries = list(kept.values())
    if not entries:
        return
    print(
        f"\n{title}, {len(entries)} draws: errors in standard deviations; + within 0.8 to 1.3, and 90 to 99%"
    )
    for name in dict.fromkeys(name for entry in entries for name in entry):
        values = np.array([entry[name] for entry in entries if entry.get(name) is not None], float)
        if not len(values):
            print(f"{name:25} never determined")
            continue
        rms, covered = rms_and_covered(values)
        # Angles and means over several numbers are no normal variables: only their size can be looked at.
        if name.startswith(("light", "source")):
            line = f"{name:25} RMS {rms:5.2f}"
        elif name.endswith(_OF_BOUND):
            line = f"{name:25} RMS {rms:5.2f}{_mark(rms, RMS_BAND)}"
        else:
            line = (
                f"{name:25} RMS {rms:5.2f}{_mark(rms, RMS_BAND)}  mean {values.mean():+5.2f}"
                f"  95% intervals hold {covered:6.1%}{_mark(covered, _COVERED)}"
            )
        lost = len(entries) - len(values)
        print(line + (f"  undetermined in {lost}" if lost else ""))


def _mark(value: float, limits: tuple[float, float]) -> str:
    return "+" if limits[0] <= value <= limits[1] else "!"
