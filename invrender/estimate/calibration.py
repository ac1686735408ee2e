"""What errors of calibration do to the numbers of a fit, to first order: scores of the photographs' changes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.calibrationerrors import CalibrationErrors, SharedError
from capture.camera import Camera
from capture.lighting import Lighting
from invrender.estimate.explanation import Explanation
from invrender.estimate.extinction import is_crossed
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
    picture_shift,
    pose_motion,
    ray_change,
    sphere_motion,
)
from recon.displacement.sphere import place_shift
from recon.mesh.bodies import Body, MeshBody, SphereBody, blended
from recon.mesh.scannoise import scan_noise
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
    turns: Floats | None = None,
) -> dict[str, Floats]:
    """Scores (p, q) of each cause, by its name, one column for each of its q errors of one standard deviation.

    A score is the sum over samples of weighted derivatives times the radiance that the error changes; times the
    inverse of the information it is what the error moves. photos : read only where there are errors. found : (4,), what
    of a sphere's centre and radius its outlines gave, so that it follows cameras that are elsewhere. lightings : known.
    Errors of different photographs, lenses and sources are independent. turns : but not of sources where photographs
    gave their directions, (2 m, 2 m), radians, the covariance about `tangents`.
    """
    if not are_any(errors, lightings):
        return {}
    directions = {name: own for name, own in lightings.items() if own.direction_std_deg is not None}
    tally = _Tally(list(photos))
    if poses := errors.poses_about(body.centre, {photo.label: photo.scene.camera for photo in tally.photos}):
        _add_cameras(tally, "poses", body, found, poses, pose_motion, body.size)
    if errors.lenses:
        _add_cameras(tally, "lenses", body, found, errors.lenses, lens_motion, 1.0)
    if errors.mesh_place is not None:
        for error in _principal(errors.mesh_place, body.size):
            motion = mesh_motion(error)
            tally.add("mesh_place", [photo.moved(motion) for photo in tally.photos])
    if errors.color is not None:
        for error in _principal(errors.color, 1.0):
            tally.add("color", [photo.field.radiance @ error.reshape(3, 3).T for photo in tally.photos])
    if errors.extinction:
        tally.add("extinction", [photo.filtered(errors.extinction) for photo in tally.photos])
    if errors.height and isinstance(body, MeshBody):
        _add_heights(tally, body, errors)
    if directions:
        columns = np.concatenate([_by_direction(tally, own) for own in directions.values()], axis=1)
        tally.enter("light_directions", columns if turns is None else columns @ _root(turns, directions))
    return tally.scores()


def are_any(errors: CalibrationErrors, lightings: Mapping[str, Lighting]) -> bool:
    """Whether errors are known of which `calibration_scores` says something."""
    return errors.named or any(own.direction_std_deg is not None for own in lightings.values())


class _Tally:
    """Scores, as they are added up, one error after the other."""

    def __init__(self, photos: Sequence[WeighedPhoto]) -> None:
        self.photos = photos
        self._columns: dict[str, list[Floats]] = {}

    def add(self, cause: str, changes: Sequence[Floats], share: float = 1.0) -> None:
        """Enter what an error changes of each photograph's samples, (n, 3), squares counting so much."""
        self.enter(cause, np.sqrt(share) * self.score(changes)[:, None])

    def score(self, changes: Sequence[Floats]) -> Floats:
        """Of changes (n, 3) of each photograph's samples, (p,)."""
        return np.asarray(sum(photo.score(own) for photo, own in zip(self.photos, changes, strict=True)))

    def enter(self, cause: str, columns: Floats) -> None:
        """Enter scores (p, q) of q errors."""
        self._columns.setdefault(cause, []).append(columns)

    def scores(self) -> dict[str, Floats]:
        return {cause: np.concatenate(columns, axis=1) for cause, columns in self._columns.items()}


