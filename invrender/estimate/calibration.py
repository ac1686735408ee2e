"""What errors of calibration do to the numbers of a fit, to first order: scores of the photographs' changes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.calibrationerrors import CalibrationErrors, SharedError
from capture.camera import Camera
from capture.lighting import Lighting
from invrender.estimate.explanation import Explanation
from invrender.estimate.jacobian import jacobians, pack
from invrender.gradients.slopes import Light, PhotoRadiance
from invrender.transport.transfer import LightElement, light_elements
from invrender.transport.visibility import Shadows
from recon.displacement.rays import (
    Motion,
    RayChange,
    SeenBody,
    lens_motion,
    mesh_motion,
    pose_motion,
    ray_change,
    sphere_motion,
)
from recon.displacement.sphere import place_shift
from recon.mesh.bodies import Body, MeshBody, SphereBody, blended
from recon.mesh.tangents import tangents
from recon.mesh.trianglemesh import smooth_normals
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# Rays that slopes are taken of, of all photographs together; under maps, which take long, fewer.
_RAYS, _RAYS_OF_MAPS = 40_000, 8_000
# Rays of a sample, of which there are up to 64 where the surface bends: many samples tell more than many rays.
_RAYS_OF_SAMPLE = 3
# Draws of a scan's noise, whose effect on normals isn't of first order; pairs of draws of a pose's or a lens's errors,
# by which their second order is known.
_DRAWS, _PAIRS = 8, 3
# Principal variances, as shares of the largest, below which an error counts for nothing.
_NEGLIGIBLE = 1e-9
# Of a sphere's radius, a shift by which differences are taken.
_PLACE_STEP = 1e-3


def calibration_scores(
    photos: Iterable[WeighedPhoto],
    body: Body,
    found: NDArray[np.bool_],
    errors: CalibrationErrors,
    lightings: Mapping[str, Lighting],
) -> dict[str, Floats]:
    """Scores (p, q) of each cause, by its name, one column for each of its q errors of one standard deviation.

    A score is the sum over samples of weighted derivatives times the radiance that the error changes; times the
    inverse of the information it is what the error moves. photos : read only where there are errors. found : (4,), what
    of a sphere's centre and radius its outlines gave, so that it follows cameras that are elsewhere. lightings : known.
    Errors of different photographs, lenses and sources are independent.
    """
    directions = {name: own for name, own in lightings.items() if own.direction_std_deg is not None}
    if not errors.of_geometry and not directions:
        return {}
    by_label = {photo.label: photo for photo in photos}
    everyone = list(by_label.values())
    size = everyone[0].weighted[0].shape[1]
    scores: dict[str, Floats] = {}
    if poses := errors.poses_about(body.centre, {photo.label: photo.scene.camera for photo in everyone}):
        scores["poses"] = _of_cameras(by_label, body, found, poses, pose_motion, body.size, size)
    if errors.lenses:
        scores["lenses"] = _of_cameras(by_label, body, found, errors.lenses, lens_motion, 1.0, size)
    if errors.mesh_place is not None:
        motions = map(mesh_motion, _principal(errors.mesh_place, body.size))
        scores["mesh_place"] = _stacked([_moved(everyone, motion, size) for motion in motions], size)
    if errors.height and isinstance(body, MeshBody):
        scores["heights"] = _of_heights(everyone, body, errors.height, size)
    columns: list[Floats] = []
    for name, lighting in directions.items():
        under = [photo for photo in everyone if photo.lighting == name]
        columns += _of_directions(under, lighting, size)
    if columns:
        scores["light_directions"] = _stacked(columns, size)
    return scores


@dataclass(frozen=True, eq=False)
class WeighedPhoto:
    """Some of a photograph's samples, and how much each counts in a fit's p numbers.

    weighted : per channel (n, p), derivatives of their radiance times weights. radiance : of the samples' rays under
    the lighting, whose elements have these strengths, (elements, 3).
    """

    label: str
    lighting: str
    scene: SeenBody
    field: LightField
    weighted: Sequence[Floats]
    radiance: PhotoRadiance
    strengths: Floats

    def score(self, change: Floats) -> Floats:
        """Of a change (m, 3) of the rays' radiance, (p,)."""
        mean = self.field.mean_over_rays(change)
        return np.asarray(sum(own.T @ mean[:, c] for c, own in enumerate(self.weighted)))

    def moved(self, motion: Motion) -> Floats:
        """Of what changes as the scene moves, (p,)."""
        return self.followed(ray_change(self.field, self.scene, motion))

    def followed(self, change: RayChange) -> Floats:
        """Of rays' changes, to first order, (p,)."""
        return self.score(self.radiance.slopes.change(change))

    def curved(self, changes: Sequence[RayChange]) -> Floats:
        """Of the mean of what independent errors change to second order, (p,): they smear highlights.

        changes : of the rays, with one standard deviation each.
        """
        rng, mean = np.random.default_rng(0), np.zeros((len(self.field.normals), 3))
        for _ in range(_PAIRS):
            own = rng.standard_normal(len(changes))
            together = RayChange(
                *(
                    sum(share * getattr(change, name) for share, change in zip(own, changes, strict=True))
                    for name in ("normals", "views", "positions")
                )
            )
            for way in (1.0, -1.0):
                mean += self.radiance.of(together.applied(self.field, way)) / (2 * _PAIRS)
        return self.score(mean - self.radiance.here)


