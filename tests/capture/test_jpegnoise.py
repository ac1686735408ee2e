from __future__ import annotations

import io

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose
from PIL import Image

from capture.files.jpegtables import JpegTables, jpeg_tables
from capture.sensor.jpegnoise import jpeg_code_variance
from capture.srgb import linear_to_srgb, srgb_to_linear
from synthetic.sensing.sensor import Sensor, expose


def scene(name: str, folder) -> np.ndarray:
    """Linear light (h, w, 3), from photographs made so small that their own noise and compression are gone."""
    if name == "sphere":
        y, x = np.mgrid[-1.1:1.1:264j, -1.5:1.5:360j]
        shade = 0.05 + 0.6 * np.maximum(0.8 * np.sqrt(np.maximum(1 - x**2 - y**2, 0)) + 0.6 * x, 0)
        return np.where(x**2 + y**2 < 1, shade, 0.02)[..., None] * np.array([1, 0.9, 0.7])
    codes = cv2.imread(str(folder / name))[..., ::-1]
    small = cv2.resize(codes, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    return srgb_to_linear(small / 255)


@pytest.mark.parametrize("quality", [98, 92, 75])
@pytest.mark.parametrize("subsampling", ["4:4:4", "4:2:0"])
@pytest.mark.parametrize("name", ["mirrorball/raw1.jpg", "temple/templeSR0001.png", "sphere"])
def test_errors_are_as_large_as_stated(data_dir, name, quality, subsampling):
    rng = np.random.default_rng(quality)
    light = np.clip(scene(name, data_dir), 0, 1)
    sensor = Sensor(full_well=20_000, read_noise=6, bits=8, response="srgb")
    buffer = io.BytesIO()
    codes = expose(light, 1.0, sensor, rng)
    Image.fromarray(codes).save(buffer, "JPEG", quality=quality, subsampling=subsampling)
    pixels = np.asarray(Image.open(buffer).convert("RGB"))
    compression = jpeg_code_variance(pixels, jpeg_tables(memoryview(buffer.getvalue())))
    shown = ((light > 0.01) & (light < 0.8)).all(axis=2)
    error = 255 * linear_to_srgb(light) - pixels
    slope = (linear_to_srgb(light + 1e-5) - linear_to_srgb(light)) / 1e-5
    noise = (light / 20_000 + (6 / 20_000) ** 2) * (255 * slope) ** 2 + 1 / 12
    stated = (error**2)[shown] / (compression + noise)[shown]
    # Compression takes part of the sensor's noise away, most in smooth places; textured ones may lose more than most.
    assert 0.45 < np.sqrt(stated.mean()) < 1.3
    # Without its part a photograph of quality 75 would be off by 2 to 5 deviations.
    if quality == 75 and name != "sphere":
        assert np.sqrt(((error**2)[shown] / noise[shown]).mean()) > 2


def test_white_noise_far_above_the_steps_gains_their_variance():
    # Every coefficient survives: the error is uniform within a step, step^2 / 12 in each, whatever its place.
    rng = np.random.default_rng(3)
    grey = np.clip(np.round(rng.normal(128, 25, (256, 256))), 0, 255).astype(np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(grey).save(buffer, "JPEG", qtables=[[12] * 64])
    pixels = np.asarray(Image.open(buffer).convert("RGB"))
    tables = jpeg_tables(memoryview(buffer.getvalue()))
    stated = jpeg_code_variance(pixels, tables)
    measured = np.mean((pixels[..., 0] - grey.astype(float)) ** 2)
    # A rounding before is not in it, nor are the few values that are clipped: 2% of 12.
    assert_allclose(stated.mean(), measured, rtol=0.03)


def test_size_needs_no_whole_blocks_and_smooth_pictures_are_nearly_exact():
    tables = JpegTables(np.full((3, 8, 8), 16.0), ((1, 1), (2, 2), (2, 2)), True)
    variance = jpeg_code_variance(np.full((21, 37, 3), 90, np.uint8), tables)
    assert variance.shape == (21, 37, 3)
    # The block's mean alone, and rounding: (16^2 / 12 / 64 + 1/6) of luma, and of chroma by the squares of JFIF.
    part = 16**2 / 12 / 64 + 1 / 6
    squares = [1 + 1.402**2, 1 + 0.344136**2 + 0.714136**2, 1 + 1.772**2]
    assert_allclose(variance, np.broadcast_to(part * np.array(squares), variance.shape), rtol=1e-5)  # float32