@dataclass(frozen=True, eq=False)
class WeighedPhoto:
    """Some of a photograph's samples, and how much each counts in a fit's p numbers.

    weighted : per channel (n, p), derivatives of their radiance times weights. radiance : of the samples' rays under
    the lighting, whose elements have these strengths, (elements, 3). texture : (n, 3, 2), by how much the samples'
    radiance changes over a pixel of the picture, to the right and down, because the surface does; None where it is the
    same all over.
    """

    label: str
    lighting: str
    scene: SeenBody
    field: LightField
    weighted: Sequence[Floats]
    radiance: PhotoRadiance
    strengths: Floats
    _: KW_ONLY
    texture: Floats | None = None

    def score(self, change: Floats) -> Floats:
        """Of a change (n, 3) of the samples' radiance, (p,)."""
        return np.asarray(sum(own.T @ change[:, c] for c, own in enumerate(self.weighted)))

    def changed(self, radiance: Floats) -> Floats:
        """By how much the samples (n, 3) change if their rays' radiance becomes (m, 3)."""
        return np.asarray(self.field.mean_over_rays(radiance - self.radiance.here))

    def filtered(self, more: float) -> Floats:
        """By how much the samples (n, 3) change if crossed filters pass so much more of the lobe."""
        share = self.field.lobe_share
        if share is None:
            return np.zeros((len(self.field), 3))
        brighter = replace(self.field, lobe_share=share + 2 * more * is_crossed(self.field))
        return self.changed(self.radiance.of(brighter))

    def moved(self, motion: Motion) -> Floats:
        """By how much the samples (n, 3) change as the scene moves, to first order."""
        return self.followed(ray_change(self.field, self.scene, motion), motion)

    def followed(self, change: RayChange, motion: Motion) -> Floats:
        """By how much the samples (n, 3) change with their rays, which a motion moves, to first order."""
        shaded = np.asarray(self.field.mean_over_rays(self.radiance.slopes.change(change)))
        if self.texture is None:
            return shaded
        shift = self.field.mean_over_rays(picture_shift(self.field, self.scene, motion))
        return shaded - np.einsum("ncx,nx->nc", self.texture, shift)

    def curved(self, changes: Sequence[RayChange]) -> Floats:
        """The mean (n, 3) of what independent errors change to second order: they smear highlights.

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
        return self.changed(mean)


def weighed_photos(
    known: Explanation,
    labels: Sequence[str],
    cameras: Sequence[Camera],
    body: Body,
    lightings: Mapping[str, Lighting],
    shadows: Shadows | None,
) -> Iterator[WeighedPhoto]:
    """The photographs of a fit, which have these labels and cameras."""
    estimate = known.best.estimate
    parameters = pack(estimate, {photo.lighting: photo.elements for photo in known.photos})
    elements = {name: light_elements(lighting) for name, lighting in lightings.items()}
    kept = some_rays([photo.field for photo in known.photos], is_mapped(elements.values()))
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


def is_mapped(elements: Iterable[Sequence[LightElement]]) -> bool:
    """Whether any of the lightings' elements has a map, under which slopes take long."""
    return any(element.slow_map is not None for own in elements for element in own)


def some_rays(
    fields: Sequence[LightField], slow: bool
) -> Iterator[tuple[NDArray[np.bool_], LightField, float]]:
    """As much of photographs as slopes are taken of: which samples, these with few rays, and how many each stands for.

    slow : whether slopes take long, so that there shall be fewer.
    """
    thin = [field.thinned(_RAYS_OF_SAMPLE) for field in fields]
    rays = sum(len(field.ray_sample) for field in thin)
    step = max(round(rays / (_RAYS_OF_MAPS if slow else _RAYS)), 1)
    for field in thin:
        keep = np.arange(len(field)) % step == 0
        yield keep, field.where(keep), len(keep) / max(int(keep.sum()), 1)


