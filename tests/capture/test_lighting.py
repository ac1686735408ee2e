from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from capture.files.imagefile import write_exr
from capture.lighting import (
    Lighting,
    check_latlong,
    latlong_directions,
    latlong_pixels,
    latlong_solid_angles,
    read_latlong,
)

AXES = {"+X": [1.0, 0, 0], "+Y": [0, 1.0, 0], "-X": [-1.0, 0, 0], "-Y": [0, -1.0, 0], "+Z": [0, 0, 1.0]}


@pytest.mark.parametrize("height", [1, 2, 7, 64])
def test_solid_angles_cover_the_sphere_exactly(height):
    omega = np.broadcast_to(latlong_solid_angles(height), (height, 2 * height))
    assert omega.sum() == pytest.approx(4 * np.pi, rel=1e-13)
    # The integral of z^2 over the sphere is 4 pi / 3; the midpoint rule misses it by (pi / height)^2 at most.
    z = latlong_directions(height)[..., 2]
    assert (omega * z**2).sum() == pytest.approx(4 * np.pi / 3, rel=(np.pi / height) ** 2)


def test_directions_are_those_of_the_convention():
    # Row r at theta = (r + 0.5) pi / H from +Z, column c at phi = (c + 0.5) 2 pi / W from +X towards +Y.
    directions = latlong_directions(4)
    assert directions.shape == (4, 8, 3)
    theta, phi = 1.5 * np.pi / 4, 2.5 * 2 * np.pi / 8
    by_hand = [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]
    assert_allclose(directions[1, 2], by_hand, atol=1e-15)
    assert_allclose(np.linalg.norm(directions, axis=-1), 1, atol=1e-15, equal_nan=False)


def test_the_axes_land_where_the_convention_says():
    height = 10
    row, column = latlong_pixels(np.array(list(AXES.values())), height)
    assert_allclose(row, [5, 5, 5, 5, 0], atol=1e-14)
    assert_allclose(column[:4], [0, 5, 10, 15], atol=1e-14)
    assert latlong_pixels(np.array([0, 0, -1.0]), height)[0] == 10


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 1e-12), (np.float32, 2e-5)])
def test_directions_to_pixels_is_the_inverse(dtype, tolerance):
    height = 16
    row, column = latlong_pixels(latlong_directions(height).astype(dtype), height)
    expected_row, expected_column = np.mgrid[:height, : 2 * height] + 0.5
    # Rounding of the directions' dtype, which near the poles arccos enlarges by 1 / theta.
    assert_allclose(row, expected_row, atol=tolerance, equal_nan=False)
    assert_allclose(column, expected_column, atol=tolerance, equal_nan=False)


def test_a_lighting_holds_unit_directions_and_read_only_arrays():
    radiance = np.ones((2, 4, 3))
    lighting = Lighting("key", radiance, [[0, 0, 2], [3, 0, 4]], [[1, 1, 1], [0, 2, 0]], recover_ambient=True)
    assert_allclose(lighting.directions, [[0, 0, 1], [0.6, 0, 0.8]], atol=1e-15)
    assert lighting.recovers == ("ambient",)
    radiance[:] = 0
    assert (lighting.radiance_map == 1).all()
    with pytest.raises(ValueError, match="read-only"):
        lighting.irradiances[0] = 1
    dark = Lighting("dark", None, [], [])
    assert dark.directions.shape == dark.irradiances.shape == (0, 3)
    assert Lighting("all", None, [[1, 0, 0]], [[1, 1, 1]], True, True).recovers == ("irradiance", "ambient")


@pytest.mark.parametrize(
    ("radiance", "directions", "irradiances", "message"),
    [
        (None, [[0, 0, 0]], [[1, 1, 1]], "'key': a source direction is zero"),
        (None, [[0, np.nan, 0]], [[1, 1, 1]], "'key': a source direction is zero or not finite"),
        (None, [[0, 0, 1]], [], "'key': 1 directions but 0 irradiances"),
        (None, [[0, 0, 1]], [[1, -1, 1]], "'key': an irradiance is negative"),
        (None, [[0, 0, 1]], [[1, np.inf, 1]], "'key': an irradiance is negative or not finite"),
        (
            np.ones((2, 5, 3)),
            [],
            [],
            r"'key': map is 5x2 pixels; a lat-long map is RGB and twice as wide as high",
        ),
        (np.ones((2, 4)), [], [], r"'key': map is 4x2 pixels; a lat-long map is RGB"),
        (np.ones((0, 0, 3)), [], [], r"'key': map is 0x0 pixels"),
        (np.full((2, 4, 3), np.nan), [], [], "'key': map holds 24 values that are not finite"),
        (np.full((2, 4, 3), -0.5), [], [], r"'key': map holds negative radiance \(lowest -0.5\)"),
    ],
)
def test_a_bad_lighting_is_named(radiance, directions, irradiances, message):
    with pytest.raises(ValueError, match=message):
        Lighting("key", radiance, directions, irradiances)


def test_a_map_is_read_as_it_was_written(tmp_path):
    radiance = np.random.default_rng(1).uniform(0, 50, (4, 8, 3)).astype(np.float32)
    write_exr(tmp_path / "room.exr", radiance)
    assert_array_equal(read_latlong(tmp_path / "room.exr"), radiance)
    assert cv2.imwrite(str(tmp_path / "room.hdr"), radiance[..., ::-1])
    # RGBE: 8 bits of mantissa for the brightest channel, cut off, so at most 1/128 of it.
    error = np.abs(read_latlong(tmp_path / "room.hdr") - radiance) / radiance.max(axis=-1, keepdims=True)
    assert error.max() < 1 / 128


def test_published_probes_are_lat_long_maps(data_dir):
    assert read_latlong(data_dir / "probes" / "Grace_Cathedral.hdr").shape == (250, 500, 3)


@pytest.mark.parametrize(
    ("radiance", "message"),
    [
        (np.ones((4, 4, 3)), r"bad\.exr is 4x4 pixels"),
        (np.zeros((2, 4, 3)), r"bad\.exr: the lighting map is zero everywhere"),
        (np.full((2, 4, 3), np.inf), r"bad\.exr holds 24 values that are not finite"),
        (np.full((2, 4, 3), -1.0), r"bad\.exr holds negative radiance"),
    ],
)
def test_a_bad_map_file_is_named(tmp_path, radiance, message):
    write_exr(tmp_path / "bad.exr", radiance)
    with pytest.raises(ValueError, match=message):
        read_latlong(tmp_path / "bad.exr")


def test_a_map_that_is_not_linear_is_refused(tmp_path):
    assert cv2.imwrite(str(tmp_path / "room.png"), np.ones((2, 4, 3), np.uint8))
    with pytest.raises(
        ValueError, match=r"room\.png: a lighting map must be EXR or Radiance \.hdr \(linear\)"
    ):
        read_latlong(tmp_path / "room.png")


def test_a_black_map_is_no_fault_of_the_check_itself():
    check_latlong(np.zeros((1, 2, 3)), "darkness")
