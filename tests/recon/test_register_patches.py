"""Places of features by least-squares matching, against pictures whose true places are known exactly."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from capture.camera import Camera
from recon.poses.register.bundle import Bundle
from recon.poses.register.patches import refine_places

Floats = NDArray[np.float64]

SIZE = 240
# The second photograph is the first one turned, sheared and shrunk a little, brighter and with less contrast.
MAP = np.array([[0.93, 0.12], [-0.08, 0.97]])
SHIFT = np.array([11.3, 14.7])


def _pictures(noise: float, rng: np.random.Generator) -> list[NDArray[np.uint8]]:
    grain = gaussian_filter(np.random.default_rng(0).normal(size=(SIZE, SIZE)), 1.5, mode="wrap")
    first = 128 + 40 * grain / grain.std()
    centres = np.stack(np.meshgrid(np.arange(SIZE), np.arange(SIZE)), axis=-1).reshape(-1, 2) + 0.5
    own = (centres - SHIFT) @ np.linalg.inv(MAP).T - 0.5
    second = map_coordinates(first, own[:, ::-1].T, order=5, mode="grid-wrap").reshape(SIZE, SIZE)
    second = 60 + 0.7 * second
    return [
        np.clip(np.round(picture + rng.normal(0, noise, picture.shape)), 0, 255).astype(np.uint8)
        for picture in (first, second)
    ]


def _bundle(places: Floats, guesses: Floats) -> Bundle:
    """Two photographs of points whose lines of sight make the first one's patches the reference."""
    count = len(places)
    lens = Camera("PINHOLE", np.array([500.0, 500, SIZE / 2, SIZE / 2]), SIZE, SIZE, np.eye(4))
    return Bundle(
        lenses=(lens,),
        lens=np.zeros(2, np.int64),
        poses=np.tile(np.eye(4), (2, 1, 1)),
        points=np.column_stack([(places - SIZE / 2) / 500, np.ones(count)]),
        photo=np.repeat([0, 1], count),
        point=np.tile(np.arange(count), 2),
        pixels=np.concatenate([places, guesses]),
        widths=np.ones(2 * count),
    )


@pytest.mark.parametrize("noise", [0.0, 3.0])
def test_places_are_found_to_hundredths_of_a_pixel_with_their_errors(noise: float) -> None:
    rng = np.random.default_rng(1)
    pictures = _pictures(noise, rng)
    places = rng.uniform(60, 180, (150, 2))
    truth = places @ MAP.T + SHIFT
    bundle = _bundle(places, truth + rng.normal(0, 0.4, truth.shape))
    # Shapes as SIFT has them: right within 5%.
    shapes = 2 * np.concatenate([np.tile(np.eye(2), (150, 1, 1)), MAP + rng.normal(0, 0.05, (150, 2, 2))])
    found = refine_places(bundle, shapes, lambda photo: pictures[photo], 0.3)
    off, widths = found.pixels[150:] - truth, found.widths[150:]
    moved = (found.pixels[150:] != bundle.pixels[150:]).any(axis=1)
    assert moved.mean() > 0.95
    # A hundredth of a pixel is lost to interpolation and eight bits; noise of 3 levels costs as much again.
    assert np.sqrt((off[moved] ** 2).mean()) < (0.02 if noise == 0 else 0.05)
    z = off[moved] / widths[moved, None]
    assert (
        np.sqrt((z**2).mean()) < 1.4
    )  # the reference's own noise is in the error, and only in part in the width
    np.testing.assert_array_equal(found.pixels[:150], places)  # the reference stays where it is


def test_what_matches_nothing_stays_and_counts_little() -> None:
    rng = np.random.default_rng(2)
    pictures = _pictures(0.0, rng)
    pictures[1] = pictures[1][::-1].copy()  # another surface
    places = rng.uniform(60, 180, (60, 2))
    bundle = _bundle(places, places @ MAP.T + SHIFT)
    found = refine_places(bundle, np.tile(2 * np.eye(2), (120, 1, 1)), lambda photo: pictures[photo], 0.3)
    stayed = (found.pixels[60:] == bundle.pixels[60:]).all(axis=1)
    assert stayed.mean() > 0.95
    np.testing.assert_array_equal(found.widths[60:][stayed], 0.3)
