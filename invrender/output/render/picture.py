"""A picture of a body: radiance over pixels, how much of each the body covers, and its standard deviation."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from capture.radiance import RadianceImage
from invrender.output.render.subject import Subject
from invrender.result.reflectance import Reflectance
from invrender.result.saved_textures import SavedTextures
from invrender.transport.interpolated import InterpolatedLobe
from invrender.transport.radiosity import Bounced
from invrender.transport.shading import shade, shade_with_slopes
from invrender.transport.transfer import LightElement
from recon.mesh.bodies import Body, body_window
from recon.sampling.draw import NO_SOURCES, samples_at
from recon.sampling.lightfield import LightField, joined

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Rays per side of a pixel that the body's edge, or one within it, runs through, or across which its normal turns by
# more than so many radians: there 1 / cos theta_o asks for more than the few rays that samples of a fit have.
_EDGE_RAYS = 6
_EDGE_TURN = 0.12
# Pixels share what was integrated of a map with those of the same part.
_PIXELS_AT_A_TIME = 150_000
# RMS error of what is reflected of a map, over its RMS, from interpolation.
_TOLERANCE = 0.005


@dataclass(frozen=True, eq=False)
class _PixelReflectance:
    """Kd and Ks of n pixels, (n, 3) each, with their standard deviations; known : (n,), the share where they are."""

    kd: Floats
    ks: Floats
    kd_std: Floats
    ks_std: Floats
    known: Floats


@dataclass(frozen=True, eq=False)
class Picture:
    """Radiance in front of black.

    radiance : (h, w, 3) float32, linear, mean over the pixel: of the body times `coverage`, as EXR has it.
    coverage : (h, w) float32, 0 to 1, the share of the pixel that the body covers, as far as its Kd and Ks are known.
    std : (h, w, 3) float32, standard deviation of the radiance, or None where it wasn't asked for.
    notes : what a user should know of it, in sentences.
    """

    radiance: NDArray[np.float32]
    coverage: NDArray[np.float32]
    std: NDArray[np.float32] | None
    notes: tuple[str, ...] = ()


def take_picture(
    subject: Subject,
    camera: Camera,
    reflectance: Reflectance,
    element: LightElement,
    with_std: bool = False,
    bounced: Bounced | None = None,
) -> Picture:
    """Predict what a camera sees of a body under an element of light; ValueError where it sees nothing of it.

    with_std : propagate the BRDF's covariance by first order. bounced : what the body sends itself under the element,
    if that is to be added.
    """
    shape = (camera.height, camera.width)
    picture = Picture(
        np.zeros((*shape, 3), np.float32),
        np.zeros(shape, np.float32),
        np.zeros((*shape, 3), np.float32) if with_std else None,
    )
    top, left, bottom, right = body_window(subject.body, camera)
    count = (bottom - top) * (right - left)
    image = RadianceImage.black(*shape)
    mapped = element.slow_map is not None and reflectance.brdf.form.axis is None and not with_std
    reflected = InterpolatedLobe(reflectance.brdf, element, _TOLERANCE) if mapped else None
    seen = False
    for start in range(0, count, _PIXELS_AT_A_TIME):
        rows, columns = np.divmod(np.arange(start, min(start + _PIXELS_AT_A_TIME, count)), right - left)
        rows, columns = rows + top, columns + left
        geometry = subject.body.pixel_geometry(camera, rows, columns)
        whole = geometry.whole & (geometry.turn <= _EDGE_TURN)
        inner = samples_at(subject.body, camera, image, rows[whole], columns[whole], NO_SOURCES)
        # What turned out not to lie wholly on the body, such as a pixel with a hole, is left to finer rays.
        done = np.zeros(shape, bool)
        done[inner.rows, inner.columns] = True
        rest = ~done[rows, columns]
        outer, alpha = _edge_samples(subject.body, camera, rows[rest], columns[rest])
        # Together, so that what is integrated of a map serves both.
        field, cover = joined([inner, outer]), np.concatenate([np.ones(len(inner)), alpha])
        if len(field):
            seen = True
            _enter(picture, subject, camera, reflectance, element, field, cover, reflected, bounced)
    if not seen:
        raise ValueError(
            f"the camera at {camera.centre.round(4).tolist()} m sees nothing of the object: it is inside it, or looks"
            " past it"
        )
    return picture


def _enter(
    picture: Picture,
    subject: Subject,
    camera: Camera,
    reflectance: Reflectance,
    element: LightElement,
    field: LightField,
    alpha: Floats,
    reflected: InterpolatedLobe | None,
    bounced: Bounced | None,
) -> None:
    """Enter samples, of which the body covers `alpha` (n,), into a picture."""
    brdf, weights = reflectance.brdf, None
    if reflectance.textures is not None:
        weights = _pixel_reflectance(subject, camera, reflectance.textures, field, alpha)
        brdf = replace(brdf, kd=weights.kd[field.ray_sample], ks=weights.ks[field.ray_sample])
    pixels = field.rows, field.columns
    if picture.std is None:
        radiance = shade(brdf, element, field, subject.shadows, reflected, bounced)
    else:
        radiance, slopes = shade_with_slopes(brdf, element, field, subject.shadows, bounced)
        variance = np.einsum("nkc,ckl,nlc->nc", slopes, reflectance.covariance, slopes)
        if weights is not None:
            # A texel's deviation is much the same all over a pixel.
            for slope, std in ((slopes[:, 0], weights.kd_std), (slopes[:, 1], weights.ks_std)):
                variance += (slope * std) ** 2
        # Rounding may leave the tiniest variances below zero.
        picture.std[pixels] = np.sqrt(np.maximum(variance, 0)) * alpha[:, None]
    picture.radiance[pixels] = radiance * alpha[:, None]
    picture.coverage[pixels] = alpha
    if weights is not None:
        # Where the photographs left Kd and Ks open, both are zero, and the body counts as not there.
        picture.coverage[pixels] *= weights.known


def _pixel_reflectance(
    subject: Subject, camera: Camera, textures: SavedTextures, field: LightField, alpha: Floats
) -> _PixelReflectance:
    """Means of Kd and Ks over samples' pixels, as far as the body covers them (alpha, (n,)); textures may be fine.

    They are taken at once for all rays of a pixel, whose light varies little beside.
    """
    places = (np.column_stack([field.columns, field.rows])[:, None] + _grid(_EDGE_RAYS)).reshape(-1, 2)
    rays = subject.ray_reflectance(textures, camera, places)

    def mean(values: Floats) -> Floats:
        return np.asarray(values.reshape(len(field), _EDGE_RAYS**2, -1).mean(axis=1) / alpha[:, None])

    known = np.minimum(mean(rays.known[:, None].astype(float))[:, 0], 1)
    return _PixelReflectance(mean(rays.kd), mean(rays.ks), mean(rays.kd_std), mean(rays.ks_std), known)


def _grid(count: int) -> Floats:
    """Points (count^2, 2) spread evenly over a pixel, from its corner."""
    steps = (np.arange(count) + 0.5) / count
    return np.asarray(np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2))


def _edge_samples(body: Body, camera: Camera, rows: Ints, columns: Ints) -> tuple[LightField, Floats]:
    """Samples of pixels that a body covers in part, over what it covers, and the covered share (n,) of each."""
    offsets = _grid(_EDGE_RAYS)
    points = (np.column_stack([columns, rows])[:, None] + offsets).reshape(-1, 2)
    hits = body.hits(camera, points)
    shares = hits.hit.reshape(-1, len(offsets)).mean(axis=1)
    touched = np.flatnonzero(shares)
    met = np.flatnonzero(hits.hit)
    number = np.cumsum(shares > 0) - 1
    views, normals, facets, positions = (
        values[met] for values in (hits.views, hits.normals, hits.facets, hits.positions)
    )
    reflected = 2 * (normals * views).sum(axis=1)[:, None] * normals - views
    nothing = np.zeros((len(touched), 3))
    field = LightField(
        rows=rows[touched],
        columns=columns[touched],
        radiance=nothing,
        variance=nothing,
        weight=np.ones(len(touched)),
        ray_sample=number[met // len(offsets)],
        positions=positions,
        normals=normals,
        views=views,
        reflected_visible=body.visible(positions, facets, reflected),
        sources_visible=np.zeros((len(met), 0), bool),
        faces=None if hits.faces is None else hits.faces[met],
        corner_weights=None if hits.weights is None else hits.weights[met],
        footprints=None if hits.faces is None else np.zeros((len(met), 2, 3)),
    )
    return field, shares[touched]
