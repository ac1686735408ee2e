from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from capture.decode import decode
from synthetic.sensing.dng import write_dng
from synthetic.sensing.sensor import RESPONSES, Sensor, expose, expose_mosaic, vignetting


@pytest.mark.parametrize("suffix", [".png", ".tif"])
@pytest.mark.parametrize(("response", "encoding"), [("linear", "linear"), ("srgb", "srgb")])
def test_signal_is_proportional_to_exposure_within_a_percent(tmp_path, suffix, response, encoding):
    rng = np.random.default_rng(1)
    radiance = np.broadcast_to(np.array([0.9, 0.5, 0.2]), (100, 120, 3))
    sensor = Sensor(response=response)
    means = []
    times = np.array([1, 1 / 2, 1 / 4, 1 / 8, 1 / 16])
    for number, time in enumerate(times):
        path = tmp_path / f"{number}{suffix}"
        assert cv2.imwrite(str(path), expose(radiance, time, sensor, rng)[..., ::-1])
        image = decode(path, encoding, exposure=time)
        assert not image.saturated.any()
        means.append(image.radiance.mean(axis=(0, 1), dtype=float))
    # 12,000 pixels with at least 250 electrons each: standard errors below 0.06%; the requirement is 1%.
    assert_allclose(means, np.broadcast_to(radiance[0, 0], (5, 3)), rtol=0.003, equal_nan=False)


def test_noise_is_the_stated_one():
    rng = np.random.default_rng(2)
    sensor = Sensor(full_well=[10_000, 20_000, 40_000], read_noise=[3, 6, 9])
    radiance = np.full((300, 400, 3), 0.25)
    signal = expose(radiance, 1.0, sensor, rng) / 65535
    expected = (0.25 * sensor.full_well + sensor.read_noise**2) / sensor.full_well**2
    # 120,000 samples: a relative standard error of the variance of 0.4%; take 4.
    assert_allclose(signal.var(axis=(0, 1)), expected, rtol=0.017, equal_nan=False)
    assert_allclose(
        signal.mean(axis=(0, 1)), 0.25, rtol=1e-4, equal_nan=False
    )  # 4 x 2% / sqrt(120,000), rounded


def test_saturation_is_the_white_level_of_every_response():
    rng = np.random.default_rng(3)
    for name in RESPONSES:
        for bits in (8, 12, 14, 16):
            codes = expose(
                np.full((4, 4, 3), 3.0), 1.0, Sensor(read_noise=[0, 0, 0], response=name, bits=bits), rng
            )
            assert_array_equal(codes, 2**bits - 1)
            assert codes.dtype == (np.uint8 if bits == 8 else np.uint16)


def test_vignetting_is_cos4_about_its_centre():
    sensor = Sensor(focal_px=50.0, centre=(10.5, 20.5))
    illumination = vignetting(sensor, 200, 100)
    assert illumination[20, 10] == 1
    # 50 pixels off axis at a focal length of 50 is 45 degrees: cos^4 = 1/4.
    assert_allclose([illumination[20, 60], illumination[70, 10]], 0.25, rtol=1e-12)


def test_mosaic_holds_each_colour_in_its_cells(tmp_path):
    import rawpy

    rng = np.random.default_rng(4)
    sensor = Sensor(bits=14)
    radiance = np.broadcast_to(np.array([0.6, 0.4, 0.1]), (200, 300, 3))
    path = tmp_path / "a.dng"
    write_dng(path, expose_mosaic(radiance, 1.0, sensor, rng, black=512), black=512, white=2**14 - 1)
    with rawpy.imread(str(path)) as raw:
        signal = (raw.raw_image_visible.astype(float) - 512) / (2**14 - 1 - 512)
        for colour, expected in ((0, 0.6), (1, 0.4), (2, 0.1), (3, 0.4)):
            cells = signal[raw.raw_colors_visible == colour]
            assert cells.mean() == pytest.approx(expected, rel=5e-4)  # 4 x 2.2% / sqrt(15,000)


def test_refuses_a_sensor_that_cannot_be():
    for fault, message in (
        ({"full_well": [0, 1, 1]}, "full_well is .* must be > 0"),
        ({"read_noise": [-1, 1, 1]}, "read_noise is .* >= 0"),
        ({"bits": 10}, "bits is 10"),
        ({"response": "velvia"}, "response 'velvia' is not known; use one of linear, srgb"),
        ({"focal_px": 0.0}, "focal_px is 0"),
    ):
        with pytest.raises(ValueError, match=message):
            Sensor(**fault)


def test_what_is_too_bright_has_one_code_whatever_the_read_noise():
    sensor = Sensor(full_well=1000, read_noise=20, bits=16)
    codes = expose(np.full((50, 60, 3), 2.0), 1.0, sensor, np.random.default_rng(5))
    assert_array_equal(codes, 65535)
