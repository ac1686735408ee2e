from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose
from PIL import Image

from capture.bracket.response import Response
from capture.decode import decode
from capture.sensor.noise import SensorNoise, estimate_noise, read_noise_model
from capture.sensor.noiserecovery import noise_document, recover_noise
from capture.sensor.photontransfer import fit_transfer, seen_variance, tiles_of
from capture.sensor.repeats import RepeatedFrame, Repeats
from capture.srgb import srgb_to_linear
from synthetic.sensing.dng import write_dng
from synthetic.sensing.sensor import Sensor, expose, expose_mosaic

WELL, READ = 20_000.0, 10.0
TRUTH = np.array([(READ / WELL) ** 2, 1 / WELL])


def ramp(height: int = 240, width: int = 320) -> np.ndarray:
    """A static scene from 1% to 90% of white, its gradients steeper across than down."""
    across, down = np.linspace(0, 1, width)[None, :, None], np.linspace(0, 1, height)[:, None, None]
    return (0.01 + 0.9 * across * (0.3 + 0.7 * down)) * np.array([1.0, 0.8, 0.5])


def frame(codes: np.ndarray, encoding: str = "linear") -> RepeatedFrame:
    white = np.iinfo(codes.dtype).max
    shares = np.arange(white + 1) / white
    table = shares if encoding == "linear" else srgb_to_linear(shares)
    step = np.gradient(table)
    return RepeatedFrame(
        table.astype(np.float32)[codes],
        (step**2 / 12).astype(np.float32)[codes],
        (codes == white).any(axis=2),
    )


def fits(frames: list[RepeatedFrame]):
    repeats = Repeats(frames[0])
    for other in frames[1:]:
        repeats.add(other, repeats.gain_of(other))
    return [fit_transfer([tiles_of(repeats, channel)]) for channel in range(3)]


def deviations(frames: list[RepeatedFrame], truth=TRUTH) -> list[np.ndarray]:
    """How many stated standard deviations each channel's (offset, slope) is off."""
    return [
        (np.array([fit.offset, fit.slope]) - truth) / np.sqrt(np.diag(fit.covariance)) for fit in fits(frames)
    ]


def write(path: Path, codes: np.ndarray, exposure_s: float | None = None, iso: int | None = None) -> Path:
    exif = Image.Exif()
    if exposure_s is not None:
        exif[33434] = exposure_s
    if iso is not None:
        exif[34855] = iso
    if codes.dtype == np.uint8:
        Image.fromarray(codes).save(path, exif=exif)
    else:
        assert cv2.imwrite(str(path), codes[..., ::-1])
    return path


@pytest.mark.parametrize(
    ("bits", "response", "well", "read"),
    [
        (16, "linear", WELL, READ),
        (8, "srgb", 4000.0, READ),
        pytest.param(8, "linear", 4000.0, READ, marks=pytest.mark.slow),
        (8, "linear", WELL, 25.0),  # in the dark a third of a step: rounding hides part of the noise
    ],
)
def test_recovered_within_the_stated_intervals(bits, response, well, read):
    rng = np.random.default_rng(bits)
    sensor = Sensor(full_well=well, read_noise=read, bits=bits, response=response)
    scene = ramp(160, 240)
    found = []
    for _ in range(14):
        frames = [frame(expose(scene, 1.0, sensor, rng), response) for _ in range(2)]
        found += deviations(frames, np.array([(read / well) ** 2, 1 / well]))
    inside = (np.abs(found) < 1.96).mean()
    # 84 numbers, in pairs that are correlated: 95% has a standard error of about 3%; the requirement is 90% to 99%.
    assert inside >= 0.87
    # Nor are the intervals too wide to mean anything: the spread of 84 is known to 8%, more with the correlation.
    assert 0.7 < np.std(found) < 1.25


