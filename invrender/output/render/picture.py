"""A picture of a body: radiance over pixels, how much of each the body covers, and its standard deviation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from capture.radiance import RadianceImage
from invrender.brdf.microfacet import Microfacet
from invrender.output.render.subject import Subject
from invrender.result.reflectance import Reflectance
from invrender.result.saved_textures import SavedTextures
from invrender.transport.interpolated import InterpolatedLobe
from invrender.transport.radiosity import Bounced
from invrender.transport.shading import shade, shade_with_slopes
from invrender.transport.sphere_rays import SphereRays
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
# RMS error of what is reflected of a map, over its RMS, that interpolation may leave; and at how many pixels of a
# picture it is measured.
TOLERANCE = 0.005
_TRIED = 256


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
    interpolated : RMS difference from an integral over the map for each ray, over the RMS radiance, as measured at some
    pixels; None where nothing is interpolated.
    notes : what a user should know of it, in sentences.
    """

    radiance: NDArray[np.float32]
    coverage: NDArray[np.float32]
    std: NDArray[np.float32] | None
    interpolated: float | None = None
    notes: tuple[str, ...] = ()


def interpolation_note(pictures: Sequence[float | None]) -> tuple[str, ...]:
    """A sentence on the worst of pictures' errors by interpolation, where there are any."""
    known = [error for error in pictures if error is not None]
    if not known:
        return ()
    return (
        f"What the lobe reflects of the map is interpolated: pictures are up to {max(known):.2%} (RMS) off an integral"
        f" for each ray, as measured at {_TRIED} pixels; --tolerance sets it.",
    )


def take_picture(
    subject: Subject,
    camera: Camera,
    reflectance: Reflectance,
    element: LightElement,
    with_std: bool = False,
    bounced: Bounced | None = None,
    tolerance: float = TOLERANCE,
) -> Picture:
    """Predict what a camera sees of a body under an element of light; ValueError where it sees nothing of it.

    with_std : propagate the BRDF's covariance by first order. bounced : what the body sends itself under the element,
    if that is to be added. tolerance : RMS error over the RMS, that interpolation of what a lobe reflects of a map may
    leave; 0 integrates for each ray, as with_std and brushed lobes always do.
    """
    shape = (camera.height, camera.width)
    shot = _Shot(subject, camera, reflectance, element, bounced)
    picture = Picture(
        np.zeros((*shape, 3), np.float32),
        np.zeros(shape, np.float32),
        np.zeros((*shape, 3), np.float32) if with_std else None,
    )
    top, left, bottom, right = body_window(subject.body, camera)
    count = (bottom - top) * (right - left)
    glossy = reflectance.brdf.sigma is not None and reflectance.brdf.form.axis is None
    mapped = glossy and element.slow_map is not None and not with_std
    reflected = InterpolatedLobe(reflectance.brdf, element, tolerance) if mapped else None
    if reflected is not None and tolerance:
        # On a sphere a grid serves, unless a narrow lobe asks for one of more nodes than there are pixels.
        gridded = replace(reflected, sphere=SphereRays.of(subject.body, camera))
        if gridded.over_sphere is not None and gridded.over_sphere.count < count:
            reflected = gridded
    exact = InterpolatedLobe(reflectance.brdf, element, 0.0)
    seen, tried = False, []
    for start in range(0, count, _PIXELS_AT_A_TIME):
        rows, columns = np.divmod(np.arange(start, min(start + _PIXELS_AT_A_TIME, count)), right - left)
        field, alpha = _samples(subject.body, camera, rows + top, columns + left)
        if not len(field):
            continue
        seen = True
        radiance = shot.enter(picture, field, alpha, reflected)
        if reflected is not None and tolerance:
            tried.append(shot.differences(field, alpha, radiance, exact, _TRIED * len(rows) / count))
    if not seen:
        raise ValueError(
            f"the camera at {camera.centre.round(4).tolist()} m sees nothing of the object: it is inside it, or looks"
            " past it"
        )
    if not tried:
        return picture
    differences, values = np.linalg.norm(np.concatenate(tried, axis=1), axis=(1, 2)).tolist()
    return replace(picture, interpolated=differences / max(values, np.finfo(float).tiny))


