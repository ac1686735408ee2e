"""Several views of a mirror ball, brackets, and finding the ball, against a room that is ray traced here.

The tracer shares no code with what it judges: its own look-at, intersection and reflection, and the room is a
formula of direction.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from capture.camera import Camera
from capture.decode import decode
from capture.lighting import latlong_directions, latlong_solid_angles
from capture.radiance import RadianceImage
from recon.mirrorball.bracket import view_bracket
from recon.mirrorball.circle import Disk
from recon.mirrorball.find import find_ball
from recon.mirrorball.light import ball_lighting
from recon.mirrorball.register import registered
from recon.mirrorball.view import BallView

Floats = NDArray[np.float64]
Room = Callable[[Floats], Floats]
Bulb = Callable[[Floats, Floats], Floats]

SIZE, FOCAL, RADIUS, DISTANCE = 260, 700.0, 0.05, 0.35
# The ball's outline in pixels: tan(asin(r / d)) f, on the axis.
OUTLINE = FOCAL * RADIUS / np.sqrt(DISTANCE**2 - RADIUS**2)
LAMP_AXIS = np.array([0.5, 0.45, np.sqrt(1 - 0.25 - 0.2025)])
LAMP_DEG = 2.5
SUN = 2 * np.pi * (1 - np.cos(np.radians(LAMP_DEG))) * np.array([60.0, 50.0, 40.0])


def room(directions: Floats) -> Floats:
    """Walls of changing brightness, a window: radiance 0.1 to 1.5, another colour all round."""
    x, y, z = np.moveaxis(directions, -1, 0)
    walls = 0.35 + 0.1 * np.sin(3 * x + 1) + 0.08 * np.cos(4 * y - 2 * z) + 0.05 * np.sin(5 * z)
    window = 1.0 / (1 + np.exp(-40 * (0.3 - np.hypot(y + 0.9, x - 0.2)))) * (y < 0)
    return np.stack([walls + window, walls * 0.9 + 0.05 * x + window, walls * 0.8 + 1.2 * window], axis=-1)


def with_lamp(directions: Floats) -> Floats:
    inside = directions @ LAMP_AXIS > np.cos(np.radians(LAMP_DEG))
    return room(directions) + inside[..., None] * np.array([60.0, 50.0, 40.0])


def camera_at(azimuth_deg: float, elevation_deg: float = 0.0) -> Camera:
    """A camera that looks at the ball in the origin, z up."""
    a, e = np.radians([azimuth_deg, elevation_deg])
    place = DISTANCE * np.array([np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)])
    forward = -place / DISTANCE
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    pose = np.eye(4)
    pose[:3, :3] = right, np.cross(forward, right), forward
    pose[:3, 3] = -pose[:3, :3] @ place
    return Camera("PINHOLE", [FOCAL, FOCAL, SIZE / 2, SIZE / 2], SIZE, SIZE, pose)


def rendered(
    camera: Camera, light: Room, behind: Room | None, side: int = 3, bulb: Bulb | None = None
) -> tuple[Floats, Floats]:
    """Radiance (h, w, 3) of the ball before a distant backdrop, and the ball's share (h, w) of each pixel.

    bulb : radiance that points on the ball meet in directions, beside the distant light.
    """
    pose = np.asarray(camera.world_to_camera)
    place = -pose[:3, :3].T @ pose[:3, 3]
    total, covered = np.zeros((SIZE, SIZE, 3)), np.zeros((SIZE, SIZE))
    for dy in (np.arange(side) + 0.5) / side:
        for dx in (np.arange(side) + 0.5) / side:
            v, u = np.mgrid[:SIZE, :SIZE]
            local = np.stack(
                [(u + dx - SIZE / 2) / FOCAL, (v + dy - SIZE / 2) / FOCAL, np.ones((SIZE, SIZE))], axis=-1
            )
            rays = local @ pose[:3, :3]
            rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
            b = rays @ place
            discriminant = b**2 - place @ place + RADIUS**2
            hit = discriminant > 0
            points = place + (-b - np.sqrt(np.maximum(discriminant, 0)))[..., None] * rays
            normals = points / RADIUS
            mirrored = rays - 2 * (rays * normals).sum(axis=-1, keepdims=True) * normals
            seen = np.zeros_like(rays) if behind is None else behind(rays)
            seen[hit] = light(mirrored[hit])
            if bulb is not None:
                seen[hit] += bulb(points[hit], mirrored[hit])
            total += seen
            covered += hit
    return total / side**2, covered / side**2


def exposed(radiance: Floats, variance: float = 0.0) -> RadianceImage:
    return RadianceImage(
        radiance.astype(np.float32),
        np.full(radiance.shape, variance, np.float32),
        np.zeros(radiance.shape[:2], bool),
    )


def viewed(camera: Camera, light: Room, name: str, bulb: Bulb | None = None, **options: object) -> BallView:
    radiance, mask = rendered(camera, light, None, bulb=bulb)
    return view_bracket([exposed(radiance)], camera, name, mask.astype(np.float32), **options)[0]  # type: ignore[arg-type]


def hidden_camera(camera: Camera, light: Room) -> Room:
    axis = -np.asarray(camera.world_to_camera)[2, :3]
    return lambda d: light(d) * np.where(d @ axis > np.cos(np.radians(9.0)), 0.02, 1.0)[..., None]


@pytest.fixture(scope="module")
def pair() -> tuple[BallView, BallView]:
    """Two views of one room at right angles, in each of which a dark camera is mirrored."""
    first, second = camera_at(0, 10), camera_at(90, -5)
    return (
        viewed(first, hidden_camera(first, with_lamp), "first"),
        viewed(second, hidden_camera(second, with_lamp), "second"),
    )


def map_error(radiance_map: NDArray[np.float32], where: NDArray[np.bool_] | None = None) -> float:
    """RMS difference from the room, relative to its RMS, over all directions; the lamp's surroundings left out."""
    directions = latlong_directions(len(radiance_map))
    count = directions @ LAMP_AXIS < np.cos(np.radians(12))
    count = count if where is None else count & where
    weight = np.broadcast_to(latlong_solid_angles(len(radiance_map)), count.shape)[count][:, None]
    truth = room(directions)[count]
    return float(np.sqrt((weight * (radiance_map[count] - truth) ** 2).sum() / (weight * truth**2).sum()))