def test_rounding_hides_what_stays_the_same():
    rng = np.random.default_rng(4)
    noise = np.array([0.2, 0.25, 0.3, 0.5, 2.0])  # steps
    mean = rng.uniform(0, 1, (1_000_000, 1))
    pair = [np.round(mean + rng.normal(size=(1_000_000, 5)) * noise) for _ in range(2)]
    measured = ((pair[0] - pair[1]) ** 2 / 2).mean(axis=0)
    # A million pairs: 0.14% for Gaussian noise, up to twice that for the few values that small noise takes.
    assert_allclose(seen_variance(noise**2, np.full(5, 1 / 12)), measured, rtol=0.01)
    # Far above a step nothing is hidden.
    assert_allclose(seen_variance(np.array([4.0]), np.array([1 / 12])), 4 + 1 / 12, rtol=1e-12)


def test_more_photographs_tell_more():
    rng = np.random.default_rng(5)
    sensor = Sensor(full_well=WELL, read_noise=READ)
    frames = [frame(expose(ramp(), 1.0, sensor, rng)) for _ in range(5)]
    two, five = fits(frames[:2])[0], fits(frames)[0]
    # Variance from n photographs has n - 1 degrees of freedom: four times as many, half the deviation.
    ratio = np.sqrt(np.diag(five.covariance) / np.diag(two.covariance))
    assert_allclose(ratio, 0.5, rtol=0.25)  # the scale of the scatter is estimated too


def test_twelve_bits_in_a_sixteen_bit_file_count_with_their_own_steps():
    rng = np.random.default_rng(6)
    sensor = Sensor(full_well=WELL, read_noise=4.0, bits=12)
    frames = [frame(expose(0.05 * ramp(), 1.0, sensor, rng) << 4) for _ in range(6)]
    # The step is 4.9 electrons: its rounding adds an eighth of the read noise's variance.
    found = deviations(frames, np.array([(4 / WELL) ** 2, 1 / WELL]))
    assert np.abs(found).max() < 3.5  # six numbers


def test_moving_things_drifting_light_and_a_hot_pixel_do_not_matter():
    rng = np.random.default_rng(7)
    sensor = Sensor(full_well=WELL, read_noise=READ)
    frames = []
    for number, drift in enumerate((1.0, 1.06, 1.09)):
        scene = ramp(480, 640) * drift
        scene[100:300, 60 * number : 60 * number + 60] *= 0.4
        codes = expose(scene, 1.0, sensor, rng)
        codes[5::40, 3::40] = rng.integers(0, 60000, codes[5::40, 3::40].shape)
        frames.append(frame(codes))
    # Shot noise belongs to the light's mean, 5% brighter than the first photograph: far outside otherwise.
    assert np.abs(deviations(frames)).max() < 3.5
    # And nothing of what moved is left to scatter: without it the slope is known to 0.5%.
    for fit in fits(frames):
        assert 0.1 < fit.moved_share < 0.25
        assert np.sqrt(fit.covariance[1, 1]) < 0.01 * fit.slope


def test_saturated_and_black_parts_are_left_out():
    rng = np.random.default_rng(8)
    sensor = Sensor(full_well=WELL, read_noise=100.0)
    scene = np.maximum(ramp() * 1.6 - 0.05, 0)
    truth = np.array([(100 / WELL) ** 2, 1 / WELL])
    found = deviations([frame(expose(scene, 1.0, sensor, rng)) for _ in range(2)], truth)
    assert np.abs(found).max() < 3.5  # six numbers


