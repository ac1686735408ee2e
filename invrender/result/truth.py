"""The truth of a synthetic photo set as a side of a comparison: no errors, no fit."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.files.documents import read_json
from capture.files.tables import LenientTable
from capture.lighting import Lighting, read_latlong
from invrender.brdf.brushed import brushed
from invrender.brdf.form import LobeForm
from invrender.brdf.lobes import BECKMANN, GGX_FORM, PHONG, PLASTICS, RH01_FORM
from invrender.brdf.microfacet import Microfacet
from invrender.brdf.phong import phong_sigma
from invrender.result.side import Number, Side, SideLighting, TrueTextures

Floats = NDArray[np.float64]

TRUTH_NAME = "truth.json"
_WHAT = "a truth.json, as `lightfactor synth` writes it, holds brdf, lighting, photos and sensor"
_Triple = tuple[float, float, float]
# Models whose kd, ks, mu and width mean what those of a form of the lobe do.
_FORMS: dict[str, LobeForm] = {"microfacet": RH01_FORM, "smith": BECKMANN, "ggx": GGX_FORM, "phong": PHONG}


class _Brdf(LenientTable):
    model: str
    kd: _Triple
    ks: _Triple
    mu: Any = None
    sigma: float | None = None
    alpha: float | None = None
    alpha_x: float | None = None
    alpha_y: float | None = None
    exponent: float | None = None
    kd_map: str | None = None
    ks_map: str | None = None

    @property
    def width(self) -> float | None:
        """Sigma of the form that has this lobe, radians; None without one."""
        if self.exponent is not None:
            return phong_sigma(self.exponent) if self.exponent > 0 else None
        if self.alpha_x is not None and self.alpha_y is not None:
            return float(np.sqrt(self.alpha_x * self.alpha_y))
        return self.sigma if self.alpha is None else self.alpha

    @property
    def form(self) -> LobeForm | None:
        """The form of its lobe; None where there is none, or none like it."""
        if self.model == "plastic":
            return PLASTICS[BECKMANN if self.alpha is None else GGX_FORM]
        if self.alpha_x is not None and self.alpha_y is not None:
            # Along the parallels, as scenes are.
            return brushed(GGX_FORM, (0.0, 0.0, 1.0)).with_numbers({"stretch": self.alpha_x / self.alpha_y})
        return None if self.width is None else _FORMS.get(self.model)


class _Source(LenientTable):
    direction: _Triple
    irradiance: _Triple


class _Lamp(LenientTable):
    position: _Triple
    intensity: _Triple


class _TrueLighting(LenientTable):
    name: str
    map: str | None
    directional: tuple[_Source, ...]
    lamps: tuple[_Lamp, ...]
    mirror_ball: dict[str, Any] | None


class _Photo(LenientTable):
    file: str
    radiance: str


class _Object(LenientTable):
    centre: _Triple = (0.0, 0.0, 0.0)
    mesh: str | None = None


class _Sensor(LenientTable):
    radiance_factor: float = 1.0


class _Truth(LenientTable):
    brdf: _Brdf
    object: _Object = _Object()
    lighting: tuple[_TrueLighting, ...]
    photos: tuple[_Photo, ...]
    sensor: _Sensor


def is_truth(path: Path) -> bool:
    """Whether a path names a truth.json."""
    return path.is_file() and path.name == TRUTH_NAME


def truth_side(path: Path) -> Side:
    """The truth of a photo set as a side."""
    truth = read_json(path, _Truth, ("brdf", "lighting", "photos", "sensor"), _WHAT, ("object",))
    factor = truth.sensor.radiance_factor
    # Where the light was read off a ball, its photographs carry the sensor's unit into the light, not into Kd and Ks.
    of_ball = any(light.mirror_ball is not None for light in truth.lighting)
    of_brdf = 1.0 if of_ball else factor
    numbers, notes = _numbers(truth.brdf, of_brdf)
    if factor != 1:
        what = "the light" if of_ball else "Kd and Ks"
        notes.append(
            f"The camera's unit of radiance is {factor:.4g} times the scene's: {what} are multiplied by it."
        )
    textures = _true_textures(path.parent, truth, of_brdf)
    is_known = truth.brdf.form is not None or truth.brdf.model == "lambertian"
    pictures = {
        Path(photo.file).name: path.parent / photo.radiance
        for photo in truth.photos
        if (path.parent / photo.radiance).is_file()
    }
    return Side(
        title=str(path),
        is_absolute=True,
        numbers=numbers,
        lightings=tuple(
            _lighting(path, light, factor if of_ball else 1.0, truth.object.centre)
            for light in truth.lighting
        ),
        brdf=brdf_of(numbers, truth.brdf.form) if is_known and textures is None else None,
        form=truth.brdf.form,
        pictures=pictures,
        picture_factor=factor,
        notes=tuple(notes),
        textures=textures,
        material=truth.brdf.model,
        is_truth=True,
    )


def brdf_of(numbers: Mapping[str, Number], form: LobeForm | None) -> Microfacet:
    """The BRDF of a truth's numbers; without a form a Lambertian one."""
    values = {name: number.value for name, number in numbers.items()}
    kd, ks, mu, sigma = (values.get(name) for name in ("kd", "ks", "mu", "sigma"))
    assert kd is not None
    return Microfacet(
        kd,
        np.zeros(3) if ks is None else ks,
        None if mu is None else float(mu[0]),
        None if sigma is None else float(sigma[0]),
        form or RH01_FORM,
    )