def test_two_views_show_what_each_lacks(pair: tuple[BallView, BallView]) -> None:
    single = [ball_lighting([view], view.name, 48) for view in pair]
    merged = ball_lighting(pair, "both", 48)
    errors = [map_error(ball.radiance_map) for ball in single]
    # Each lacks a cone behind it of 16 degrees and the camera; filled from neighbours they are a third off.
    assert map_error(merged.radiance_map) < 0.5 * min(errors)
    assert map_error(merged.radiance_map) < 0.04  # nine samples of a window's edge in each pixel of 4 degrees
    assert min(ball.uncovered_share for ball in single) > 0.02
    assert merged.uncovered_share == 0
    directions = latlong_directions(48)
    for view in pair:
        at_camera = directions @ -view.camera.world_to_camera[2, :3] > np.cos(np.radians(9))
        # The other view sees it from the side, where a pixel turns the direction by a degree.
        assert map_error(merged.radiance_map, at_camera) < 0.05
    assert merged.warnings == ()
    assert all(each.factor == pytest.approx(1, abs=0.01) for each in merged.agreement)


def test_a_source_in_two_views_is_one_and_better_known(pair: tuple[BallView, BallView]) -> None:
    merged = ball_lighting(pair, "both", 24)
    (source,) = merged.sources
    assert source.views == ("first", "second")
    error = np.degrees(np.arccos(source.direction @ LAMP_AXIS))
    assert error < 3 * source.direction_std_deg
    for view in pair:
        assert source.direction_std_deg < view.sources[0].direction_std_deg
        assert (source.irradiance_std < view.sources[0].irradiance_std).all()
    np.testing.assert_allclose(source.irradiance, SUN, rtol=0.02)  # the pixels' grid, as for a single view
    # Not counted twice: what one view took out the other must not put back.
    light = (merged.radiance_map * latlong_solid_angles(24)[..., None]).sum(axis=(0, 1)) + source.irradiance
    directions = latlong_directions(192)
    truth = (room(directions) * latlong_solid_angles(192)[..., None]).sum(axis=(0, 1)) + SUN
    np.testing.assert_allclose(light, truth, rtol=0.01)  # sampling of the window's edge