def weighed_photos(
    known: Explanation,
    labels: Sequence[str],
    cameras: Sequence[Camera],
    body: Body,
    lightings: Mapping[str, Lighting],
    shadows: Shadows | None,
) -> Iterator[WeighedPhoto]:
    """The photographs of a fit, which have these labels and cameras."""
    estimate = known.candidates[known.chosen].estimate
    parameters = pack(estimate, {photo.lighting: photo.elements for photo in known.photos})
    elements = {name: light_elements(lighting) for name, lighting in lightings.items()}
    kept = some_rays([photo.field for photo in known.photos], elements.values())
    for label, photo, (keep, field, weight), own, camera in zip(
        labels, known.photos, kept, known.weights, cameras, strict=True
    ):
        weights, strengths = weight * own.weight[keep], estimate.strengths[photo.lighting]
        derivatives = jacobians(photo, parameters, estimate)
        yield WeighedPhoto(
            label,
            photo.lighting,
            SeenBody(camera, body),
            field,
            [channel[keep] * weights[:, c, None] for c, channel in enumerate(derivatives)],
            PhotoRadiance(estimate.brdf, Light(elements[photo.lighting], strengths), field, shadows),
            strengths,
        )


def some_rays(
    fields: Sequence[LightField], elements: Iterable[Sequence[LightElement]]
) -> Iterator[tuple[NDArray[np.bool_], LightField, float]]:
    """As much of photographs as slopes are taken of: which samples, these with few rays, and how many each stands for.

    elements : of all lightings.
    """
    mapped = any(element.slow_map is not None for own in elements for element in own)
    thin = [field.thinned(_RAYS_OF_SAMPLE) for field in fields]
    rays = sum(len(field.ray_sample) for field in thin)
    step = max(round(rays / (_RAYS_OF_MAPS if mapped else _RAYS)), 1)
    for field in thin:
        keep = np.arange(len(field)) % step == 0
        yield keep, field.where(keep), len(keep) / max(int(keep.sum()), 1)


def _moved(photos: Iterable[WeighedPhoto], motion: Motion, size: int) -> Floats:
    """The score (p,) of a motion in all of some photographs."""
    return np.asarray(sum((photo.moved(motion) for photo in photos), np.zeros(size)))


def _of_cameras(
    photos: Mapping[str, WeighedPhoto],
    body: Body,
    found: NDArray[np.bool_],
    errors: Sequence[SharedError],
    motion_of: Callable[[Floats], Motion],
    length: float,
    size: int,
) -> Floats:
    """Scores of errors of poses or lenses, last of their second order. A sphere that was found goes with them."""
    everyone = list(photos.values())
    scenes = [photo.scene for photo in everyone]
    columns = []
    by_place = None
    if isinstance(body, SphereBody) and found.any():
        step = _PLACE_STEP * body.sphere.radius
        shifts = [_moved(everyone, sphere_motion(step * unit), size) for unit in np.eye(4)]
        # Per metre.
        by_place = np.stack(shifts, axis=1) / step
    curved = np.zeros(size)
    for shared in errors:
        own = [photos[label] for label in shared.photos if label in photos]
        motions = [motion_of(error) for error in (_principal(shared.covariance, length) if own else ())]
        changes = [[ray_change(photo.field, photo.scene, motion) for motion in motions] for photo in own]
        for photo, of_errors in zip(own, changes, strict=True):
            curved += photo.curved(of_errors)
        for k, motion in enumerate(motions):
            column = np.sum(
                [photo.followed(each[k]) for photo, each in zip(own, changes, strict=True)], axis=0
            )
            if by_place is not None and isinstance(body, SphereBody):
                moving = [photo in own for photo in everyone]
                column += by_place @ place_shift(body.sphere, scenes, moving, motion, found)
            columns.append(column)
    return _stacked([*columns, curved], size)


