"""Distant lighting read off a photograph of a mirror (chrome) ball.

Each pixel of the ball mirrors one direction, so the photograph is a picture of nearly the whole sphere of
directions; only a cone behind the ball is missing, and the last directions before it are squeezed into the
ball's rim. The mirror is taken as perfect: what it absorbs scales all light alike, and the scale of light
is a gauge unless it is measured otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion
from scipy.spatial import cKDTree

from capture.arrays import frozen_array
from capture.camera import Camera
from capture.decode import RadianceImage
from capture.lighting import Lighting, latlong_directions
from recon.compact import Pixels, Spot, find_spots
from recon.lightfield import sphere_pixels
from recon.locate import View, disk_mask, locate_sphere
from recon.reflection import mirrored_directions, mirroring_points, solid_angles
from recon.sphere import Sphere

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Pixels at the ball's rim that aren't used: the lens mixes the background into them, and the first of them
# alone spans tens of degrees.
_RIM_PX = 2
# Share of saturated ball pixels beyond which a photograph says nothing.
_MAX_SATURATED = 0.9
# Most samples along each side of a map pixel; beyond, they would only average the sensor's noise.
_MAX_SUPERSAMPLING = 8
# Mean level, in steps of the file's numbers, below which an integer photograph shows darkness, not light.
_FEWEST_STEPS = 3.0


@dataclass(frozen=True, eq=False)
class BallSource:
    """A compact bright source, as a mirror ball shows it.

    direction : (3,) unit, world, towards the source.
    irradiance : (3,), on a plane that faces the source, in the photograph's unit of radiance times sr.
    angular_radius_deg : of the disc with the same solid angle.
    direction_std_deg : standard deviation of the direction in any tangent direction, from the scatter of
        the ball's outline and the pixel grid. A mask that is too large all round is not in it: radius off
        by a share e turns a direction at angle a from the camera's by 2 e tan(a / 2) radians.
    clipped : has saturated pixels: the irradiance is only a lower bound.
    """

    direction: Floats
    irradiance: Floats
    angular_radius_deg: float
    direction_std_deg: float
    clipped: bool

    def __post_init__(self) -> None:
        object.__setattr__(self, "direction", frozen_array(self.direction))
        object.__setattr__(self, "irradiance", frozen_array(self.irradiance))


@dataclass(frozen=True, eq=False)
class BallLighting:
    """What a mirror ball shows of the light around it.

    name : of the photograph, for messages and results.
    sphere : the ball, in the world; seen from one place its distance is a gauge.
    radiance_map : (H, 2H, 3) float32 lat-long radiance in the world frame (`capture.lighting`), without the
        sources; filled from neighbours where nothing was seen.
    coverage : (H, 2H) bool, the map's pixels that were seen.
    uncovered_share : share of the sphere of directions that was not seen.
    clipped_share : share of the sphere of directions, sources apart, where the photograph is saturated: the
        map is a lower bound there.
    too_dark : all but the sources is within a few steps of the file's black, so that the map is unreliable.
    sources : brightest first.
    """

    name: str
    sphere: Sphere
    radiance_map: NDArray[np.float32]
    coverage: Mask
    uncovered_share: float
    clipped_share: float
    too_dark: bool
    sources: tuple[BallSource, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "radiance_map", frozen_array(self.radiance_map, np.float32))
        object.__setattr__(self, "coverage", frozen_array(self.coverage, np.bool_))


def ball_lighting(
    image: RadianceImage,
    coverage: NDArray[np.float32] | None,
    camera: Camera,
    name: str,
    height: int = 64,
) -> BallLighting:
    """Read distant lighting off a photograph of a mirror ball.

    coverage : (h, w) mask of the ball in 0 to 1, which may be cut off by the image's edge; None to look for
        the ball, which must then stand out bright from the background.
    camera : perspective or orthographic; its pose gives the world frame of all directions.
    name : of the photograph, for messages. height : rows of the lat-long map, >= 2.

    ValueError names the photograph if sizes disagree, if no ball is found or the mask is not a ball's
    outline, and if the ball is black or saturated.
    """
    if height < 2:
        raise ValueError(f"{name}: a lat-long map of {height} rows is asked for; it must have at least 2")
    _check_size(image.radiance, camera, f"{name}: the photograph")
    if coverage is None:
        coverage = _bright_disk(image, camera, name)
    _check_size(coverage, camera, f"{name}: the mask")
    sphere = locate_sphere([View(name, camera, coverage)])
    pixels = _mirrored_pixels(sphere, camera, image, coverage)
    _check_exposed(pixels, name)
    spots, filled, in_spot = find_spots(pixels)
    radiance_map, seen = _latlong(sphere, camera, filled, pixels.usable, height)
    clipped = pixels.usable & pixels.saturated & ~in_spot
    rest = pixels.usable & ~in_spot
    step = np.sqrt(12 * image.variance[rest].mean())
    return BallLighting(
        name=name,
        sphere=sphere,
        radiance_map=radiance_map,
        coverage=seen,
        uncovered_share=max(0.0, 1 - float(pixels.solid_angles[pixels.usable].sum()) / (4 * np.pi)),
        clipped_share=float(pixels.solid_angles[clipped].sum()) / (4 * np.pi),
        too_dark=bool(filled[rest].mean() < _FEWEST_STEPS * step),
        sources=tuple(_source(sphere, camera, spot) for spot in spots),
    )


def lighting_of_ball(
    ball: BallLighting, recover: tuple[str, ...] | None, name: str | None = None
) -> Lighting:
    """The lighting that a ball shows, with what of it is left to be recovered.

    recover : any of "irradiance" and "ambient"; None for what the photograph calls for: nothing if no source
        is clipped, else its irradiance, and the ambient as well if all the rest is too dark to be known.
        With "ambient", a uniform radiance that is fitted stands in for the map.
    name : of the lighting; the photograph's where none is given.
    """
    if recover is None:
        recover = ()
        if any(source.clipped for source in ball.sources):
            recover = ("irradiance", "ambient") if ball.too_dark else ("irradiance",)
    return Lighting(
        name=ball.name if name is None else name,
        radiance_map=None if "ambient" in recover else ball.radiance_map,
        directions=np.array([source.direction for source in ball.sources]),
        irradiances=np.array([source.irradiance for source in ball.sources]),
        direction_std_deg=np.array([source.direction_std_deg for source in ball.sources]),
        recover_irradiance="irradiance" in recover,
        recover_ambient="ambient" in recover,
        origin=f"mirror ball {ball.name}",
    )


def _check_size(pixels: NDArray[np.generic], camera: Camera, what: str) -> None:
    height, width = pixels.shape[:2]
    if (height, width) != (camera.height, camera.width):
        raise ValueError(f"{what} is {width}x{height} pixels, but its camera {camera.width}x{camera.height}")


def _bright_disk(image: RadianceImage, camera: Camera, name: str) -> NDArray[np.float32]:
    try:
        return disk_mask(name, camera, image.radiance)
    except ValueError as error:
        raise ValueError(
            f"{name}: no mask is given and no ball stands out from the background; give a mask (an image of"
            " the same size, nonzero where the ball is)"
        ) from error


def _mirrored_pixels(
    sphere: Sphere, camera: Camera, image: RadianceImage, coverage: NDArray[np.float32]
) -> Pixels:
    """What each pixel of the ball mirrors, computed only where the ball is."""
    h, w = coverage.shape
    rows, columns = sphere_pixels(sphere, camera)
    on_ball = np.zeros((h, w), bool)
    on_ball[rows, columns] = True
    # Beyond the image's edge nothing is known to be wrong: only the ball's own rim is taken off.
    usable = binary_erosion(on_ball & (coverage >= 0.5), np.ones((3, 3)), iterations=_RIM_PX, border_value=1)
    rows, columns = np.nonzero(usable)
    directions = np.zeros((h, w, 3))
    areas = np.zeros((h, w))
    at = np.column_stack([columns, rows]).astype(float)
    directions[rows, columns] = mirrored_directions(sphere, camera, at + 0.5)[1]
    # Pixels share corners, but the ball's pixels are few enough to trace each corner four times.
    square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], float)
    corners = [mirrored_directions(sphere, camera, at + corner)[1] for corner in square]
    areas[rows, columns] = solid_angles(np.stack(corners))
    return Pixels(np.asarray(image.radiance, float), image.saturated, usable, directions, areas)


def _check_exposed(pixels: Pixels, name: str) -> None:
    if not pixels.usable.any():
        raise ValueError(f"{name}: no pixel of the ball is usable; it is too small or its mask misses it")
    if not pixels.radiance[pixels.usable].max() > 0:
        raise ValueError(f"{name}: the ball is black, it mirrors no light; check the mask, or expose longer")
    saturated = float(pixels.saturated[pixels.usable].mean())
    if saturated > _MAX_SATURATED:
        raise ValueError(f"{name}: {saturated:.0%} of the ball is saturated; photograph it exposed less")


def _latlong(
    sphere: Sphere, camera: Camera, radiance: Floats, usable: Mask, height: int
) -> tuple[NDArray[np.float32], Mask]:
    """The lat-long map (H, 2H, 3) of what the usable pixels mirror, and which of its pixels they cover.

    Samples lie on an equal-area grid within each map pixel, as dense as the ball's own pixels, so that a
    map pixel is the mean over the ball pixels that mirror it.
    """
    per_side = int(np.clip(np.ceil(np.pi / height * sphere.pixel_radius(camera) / 2), 3, _MAX_SUPERSAMPLING))
    offsets = (np.arange(per_side) + 0.5) / per_side
    edges = np.cos(np.arange(height + 1) * np.pi / height)
    z = edges[:-1, None] + np.diff(edges)[:, None] * offsets
    phi = (np.arange(2 * height)[:, None] + offsets) * np.pi / height
    source = radiance.astype(np.float32)
    mapped = np.zeros((height, 2 * height, 3), np.float32)
    seen = np.zeros((height, 2 * height), bool)
    for row in range(height):
        directions = _directions(z[row][:, None, None], phi).reshape(-1, 3)
        visible, points = mirroring_points(sphere, camera, directions)
        column, line = np.floor(np.where(visible[:, None], points, -1.0)).astype(int).T
        inside = (column >= 0) & (line >= 0) & (column < usable.shape[1]) & (line < usable.shape[0])
        inside[inside] = usable[line[inside], column[inside]]
        # OpenCV puts the first pixel's centre at (0, 0), the camera at (0.5, 0.5).
        at = np.where(inside[:, None], points - 0.5, 0.0).astype(np.float32)
        values = cv2.remap(
            source, at[:, None, 0], at[:, None, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        grid = (per_side, 2 * height, per_side)
        count = inside.reshape(grid).sum(axis=(0, 2))
        total = (values.reshape(-1, 3) * inside[:, None]).reshape(*grid, 3).sum(axis=(0, 2))
        mapped[row] = total / np.maximum(count, 1)[:, None]
        seen[row] = 2 * count >= per_side**2
    if not seen.all() and seen.any():
        mapped[~seen] = _from_neighbours(mapped, seen)
    return mapped, seen


def _from_neighbours(mapped: NDArray[np.float32], seen: Mask) -> NDArray[np.float32]:
    """Values (n, 3) for the unseen pixels: the mean over the seen ones that are nearest in direction."""
    directions = latlong_directions(len(mapped))
    count = min(8, int(seen.sum()))
    _, nearest = cKDTree(directions[seen]).query(directions[~seen], k=count)
    return np.asarray(mapped[seen][nearest.reshape(-1, count)].mean(axis=1))


def _source(sphere: Sphere, camera: Camera, spot: Spot) -> BallSource:
    std = np.hypot(spot.centroid_std, _outline_std(sphere, camera, spot))
    return BallSource(
        direction=spot.direction,
        irradiance=spot.irradiance,
        angular_radius_deg=float(np.degrees(spot.angular_radius)),
        direction_std_deg=float(np.degrees(std)),
        clipped=spot.clipped,
    )


def _outline_std(sphere: Sphere, camera: Camera, spot: Spot) -> float:
    """Standard deviation in radians, in any tangent direction, that the ball's fit leaves to a direction."""
    _, point = mirroring_points(sphere, camera, spot.direction[None])
    _, direction = mirrored_directions(sphere, camera, point)
    values, vectors = np.linalg.eigh(sphere.covariance)
    variance = 0.0
    for value, vector in zip(values, vectors.T, strict=True):
        step = np.sqrt(max(value, 0.0)) * vector
        moved = Sphere(sphere.centre + step[:3], sphere.radius + step[3], sphere.covariance)
        variance += float(((mirrored_directions(moved, camera, point)[1] - direction) ** 2).sum())
    # The sum is over two tangent directions.
    return float(np.sqrt(variance / 2))


def _directions(z: Floats, phi: Floats) -> Floats:
    """Unit directions (..., 3) of heights z above the equator and azimuths phi, broadcast."""
    z, phi = np.broadcast_arrays(z, phi)
    ring = np.sqrt(1 - z**2)
    return np.stack([ring * np.cos(phi), ring * np.sin(phi), z], axis=-1)
