"""What one view of a mirror ball shows: pixel by pixel the light that it mirrors, and the compact sources.

Each pixel of the ball mirrors one direction, so a photograph is a picture of nearly the whole sphere of
directions; only a cone behind the ball is missing, and the last directions before it are squeezed into the
ball's rim. The mirror's reflectance is one number per channel, whatever the angle: metals and silvered glass
change by a few percent up to 80 degrees of incidence, which only the rim sees (Fresnel is out of scope here).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion

from capture.arrays import frozen_array
from capture.camera import Camera
from capture.radiance import RadianceImage
from capture.source_region import SourceRegion
from recon.mesh.bodies import SphereBody, body_pixels
from recon.mirrorball.compact import Pixels, Spot, find_spots
from recon.mirrorball.reflection import mirrored_directions, mirroring_points, solid_angles
from recon.sphere.sphere import Sphere, to_camera

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Half-angle of the cone of directions about the camera's that holds the camera, its tripod and most of who
# stands behind it: a photographer's head and shoulders at two metres.
CAMERA_MASK_DEG = 10.0
# Pixels at the ball's rim that aren't used: the lens mixes the background into them, and the first of them
# alone spans tens of degrees.
_RIM_PX = 2
# Share of saturated ball pixels beyond which a photograph says nothing.
_MAX_SATURATED = 0.9


@dataclass(frozen=True, eq=False)
class BallSource:
    """A compact bright source, as a mirror ball shows it.

    direction : (3,) unit, world, towards the source.
    irradiance : (3,), on a plane that faces the source, in the photograph's unit of radiance times sr.
    irradiance_std : (3,), its standard deviation: noise, the background under the source, the pixel grid and
        the scatter of the ball's outline. A wrong response curve or reflectance is not in it.
    angular_radius_deg : of the disc with the same solid angle.
    direction_std_deg : standard deviation of the direction in any tangent direction, from the scatter of
        the ball's outline and the pixel grid. A mask that is too large all round is not in it: radius off
        by a share e turns a direction at angle a from the camera's by 2 e tan(a / 2) radians.
    clipped : has saturated pixels: the irradiance is only a lower bound.
    views : names of the views in which it was found.
    closeness, closeness_std : 1 / metres, one over the distance from the ball's centre; 0 of one far away. Direction
        and irradiance of a near source are what the ball's centre sees.
    """

    direction: Floats
    irradiance: Floats
    irradiance_std: Floats
    angular_radius_deg: float
    direction_std_deg: float
    clipped: bool
    views: tuple[str, ...]
    closeness: float = 0.0
    closeness_std: float = 0.0

    def __post_init__(self) -> None:
        for name in ("direction", "irradiance", "irradiance_std"):
            object.__setattr__(self, name, frozen_array(getattr(self, name)))


@dataclass(frozen=True, eq=False)
class BallView:
    """One view of a mirror ball: a photograph, or a bracket merged to one.

    name : for messages and results. camera : its rotation gives the world frame of all directions.
    sphere : the ball in that camera's world; seen from one place its distance is a gauge.
    corner : (x, y), the pixel of the photograph where the arrays below begin; they show only the ball.
    pixels : what each pixel mirrors, radiance divided by the mirror's reflectance.
    without_sources : (h, w, 3) radiance with the sources replaced by what surrounds them.
    in_source : (h, w) bool, the pixels that were replaced.
    in_camera_mask : (h, w) bool, the pixels that mirror the camera and what stands behind it.
    sources : brightest first.
    bracket_factors : of a bracket, how many times as bright each photograph shows the ball as the one before it;
        1 where exposures and response are right. Empty for a single photograph.
    guessed : the ball was taken for the clearest round outline, since nothing said where it is.
    """

    name: str
    camera: Camera
    sphere: Sphere
    corner: tuple[int, int]
    pixels: Pixels
    without_sources: Floats
    in_source: Mask
    in_camera_mask: Mask
    sources: tuple[BallSource, ...]
    bracket_factors: tuple[float, ...] = ()
    guessed: bool = False

    @property
    def in_map(self) -> Mask:
        """The pixels (h, w) that a map is made from."""
        return self.pixels.usable & ~self.in_camera_mask

    @property
    def radius_px(self) -> float:
        return self.sphere.pixel_radius(self.camera)


def view_ball(
    image: RadianceImage,
    sphere: Sphere,
    coverage: NDArray[np.float32] | None,
    camera: Camera,
    name: str,
    reflectance: Sequence[float] = (1.0, 1.0, 1.0),
    camera_mask_deg: float = CAMERA_MASK_DEG,
    source_region: SourceRegion | None = None,
) -> BallView:
    """What a photograph of a mirror ball shows of the light around it.

    sphere : the ball (`recon.mirrorball.find`). coverage : (h, w) mask in 0 to 1 beyond which nothing is used, since
        something stands in front of the ball there; None if nothing does.
    reflectance : of the mirror per channel, in (0, 1]: radiance is divided by it.
    camera_mask_deg : half-angle of the cone of directions about the camera's that is left out of maps. Compact
        sources are kept: cameras don't shine.
    source_region : where compact sources may be, in the world; None for anywhere.

    ValueError names the photograph if no pixel is usable, and if the ball is black or saturated.
    """
    if not all(0 < share <= 1 for share in reflectance):
        raise ValueError(
            f"{name}: the ball's reflectance is {list(reflectance)}; each channel's must be above 0 and at most 1"
        )
    corner, pixels = _mirrored_pixels(sphere, camera, image, coverage, name, np.asarray(reflectance, float))
    _check_exposed(pixels, name)
    spots, without_sources, in_source = find_spots(pixels, source_region)
    # So that a mask of 0 is none, whatever a direction's rounding.
    nearest = np.cos(np.radians(camera_mask_deg)) if camera_mask_deg > 0 else np.inf
    return BallView(
        name=name,
        camera=camera,
        sphere=sphere,
        corner=corner,
        pixels=pixels,
        without_sources=without_sources,
        in_source=in_source,
        in_camera_mask=pixels.usable & (pixels.directions @ to_camera(sphere, camera)[0] > nearest),
        sources=tuple(_source(sphere, camera, spot, name) for spot in spots),
    )


def _mirrored_pixels(
    sphere: Sphere,
    camera: Camera,
    image: RadianceImage,
    coverage: NDArray[np.float32] | None,
    name: str,
    reflectance: Floats,
) -> tuple[tuple[int, int], Pixels]:
    """What each pixel of the ball mirrors, in a window about it, and the window's first pixel (x, y)."""
    size = np.array(image.saturated.shape)
    rows, columns = body_pixels(SphereBody(sphere), camera)
    if not len(rows):
        raise ValueError(f"{name}: no pixel of the ball is usable; it is too small or its mask misses it")
    low = np.maximum([rows.min() - _RIM_PX, columns.min() - _RIM_PX], 0)
    high = np.minimum([rows.max() + _RIM_PX + 1, columns.max() + _RIM_PX + 1], size)
    window = (slice(low[0], high[0]), slice(low[1], high[1]))
    on_ball = np.zeros(high - low, bool)
    on_ball[rows - low[0], columns - low[1]] = True
    if coverage is not None:
        on_ball &= coverage[window] >= 0.5
    # Beyond the image's edge nothing is known to be wrong: only the ball's own rim is taken off.
    usable = binary_erosion(on_ball, np.ones((3, 3)), iterations=_RIM_PX, border_value=1)
    rows, columns = np.nonzero(usable)
    directions = np.zeros((*usable.shape, 3))
    areas, stretch = np.zeros(usable.shape), np.zeros(usable.shape)
    at = np.column_stack([columns + low[1], rows + low[0]]).astype(float)
    directions[rows, columns] = mirrored_directions(sphere, camera, at + 0.5)[1]
    traced = np.zeros((usable.shape[0] + 1, usable.shape[1] + 1), bool)
    square = [(0, 0), (1, 0), (1, 1), (0, 1)]  # x, y
    for x, y in square:
        traced[rows + y, columns + x] = True
    down, across = np.nonzero(traced)
    at_corners = np.column_stack([across + low[1], down + low[0]]).astype(float)
    lattice = np.zeros((*traced.shape, 3))
    lattice[traced] = mirrored_directions(sphere, camera, at_corners)[1]
    corners = np.stack([lattice[rows + y, columns + x] for x, y in square])
    areas[rows, columns] = solid_angles(corners)
    stretch[rows, columns] = _stretch(corners)
    return (int(low[1]), int(low[0])), Pixels(
        radiance=np.asarray(image.radiance[window], float) / reflectance,
        variance=np.asarray(image.variance[window], float) / reflectance**2,
        saturated=image.saturated[window],
        usable=usable,
        directions=directions,
        solid_angles=areas,
        stretch=stretch,
    )


