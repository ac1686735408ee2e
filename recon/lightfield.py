"""Light-field samples: radiance with the normal and the view that it belongs to, photo by photo."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion

from capture.arrays import frozen_array
from capture.camera import Camera
from capture.radiance import RadianceImage
from recon.sphere import Sphere

Floats = NDArray[np.float64]

# Exitant angles beyond 81 degrees are left out: the microfacet model grows without bound there
# (RH01 section 5.2: grazing observations "are usually assigned low confidence anyway").
MIN_COS_EXITANT = 0.15
# A pixel across which the normal turns by more than a quarter of a radian says nothing of one angle.
_MAX_TURN = 0.25
# (turn, rays per side): a pixel across which the normal turns by less than the first is one ray through its
# centre; others are grids of 2-point Gauss rules. One rule in all would make 1 / cos theta_o, as the model
# has it, 2.6% too small at cos theta_o = 0.15 on a sphere of 53 px.
_RAYS_PER_SIDE = ((0.02, 1), (0.08, 2), (np.inf, 4))
# Rays that are traced at once, to bound memory; and how many times the budget is looked at in choosing it.
_RAYS_AT_A_TIME, _SPARE = 200_000, 8
# Cosine to a source within which its disc may be cut by the horizon: a lamp of a degree's radius.
_PENUMBRA = 0.02


@dataclass(frozen=True, eq=False)
class LightField:
    """Samples of one photograph. A sample is a pixel; where the surface curves within it, several rays.

    rows, columns : (n,) int, the pixels.
    radiance, variance : (n, 3) float64, linear.
    ray_sample : (m,) int, ascending: the sample that each ray belongs to; a sample is its rays' mean.
    normals, views : (m, 3) unit; outward, and towards the camera.
    """

    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    radiance: Floats
    variance: Floats
    ray_sample: NDArray[np.int64]
    normals: Floats
    views: Floats

    def __post_init__(self) -> None:
        if len(self.rows) != len(self.radiance) or len(self.ray_sample) != len(self.normals):
            raise ValueError(
                f"{len(self.rows)} pixels for {len(self.radiance)} radiances, {len(self.ray_sample)} rays for"
                f" {len(self.normals)} normals; lengths must agree"
            )
        for name in ("rows", "columns", "ray_sample"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), np.int64))
        for name in ("radiance", "variance", "normals", "views"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))

    def __len__(self) -> int:
        return len(self.rows)

    def mean_over_rays(self, values: NDArray[np.floating]) -> NDArray[np.floating]:
        """Means (n, ...) over each sample's rays of per-ray values (m, ...)."""
        if len(values) == len(self):
            return values
        starts = np.flatnonzero(np.diff(self.ray_sample, prepend=-1))
        counts = np.diff(starts, append=len(values))
        sums = np.add.reduceat(values, starts, axis=0)
        return sums / counts.reshape(-1, *[1] * (values.ndim - 1)).astype(values.dtype)

    def where(self, keep: NDArray[np.bool_]) -> LightField:
        """The samples marked by a mask (n,)."""
        rays = keep[self.ray_sample]
        return LightField(
            rows=self.rows[keep],
            columns=self.columns[keep],
            radiance=self.radiance[keep],
            variance=self.variance[keep],
            ray_sample=(np.cumsum(keep) - 1)[self.ray_sample[rays]],
            normals=self.normals[rays],
            views=self.views[rays],
        )

    @property
    def cos_exitant(self) -> Floats:
        """Cosine of the exitant angle, (n,), mean over the pixel."""
        return np.asarray(self.mean_over_rays((self.normals * self.views).sum(axis=1)))

    @property
    def sample_normals(self) -> Floats:
        """Mean normal of each sample, (n, 3), not renormalised."""
        return np.asarray(self.mean_over_rays(self.normals))


def off_terminators(field: LightField, directions: Floats) -> LightField:
    """The samples in which none of the sources (k, 3) rises or sets.

    There the light is neither on nor off: a source has a size, a pixel a width, and the model's highlight
    ends abruptly [RH01, eq. 23 has no shadowing term], so that dim pixels would carry large errors.
    """
    if not len(directions):
        return field
    cos = field.normals @ directions.T
    lit_share = np.asarray(field.mean_over_rays((cos > 0).astype(float)))
    at_horizon = np.abs(field.mean_over_rays(cos)) < _PENUMBRA
    keep = ~(((lit_share > 0) & (lit_share < 1)) | at_horizon).any(axis=1)
    return field.where(keep)


def sphere_pixels(sphere: Sphere, camera: Camera) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of the pixels whose whole square lies on the sphere."""
    (top, left), corners = _hits_in_window(sphere, camera, shift=0.0)
    whole = corners[:-1, :-1] & corners[:-1, 1:] & corners[1:, :-1] & corners[1:, 1:]
    rows, columns = np.nonzero(whole)
    return rows + top, columns + left


def sphere_coverage(sphere: Sphere, camera: Camera) -> NDArray[np.bool_]:
    """Whether rays through the pixels' centres meet the sphere, (h, w)."""
    (top, left), hit = _hits_in_window(sphere, camera, shift=0.5)
    result = np.zeros((camera.height, camera.width), bool)
    result[top : top + hit.shape[0], left : left + hit.shape[1]] = hit[
        : camera.height - top, : camera.width - left
    ]
    return result