@pytest.mark.parametrize(
    ("pedestal", "well", "darkest"),
    [
        (0, 1500, 4e-4),
        (16, 1500, 4e-4),
        pytest.param(0, 4000, 2e-3, marks=pytest.mark.slow),
        pytest.param(0, 1500, 1e-2, marks=pytest.mark.slow),
    ],
)
def test_black_that_only_some_pixels_reach_is_clipped_all_the_same(pedestal, well, darkest):
    rng = np.random.default_rng(18)
    # Read noise of about one code: in the dark, the lowest code holds little more than the next, or less.
    sensor = Sensor(full_well=well, read_noise=8, bits=8)
    scene = np.geomspace(darkest, 0.8, 240)[None, :, None] * np.ones((160, 1, 3))
    truth = np.array([(8 / well) ** 2 - pedestal / 255 / well, 1 / well])
    found = []
    for _ in range(12):
        codes = [expose(scene, 1.0, sensor, rng) + np.uint8(pedestal) for _ in range(2)]
        found += deviations([frame(one) for one in codes], truth)
    # 36 of each: the mean is known to a sixth of a deviation, taken four times. Clipped tiles made it -9 and +2.
    assert np.abs(np.mean(found, axis=0)).max() < 0.7


def test_parts_darker_than_a_response_is_known_are_left_out(tmp_path):
    rng = np.random.default_rng(19)
    sensor = Sensor(full_well=20_000, read_noise=10, bits=8, response="film")
    light = np.linspace(0, 1, 200_001)
    film = (1 - np.exp(-3.2 * light**0.8)) / (1 - np.exp(-3.2))
    exposure = np.log(np.maximum(np.interp(np.arange(256) / 255, film, light), 1e-9))
    # Recovered from code 12 on: below, the curve is a straight line to black, whose slope isn't the film's.
    exposure[:12] = exposure[253:] = np.nan
    std = np.where(np.isfinite(exposure), 0.003, np.nan)
    response = Response(np.tile(exposure, (3, 1)), np.tile(std, (3, 1)), np.array([[0, 1.0]] * 3))
    scene = np.geomspace(2e-4, 0.5, 320)[None, :, None] * np.ones((240, 1, 3))
    photos = [write(tmp_path / f"{n}.png", expose(scene, 1.0, sensor, rng)) for n in range(4)]
    recovery = recover_noise(photos, response)
    dark = np.exp(exposure[12])
    for fit, shot in zip(recovery.fits, recovery.shot, strict=True):
        assert fit.tiles.signal.min() > dark
        assert abs(shot.value - 1 / 20_000) < 3.5 * shot.std


def test_jpeg_is_no_witness_of_its_sensor(tmp_path):
    rng = np.random.default_rng(20)
    sensor = Sensor(full_well=1500, read_noise=READ, bits=8, response="srgb")
    photos = [tmp_path / f"{n}.jpg" for n in range(2)]
    for path in photos:
        Image.fromarray(expose(ramp(), 1.0, sensor, rng)).save(path, quality=95)
    recovery = recover_noise(photos, "srgb")
    assert len(recovery.warnings) == 1
    assert noise_document(recovery)["warnings"] == recovery.warnings
    # Rounding to codes is all that is taken out; compression's own error stays in what pixels scatter by.
    step = np.gradient(srgb_to_linear(np.arange(256) / 255))
    assert max(fit.tiles.quantisation.max() for fit in recovery.fits) <= step.max() ** 2 / 12


def test_raw_photographs_are_read_before_demosaicing(tmp_path):
    rng = np.random.default_rng(9)
    sensor = Sensor(full_well=WELL, read_noise=READ, bits=14)
    photos = []
    for number, seconds in enumerate((1.0, 1.0, 0.1, 0.1)):
        photos.append(tmp_path / f"{number}.dng")
        mosaic = expose_mosaic(ramp(400, 600), seconds, sensor, rng, black=512)
        write_dng(photos[-1], mosaic, black=512, white=2**14 - 1, exposure_s=seconds, iso=200)
    recovery = recover_noise(photos)
    assert recovery.iso == 200
    assert [len(group) for group in recovery.groups] == [2, 2]
    for electrons, truth in ((recovery.read_electrons, READ), (recovery.full_well, WELL)):
        for part in electrons:
            assert abs(part.value - truth) < 3.5 * part.std
            assert part.std < 0.05 * truth
    # Demosaicing averages neighbours: it would have shown less noise than there is, by a third or more.