def _stretch(corners: Floats) -> Floats:
    """The largest turn (n,) in radians of the mirrored direction per pixel, of pixels with corners (4, n, 3)."""
    right = (corners[1] + corners[2] - corners[0] - corners[3]) / 2
    down = (corners[2] + corners[3] - corners[0] - corners[1]) / 2
    xx, yy, xy = ((a * b).sum(axis=-1) for a, b in ((right, right), (down, down), (right, down)))
    # The largest singular value of the 3x2 matrix of both.
    return np.asarray(np.sqrt((xx + yy) / 2 + np.hypot((xx - yy) / 2, xy)))


def _check_exposed(pixels: Pixels, name: str) -> None:
    if not pixels.usable.any():
        raise ValueError(f"{name}: no pixel of the ball is usable; it is too small or its mask misses it")
    if not pixels.radiance[pixels.usable].max() > 0:
        raise ValueError(f"{name}: the ball is black, it mirrors no light; check the mask, or expose longer")
    saturated = float(pixels.saturated[pixels.usable].mean())
    if saturated > _MAX_SATURATED:
        raise ValueError(f"{name}: {saturated:.0%} of the ball is saturated; photograph it exposed less")


def _source(sphere: Sphere, camera: Camera, spot: Spot, name: str) -> BallSource:
    turn, swelling = _outline_std(sphere, camera, spot)
    return BallSource(
        direction=spot.direction,
        irradiance=spot.irradiance,
        irradiance_std=np.hypot(spot.irradiance_std, spot.irradiance * swelling),
        angular_radius_deg=float(np.degrees(spot.angular_radius)),
        direction_std_deg=float(np.degrees(np.hypot(spot.centroid_std, turn))),
        clipped=spot.clipped,
        views=(name,),
    )


def _outline_std(sphere: Sphere, camera: Camera, spot: Spot) -> tuple[float, float]:
    """What the ball's fit leaves in doubt: of a direction, in radians in any tangent direction, and of the
    solid angle that a pixel mirrors there, as a share."""
    _, point = mirroring_points(sphere, camera, spot.direction[None])
    square = point + np.array([(0, 0), (-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])
    direction, *corners = mirrored_directions(sphere, camera, square)[1]
    area = solid_angles(np.stack(corners))
    values, vectors = np.linalg.eigh(sphere.covariance)
    turn, swelling = 0.0, 0.0
    for value, vector in zip(values, vectors.T, strict=True):
        step = np.sqrt(max(value, 0.0)) * vector
        moved = Sphere(sphere.centre + step[:3], sphere.radius + step[3], sphere.covariance)
        there, *corners = mirrored_directions(moved, camera, square)[1]
        turn += float(((there - direction) ** 2).sum())
        swelling += float((solid_angles(np.stack(corners)) / area - 1) ** 2)
    # The turn's sum is over two tangent directions.
    return float(np.sqrt(turn / 2)), float(np.sqrt(swelling))