def test_a_source_that_one_view_alone_takes_out_is_hidden_in_the_other(
    pair: tuple[BallView, BallView],
) -> None:
    blind = replace(
        pair[1], sources=(), without_sources=pair[1].pixels.radiance, in_source=pair[1].in_source & False
    )
    merged = ball_lighting((pair[0], blind), "both", 48)
    near = latlong_directions(48) @ LAMP_AXIS > np.cos(np.radians(5))
    # The room is below 2; the lamp would put 50 times as much there.
    assert merged.radiance_map[near].max() < 2


def test_wrong_poses_are_noticed(pair: tuple[BallView, BallView]) -> None:
    turned = camera_at(60, -5)
    radiance, mask = rendered(camera_at(90, -5), with_lamp, None)
    moved, _ = view_bracket([exposed(radiance)], turned, "second", mask.astype(np.float32))
    warnings = " ".join(ball_lighting([pair[0], moved], "both", 24).warnings)
    assert "check the poses" in warnings


def test_reflectance_is_divided_out_per_channel() -> None:
    camera = camera_at(30)
    share = np.array([0.5, 0.4, 0.8])
    full = viewed(camera, with_lamp, "ball")
    dim = viewed(camera, lambda d: with_lamp(d) * share, "ball", reflectance=tuple(share))
    np.testing.assert_allclose(dim.sources[0].irradiance, full.sources[0].irradiance, rtol=1e-5)  # float32
    np.testing.assert_allclose(
        ball_lighting([dim], "ball", 8).radiance_map, ball_lighting([full], "ball", 8).radiance_map, rtol=1e-5
    )
    with pytest.raises(ValueError, match=r"ball: the ball's reflectance is .*1\.2.* at most 1"):
        viewed(camera, room, "ball", reflectance=(1.2, 1, 1))


def test_the_camera_is_masked_but_not_a_lamp_on_it() -> None:
    camera = camera_at(30)
    to_camera = -np.asarray(camera.world_to_camera)[2, :3]
    flash: Room = lambda d: room(d) + (d @ to_camera > np.cos(np.radians(2)))[..., None] * np.full(3, 50.0)  # noqa: E731
    masked = viewed(camera, flash, "ball", camera_mask_deg=15.0)
    whole = viewed(camera, flash, "ball", camera_mask_deg=0.0)
    assert not whole.in_camera_mask.any()
    # The solid angle of the cone, in pixels at its edge.
    cone = masked.pixels.solid_angles[masked.in_camera_mask].sum()
    assert cone == pytest.approx(2 * np.pi * (1 - np.cos(np.radians(15))), rel=0.05)
    assert masked.sources[0].direction @ to_camera > np.cos(np.radians(0.5))
    lost = [ball_lighting([view], "ball", 64).uncovered_share for view in (masked, whole)]
    assert lost[0] - lost[1] == pytest.approx(cone / (4 * np.pi), abs=0.002)  # pixels of 64 rows


