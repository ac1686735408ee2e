"""Photographs of a sphere as a sensor takes them: means over pixels, with noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array
from capture.camera import Camera
from recon.sphere import Sphere
from synthetic.lights.arealight import AreaLight
from synthetic.lights.sources import DirectionalSource
from synthetic.materials.microfacet import Microfacet
from synthetic.render.lobes import reflected_radiance

Floats = NDArray[np.float64]

# A pixel's mean is taken over Gauss-Legendre points, 2 to 6 per side: so many that the normal turns by at most
# this from one to the next, radians. (Midpoints, 2 per side, have only 3/4 of a pixel's second moment; the
# missing blur shows as a highlight that is too narrow: 0.1% in sigma at 45 px radius.)
_TURN_PER_SUBSAMPLE = 0.015
_FEWEST_SUBSAMPLES, _MOST_SUBSAMPLES = 2, 6
# Coverage is told in 256 steps, as an 8-bit mask stores it.
_SUBSAMPLES_OF_COVERAGE = 16


@dataclass(frozen=True)
class Noise:
    """Gaussian sensor noise of two independent parts.

    relative : standard deviation as a share of the pixel's own radiance.
    floor : standard deviation in every pixel, as a share of the sphere's mean radiance in the photograph.
    """

    relative: float = 0.01
    floor: float = 0.001

    def __post_init__(self) -> None:
        if not (0 <= self.relative < np.inf and 0 <= self.floor < np.inf):
            raise ValueError(f"noise is {self.relative} relative and {self.floor} floor; both must be >= 0")


@dataclass(frozen=True, eq=False)
class SphereScene:
    """A homogeneous sphere under distant light, in front of black, and where it is photographed from.

    centre : (3,) metres. radius : metres. cameras : one per photograph.
    held_out : indices of photographs that are kept for scoring. seed : of the sensor's noise.
    """

    name: str
    material: Microfacet
    area_lights: tuple[AreaLight, ...]
    sources: tuple[DirectionalSource, ...]
    centre: Floats
    radius: float
    cameras: tuple[Camera, ...]
    noise: Noise = Noise()
    held_out: tuple[int, ...] = ()
    seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", frozen_array(self.centre))
        if not self.area_lights and not self.sources:
            raise ValueError(f"scene {self.name!r} has no light; give an area light or a source")
        for index, camera in enumerate(self.cameras):
            if not camera.is_orthographic and camera.depth(self.centre)[0] <= self.radius:
                raise ValueError(f"scene {self.name!r}: the sphere is not in front of camera {index}")
        beyond = [index for index in self.held_out if not 0 <= index < len(self.cameras)]
        if beyond:
            raise ValueError(
                f"scene {self.name!r}: held_out names photograph {beyond[0]}, counted from 0,"
                f" but there are {len(self.cameras)}"
            )

    @property
    def sphere(self) -> Sphere:
        return Sphere(self.centre, self.radius, np.zeros((4, 4)))


def render(
    scene: SphereScene, camera: Camera, rng: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """A photograph (h, w, 3) float32, linear and noisy, and the coverage mask (h, w) float32 in 0 to 1."""
    radiance, coverage = expose(scene, camera)
    on_sphere = coverage > 0
    floor = scene.noise.floor * radiance[on_sphere].mean() if on_sphere.any() else 0.0
    deviation = np.hypot(scene.noise.relative * radiance, floor)
    photo = radiance + deviation * rng.standard_normal(radiance.shape)
    return photo.astype(np.float32), coverage.astype(np.float32)


def expose(scene: SphereScene, camera: Camera) -> tuple[Floats, Floats]:
    """The photograph without noise (h, w, 3) and its coverage (h, w): means over each pixel's square."""
    sphere = scene.sphere
    coverage = pixel_coverage(sphere, camera)
    rows, columns = np.nonzero(coverage)
    pixels = np.column_stack([columns, rows])
    _, normals, views = _surface(sphere, camera, pixels + 0.5)
    cos_o = np.maximum((normals * views).sum(axis=1), 1e-3)
    turn = 1 / (sphere.pixel_radius(camera) * cos_o)
    per_side = np.clip(np.ceil(turn / _TURN_PER_SUBSAMPLE), _FEWEST_SUBSAMPLES, _MOST_SUBSAMPLES).astype(int)
    radiance = np.zeros((camera.height, camera.width, 3))
    for count in np.unique(per_side):
        chosen = per_side == count
        radiance[rows[chosen], columns[chosen]] = _pixel_means(scene, camera, pixels[chosen], count)
    return radiance, coverage


def pixel_coverage(sphere: Sphere, camera: Camera) -> Floats:
    """Share of each pixel's square that the sphere covers, (h, w), 0 to 1."""
    y, x = np.mgrid[: camera.height + 1, : camera.width + 1]
    hit, _, _ = _surface(sphere, camera, np.column_stack([x.ravel(), y.ravel()]))
    corners = hit.reshape(x.shape)
    rows_of_two = corners[:-1].astype(int) + corners[1:]
    count = rows_of_two[:, :-1] + rows_of_two[:, 1:]
    # A pixel with no corner on the sphere is grazed by the outline at most: below 1/256 from 10 px radius on.
    coverage = (count == 4).astype(float)
    rows, columns = np.nonzero((count > 0) & (count < 4))
    middles = (np.arange(_SUBSAMPLES_OF_COVERAGE) + 0.5) / _SUBSAMPLES_OF_COVERAGE
    points = _subsamples(np.column_stack([columns, rows]), middles)
    hit, _, _ = _surface(sphere, camera, points)
    coverage[rows, columns] = hit.reshape(len(rows), -1).mean(axis=1)
    return coverage


def _pixel_means(scene: SphereScene, camera: Camera, pixels: NDArray[np.int64], per_side: int) -> Floats:
    """Mean radiance (n, 3) over pixels (n, 2) given as (column, row); what misses the sphere is black."""
    node, weight = np.polynomial.legendre.leggauss(per_side)
    weights = np.outer(weight, weight).ravel() / 4
    hit, normals, views = _surface(scene.sphere, camera, _subsamples(pixels, (node + 1) / 2))
    radiance = np.zeros((len(hit), 3))
    radiance[hit] = reflected_radiance(
        scene.material, scene.area_lights, scene.sources, normals[hit], views[hit]
    )
    return np.asarray(weights @ radiance.reshape(len(pixels), per_side**2, 3))


def _subsamples(pixels: NDArray[np.int64], steps: Floats) -> Floats:
    """Image points (n * s^2, 2), pixel by pixel: the grid of s `steps` (0 to 1) in each pixel (column, row)."""
    offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    return (pixels[:, None, :] + offsets).reshape(-1, 2)


def _surface(
    sphere: Sphere, camera: Camera, points: NDArray[np.number]
) -> tuple[NDArray[np.bool_], Floats, Floats]:
    """Whether the sphere is at image points (n, 2); its normals and the directions to the viewer, (n, 3)."""
    origins, directions = camera.rays(points)
    hit, normals = sphere.hits(origins, directions)
    return hit, normals, -directions