def test_hidden_by_steps_is_undetermined_with_a_bound_that_holds(tmp_path):
    rng = np.random.default_rng(10)
    sensor = Sensor(full_well=WELL, read_noise=2.0, bits=8)
    photos = [write(tmp_path / f"{n}.png", expose(ramp(), 1.0, sensor, rng)) for n in range(2)]
    recovery = recover_noise(photos)
    for part in recovery.read_std:
        assert part.value is None
        assert part.remedy
        assert 2 / WELL < part.at_most < 0.2 / 255
    document = noise_document(recovery)
    assert document["read_std"]["value"] == [None] * 3
    assert {entry["parameter"] for entry in document["undetermined"]} >= {"read_std"}
    json.dumps(document, allow_nan=False)


def test_a_scene_of_one_brightness_leaves_both_undetermined(tmp_path):
    rng = np.random.default_rng(11)
    scene = np.full((240, 320, 3), 0.5)
    sensor = Sensor(full_well=WELL, read_noise=READ)
    photos = [write(tmp_path / f"{n}.png", expose(scene, 1.0, sensor, rng)) for n in range(2)]
    recovery = recover_noise(photos)
    assert all(part.value is None for part in recovery.shot)
    assert all("dark and bright parts" in part.remedy for part in recovery.shot)
    assert all(part.at_most > 1 / WELL for part in recovery.shot)


def test_refusals_name_the_photograph(tmp_path):
    rng = np.random.default_rng(12)
    sensor = Sensor(full_well=2000, read_noise=READ, bits=8)
    codes = [expose(ramp(120, 160), 1.0, sensor, rng) for _ in range(2)]
    one = write(tmp_path / "one.png", codes[0], 0.5, 100)
    with pytest.raises(ValueError, match=r"one\.png: no second photograph has its exposure"):
        recover_noise([one])
    with pytest.raises(ValueError, match=r"iso\.png: ISO is 800.*one\.png has 100"):
        recover_noise([one, write(tmp_path / "iso.png", codes[1], 0.5, 800)])
    with pytest.raises(ValueError, match=r"time\.png|one\.png: no second photograph"):
        recover_noise([one, write(tmp_path / "time.png", codes[1], 0.25, 100)])
    with pytest.raises(ValueError, match=r"copy\.png: equals one\.png pixel by pixel"):
        recover_noise([one, write(tmp_path / "copy.png", codes[0], 0.5, 100)])
    with pytest.raises(ValueError, match=r"small\.png: is 100x120 pixels, but one\.png is 160x120"):
        recover_noise([one, write(tmp_path / "small.png", codes[1][:, :100], 0.5, 100)])
    other = ramp(120, 160)[:, ::-1]
    with pytest.raises(ValueError, match=r"of the scene changes|no second photograph"):
        recover_noise([one, write(tmp_path / "moved.png", expose(other, 1.0, sensor, rng), 0.5, 100)])


def test_model_adds_read_and_shot_noise():
    model = SensorNoise([0.1, 0.2, 0.3], [0.01, 0.02, 0.03])
    linear = np.array([[[0.0, 0.5, 1.0], [-0.5, 2.0, 0.25]]], np.float32)
    expected = [[[0.01, 0.05, 0.12], [0.01, 0.08, 0.0975]]]
    assert_allclose(model.variance(linear), expected, rtol=1e-6, equal_nan=False)  # float32
    assert model.variance(linear).dtype == np.float32
    with pytest.raises(ValueError, match=r"shot is \[-1.0, 0.0, 0.0\]; it must be three finite numbers >= 0"):
        SensorNoise(np.zeros(3), [-1, 0, 0])