def _add_cameras(
    tally: _Tally,
    cause: str,
    body: Body,
    found: NDArray[np.bool_],
    errors: Sequence[SharedError],
    motion_of: Callable[[Floats], Motion],
    length: float,
) -> None:
    """Enter errors of poses or lenses, to second order. A sphere that was found goes with them."""
    photos = tally.photos
    scenes = [photo.scene for photo in photos]
    sphere = body.sphere if isinstance(body, SphereBody) and found.any() else None
    by_place: list[Floats] = []
    if sphere is not None:
        step = _PLACE_STEP * sphere.radius
        shifts = [sphere_motion(step * unit) for unit in np.eye(4)]
        # Per metre.
        by_place = [np.stack([photo.moved(shift) for shift in shifts], axis=-1) / step for photo in photos]
    nothing = [np.zeros((len(photo.field), 3)) for photo in photos]
    curved = nothing.copy()
    for shared in errors:
        own = [k for k, photo in enumerate(photos) if photo.label in shared.photos]
        found_changes: dict[int, list[RayChange]] = {k: [] for k in own}
        for error in _principal(shared.covariance, length) if own else ():
            motion, shift = motion_of(error), np.zeros(4)
            if sphere is not None:
                shift = place_shift(sphere, scenes, [k in own for k in range(len(photos))], motion, found)
            changes = [each @ shift for each in by_place] or nothing.copy()
            for k in own:
                together = motion if sphere is None else _after(motion, sphere_motion(shift))
                found_changes[k].append(ray_change(photos[k].field, photos[k].scene, together))
                changes[k] = photos[k].followed(found_changes[k][-1], together)
            tally.add(cause, changes)
        second = nothing.copy()
        for k, of_errors in found_changes.items():
            second[k] = photos[k].curved(of_errors)
            curved[k] = curved[k] + second[k]
        # The square of a normal variable varies by the root of 2 about its mean.
        tally.add(cause, second, share=2.0)
    tally.add(cause, curved)


def _after(first: Motion, second: Motion) -> Motion:
    return lambda scene, way: second(first(scene, way), way)


def _add_heights(tally: _Tally, body: MeshBody, errors: CalibrationErrors) -> None:
    """Enter a scan's noise, vertices that are off by it along their normals, by draws of it."""
    mesh, rng = body.mesh, np.random.default_rng(0)
    flat = smooth_normals(mesh.vertices, mesh.faces)
    for _ in range(_DRAWS):
        offsets = scan_noise(mesh, errors.height, errors.height_correlation, rng)
        bent = smooth_normals(mesh.vertices + offsets[:, None] * mesh.normals, mesh.faces) - flat
        changes = []
        for photo in tally.photos:
            field = photo.field
            assert field.faces is not None
            assert field.corner_weights is not None
            normals = field.normals + blended(bent, mesh.faces[field.faces], field.corner_weights)
            normals /= np.linalg.norm(normals, axis=1, keepdims=True)
            changes.append(photo.changed(photo.radiance.of(replace(field, normals=normals))))
        # Squares of what draws move add up to its mean square.
        tally.add("heights", changes, share=1 / _DRAWS)


def _by_direction(tally: _Tally, lighting: Lighting) -> Floats:
    """Scores (p, 2 sources) of a lighting's sources, each turned by its standard deviation, either way across."""
    assert lighting.direction_std_deg is not None
    columns = []
    for k, std in enumerate(np.radians(lighting.direction_std_deg)):
        for tangent in tangents(lighting.directions[k][None])[0]:
            changes = []
            for photo in tally.photos:
                change = np.zeros((len(photo.field), 3))
                if photo.lighting == lighting.name and std > 0:
                    ends = [
                        photo.radiance.under(turned_source(lighting, k, turn, photo.strengths)).here
                        for turn in (std / 2 * tangent, -std / 2 * tangent)
                    ]
                    change = np.asarray(photo.field.mean_over_rays(ends[0] - ends[1]))
                changes.append(change)
            columns.append(tally.score(changes))
    return np.stack(columns, axis=1)


def _root(turns: Floats, lightings: Mapping[str, Lighting]) -> Floats:
    """A root (2 m, 2 m) of the covariance of sources' turns, in standard deviations of each."""
    stated = [own.direction_std_deg for own in lightings.values() if own.direction_std_deg is not None]
    unit = np.repeat(np.maximum(np.radians(np.concatenate(stated)), 1e-300), 2)
    variances, ways = np.linalg.eigh(turns / np.outer(unit, unit))
    return np.asarray(ways * np.sqrt(np.maximum(variances, 0)))


def turned_source(lighting: Lighting, source: int, turn: Floats, strengths: Floats) -> Light:
    """One of a lighting's sources alone, its direction turned by a little (3,) across it.

    strengths : of all the lighting's elements.
    """
    here = slice(source, source + 1)
    alone = replace(
        lighting,
        radiance_map=None,
        directions=lighting.directions[here] + turn,
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
