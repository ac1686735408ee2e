"""One side of a comparison: what a result, or the truth, says of BRDF, light and photographs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting
from invrender.brdf.form import LobeForm
from invrender.brdf.microfacet import Microfacet
from invrender.result.reflectance import reflectance
from invrender.result.saved import SavedQuantity, SavedResult

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Number:
    """A number, or one per channel, with its standard deviation.

    value, std : (k,), k = 1 or 3; None where there is none. absence : why, in words to follow "is".
    """

    value: Floats | None
    std: Floats | None
    absence: str = ""


@dataclass(frozen=True, eq=False)
class SideLighting:
    """A lighting and how well its sources are known.

    irradiance_std : (k, 3), 0 where given, NaN where unknown.
    """

    lighting: Lighting
    irradiance_std: Floats


@dataclass(frozen=True, eq=False)
class TrueTextures:
    """Files of the true Kd and Ks over a surface. mesh : whose texture coordinates the maps lie on.

    factor : what their values are to be multiplied by.
    """

    kd_map: Path
    ks_map: Path
    mesh: Path
    factor: float


@dataclass(frozen=True, eq=False)
class Side:
    """What is compared.

    title : the file that it was read from. is_absolute : whether Kd and Ks are in the light's own scale.
    numbers : "kd", "ks", "mu", "sigma", "kd_normalised", "ks_normalised", "alpha_x", "alpha_y"; a name may be missing.
    brdf : for pictures, None where it is not fully known or of another model. form : of its lobe, None where it has
    none, or another.
    photo_errors : relative RMS by photograph, NaN where none is known; held_out : those never fitted.
    pictures : predicted (or true) photographs, EXR; picture_factor : what their radiance is to be multiplied by.
    inputs : hashes of what it was made from. notes : sentences.
    textures : what holds Kd and Ks where they vary over the surface; the numbers are then means.
    is_truth : as said; material : then the name of its model.
    """

    title: str
    is_absolute: bool
    numbers: Mapping[str, Number]
    lightings: tuple[SideLighting, ...]
    brdf: Microfacet | None
    pictures: Mapping[str, Path]
    form: LobeForm | None = None
    photo_errors: Mapping[str, float] = field(default_factory=dict)
    held_out: frozenset[str] = frozenset()
    picture_factor: float = 1.0
    inputs: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    textures: SavedResult | TrueTextures | None = None
    is_truth: bool = False
    material: str = ""


def result_side(result: SavedResult) -> Side:
    """A result as a side."""
    content, brdf = result.content, result.content.brdf
    saved = {
        "kd": brdf.kd,
        "ks": brdf.ks,
        "mu": brdf.mu,
        "sigma": brdf.sigma,
        "kd_normalised": brdf.normalised.kd,
        "ks_normalised": brdf.normalised.ks,
        **{name: own for name, own in brdf.form_numbers.items() if name in ("alpha_x", "alpha_y")},
    }
    known = all(quantity is None or quantity.value is not None for quantity in saved.values())
    return Side(
        title=str(result.path),
        is_absolute=result.is_absolute,
        numbers={name: _number(quantity) for name, quantity in saved.items()},
        lightings=tuple(
            SideLighting(result.read_lighting(entry), entry.irradiance_std) for entry in content.lighting
        ),
        brdf=reflectance(result, {}).brdf if known else None,
        pictures=_predicted(result),
        form=None if brdf.sigma is None else brdf.form,
        photo_errors={photo.file: photo.rms_relative for photo in content.photos},
        held_out=frozenset(photo.file for photo in content.photos if photo.held_out),
        inputs=content.inputs,
        textures=None if content.texture is None else result,
    )


def _number(quantity: SavedQuantity | None) -> Number:
    if quantity is None:
        return Number(None, None, "not in its model")
    if quantity.value is None:
        return Number(None, None, "undetermined")
    if quantity.std is None:
        return Number(None, None, "without a standard deviation")
    return Number(np.atleast_1d(quantity.value), np.atleast_1d(quantity.std))


def _predicted(result: SavedResult) -> dict[str, Path]:
    """Predictions by the names of their photographs; where two of those differ in their ending only, it is kept."""
    found = {}
    for photo in result.content.photos:
        whole = result.folder / "predicted" / f"{photo.file.replace('/', '_')}.exr"
        short = whole.with_suffix("").with_suffix(".exr")
        path = whole if whole.is_file() else short
        if path.is_file():
            found[photo.file] = path
    return found
