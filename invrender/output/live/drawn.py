"""What a browser draws, computed here: the witness of its shader, and how far live pictures are off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from capture.lighting import Lighting, cosines, seen_from
from capture.progress import Track, silent
from capture.srgb import srgb_to_linear
from invrender.output.live.live_light import LiveLight
from invrender.output.live.live_material import LEAST_KNOWN, LiveReflectance
from invrender.output.live.scene import LiveScene
from invrender.output.render import view
from invrender.output.render.photographer import Photographer
from invrender.result.saved_textures import texels_around
from invrender.transport.visibility import MIN_COS, facing_normals
from recon.mesh.bodies import MeshBody, SurfaceHits, blended, body_window, sees

Floats = NDArray[np.float64]

# Where live pictures are compared: azimuth, elevation and the light's turn, degrees; and the pictures' side, pixels.
_COMPARED = ((0.0, 20.0, 0.0), (75.0, 50.0, 40.0), (190.0, -10.0, 125.0), (290.0, 10.0, 260.0))
_SIDE = 160
# Where in a pixel rays are cast.
_RAYS = ((0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75))


@dataclass(frozen=True)
class LiveError:
    """What live pictures are off by, relative RMS over whole pixels of the object: of all, and of the worst."""

    rms: float
    worst: float

    @property
    def stated(self) -> str:
        """A sentence."""
        return (
            f"Live pictures are off by {self.rms:.1%} from `lightfactor render` (RMS over {len(_COMPARED)} views and"
            f" turns of each light), the worst of them by {self.worst:.1%}."
        )


def live_error(
    scene: LiveScene, studio: Photographer, lightings: Sequence[Lighting], track: Track = silent
) -> LiveError:
    """Compare what a browser draws with a photographer's pictures under each of the scene's lights."""
    optics = view.new_optics(_photographs(studio), scene.radius, (_SIDE, _SIDE), None)
    ratios = []
    pairs = [
        (light, replace(studio, lighting=lighting), compared)
        for light, lighting in zip(scene.lights, lightings, strict=True)
        for compared in _COMPARED
    ]
    for light, own, (azimuth, elevation, turn) in track(pairs, "Comparing"):
        camera = view.seen_from(optics, view.View(azimuth, elevation, None), scene.centre, scene.radius)
        picture = own.take(camera, turn)
        radiance, coverage = drawn(scene, light, camera, np.radians(turn))
        whole = (coverage >= 1) & (picture.coverage >= 1)
        difference, truth = (radiance - picture.radiance)[whole], picture.radiance[whole]
        ratios.append((difference**2).sum() / max((truth**2).sum(), np.finfo(float).tiny))
    return LiveError(float(np.sqrt(np.mean(ratios))), float(np.sqrt(np.max(ratios))))


def drawn(scene: LiveScene, light: LiveLight, camera: Camera, turn: float) -> tuple[Floats, Floats]:
    """Radiance in front of black (h, w, 3) and coverage (h, w), the light turned about +Z by so many radians.

    Four rays to a pixel, as browsers take four samples.
    """
    body = MeshBody(scene.mesh)
    top, left, bottom, right = body_window(body, camera)
    rows, columns = (each.ravel() for each in np.mgrid[top:bottom, left:right])
    radiance, coverage = np.zeros((camera.height, camera.width, 3)), np.zeros((camera.height, camera.width))
    for across, down in _RAYS:
        hits = body.hits(camera, np.column_stack([columns + across, rows + down]))
        met = np.flatnonzero(hits.hit)
        assert hits.faces is not None
        assert hits.weights is not None
        at = SurfaceHits(
            hits.hit[met],
            hits.views[met],
            hits.positions[met],
            facing_normals(hits.normals[met], hits.views[met]),
            hits.facets[met],
            hits.faces[met],
            hits.weights[met],
        )
        kd, known = _reflectance(scene, scene.kd, at)
        ks, _ = _reflectance(scene, scene.ks, at)
        diffuse, specular = _reflected(scene, light, body, at, turn)
        there = (known >= LEAST_KNOWN) / len(_RAYS)
        radiance[rows[met], columns[met]] += (kd * diffuse + ks * specular) * light.unit * there[:, None]
        coverage[rows[met], columns[met]] += there
    return radiance, coverage


def _photographs(studio: Photographer) -> tuple[list[Camera], Floats, float] | None:
    if studio.photoset is None:
        return None
    known = studio.result.content.object
    return [photo.camera for photo in studio.photoset.photos], np.array(known.centre), known.radius


def _reflected(
    scene: LiveScene, light: LiveLight, body: MeshBody, at: SurfaceHits, turn: float
) -> tuple[Floats, Floats]:
    """Radiance (m, 3) each, over the light's unit, per unit of Kd and of Ks."""
    assert at.faces is not None
    assert at.weights is not None
    corners = scene.mesh.faces[at.faces]
    cos_o = np.clip((at.normals * at.views).sum(axis=1), 0, 1)
    diffuse = blended(light.irradiance(turn), corners, at.weights)
    # In place of the light, what it falls on is turned, the other way.
    cos, sin = np.cos(turn), np.sin(turn)
    about_z = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    specular = light.maps.towards(at.normals @ about_z, at.views @ about_z)
    if scene.has_shadows:
        mirrored = 2 * (at.normals * at.views).sum(axis=1)[:, None] * at.normals - at.views
        specular *= body.visible(at.positions, at.facets, mirrored)[:, None]
    for lamp, strength in zip(light.lamps_turned(turn), light.irradiances, strict=True):
        # Lamps are in radii about the centre.
        source = np.append(lamp[:3] + lamp[3] / scene.radius * scene.centre, lamp[3] / scene.radius)
        towards, factors = seen_from(source[None], at.positions)
        towards, factor = towards[:, 0], factors[:, 0]
        lit = cosines(at.normals, towards[:, None])[:, 0]
        factor = factor * (lit > 0)
        if scene.has_shadows:
            factor = factor * sees(body, at.positions, at.facets, source)
        received = factor * lit * _entry(scene.transmitted, lit)
        diffuse = diffuse + received[:, None] * strength
        specular = specular + (factor * _lobe(scene, at.normals, towards, at.views))[:, None] * strength
    return diffuse * _entry(scene.transmitted, cos_o)[:, None], specular


