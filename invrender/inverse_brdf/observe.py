"""What a photo set shows of reflectance under light that is all known: samples of each photograph, and their light."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting
from capture.photo import Photo
from capture.photoset import PhotoSet
from capture.progress import Track, silent
from invrender.inverse_brdf.samples import Source
from recon.harmonics.complex import project_sources
from recon.harmonics.latlong import map_coefficients
from recon.lighting import read_lighting
from recon.mesh.bodies import Body, SphereBody
from recon.sampling.find import check_has_body, check_unfiltered, find_body
from recon.sampling.lightfield import LightField
from recon.sampling.stream import light_fields

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Observations:
    """Samples (one LightField per photograph, in the set's order) and the lightings that they are under, by name."""

    photoset: PhotoSet
    body: Body
    fields: tuple[LightField, ...]
    lightings: Mapping[str, Lighting]
    warnings: tuple[str, ...]

    @property
    def centre(self) -> Floats:
        """Of the sphere, (3,) metres."""
        assert isinstance(self.body, SphereBody)
        return self.body.sphere.centre

    @property
    def fitted(self) -> list[tuple[Photo, LightField]]:
        """Photographs that aren't held out, with their samples."""
        pairs = zip(self.photoset.photos, self.fields, strict=True)
        return [(photo, field) for photo, field in pairs if not photo.held_out]


def observe(photoset: PhotoSet, samples: int | None, track: Track = silent) -> Observations:
    """Samples of all photographs of a sphere under known light.

    samples : of all photographs together, None for all usable pixels. Raises ValueError for a mesh, a texture, light
    that isn't known, and photographs without a usable pixel.
    """
    where = photoset.manifest
    check_has_body(photoset)
    check_unfiltered(photoset)
    if photoset.object.shape != "sphere":
        raise ValueError(
            f"{where}: [object] shape = 'mesh': reflectance without a formula is measured on spheres, which shadow"
            " nothing of themselves"
        )
    if photoset.object.texture:
        raise ValueError(f"{where}: [object] texture = true: one BRDF is measured for the whole object")
    lightings = _known_lightings(photoset)
    found = find_body(photoset, track)
    sources = {name: lighting.directions for name, lighting in lightings.items()}
    streamed = light_fields(photoset, found.body, sources, samples, found.mask_of)
    fields = tuple(next(streamed) for _ in track(photoset.photos, "Reading photographs"))
    if not any(len(field) for field in fields):
        raise ValueError(
            f"{where}: no pixel of any photograph is usable: not saturated, within the mask, not at the rim; look at"
            " the masks and exposures"
        )
    if not any(field.radiance.any() for field in fields):
        raise ValueError(f"{where}: the object is black in every photograph; expose longer")
    return Observations(photoset, found.body, fields, lightings, found.warnings)


def light_coefficients(lighting: Lighting, l_max: int) -> Floats:
    """Real coefficients ((l_max + 1)^2, 3) of a lighting: its map's, and its sources as delta functions."""
    result = project_sources(lighting.directions, lighting.irradiances, l_max)
    if lighting.radiance_map is not None:
        result = result + map_coefficients(lighting.radiance_map, l_max)
    return result


def single_source(photoset: PhotoSet, lighting: Lighting) -> Source:
    """The source of a lighting that is one source and nothing else; ValueError for any other."""
    has_map = lighting.radiance_map is not None and bool(lighting.radiance_map.any())
    if len(lighting.directions) == 1 and not has_map:
        return Source(lighting.directions[0], lighting.irradiances[0])
    holds = f"{len(lighting.directions)} source(s)" + (" and a map" if has_map else "")
    raise ValueError(
        f'{photoset.manifest}: [[lighting]] "{lighting.name}" has {holds}: a table is measured under a single source'
        " and nothing else; hold the photos under it out (held_out = true), or use --method harmonic"
    )


def _known_lightings(photoset: PhotoSet) -> dict[str, Lighting]:
    where = photoset.manifest
    remedy = "give map, directional with irradiance, or mirror_ball; `lightfactor process` recovers strengths"
    used = {photo.lighting for photo in photoset.photos}
    lightings = {}
    for table in photoset.lightings:
        if table.name not in used:
            continue
        if table.unknown or table.recover:
            lacking = "unknown = true" if table.unknown else f"recover = {list(table.recover or ())}"
            raise ValueError(
                f'{where}: [[lighting]] "{table.name}": {lacking}: this measurement needs light that is known; {remedy}'
            )
        lightings[table.name] = read_lighting(photoset, table)
    return lightings