def _of_heights(photos: Sequence[WeighedPhoto], body: MeshBody, height: float, size: int) -> Floats:
    """Scores (p, draws) of a scan's noise: vertices that are off by it along their normals, independently.

    Divided so that squares of what they move add up to its mean square.
    """
    mesh, rng = body.mesh, np.random.default_rng(0)
    flat = smooth_normals(mesh.vertices, mesh.faces)
    # Vertices that a texture's seam doubles are one.
    _, same = np.unique(mesh.vertices, axis=0, return_inverse=True)
    columns = []
    for _ in range(_DRAWS):
        offsets = height * rng.standard_normal(int(same.max()) + 1)[same.ravel()]
        bent = smooth_normals(mesh.vertices + offsets[:, None] * mesh.normals, mesh.faces) - flat
        column = np.zeros(size)
        for photo in photos:
            field = photo.field
            assert field.faces is not None
            assert field.corner_weights is not None
            normals = field.normals + blended(bent, mesh.faces[field.faces], field.corner_weights)
            normals /= np.linalg.norm(normals, axis=1, keepdims=True)
            column += photo.score(photo.radiance.of(replace(field, normals=normals)) - photo.radiance.here)
        columns.append(column / np.sqrt(_DRAWS))
    return _stacked(columns, size)


def _of_directions(photos: Sequence[WeighedPhoto], lighting: Lighting, size: int) -> list[Floats]:
    """Scores (p,) of each source's direction, off by its standard deviation either way across."""
    assert lighting.direction_std_deg is not None
    columns = []
    for k, std in enumerate(np.radians(lighting.direction_std_deg)):
        for tangent in tangents(lighting.directions[k][None])[0] if std > 0 else ():
            turned = []
            for way in (0.5, -0.5):
                directions = lighting.directions.copy()
                directions[k] += way * std * tangent
                turned.append(replace(lighting, directions=directions))
            column = np.zeros(size)
            for photo in photos:
                ends = [photo.radiance.under(_one_source(one, k, photo.strengths)).here for one in turned]
                column += photo.score(ends[0] - ends[1])
            columns.append(column)
    return columns


def _one_source(lighting: Lighting, source: int, strengths: Floats) -> Light:
    """A lighting with nothing but one of its sources; strengths : of all the lighting's elements."""
    here = slice(source, source + 1)
    alone = replace(
        lighting,
        radiance_map=None,
        directions=lighting.directions[here],
        irradiances=lighting.irradiances[here],
        recover_ambient=False,
        direction_std_deg=None,
        closeness=None if lighting.closeness is None else lighting.closeness[here],
        closeness_std=None,
    )
    own = np.ones((1, 3))
    if lighting.recover_irradiance:
        # Elements are what is known, if there is anything, then the sources.
        first = len(light_elements(lighting)) - len(lighting.directions) - lighting.recover_ambient
        own = strengths[first + source][None]
    return Light(light_elements(alone), own)


def _principal(covariance: Floats, length: float) -> list[Floats]:
    """Independent errors (p,) of one standard deviation each that make up a covariance.

    length : metres, by which shifts, the second three numbers, are compared with turns.
    """
    unit = np.ones(len(covariance))
    unit[3:6] = length
    variances, directions = np.linalg.eigh(covariance / np.outer(unit, unit))
    notable = variances > _NEGLIGIBLE * max(float(variances.max()), 1e-300)
    return list((directions * np.sqrt(np.maximum(variances, 0)))[:, notable].T * unit)


def _stacked(columns: Sequence[Floats], size: int) -> Floats:
    return np.stack(columns, axis=1) if columns else np.zeros((size, 0))