def test_a_bracket_measures_what_the_longest_exposure_clips() -> None:
    rng = np.random.default_rng(2)
    camera = camera_at(45, 5)
    radiance, mask = rendered(camera, with_lamp, room)
    scores = []
    for _ in range(3):
        images = []
        for exposure, shift in ((1.0, 0), (1 / 8, 1), (1 / 64, 2)):
            # The camera sinks by a pixel between exposures; shot and read noise, 10 bits, white at 1.
            shifted = np.roll(radiance, shift, axis=0)
            photons = rng.poisson(np.minimum(shifted * exposure, 2) * 20_000) / 20_000
            noisy = photons + 0.001 * rng.normal(size=shifted.shape)
            codes = np.clip(np.round(noisy * 1023), 0, 1023)
            variance = (
                np.maximum(shifted * exposure, 0) / 20_000 + 0.001**2 + (1 / 1023) ** 2 / 12
            ) / exposure**2
            images.append(
                RadianceImage(
                    (codes / 1023 / exposure).astype(np.float32),
                    variance.astype(np.float32),
                    (codes >= 1023).any(axis=2),
                )
            )
        view, _ = view_bracket(
            images, camera, "bracket", mask.astype(np.float32), exposures=(1.0, 1 / 8, 1 / 64)
        )
        source = view.sources[0]
        assert not source.clipped
        np.testing.assert_allclose(
            view.bracket_factors, 1, atol=0.02
        )  # noise of the darkest, clipped at black
        scores.append((source.irradiance - SUN) / source.irradiance_std)
        alone, _ = view_bracket(images[:1], camera, "long", mask.astype(np.float32))
        assert all(source.clipped for source in alone.sources)
        assert alone.pixels.radiance[alone.pixels.saturated].max() < 2  # the lamp is 60
    scores = np.abs(scores)
    # The grid's error is the same in all draws, so that this is no sample of independent ones: none may be far off.
    assert scores.max() < 3
    np.testing.assert_allclose(source.irradiance, SUN, rtol=0.03)


def stand(directions: Floats) -> Floats:
    """What is behind the ball: the room, nearer and busier."""
    x, y, z = np.moveaxis(directions, -1, 0)
    stripes = 0.25 + 0.2 * np.sign(np.sin(60 * y) * np.sin(45 * z + 3 * x))
    return np.stack([stripes, stripes * 0.8, stripes * 0.6], axis=-1)


@pytest.mark.parametrize("exposure", [1.0, 0.3])
def test_the_ball_is_found_against_the_empty_room_and_by_hand(exposure: float) -> None:
    rng = np.random.default_rng(4)
    camera = camera_at(20, 5)
    radiance, _ = rendered(camera, room, stand)
    empty = np.roll(
        rendered(camera, stand, stand)[0], 1, axis=1
    )  # the camera was touched: a pixel to the right
    # A rod carries the ball, and casts a shadow on what is behind.
    half = SIZE // 2
    radiance[half + 90 :, half - 12 : half + 12] = 0.05
    radiance[half + 100 :, :half] *= 0.93
    noise = 0.004 * rng.normal(size=(2, *radiance.shape))
    photo = exposed(np.abs(radiance * exposure + noise[0]))
    background = exposed(np.abs(empty + noise[1]))
    for given in ({"background": background}, {"disk": Disk(half + 3, half - 2, OUTLINE - 3)}):
        sphere, _ = find_ball(photo, camera, "ball", **given)  # type: ignore[arg-type]
        # The rim mirrors what is behind it, and so seems to begin up to half a pixel further in.
        np.testing.assert_allclose(camera.project(sphere.centre[None])[0], half, atol=0.6)
        assert sphere.pixel_radius(camera) == pytest.approx(OUTLINE, abs=0.8)


def test_a_ball_that_is_not_there_is_not_found() -> None:
    camera = camera_at(20)
    empty = exposed(rendered(camera, stand, stand, side=1)[0])
    with pytest.raises(ValueError, match=r"nothing round differs from the background; .* mask"):
        find_ball(empty, camera, "ball", background=empty)
    flat = exposed(np.full((SIZE, SIZE, 3), 0.3))
    with pytest.raises(ValueError, match=r"only 0% of the ball's outline can be seen near column 130"):
        find_ball(flat, camera, "ball", disk=Disk(130, 130, 90))
    with pytest.raises(ValueError, match=r"no ball can lie .* radius of 2 pixels"):
        find_ball(flat, camera, "ball", disk=Disk(130, 130, 2))
    with pytest.raises(ValueError, match="the background is 10x10 pixels, but its camera 260x260"):
        find_ball(empty, camera, "ball", background=exposed(np.ones((10, 10, 3))))
    with pytest.raises(ValueError, match=r"give a mask .* \(background\), .* \(ball\)"):
        find_ball(flat, camera, "ball")