def _hits_in_window(
    sphere: Sphere, camera: Camera, shift: float
) -> tuple[tuple[int, int], NDArray[np.bool_]]:
    """Which rays through pixel corners (`shift` = 0) or centres (0.5) meet the sphere, about its image only.

    Returns the window's first row and column, and the hits (rows, columns) within it; corners run to the
    far edge of the image. A photograph is much larger than its sphere, and rays are dear.
    """
    if not camera.is_orthographic and camera.depth(sphere.centre)[0] <= sphere.radius:
        return (0, 0), np.zeros((1, 1), bool)  # behind the camera, or around it
    # Points all over the sphere, on a spiral as even as their number allows.
    k = np.arange(600) + 0.5
    z, azimuth = 1 - 2 * k / len(k), np.pi * (1 + np.sqrt(5)) * k
    around = np.sqrt(1 - z**2)
    surface = np.stack([around * np.cos(azimuth), around * np.sin(azimuth), z], axis=-1)
    pixels = camera.project(sphere.centre + sphere.radius * surface)
    margin = 2 + 0.05 * np.nan_to_num(np.ptp(pixels, axis=0), nan=np.inf)
    edge = np.array([camera.width, camera.height]) + (shift == 0)
    low = np.clip(np.nan_to_num(pixels.min(axis=0) - margin, nan=-np.inf), 0, edge).astype(int)
    high = np.clip(np.nan_to_num(np.ceil(pixels.max(axis=0) + margin), nan=np.inf), 0, edge).astype(int)
    hit = np.zeros((high[1] - low[1], high[0] - low[0]), bool)
    band = max(_RAYS_AT_A_TIME // max(hit.shape[1], 1), 1)
    for first in range(0, len(hit), band):
        y, x = np.mgrid[low[1] + first : min(low[1] + first + band, high[1]), low[0] : high[0]]
        rays = camera.rays(np.column_stack([x.ravel(), y.ravel()]) + shift)
        hit[first : first + band] = sphere.hits(*rays)[0].reshape(y.shape)
    return (int(low[1]), int(low[0])), hit


def sample_sphere(
    sphere: Sphere,
    camera: Camera,
    image: RadianceImage,
    coverage: NDArray[np.float32] | None,
    budget: int | None,
    rng: np.random.Generator,
) -> LightField:
    """Samples of a sphere in one photograph, at most `budget` of them drawn evenly from its usable pixels.

    coverage : (h, w) mask in 0 to 1, or None to trust the sphere alone. Pixels are usable when they lie
    wholly on the sphere, a pixel away from the mask's border, are not saturated and not too grazing.
    """
    rows, columns = sphere_pixels(sphere, camera)
    usable = ~image.saturated[rows, columns]
    if coverage is not None:
        usable &= binary_erosion(coverage >= 0.999, np.ones((3, 3)), border_value=1)[rows, columns]
    rows, columns = rows[usable], columns[usable]
    if budget is not None and len(rows) > _SPARE * budget:
        drawn = np.sort(rng.choice(len(rows), _SPARE * budget, replace=False))
        rows, columns = rows[drawn], columns[drawn]
    cos, turn = _grazing(sphere, camera, rows, columns)
    keep = np.flatnonzero((cos >= MIN_COS_EXITANT) & (turn <= _MAX_TURN))
    if budget is not None and len(keep) > budget:
        keep = np.sort(rng.choice(keep, budget, replace=False))
    return _gather(sphere, camera, image, rows[keep], columns[keep], turn[keep])


def samples_at(
    sphere: Sphere,
    camera: Camera,
    image: RadianceImage,
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
) -> LightField:
    """The samples of given pixels that lie wholly on the sphere, usable for a fit or not."""
    _, turn = _grazing(sphere, camera, rows, columns)
    return _gather(sphere, camera, image, rows, columns, turn)


def _grazing(
    sphere: Sphere, camera: Camera, rows: NDArray[np.int64], columns: NDArray[np.int64]
) -> tuple[Floats, Floats]:
    """Exitant cosine at pixels' centres, and the angle by which the normal turns across each, radians."""
    origins, directions = camera.rays(np.column_stack([columns, rows]) + 0.5)
    _, normals = sphere.hits(origins, directions)
    cos = -(normals * directions).sum(axis=1)
    return cos, 1 / (sphere.pixel_radius(camera) * np.maximum(cos, 1e-9))


def _gather(
    sphere: Sphere,
    camera: Camera,
    image: RadianceImage,
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    turn: Floats,
) -> LightField:
    limits = [limit for limit, _ in _RAYS_PER_SIDE]
    sides = [side for _, side in _RAYS_PER_SIDE]
    per_side = np.array(sides)[np.searchsorted(limits, turn)]
    ray_sample = np.repeat(np.arange(len(rows)), per_side**2)
    first = np.flatnonzero(np.diff(ray_sample, prepend=-1))
    which = np.arange(len(ray_sample)) - first[ray_sample]
    offsets = np.zeros((len(ray_sample), 2))
    for side in sides:
        mine = per_side[ray_sample] == side
        nodes = _gauss_nodes(side)
        offsets[mine] = np.column_stack([nodes[which[mine] % side], nodes[which[mine] // side]])
    points = np.column_stack([columns, rows])[ray_sample] + 0.5 + offsets
    origins, directions = camera.rays(points)
    _, normals = sphere.hits(origins, directions)
    return LightField(
        rows=rows,
        columns=columns,
        radiance=image.radiance[rows, columns].astype(np.float64),
        variance=image.variance[rows, columns].astype(np.float64),
        ray_sample=ray_sample,
        normals=normals,
        views=-directions,
    )


def _gauss_nodes(count: int) -> Floats:
    """Nodes (count,) of equal weight across a pixel, -0.5 to 0.5: its centre, or 2-point Gauss rules abreast."""
    if count == 1:
        return np.zeros(1)
    rules = count // 2
    centres = (np.arange(rules) + 0.5) / rules - 0.5
    return (centres[:, None] + np.array([-0.5, 0.5]) / np.sqrt(3) / rules).ravel()
