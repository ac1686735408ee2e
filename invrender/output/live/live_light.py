"""One light of a live picture: lamps, reflection maps, and what falls on each vertex as the light turns."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.lighting import Lighting, latlong_pixels, latlong_solid_angles
from invrender.output.live.lobe_maps import LobeMaps, lobe_maps
from invrender.output.render.light import light_element, turned
from invrender.output.render.photographer import Photographer
from invrender.transport.diffuse_base import base_irradiance
from invrender.transport.radiosity import Bounced
from invrender.transport.transfer import LightElement
from recon.mesh.bodies import MeshBody
from recon.mesh.trianglemesh import TriangleMesh

Floats = NDArray[np.float64]
Halves = NDArray[np.float16]

# Lamps cost a ray per pixel each; what is beyond these is put into the map, whose rows are at least so many.
_MOST_LAMPS, _LEAST_ROWS = 4, 64
# Turns of the light at which the irradiance of vertices is computed, and the share of it that its series may miss.
_TURNS, _MISSED = 24, 0.002


@dataclass(frozen=True, eq=False)
class LiveLight:
    """A light, all radiance over `unit`.

    lamps : (k, 4), as `Lighting.sources` has them, in radii of the object about its centre. irradiances : (k, 3).
    series : (v, 2m + 1, 3), irradiance of vertices by all but the lamps, and by what parts of the object send each
    other, over the light's turn t about +Z: constant, then factors of cos t, sin t, cos 2t, ...
    maps : of the lobe.
    """

    name: str
    unit: float
    lamps: Floats
    irradiances: Floats
    series: Halves
    maps: LobeMaps

    def irradiance(self, turn: float) -> Floats:
        """Irradiance (v, 3) of vertices, lamps aside, the light turned by so many radians."""
        order = np.arange(1, self.series.shape[1] // 2 + 1)
        waves = np.stack([np.cos(order * turn), np.sin(order * turn)], axis=-1).ravel()
        return np.maximum(np.einsum("vmc,m->vc", self.series.astype(float), np.concatenate([[1], waves])), 0)

    def lamps_turned(self, turn: float) -> Floats:
        """The lamps (k, 4), turned with the light by so many radians."""
        cos, sin = np.cos(turn), np.sin(turn)
        about_z = np.array([[cos, -sin, 0, 0], [sin, cos, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
        return self.lamps @ about_z.T


def live_light(studio: Photographer, lighting: Lighting, mesh: TriangleMesh) -> LiveLight:
    """A lighting for live pictures of a photographer's subject, whose surface the mesh is.

    ValueError where the lighting is dark.
    """
    element = _few_lamps(light_element(lighting))
    by_turn = np.stack(
        [
            _received(studio, turned(element, studio.subject.centre, 360 * k / _TURNS), mesh)
            for k in range(_TURNS)
        ]
    )
    series = _series(by_turn)
    unit = float(max(np.abs(series).max(), element.irradiances.max(initial=0))) / np.pi or 1.0
    closeness = np.zeros(len(element.directions))
    towards = element.directions
    if element.directions.shape[1] == 4:
        closeness = element.directions[:, 3]
        towards = element.directions[:, :3] - closeness[:, None] * studio.subject.centre
    return LiveLight(
        lighting.name,
        unit,
        np.column_stack([towards, closeness * studio.subject.radius]),
        element.irradiances / unit,
        (series / unit).astype(np.float16),
        lobe_maps(studio.material.brdf, element, unit),
    )


def _few_lamps(element: LightElement) -> LightElement:
    """An element whose weaker lamps are part of its map, so that few are left."""
    order = np.argsort(-element.irradiances.sum(axis=1))
    kept, others = order[:_MOST_LAMPS], order[_MOST_LAMPS:]
    if not len(others):
        return element
    slow = element.slow_map
    slow = np.zeros((_LEAST_ROWS, 2 * _LEAST_ROWS, 3), np.float32) if slow is None else slow.copy()
    directions = element.directions[others, :3]
    directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    rows, columns = (each.astype(int) for each in latlong_pixels(directions, len(slow)))
    radiance = element.irradiances[others] / latlong_solid_angles(len(slow))[rows]
    np.add.at(slow, (rows, columns % slow.shape[1]), radiance)
    return replace(
        element, directions=element.directions[kept], irradiances=element.irradiances[kept], slow_map=slow
    )


def _received(studio: Photographer, element: LightElement, mesh: TriangleMesh) -> Floats:
    """Irradiance (v, 3) of vertices, lamps aside, with what the parts of the object send each other by all light."""
    brdf, shadows = studio.material.brdf, studio.subject.shadows
    rest = element.without_sources
    total = np.zeros(mesh.vertices.shape)
    if rest.slow_map is not None:
        visible = None if shadows is None else shadows.of_vertices(rest)
        total += base_irradiance(brdf.form, brdf.mu, rest, mesh.normals, visible)
    bounced: Bounced | None = studio.bounced(element) if isinstance(studio.subject.body, MeshBody) else None
    return total if bounced is None else total + bounced.irradiance


def _series(by_turn: Floats) -> Floats:
    """Fourier series (v, 2m + 1, 3) of values (turns, v, 3), as short as `_MISSED` allows."""
    count = len(by_turn)
    spectrum = np.fft.rfft(by_turn, axis=0)[: count // 2] / count
    # The real part goes with cos, the imaginary one with -sin.
    energy = (np.abs(spectrum) ** 2).sum(axis=(1, 2)) * np.where(np.arange(len(spectrum)) > 0, 2, 1)
    left = energy[::-1].cumsum()[::-1]
    least = int(np.argmax(np.append(left[1:], 0) <= _MISSED**2 * left[0]))
    waves = spectrum[1 : least + 1]
    pairs = np.stack([2 * waves.real, -2 * waves.imag], axis=1).reshape(-1, *by_turn.shape[1:])
    return np.moveaxis(np.concatenate([spectrum[:1].real, pairs]), 0, 1)