def _true_textures(folder: Path, truth: _Truth, factor: float) -> TrueTextures | None:
    """Where the truth's textures lie; None where it has none."""
    brdf = truth.brdf
    if brdf.kd_map is None or brdf.ks_map is None or truth.object.mesh is None:
        return None
    return TrueTextures(folder / brdf.kd_map, folder / brdf.ks_map, folder / truth.object.mesh, factor)


def _numbers(brdf: _Brdf, factor: float) -> tuple[dict[str, Number], list[str]]:
    """The truth's numbers as far as they mean what a result's do, and sentences where they don't."""
    notes = []
    kd, ks = np.array(brdf.kd) * factor, np.array(brdf.ks) * factor
    numbers = {"kd": _exact(kd)}
    if brdf.form is None and brdf.model != "lambertian":
        notes.append(f"The truth's model is {brdf.model}: of its numbers only Kd means what a result's does.")
        return numbers, notes
    widths = {name: value for name in ("alpha_x", "alpha_y") if (value := getattr(brdf, name)) is not None}
    numbers |= {name: _exact(np.array([value])) for name, value in widths.items()}
    for named in ("alpha", "exponent"):
        if (value := getattr(brdf, named)) is not None:
            notes.append(f"The truth's sigma stands for its {named}, {value:g}, of the same highlight.")
    absent = Number(None, None, "not in its model")
    total = np.where(kd + ks > 0, kd + ks, 1.0)
    numbers |= {
        "ks": _exact(ks),
        "kd_normalised": _exact(kd / total),
        "ks_normalised": _exact(ks / total),
        "mu": absent if brdf.mu is None else _exact(np.array([float(brdf.mu)])),
        "sigma": absent if brdf.width is None else _exact(np.array([brdf.width])),
    }
    return numbers, notes


def _exact(value: Floats) -> Number:
    return Number(value, np.zeros_like(value))


def _lighting(path: Path, light: _TrueLighting, factor: float, centre: _Triple) -> SideLighting:
    """A lighting; of near lamps what the object's centre sees, and their closeness."""
    radiance = None if light.map is None else read_latlong(path.parent / light.map) * np.float32(factor)
    directions = [np.array(source.direction) for source in light.directional]
    irradiances = [np.array(source.irradiance) for source in light.directional]
    closeness = [0.0] * len(directions)
    for lamp in light.lamps:
        towards = np.array(lamp.position) - np.array(centre)
        directions.append(towards)
        irradiances.append(np.array(lamp.intensity) / (towards @ towards))
        closeness.append(float(1 / np.linalg.norm(towards)))
    lighting = Lighting(
        light.name,
        radiance,
        np.array(directions).reshape(-1, 3),
        factor * np.array(irradiances).reshape(-1, 3),
        closeness=np.array(closeness) if light.lamps else None,
        centre=np.array(centre),
    )
    return SideLighting(lighting, np.zeros_like(lighting.irradiances))
