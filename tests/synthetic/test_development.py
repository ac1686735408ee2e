"""Radiance to camera files and back, as capture decodes them."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from capture.decode import decode, decode_in_set
from capture.exposure import ExposureSettings, read_exif_exposure
from capture.files.imagefile import read_pixels
from capture.manifest import RadiometryTable
from capture.radiance import RadianceImage
from capture.radiometry import read_radiometry
from synthetic.sensing.autoexposure import choose_exposure, object_brightness
from synthetic.sensing.development import Development, WrittenShot, write_photograph
from synthetic.sensing.noise import Noise
from synthetic.sensing.radiometryfiles import true_response, write_radiometry
from synthetic.sensing.sensor import RESPONSES, Sensor, signal_of

HEIGHT, WIDTH = 180, 240
# What every sensor here has: noise that shows, and a lens that takes half of the light in the corners.
LENS = {"full_well": 20_000, "read_noise": 6, "focal_px": 250}


def smooth_radiance(rng: np.random.Generator) -> np.ndarray:
    """Two stops of brightness, far from the unit of the sensor, the same in no two channels."""
    field = cv2.GaussianBlur(rng.normal(size=(HEIGHT, WIDTH, 3)), (0, 0), 12)
    return 40 * np.exp2(0.5 * field / field.std(axis=(0, 1)))


def photographed(
    folder: Path, radiance: np.ndarray, development: Development, rng: np.random.Generator
) -> RadianceImage:
    """Exposed automatically, written, and decoded by the calibration files and manifest keys that come with it."""
    covered = np.ones(radiance.shape[:2])
    time = choose_exposure([object_brightness(radiance, covered, development.sensor)], development)
    keys = write_radiometry(folder, development, *radiance.shape[1::-1])
    (shot,) = write_photograph(folder / "a", radiance, time, development, rng)
    path = folder / shot.file
    settings = ExposureSettings(shot.exposure_s if keys["exposure"] == "manual" else None)
    radiometry = read_radiometry(RadiometryTable(**keys), folder.joinpath, [path])
    return decode_in_set(radiometry, path, settings, radiance.shape[:2])


@pytest.mark.parametrize(
    ("bits", "response", "file"),
    [
        (8, "linear", "png"),
        (8, "film", "png"),
        (12, "linear", "png"),
        (14, "linear", "tiff"),
        (16, "film", "png"),
        (16, "gamma", "tiff"),
        (16, "srgb", "tiff"),
    ],
)
def test_decoded_radiance_is_the_truth_within_the_noise_that_it_states(tmp_path, rng, bits, response, file):
    radiance = smooth_radiance(rng)
    development = Development(Sensor(**LENS, bits=bits, response=response), file)
    image = photographed(tmp_path, radiance, development, rng)
    off = (image.radiance - radiance) / np.sqrt(image.variance)
    assert not image.saturated.any()
    # 4 standard errors of 130,000 numbers of 1500 electrons and more, and 1 / (2 sqrt(1500)) = 0.013, by which a
    # variance that is read off the noisy signal shifts them.
    assert off.mean() == pytest.approx(0, abs=4 / math.sqrt(off.size) + 0.013)
    assert off.std() == pytest.approx(1, abs=4 / math.sqrt(2 * off.size) + 0.005)


def test_the_rounding_of_12_bits_is_known_in_files_of_16(tmp_path, rng):
    radiance = smooth_radiance(rng)
    image = photographed(tmp_path, radiance, Development(Sensor(full_well=1e9, bits=12)), rng)
    # Hardly any photon noise, but steps of 1/4095; 4 standard errors are 0.8%.
    assert np.std((image.radiance - radiance) / np.sqrt(image.variance)) == pytest.approx(1, abs=0.01)


@pytest.mark.parametrize("bits", [12, 14])
def test_raw_photosites_are_the_truth_within_the_noise_and_exif_only_scales_them(tmp_path, rng, bits):
    radiance = smooth_radiance(rng)
    development = Development(Sensor(**LENS, bits=bits), "dng", iso=400, f_number=5.6)
    image = photographed(tmp_path, radiance, development, rng)
    assert development.radiance_factor == pytest.approx(5.6**2 / 4, rel=1e-12)
    off = (image.radiance - radiance * (5.6**2 / 4)) / np.sqrt(image.variance)
    for channel, row, column in ((0, 0, 0), (1, 0, 1), (1, 1, 0), (2, 1, 1)):
        own = off[row::2, column::2, channel]  # not interpolated
        assert own.mean() == pytest.approx(0, abs=4 / math.sqrt(own.size) + 0.013)  # as above
        assert own.std() == pytest.approx(1, abs=4 / math.sqrt(2 * own.size) + 0.005)


@pytest.mark.parametrize(
    ("file", "demosaic", "response"),
    [("jpeg", False, "srgb"), ("jpeg", True, "film"), ("png", True, "srgb")],
)
def test_what_mixes_pixels_stays_unbiased(tmp_path, rng, file, demosaic, response):
    radiance = smooth_radiance(rng)
    development = Development(Sensor(**LENS, bits=8, response=response), file, demosaic, iso=200)
    image = photographed(tmp_path, radiance, development, rng)
    truth = radiance * development.radiance_factor
    assert development.radiance_factor == (0.5 if file == "jpeg" else 1.0)
    # Compression shifts blocks by up to a code each, half a percent, in no direction; the photons' part is 0.003%.
    assert_allclose(image.radiance.mean(axis=(0, 1)), truth.mean(axis=(0, 1)), rtol=0.002)
    # Errors no larger than stated; interpolation and compression leave less noise than a photosite has.
    assert 0.4 < np.std((image.radiance - truth) / np.sqrt(image.variance)) < 1.05


def test_demosaicing_keeps_plain_colour_and_gives_grey_edges_colour(tmp_path, rng):
    plain = np.broadcast_to([0.6, 0.4, 0.1], (40, 60, 3))
    sensor = Sensor(full_well=1e6, read_noise=0, bits=16)
    grey = np.where(np.arange(60) < 31, 0.1, 0.8)[None, :, None] * np.ones((40, 1, 3))
    pictures = []
    for stem, radiance, demosaic in (("a", plain, True), ("b", grey, True), ("c", grey, False)):
        development = Development(sensor, demosaic=demosaic)
        (shot,) = write_photograph(tmp_path / stem, radiance, 1.0, development, rng)
        pictures.append(read_pixels(tmp_path / shot.file) / 65535)
    assert_allclose(pictures[0].mean(axis=(0, 1)), plain[0, 0], rtol=1e-3)  # 0.3% / sqrt(600) and less
    colour = [np.ptp(picture, axis=2).max() for picture in pictures[1:]]
    assert colour[0] > 0.2 > 0.02 > colour[1]  # noise of 0.1% only, without a mosaic


def test_truth_of_the_response_is_its_inverse():
    # An independent inverse: the curve drawn on a fine grid, read the other way round.
    grid = np.concatenate([[0], np.geomspace(1e-9, 1, 400_001)])
    for name, bits in (("film", 8), ("film", 16), ("gamma", 8)):
        found = true_response(Sensor(response=name, bits=bits))
        expected = np.interp(found.values[1:], RESPONSES[name](grid), grid)
        assert_allclose(np.exp(found.log_exposure[1, 1:]), expected, rtol=1e-6)  # the grid's step squared
    assert found.brightest(255).tolist() == [254, 254, 254]


@pytest.mark.parametrize(("bits", "response"), [(8, "srgb"), (14, "linear"), (16, "film")])
@pytest.mark.parametrize("share", [None, 0.0, 0.05, 0.2])
def test_the_share_of_the_object_that_saturates_is_as_asked(tmp_path, rng, share, bits, response):
    sensor = Sensor(full_well=20_000, focal_px=250, bits=bits, response=response)
    development = Development(sensor, "png", saturated=share)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    covered = ((x - 100) ** 2 + (y - 90) ** 2 < 70**2).astype(float)
    # Two photographs of one exposure, the second hardly darker; what lies beside the object doesn't count.
    photos = [smooth_radiance(rng), 0.9 * smooth_radiance(rng)]
    for photo in photos:
        photo[covered == 0] = 1e4
    brightness = [object_brightness(photo, covered, sensor) for photo in photos]
    time = choose_exposure(brightness, development)
    white = []
    for stem, photo in zip("ab", photos, strict=True):
        (shot,) = write_photograph(tmp_path / stem, photo, time, development, rng)
        white.append(decode(tmp_path / shot.file).saturated[covered > 0])
    if not share:
        assert not np.any(white)
        # And not underexposed: 5 deviations below white, 5 x 0.7%, and the photons' own scatter.
        assert read_pixels(tmp_path / "a.png").max() > signal_of_level(sensor, 0.94) * (
            255 if bits == 8 else 65535
        )
    else:
        assert np.mean(white) == pytest.approx(share, rel=0.1)  # noise flips pixels next to white


def signal_of_level(sensor: Sensor, signal: float) -> float:
    return float(np.asarray(sensor.curve(np.array(signal))))


def test_a_bracket_is_files_of_one_scene_whose_exif_says_what_was_exposed(tmp_path, rng):
    development = Development(
        Sensor(bits=8, response="srgb"), "jpeg", bracket=(-2, 0, 2), iso=320, f_number=2.8, jpeg_quality=97
    )
    radiance = np.full((64, 80, 3), 2.0)
    shots = write_photograph(tmp_path / "ball", radiance, 0.1, development, rng)
    assert shots == (
        WrittenShot("ball_0.jpg", 0.025),
        WrittenShot("ball_1.jpg", 0.1),
        WrittenShot("ball_2.jpg", 0.4),
    )
    assert [read_exif_exposure(tmp_path / shot.file) for shot in shots] == [
        ExposureSettings(pytest.approx(shot.exposure_s, rel=1e-9), 320, pytest.approx(2.8, rel=1e-9))
        for shot in shots
    ]
    means = [decode(tmp_path / shot.file, "srgb", exposure=shot.exposure_s).radiance.mean() for shot in shots]
    assert_allclose(means, 2.0, rtol=0.005)  # a third of a code, on a plain grey


def test_exif_times_of_all_lengths_are_read_back(tmp_path, rng):
    for time in (2e-6, 1 / 3, 12.34567, 9e5):
        radiance = np.full((32, 32, 3), 0.5 / time)  # LibRaw takes nothing smaller than 22
        for file, bits in (("dng", 14), ("jpeg", 8)):
            (shot,) = write_photograph(
                tmp_path / "a", radiance, time, Development(Sensor(bits=bits), file), rng
            )
            found = read_exif_exposure(tmp_path / shot.file).exposure_s
            assert found == pytest.approx(time, rel=3e-7)  # LibRaw's float32


def test_same_seed_same_bytes(tmp_path):
    radiance = smooth_radiance(np.random.default_rng(1))
    for file, bits in (("png", 8), ("tiff", 12), ("jpeg", 8), ("dng", 14)):
        development = Development(Sensor(bits=bits), file)
        data = []
        for _ in range(2):
            (shot,) = write_photograph(tmp_path / "a", radiance, 0.01, development, np.random.default_rng(2))
            data.append((tmp_path / shot.file).read_bytes())
        assert data[0] == data[1]


def test_an_ideal_sensor_has_noise_of_two_parts(rng):
    radiance, coverage = np.zeros((200, 300, 3)), np.zeros((200, 300))
    coverage[:, 100:] = 1
    radiance[:, 100:] = 2.0
    photo = Noise(relative=0.03, floor=0.02).applied(radiance, coverage, rng)
    # The floor is 2% of the object's mean, everywhere; 60,000 numbers and more: 4 standard errors are 1.2%.
    assert photo[:, :100].std() == pytest.approx(0.04, rel=0.012)
    assert photo[:, 100:].std() == pytest.approx(math.hypot(0.06, 0.04), rel=0.012)
    assert_array_equal(Noise(0, 0).applied(radiance, coverage, rng), radiance.astype(np.float32))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"file": "gif"}, "file is 'gif'; use one of png, tiff, jpeg, dng"),
        ({"file": "jpeg"}, r"JPEG holds 8 bits, but the sensor's bits is 16: write bits = 8"),
        ({"file": "dng", "sensor": Sensor(bits=8)}, "RAW files hold 12 to 16 bits"),
        ({"file": "dng", "sensor": Sensor(response="srgb")}, "RAW files are linear, but response is 'srgb'"),
        ({"file": "dng", "demosaic": True}, "a DNG holds the mosaic"),
        ({"sensor": Sensor(bits=12, response="film")}, "bits is 12 with response 'film'"),
        ({"exposure_s": 0.0}, r"exposure_s is 0\.0; it must be > 0"),
        ({"exposure_s": 1.0, "saturated": 0.2}, r"exposure_s = 1\.0 fixes .* saturated = 0\.2.*remove one"),
        ({"saturated": 1.0}, r"saturated is 1\.0; it is a share"),
        ({"bracket": (1, 0)}, r"bracket is \[1, 0\]; it must be rising stops"),
        ({"iso": 0}, "iso is 0"),
        ({"f_number": -1}, "f_number is -1"),
        ({"jpeg_quality": 90}, "jpeg_quality is for file = 'jpeg', but that is 'png'"),
        ({"file": "jpeg", "sensor": Sensor(bits=8), "jpeg_quality": 0}, "jpeg_quality is 0"),
    ],
)
def test_a_development_that_contradicts_itself_is_refused(given, message):
    with pytest.raises(ValueError, match=message):
        Development(**given)


def test_what_cannot_be_photographed_is_named(tmp_path, rng):
    sensor = Sensor(bits=14)
    radiance, covered = np.zeros((8, 8, 3)), np.ones((8, 8))
    with pytest.raises(
        ValueError, match="the exposure can't be chosen: all of the object's pixels are black"
    ):
        choose_exposure([object_brightness(radiance, covered, sensor)], Development(sensor))
    with pytest.raises(ValueError, match=r"a: radiance is \(8, 8, 3\) with a minimum of -1"):
        write_photograph(tmp_path / "a", radiance - 1, 1.0, Development(sensor), rng)
    with pytest.raises(
        ValueError, match=r"a: exposure times run from 1e-08 to 1e-08 s, but EXIF holds 1e-06"
    ):
        write_photograph(tmp_path / "a", radiance, 1e-8, Development(sensor, "dng"), rng)
    deep = Development(Sensor(focal_px=50))
    with pytest.raises(ValueError, match=r"focal_px = 50 at 240x180 pixels: the flat field falls to"):
        write_radiometry(tmp_path, deep, 240, 180)
    weak = Development(Sensor(full_well=10, read_noise=50))
    with pytest.raises(ValueError, match=r"full_well .* leaves nothing between noise and white"):
        choose_exposure([np.ones(3)], weak)
    assert signal_of(0.5, sensor) == pytest.approx(0.5, abs=1e-15)