@pytest.mark.slow
def test_views_are_turned_to_each_other_by_what_they_show() -> None:
    first, second = camera_at(0, 10), camera_at(75, -15)
    views = [viewed(first, with_lamp, "first"), viewed(second, with_lamp, "second")]
    # As if nothing were known of the second: its camera in the first one's place.
    radiance, mask = rendered(second, with_lamp, None)
    lost, _ = view_bracket([exposed(radiance)], first, "second", mask.astype(np.float32))
    (_, found), turns = registered([views[0], lost])
    relative = found.camera.world_to_camera[:3, :3] @ second.world_to_camera[:3, :3].T
    error = np.degrees(np.arccos(np.clip((np.trace(relative) - 1) / 2, -1, 1)))
    # A rotation's angle is the length of three numbers with this standard deviation each.
    assert error < 4 * turns[1].std_deg
    assert error < 1
    assert turns[1].std_deg < 1
    even: Room = lambda d: np.stack([0.2 + 0.1 * d[..., 2] ** 2] * 3, axis=-1)  # noqa: E731
    with pytest.raises(ValueError, match="second: how it is turned to first cannot be determined"):
        registered([viewed(first, even, "first"), viewed(second, even, "second")])


@pytest.mark.slow
def test_the_bracket_of_a_ball_in_a_room(data_dir: Path) -> None:
    folder = data_dir / "mirrorball"
    # 19.8 mm on a sensor 23.5 mm wide.
    camera = Camera("SIMPLE_PINHOLE", [1264.0, 750.0, 500.0], 1500, 1000, np.diag([1.0, -1.0, -1.0, 1.0]))
    images = [
        decode(folder / f"raw{k}.jpg", "srgb", seconds)
        for k, seconds in ((1, 1 / 10), (2, 1 / 40), (3, 1 / 160))
    ]
    background = decode(folder / "raw0.jpg", "srgb", 1 / 40)
    seconds = (1 / 10, 1 / 40, 1 / 160)
    view, _ = view_bracket(images, camera, "room", background=background, exposures=seconds)
    by_hand, _ = view_bracket(images[:1], camera, "room", disk=Disk(758, 551, 70))
    # Read off an enlargement with a ruler: columns 683 to 828, topmost row 476.
    for each in (view, by_hand):
        centre = camera.project(each.sphere.centre[None])[0]
        np.testing.assert_allclose([*centre, each.radius_px], [755.5, 549, 72.5], atol=1.2)
    ball = ball_lighting([view], "room", 64)
    # The camera's curve is steeper than sRGB's, and the user is told.
    assert "a curve of their own" in " ".join(ball.warnings)
    directions = latlong_directions(64)
    weight = latlong_solid_angles(64)
    blue = ball.radiance_map[..., 2] * weight
    # The window is right of the camera and a little above it: in the photograph 27 px right of the ball's middle and 12
    # above, where the normal leans by 24 degrees, so that its light comes from twice that.
    bright = ball.radiance_map[..., 2] > 0.5 * np.percentile(ball.radiance_map[..., 2], 99.5)
    mean = (directions * (blue * bright)[..., None]).sum(axis=(0, 1))
    x, y, z = mean / np.linalg.norm(mean)
    assert np.degrees(np.arctan2(x, z)) == pytest.approx(47, abs=8)
    assert np.degrees(np.arcsin(y)) == pytest.approx(12, abs=8)
    assert 0.05 < ball.uncovered_share < 0.15
    # The ceiling's spots are behind the ball: up, and away from the camera.
    spots = [s for s in ball.sources if s.direction[1] > 0.6 and s.direction[2] < -0.3]
    assert len(spots) == 2
