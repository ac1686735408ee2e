"""Lighting read off a mirror ball, against balls that are ray traced in environments known in closed form."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from capture.arc.gantry import look_at
from capture.camera import Camera
from capture.decode import decode, read_mask
from capture.lighting import latlong_directions, latlong_pixels, latlong_solid_angles
from capture.radiance import RadianceImage
from capture.source_region import SourceRegion
from recon.mirrorball.bracket import view_bracket
from recon.mirrorball.find import find_ball
from recon.mirrorball.light import BallLighting, lighting_of_ball
from recon.mirrorball.light import ball_lighting as merged_lighting
from recon.mirrorball.reflection import mirrored_directions
from recon.sphere.circle import Disk
from recon.sphere.sphere import Sphere

Floats = NDArray[np.float64]

BALL = Sphere(np.array([0.1, -0.2, 0.3]), 0.05, np.zeros((4, 4)))
TO_CAMERA = np.array([0.09, -0.07, 0.05])
# The ball fills the frame from 2.5 radii away: strongly perspective.
NEAR = Camera(
    "PINHOLE",
    [440.0, 440.0, 200.0, 200.0],
    400,
    400,
    look_at(BALL.centre + TO_CAMERA, BALL.centre + np.array([0.004, 0.0, 0.003]), (0, 0, 1)),
)
FAR = Camera(
    "ORTHOGRAPHIC",
    [3500.0, 200.0, 200.0],
    400,
    400,
    look_at(BALL.centre + np.array([0.5, -0.3, 0.2]), BALL.centre, (0, 0, 1)),
)
CAMERAS = pytest.mark.parametrize("camera", [NEAR, FAR], ids=["perspective", "orthographic"])


@dataclass(frozen=True)
class Disc:
    """A disc of light on the sphere of directions: its axis, angular radius and radiance (3,)."""

    axis: Floats
    radius_deg: float
    radiance: Floats

    @property
    def flux(self) -> Floats:
        """Radiance times solid angle, 2 pi (1 - cos a)."""
        return 2 * np.pi * (1 - np.cos(np.radians(self.radius_deg))) * self.radiance

    def __call__(self, directions: Floats) -> Floats:
        return (directions @ self.axis > np.cos(np.radians(self.radius_deg)))[..., None] * self.radiance


def smooth(directions: Floats) -> Floats:
    """A room without edges: radiance between 0.05 and 0.35, another gradient in each channel."""
    x, y, z = np.moveaxis(directions, -1, 0)
    return np.stack([0.2 + 0.1 * z + 0.05 * x, 0.2 + 0.1 * y * z, 0.15 + 0.1 * x * x - 0.05 * y], axis=-1)


def towards(camera: Camera, right_deg: float, up_deg: float) -> Floats:
    """A world direction that far to the right of and above the line from the ball to the camera."""
    a, b = np.radians([right_deg, up_deg])
    local = np.array([np.sin(a) * np.cos(b), -np.sin(b), -np.cos(a) * np.cos(b)])
    return camera.camera_to_world[:3, :3] @ local


@cache
def mirrored(camera: Camera, side: int) -> list[tuple[NDArray[np.int64], Floats]]:
    """For side x side points within each pixel: the pixels (k,) whose point shows the ball, and what these mirror."""
    offsets = (np.arange(side) + 0.5) / side
    y, x = np.mgrid[: camera.height, : camera.width]
    found = []
    for dy in offsets:
        for dx in offsets:
            hit, directions = mirrored_directions(
                BALL, camera, np.column_stack([x.ravel() + dx, y.ravel() + dy])
            )
            found.append((np.flatnonzero(hit), directions[hit]))
    return found


def photograph(
    camera: Camera, *discs: Disc, background: float | None = None, level: float = np.inf, side: int = 4
) -> tuple[RadianceImage, NDArray[np.float32]]:
    """The ball in a smooth room (or one of uniform radiance) with discs, and its mask, side^2 rays a pixel.

    level : radiance at which the sensor clips.
    """
    total = np.zeros((camera.height * camera.width, 3))
    covered = np.zeros(camera.height * camera.width)
    for pixels, directions in mirrored(camera, side):
        seen = smooth(directions) if background is None else np.full(directions.shape, background)
        for disc in discs:
            seen = seen + disc(directions)
        total[pixels] += seen
        covered[pixels] += 1
    shape = (camera.height, camera.width)
    radiance = (total / side**2).reshape(*shape, 3)
    image = RadianceImage(np.minimum(radiance, level), np.zeros((*shape, 3)), (radiance >= level).any(axis=2))
    return image, (covered / side**2).reshape(shape).astype(np.float32)


def ball_lighting(
    image: RadianceImage,
    mask: NDArray[np.float32] | None,
    camera: Camera,
    name: str,
    height: int = 64,
    region: SourceRegion | None = None,
) -> BallLighting:
    """The light that one photograph shows; region : where sources may be."""
    view = view_bracket([image], camera, name, mask, source_region=region)[0]
    return merged_lighting([view], name, height)


def angle_deg(a: Floats, b: Floats) -> float:
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


@CAMERAS
@pytest.mark.parametrize("where", [(20, 10), (-70, 30), (100, -20)])
def test_a_source_is_measured(camera: Camera, where: tuple[float, float]) -> None:
    disc = Disc(towards(camera, *where), 2.0, np.array([40.0, 30.0, 20.0]))
    image, mask = photograph(camera, disc)
    ball = ball_lighting(image, mask, camera, "ball.exr", height=32)
    assert len(ball.sources) == 1
    source = ball.sources[0]
    # A pixel mirrors 0.7 degrees; the centroid of 20 of them and the mask's quantised grey leave a tenth.
    assert angle_deg(source.direction, disc.axis) < 0.1
    # Solid angle varies across the half-lit pixels of the edge; the room beneath is subtracted as a constant.
    np.testing.assert_allclose(source.irradiance, disc.flux, rtol=0.015)
    assert not source.clipped
    assert source.angular_radius_deg == pytest.approx(2.0, abs=0.3)  # half a pixel
    assert 0 < source.direction_std_deg < 0.2


@CAMERAS
def test_the_map_shows_the_room_without_the_source(camera: Camera) -> None:
    disc = Disc(towards(camera, 40, 20), 2.0, np.full(3, 40.0))
    image, mask = photograph(camera, disc)
    ball = ball_lighting(image, mask, camera, "ball.exr")
    directions = latlong_directions(64)
    truth = smooth(directions)
    near_source = directions @ disc.axis > np.cos(np.radians(10))
    clear = ball.coverage & ~near_source
    error = np.abs(ball.radiance_map / truth - 1)
    # Nine samples of a linear interpolation of a smooth function, to float32; the steep rim costs the most.
    assert error[clear].max() < 0.02
    # Behind the source a constant stands in for the room, whose gradient it can't know.
    assert error[near_source].max() < 0.1
    areas = np.broadcast_to(latlong_solid_angles(64), ball.coverage.shape)
    unseen = areas[~ball.coverage].sum() / (4 * np.pi)
    assert ball.uncovered_share == pytest.approx(unseen, abs=0.01)  # pixels of 64 rows at the cone's edge
    # Filled from the neighbours: the room goes on with a gradient of at most 0.1 per radian.
    assert error[~ball.coverage].max() < 0.5


@CAMERAS
def test_map_and_sources_together_hold_all_the_light(camera: Camera) -> None:
    window = Disc(towards(camera, -50, 15), 25.0, np.array([3.0, 2.0, 1.0]))
    lamp = Disc(towards(camera, 60, -20), 1.5, np.full(3, 100.0))
    image, mask = photograph(camera, window, lamp, background=0.1)
    ball = ball_lighting(image, mask, camera, "ball.exr")
    assert len(ball.sources) == 1
    in_map = (ball.radiance_map * latlong_solid_angles(64)[..., None]).sum(axis=(0, 1))
    total = in_map + ball.sources[0].irradiance
    # The window's edge is sampled, not integrated; the lamp holds to 1.5 %.
    np.testing.assert_allclose(total, 0.1 * 4 * np.pi + window.flux + lamp.flux, rtol=0.015)


@pytest.mark.parametrize(
    ("discs", "background"),
    [
        ((), 0.4),
        ((), None),
        ((Disc(towards(FAR, 60, 10), 20.0, np.full(3, 5.0)),), 0.1),
    ],
    ids=["uniform", "gradient", "window"],
)
@pytest.mark.parametrize("level", [np.inf, 4.0], ids=["exposed", "clipped"])
def test_extended_light_is_no_source(discs: tuple[Disc, ...], background: float | None, level: float) -> None:
    image, mask = photograph(FAR, *discs, background=background, level=level)
    ball = ball_lighting(image, mask, FAR, "ball.exr", height=16)
    assert ball.sources == ()
    clipped_window = bool(discs) and np.isfinite(level)
    # A cap of 20 degrees is 3 % of the sphere.
    assert ball.clipped_share == pytest.approx(0.0302 if clipped_window else 0.0, abs=0.001)


def test_sensor_noise_is_no_source() -> None:
    image, mask = photograph(FAR, background=0.02)
    rng = np.random.default_rng(3)
    noisy = np.clip(image.radiance + 0.01 * rng.normal(size=image.radiance.shape), 0, 1)
    ball = ball_lighting(RadianceImage(noisy, image.variance, image.saturated), mask, FAR, "ball.exr", 16)
    assert ball.sources == ()


@CAMERAS
def test_two_sources_are_told_apart_and_sorted(camera: Camera) -> None:
    weak = Disc(towards(camera, 30, 0), 1.5, np.array([10.0, 20.0, 30.0]))
    strong = Disc(towards(camera, 42, 5), 3.0, np.full(3, 25.0))
    image, mask = photograph(camera, weak, strong)
    sources = ball_lighting(image, mask, camera, "ball.exr", height=16).sources
    assert len(sources) == 2
    for source, disc in zip(sources, (strong, weak), strict=True):
        assert angle_deg(source.direction, disc.axis) < 0.1  # as for a single one
        # The background is read from a ring that holds some of the other one's skirt.
        np.testing.assert_allclose(source.irradiance, disc.flux, rtol=0.02)


def test_a_source_outside_the_region_stays_in_the_map() -> None:
    lamp, glare = (Disc(towards(FAR, *way), 2.0, np.full(3, 50.0)) for way in ((60, -20), (-40, 30)))
    image, mask = photograph(FAR, lamp, glare, background=0.1)
    ball = ball_lighting(image, mask, FAR, "ball.exr", region=SourceRegion(lamp.axis, 0.2))
    (source,) = ball.sources
    assert angle_deg(source.direction, lamp.axis) < 0.1  # as for a single one
    # The other one's light is in the map, whose pixels have 2.8 degrees.
    place = tuple(int(p) for p in latlong_pixels(glare.axis, 64))
    near = ball.radiance_map[place[0] - 3 : place[0] + 4, place[1] - 3 : place[1] + 4]
    areas = latlong_solid_angles(64)[place[0] - 3 : place[0] + 4, :, None]
    flux = ((near - 0.1) * areas).sum(axis=(0, 1))
    assert_allclose(flux, glare.flux, rtol=0.03)  # a disc's edge in pixels of its own size
    assert len(ball_lighting(image, mask, FAR, "ball.exr", 16).sources) == 2


def test_a_clipped_source_is_flagged_and_only_its_direction_used() -> None:
    disc = Disc(towards(FAR, 20, 10), 2.0, np.full(3, 40.0))
    image, mask = photograph(FAR, disc, level=1.0)
    ball = ball_lighting(image, mask, FAR, "ball.exr")
    (source,) = ball.sources
    assert source.clipped
    assert angle_deg(source.direction, disc.axis) < 0.15  # the grown, unweighted core is off by more
    assert (source.irradiance < disc.flux).all()
    lighting = lighting_of_ball(ball, recover=None)
    # The rest of the ball is well exposed: its map stays, and only the source's brightness is left open.
    assert lighting.recovers == ("irradiance",)
    assert lighting.radiance_map is not None
    assert "ball.exr" in lighting.origin


def test_a_room_too_dark_to_be_measured_is_recovered_as_well() -> None:
    disc = Disc(towards(FAR, 20, 10), 2.0, np.full(3, 1e4))
    bright, mask = photograph(FAR, disc, level=1.0)
    # As an 8-bit file would hold it, with the room at one step above black.
    step = np.float32(1 / 255)
    radiance = np.where(bright.saturated[:, :, None], 1, np.where(bright.radiance > 0, step, 0)).astype(
        np.float32
    )
    image = RadianceImage(radiance, np.full_like(radiance, step**2 / 12), bright.saturated)
    lighting = lighting_of_ball(ball_lighting(image, mask, FAR, "dark.png"), recover=None)
    assert lighting.recovers == ("irradiance", "ambient")
    assert lighting.radiance_map is None


def test_what_is_recovered_can_be_chosen() -> None:
    disc = Disc(towards(FAR, 20, 10), 2.0, np.full(3, 40.0))
    image, mask = photograph(FAR, disc)
    ball = ball_lighting(image, mask, FAR, "ball.exr", height=16)
    known = lighting_of_ball(ball, recover=None, name="room")
    assert (known.name, known.recovers) == ("room", ())
    assert known.radiance_map is not None
    np.testing.assert_array_equal(known.irradiances[0], ball.sources[0].irradiance)
    ambient = lighting_of_ball(ball, recover=("ambient",))
    assert ambient.recovers == ("ambient",)
    assert ambient.radiance_map is None
    irradiance = lighting_of_ball(ball, recover=("irradiance",))
    assert irradiance.recovers == ("irradiance",)
    assert irradiance.radiance_map is not None


def test_stated_direction_error_covers_the_real_one() -> None:
    # Binary masks whose edge pixels are drawn by lot: the outline scatters, the error bar must follow.
    rng = np.random.default_rng(5)
    small = Camera("ORTHOGRAPHIC", [1750.0, 100.0, 100.0], 200, 200, FAR.world_to_camera)
    scores = []
    for _ in range(12):
        up, right = rng.uniform(-50, 50, 2)
        disc = Disc(towards(small, right, up), 3.0, np.full(3, 40.0))
        image, mask = photograph(small, disc, side=2)
        drawn = (rng.uniform(size=mask.shape) < mask).astype(np.float32)
        (source,) = ball_lighting(image, drawn, small, "ball.exr", height=8).sources
        scores.append((angle_deg(source.direction, disc.axis) / source.direction_std_deg) ** 2)
    # Mean of (error / std)^2 in two dimensions is 2; of 12, it lies within 0.2 and 5 but for odds of 1e-4.
    assert 0.2 < np.mean(scores) < 5


def test_a_ball_cut_off_by_the_image_is_read_as_far_as_it_goes() -> None:
    disc = Disc(towards(FAR, 20, 10), 2.0, np.full(3, 40.0))
    image, mask = photograph(FAR, disc)
    cut = slice(0, 290)
    camera = Camera("ORTHOGRAPHIC", FAR.params, 290, 400, FAR.world_to_camera)
    part = RadianceImage(image.radiance[:, cut], image.variance[:, cut], image.saturated[:, cut])
    ball = ball_lighting(part, mask[:, cut], camera, "ball.exr")
    assert angle_deg(ball.sources[0].direction, disc.axis) < 0.2  # an outline of three quarters
    # What is cut off a disk of radius 175 at 90 from its centre: a segment of 20 % of its area.
    assert ball.uncovered_share == pytest.approx(0.2, abs=0.03)
    assert np.isfinite(ball.radiance_map).all()


def test_without_a_mask_the_ball_is_found_if_it_stands_out() -> None:
    image, mask = photograph(FAR, background=0.4)
    with_mask, without = (find_ball(image, FAR, "ball.exr", given)[0] for given in (mask, None))
    # Otsu's outline is a fraction of a pixel off the grey mask's.
    assert without.radius == pytest.approx(with_mask.radius, rel=0.01)


def test_bad_photographs_are_refused_by_name() -> None:
    image, mask = photograph(FAR, background=0.4, side=2)

    def read(radiance: float = 0.4, saturated: bool = False, mask: Floats | None = mask) -> BallLighting:
        shape = image.radiance.shape
        flat = RadianceImage(np.full(shape, radiance), np.zeros(shape), np.full(shape[:2], saturated))
        return ball_lighting(flat, mask, FAR, "ball7.png")

    square = np.zeros_like(mask)
    square[60:340, 60:340] = 1
    with pytest.raises(ValueError, match=r"ball7\.png: the ball is black"):
        read(radiance=0.0)
    with pytest.raises(ValueError, match=r"ball7\.png: 100% of the ball is saturated; .* less"):
        read(saturated=True)
    with pytest.raises(ValueError, match=r"ball7\.png: its mask's outline"):
        read(mask=square)
    with pytest.raises(ValueError, match=r"ball7\.png: no mask is given"):
        read(mask=None)
    with pytest.raises(ValueError, match=r"ball7\.png: the mask is 100x400 pixels, but its camera 400x400"):
        read(mask=mask[:, :100])
    with pytest.raises(ValueError, match=r"ball7\.png: a lat-long map of 1 rows"):
        ball_lighting(image, mask, FAR, "ball7.png", height=1)


def test_photographs_of_a_chrome_ball(data_dir: Path) -> None:
    folder = data_dir / "psm"
    truth = np.loadtxt(folder / "lights.txt", skiprows=1)
    mask = read_mask(folder / "chrome" / "chrome.mask.png", (340, 512))
    # x right, y up, z towards the camera: the frame of lights.txt.
    camera = Camera("ORTHOGRAPHIC", [], 512, 340, np.diag([1, -1, -1, 1]))
    angles = []
    for index in range(0, len(truth), 2):
        image = decode(folder / "chrome" / f"chrome.{index}.png")
        ball = ball_lighting(image, mask, camera, f"chrome.{index}.png", height=16)
        (source,) = ball.sources
        assert source.clipped
        assert source.direction_std_deg < 0.5
        angles.append(angle_deg(source.direction, truth[index]))
    # The published directions are approximate: most are off the ball's by 1 to 3 degrees, a quarter by 4 to 9.
    assert np.median(angles) < 3
    assert max(angles) < 9


@pytest.mark.slow
def test_a_ball_in_a_room_is_found_without_a_hint_in_nine_megapixels(data_dir: Path, tmp_path: Path) -> None:
    room, empty = (decode(data_dir / "mirrorball" / f"raw{k}.jpg", "srgb") for k in (1, 0))

    def eye(image: RadianceImage) -> Camera:
        height, width = image.saturated.shape
        return Camera("ORTHOGRAPHIC", [], width, height, np.diag([1, -1, -1, 1]))

    factor = 2.45
    codes = cv2.imread(str(data_dir / "mirrorball" / "raw1.jpg"))
    # Of a smooth enlargement the picture of 459 pixels, in which circles are looked for first, has too many edges.
    codes = cv2.resize(codes, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC)
    cv2.imwrite(str(tmp_path / "large.jpg"), codes)
    large = decode(tmp_path / "large.jpg", "srgb")
    assert large.saturated.size > 9e6
    by_hand, _ = find_ball(room, eye(room), "raw1.jpg", disk=Disk(756, 548, 72))
    found, guessed = find_ball(large, eye(large), "large.jpg")
    assert guessed
    # By hand, the rim of small steps is found to a pixel of the photograph.
    centres = [eye(image).project(ball.centre[None])[0] for image, ball in ((large, found), (room, by_hand))]
    assert_allclose(centres[0], factor * centres[1], atol=factor)
    assert found.radius == pytest.approx(factor * by_hand.radius, abs=factor)
    with pytest.raises(ValueError, match=r"raw0\.jpg: .*likeliest circles are .*give a mask"):
        find_ball(empty, eye(empty), "raw0.jpg")