def _entry(table: NDArray[np.float16], cos: Floats) -> Floats:
    """Values of a table over even cosines 0 to 1."""
    return np.interp(cos, np.linspace(0, 1, len(table)), table.astype(float))


def _lobe(scene: LiveScene, normals: Floats, towards: Floats, views: Floats) -> Floats:
    """What the lobe reflects (m,) of unit irradiance across a beam from unit directions (m, 3)."""
    half = towards + views
    half /= np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-9)
    cos_h, cos_d = (np.clip((half * of).sum(axis=1), 0, 1) for of in (normals, views))
    cos_i, cos_o = ((normals * of).sum(axis=1) for of in (towards, views))
    sines = np.sqrt((1 - cos_h**2) * (1 - cos_d**2))
    phi = np.arccos(np.clip((cos_h * cos_d - cos_i) / np.maximum(sines, 1e-6), -1, 1))
    values = scene.volume.at(np.arccos(cos_h), np.arccos(cos_d), phi)
    return values / np.maximum(cos_o, MIN_COS)


def _reflectance(scene: LiveScene, of: LiveReflectance, at: SurfaceHits) -> tuple[Floats, Floats]:
    """Kd or Ks (m, 3) and the share that is known (m,)."""
    assert at.faces is not None
    assert at.weights is not None
    corners = scene.mesh.faces[at.faces]
    values = blended(of.at_vertices.astype(float), corners, at.weights)
    if scene.mesh.uv is not None and of.codes.shape[:2] != (1, 1):
        values *= _texels(of.codes, blended(scene.mesh.uv, corners, at.weights))
    return values[:, :3] * of.scale, values[:, 3]


def _texels(codes: NDArray[np.uint8], uv: Floats) -> Floats:
    """Linear values and the share that is known, (m, 4), between texels."""
    linear = np.dstack([srgb_to_linear(codes[..., :3] / 255), codes[..., 3] / 255])
    rows, columns, weights = texels_around(uv, *codes.shape[:2])
    return np.einsum("mk,mkc->mc", weights, linear[rows, columns])