def pixel_terms(
    subject: Subject,
    camera: Camera,
    reflectance: Reflectance,
    element: LightElement,
    pixel: tuple[int, int],
    bounced: Bounced | None = None,
) -> tuple[Floats, Floats, Floats]:
    """What adds up to a pixel's radiance, (3,) each: the base's, the lobe's, and of either what the body sends itself.

    pixel : row and column. Arguments else as of `take_picture`; zeros where the camera sees nothing of the body.
    """
    row, column = pixel
    field, alpha = _samples(subject.body, camera, np.array([row]), np.array([column]))
    if not len(field):
        return np.zeros(3), np.zeros(3), np.zeros(3)
    brdf = _Shot(subject, camera, reflectance, element, bounced)._textured(field, alpha)[1]

    def radiance(of: Microfacet, and_bounced: Bounced | None = None) -> Floats:
        return np.asarray(alpha[0] * shade(of, element, field, subject.shadows, bounced=and_bounced)[0])

    matte, direct = radiance(replace(brdf, ks=np.zeros_like(brdf.ks))), radiance(brdf)
    return matte, direct - matte, radiance(brdf, bounced) - direct


@dataclass(frozen=True, eq=False)
class _Shot:
    """What is taken, from where, and under what: the arguments of `take_picture`."""

    subject: Subject
    camera: Camera
    reflectance: Reflectance
    element: LightElement
    bounced: Bounced | None

    def enter(
        self, picture: Picture, field: LightField, alpha: Floats, reflected: InterpolatedLobe | None
    ) -> Floats:
        """Enter samples, of which the body covers `alpha` (n,), into a picture; returns their radiance (n, 3)."""
        weights, brdf = self._textured(field, alpha)
        pixels = field.rows, field.columns
        if picture.std is None:
            radiance = shade(brdf, self.element, field, self.subject.shadows, reflected, self.bounced)
        else:
            radiance, slopes = shade_with_slopes(
                brdf, self.element, field, self.subject.shadows, self.bounced
            )
            variance = np.einsum("nkc,ckl,nlc->nc", slopes, self.reflectance.covariance, slopes)
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
        return radiance

    def differences(
        self, field: LightField, alpha: Floats, radiance: Floats, exact: InterpolatedLobe, number: float
    ) -> Floats:
        """How far the radiance (n, 3) of about so many samples, drawn, is from exact; and exact: (2, r, 3)."""
        some = np.random.default_rng(0).random(len(field)) * len(field) < number
        if not some.any():
            return np.zeros((2, 0, 3))
        drawn = field.where(some)
        brdf = self._textured(drawn, alpha[some])[1]
        each = shade(brdf, self.element, drawn, self.subject.shadows, exact, self.bounced)
        return np.array([radiance[some] - each, each]) * alpha[some, None]

    def _textured(self, field: LightField, alpha: Floats) -> tuple[_PixelReflectance | None, Microfacet]:
        """Kd and Ks of samples' pixels where they vary, and the BRDF with those of their rays."""
        brdf = self.reflectance.brdf
        if self.reflectance.textures is None:
            return None, brdf
        weights = _pixel_reflectance(self.subject, self.camera, self.reflectance.textures, field, alpha)
        return weights, replace(brdf, kd=weights.kd[field.ray_sample], ks=weights.ks[field.ray_sample])


def _samples(body: Body, camera: Camera, rows: Ints, columns: Ints) -> tuple[LightField, Floats]:
    """Samples of those pixels that a body covers at least in part, and the covered share (n,) of each."""
    geometry = body.pixel_geometry(camera, rows, columns)
    whole = geometry.whole & (geometry.turn <= _EDGE_TURN)
    image = RadianceImage.black(camera.height, camera.width)
    inner = samples_at(body, camera, image, rows[whole], columns[whole], NO_SOURCES)
    # What turned out not to lie wholly on the body, such as a pixel with a hole, is left to finer rays.
    done = np.zeros((camera.height, camera.width), bool)
    done[inner.rows, inner.columns] = True
    rest = ~done[rows, columns]
    outer, alpha = _edge_samples(body, camera, rows[rest], columns[rest])
    # Together, so that what is integrated of a map serves both.
    return joined([inner, outer]), np.concatenate([np.ones(len(inner)), alpha])


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
