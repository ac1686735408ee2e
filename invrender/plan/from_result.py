"""A result as an experiment to plan: its object, light, cameras and noise, and what one photograph more would bring."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from capture.decode import decode_photo
from capture.photo import Photo
from capture.photoset import PhotoSet
from capture.progress import Track, silent
from invrender.brdf.lobes import RH01_FORM
from invrender.brdf.microfacet import Microfacet
from invrender.observation.sphere_place import found_of_sphere
from invrender.plan.experiment import (
    BOUNCES_NOTE,
    INTERFACE_NOTE,
    MEANS_NOTE,
    Experiment,
    PlannedLight,
    PlannedView,
)
from invrender.result.reflectance import reflectance
from invrender.result.saved import SavedResult
from invrender.result.source_set import find_photoset, scanned_mesh
from recon.mesh.bodies import Body, MeshBody, SphereBody
from recon.mesh.shape import placed
from recon.sampling.find import check_unfiltered
from recon.sphere.sphere import Sphere

Floats = NDArray[np.float64]

# Photographs, and pixels of each, by which noise is learnt; levels of radiance between which it is interpolated.
_PHOTOS, _PIXELS, _LEVELS = 8, 4000, 24
# What stands for an index or a roughness that the photographs leave open.
_OPEN = {"mu": 1.5, "sigma": 0.2}


def result_experiment(
    result: SavedResult, photoset: Path | None = None, known: bool | None = None, track: Track = silent
) -> Experiment:
    """What is to be planned of a result: its fitted photographs, taken as they were.

    photoset : the set that the result was made from, looked for around it if None. known : whether a set gives the
    light, in place of what its manifest says. ValueError where the set isn't there, and for brushed lobes.
    """
    content = result.content
    if content.brdf.form.axis is not None:
        raise ValueError(
            f"{result.path}: its lobe is brushed, with two roughnesses, and a plan is for one; none can be made of it"
        )
    of = find_photoset(result, photoset)
    if of is None:
        raise ValueError(
            f"{result.path}: the photo set that it was made from isn't beside it, and a plan needs its cameras: name"
            " its folder with --set"
        )
    check_unfiltered(of)
    quantities = {name: getattr(content.brdf, name) for name in _OPEN}
    undetermined = [name for name, found in quantities.items() if found is not None and found.value is None]
    assumed = {name: _OPEN[name] for name in undetermined}
    brdf = reflectance(result, assumed, means=content.texture is not None).brdf
    notes = [f"{name} is undetermined, and planned as if it were {_OPEN[name]:g}" for name in undetermined]
    if brdf.form != RH01_FORM and brdf.sigma is not None:
        notes.append(f"the lobe, {brdf.form.description}, is planned as RH01's: same Kd, Ks, sigma and mu")
    if brdf.form.interface:
        notes.append(INTERFACE_NOTE)
    if content.texture is not None:
        notes.append(MEANS_NOTE)
    if content.interreflection is not None:
        notes.append(BOUNCES_NOTE)
    fitted = {photo.file for photo in content.photos if not photo.held_out}
    shot = [photo for photo in of.photos if photo.label in fitted]
    used = sorted({photo.lighting for photo in shot})
    given = {table.name: not table.unknown for table in of.lightings}
    lights = tuple(
        PlannedLight(result.read_lighting(result.lighting(name)), given[name] if known is None else known)
        for name in used
    )
    body = _body(result, of)
    sensor = _sensor(of, shot, content.fit.fitted or 0.0, track)
    notes.append(
        f"the noise of a pixel is that of the photographs, and no less than what the fit leaves, {sensor.left:.1%} of"
        " the radiance; errors that pixels share come on top, and the result's own deviations hold them"
    )
    return Experiment(
        name=content.name,
        body=body,
        centre=body.centre,
        brdf=Microfacet(brdf.kd, brdf.ks, brdf.mu, brdf.sigma if brdf.ks.any() else None),
        lights=lights,
        views=tuple(PlannedView(photo.camera, used.index(photo.lighting), photo.label) for photo in shot),
        sensor=sensor,
        notes=tuple(notes),
        errors=of.errors,
        found_place=found_of_sphere(of),
    )


def _body(result: SavedResult, photoset: PhotoSet) -> Body:
    """The object where it lay when the result was made."""
    known = result.content.object
    if known.shape == "sphere":
        return SphereBody(Sphere(np.array(known.centre), known.radius, np.zeros((4, 4))))
    mesh, _, mesh_to_world, _ = scanned_mesh(result, photoset)
    return MeshBody(placed(mesh, mesh_to_world))


@dataclass(frozen=True, eq=False)
class PhotographedSensor:
    """Noise as photographs have it, and no less than what their fit leaves. It saturates nowhere.

    levels, variances : (k,), logarithms of rising radiances, and of the noise's variance there. left : a share of the
    radiance, a standard deviation.
    """

    levels: Floats
    variances: Floats
    left: float

    @property
    def exposures(self) -> int:
        return 1

    def exposure_s(self, photographs: Sequence[Floats]) -> float:
        return 1.0

    def information(self, radiance: Floats, photograph: Floats, exposure_s: float) -> Floats:
        level = np.log(np.maximum(radiance, 1e-300))
        # Beyond the brightest noise is that of photons, which grows with the radiance.
        brighter = np.maximum(level - self.levels[-1], 0)
        noise = np.exp(np.interp(level, self.levels, self.variances) + brighter)
        return np.asarray(1 / (np.maximum(noise, (self.left * radiance) ** 2) + 1e-300))


def _sensor(photoset: PhotoSet, photos: Sequence[Photo], left: float, track: Track) -> PhotographedSensor:
    """The noise of some of the photographs, by medians between levels of radiance."""
    some = np.unique(np.linspace(0, len(photos) - 1, min(len(photos), _PHOTOS)).round().astype(int))
    rng = np.random.default_rng(0)
    radiance, variance = [], []
    for k in track(some.tolist(), "Reading the noise of photographs"):
        image = decode_photo(photoset.radiometry, photos[k])
        height, width = image.saturated.shape
        rows, columns = rng.integers(height, size=_PIXELS), rng.integers(width, size=_PIXELS)
        usable = ~image.saturated[rows, columns]
        rows, columns = rows[usable], columns[usable]
        radiance.append(image.radiance[rows, columns].ravel())
        variance.append(image.variance_at(rows, columns).ravel())
    seen, noise = np.concatenate(radiance).astype(float), np.concatenate(variance).astype(float)
    lit = (seen > 0) & (noise > 0)
    if not lit.any():
        # Floats that state no noise have what the fit leaves alone.
        return PhotographedSensor(np.zeros(1), np.full(1, -np.inf), left)
    level, noise = np.log(seen[lit]), np.log(noise[lit])
    edges = np.unique(np.quantile(level, np.linspace(0, 1, _LEVELS + 1)))
    part = np.clip(np.searchsorted(edges, level, side="right") - 1, 0, max(len(edges) - 2, 0))
    parts = np.unique(part)
    return PhotographedSensor(
        np.array([np.median(level[part == k]) for k in parts]),
        np.array([np.median(noise[part == k]) for k in parts]),
        left,
    )