def test_file_is_read_back_with_bounds_for_what_is_undetermined(tmp_path):
    path = tmp_path / "noise.json"
    part = {"value": [0.1, None, 0.3], "std": [0.01, None, 0.01], "at_most": [0.12, 0.25, 0.32]}
    path.write_text(json.dumps({"format": 1, "read_std": part, "shot": part, "iso": 100}))
    model = read_noise_model(path)
    assert_allclose(model.read_std, [0.1, 0.25, 0.3])
    assert_allclose(model.shot, [0.1, 0.25, 0.3])
    path.write_text(json.dumps({"format": 2, "read_std": part, "shot": part}))
    with pytest.raises(ValueError, match=r"noise\.json: format is 2"):
        read_noise_model(path)
    path.write_text(json.dumps({"format": 1, "shot": part}))
    with pytest.raises(ValueError, match=r"noise\.json: lacks the key 'read_std'; a noise\.json"):
        read_noise_model(path)


def std_ratio(model: SensorNoise, well: float = 10_000.0, read: float = 10.0) -> np.ndarray:
    """Estimated over true standard deviation at levels from dark to bright, (4, 3)."""
    level = np.array([0.02, 0.1, 0.3, 0.7])[:, None]
    return np.sqrt((model.read_std**2 + model.shot * level) / ((read / well) ** 2 + level / well))


def test_guess_from_one_smooth_photograph():
    rng = np.random.default_rng(13)
    sensor = Sensor(full_well=10_000, read_noise=10)
    image = (expose(ramp(600, 800), 1.0, sensor, rng) / 65535).astype(np.float32)
    assert_allclose(std_ratio(estimate_noise(image, 1 / 65535)), 1, atol=0.12)  # 24 points of a tenth each
    mosaic = (expose_mosaic(ramp(600, 800), 1.0, sensor, rng, black=512) - 512.0) / (65535 - 512)
    assert_allclose(std_ratio(estimate_noise(mosaic.astype(np.float32), 1 / 65535)), 1, atol=0.12)


@pytest.mark.parametrize(
    "name", ["mirrorball/raw1.jpg", "memorial/memorial0066.png", "temple/templeSR0001.png"]
)
def test_guess_is_not_fooled_by_real_texture(data_dir, name):
    rng = np.random.default_rng(14)
    # Real scenes, halved in size so that their own noise is gone, photographed by a known sensor.
    scene = cv2.resize(
        np.array(decode(data_dir / name, "srgb").radiance), None, fx=0.5, fy=0.5, interpolation=3
    )
    image = (expose(scene, 1.0, Sensor(full_well=10_000, read_noise=10), rng) / 65535).astype(np.float32)
    ratio = std_ratio(estimate_noise(image, 1 / 65535))
    assert ratio.min() > 0.8
    assert ratio.max() < 1.5  # the promise


def test_guess_takes_rounding_out_but_not_below_zero():
    rng = np.random.default_rng(15)
    step = 1 / 255
    scene = 0.1 + 0.7 * np.broadcast_to(np.linspace(0, 1, 800)[None, :, None], (600, 800, 3))
    rounded = (np.round(scene / step) * step).astype(np.float32)
    silent = estimate_noise(rounded, step)
    # Nothing but rounding: what is left is below rounding itself, step^2 / 12, everywhere.
    assert (silent.read_std**2 + silent.shot < step**2 / 12).all()
    noisy = (np.round((scene + rng.normal(0, 2 * step, scene.shape)) / step) * step).astype(np.float32)
    model = estimate_noise(noisy, step)
    assert_allclose(np.sqrt(model.read_std**2 + 0.4 * model.shot), 2 * step, rtol=0.1)  # as above
    # A step that depends on the signal may be given as a function.
    again = estimate_noise(noisy, lambda signal: np.full_like(signal, step))
    assert_allclose(again.read_std, model.read_std, rtol=1e-6)


def test_guess_needs_something_to_look_at():
    with pytest.raises(ValueError, match="only 0 blocks of the photograph are neither saturated nor black"):
        estimate_noise(np.zeros((100, 100, 3), np.float32))
    with pytest.raises(ValueError, match="the photograph is 5x4; noise is read off blocks"):
        estimate_noise(np.ones((4, 5, 3), np.float32))
