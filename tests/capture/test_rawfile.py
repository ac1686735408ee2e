from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from capture.decode import decode
from capture.exposure import ExposureSettings, read_exif_exposure
from capture.files.imageheader import is_raw
from capture.files.rawfile import camera_white_balance, read_raw
from capture.sensor.noise import SensorNoise
from synthetic.sensing.dng import write_dng

NO_NOISE = SensorNoise(np.zeros(3), np.zeros(3))
# Exposure time, ISO and f-number as exiv2-like tools print them, to the rounding of the tags.
REAL = {
    "CRW_0101.CRW": (1 / 100.86, 50, 2.8),
    "P003911.KDC": (0.00376, 160, 3.7),
    "RAW_KODAK_DC50_é.KDC": (0.00435, 84, 6.2),
    "RAW_NIKON_D1.NEF": (1 / 250, 200, 7.6),
    "canon_eos_6d.dng": (1 / 60, 1000, 5.6),
}


@pytest.mark.parametrize("name", REAL)
def test_raw_files_of_three_makers_and_a_dng_decode(data_dir, name):
    path = data_dir / "raw" / name
    image = decode(path)
    assert image.radiance.shape[0] > 500
    assert image.radiance.dtype == np.float32
    # Linear, and between black and white but for noise about black.
    assert image.radiance.min() > -0.01
    assert 0.5 < image.radiance.max() <= 1.0
    assert (image.variance > 0).all()
    time, iso, f_number = REAL[name]
    found = read_exif_exposure(path)
    assert (found.exposure_s, found.iso, found.f_number) == (
        pytest.approx(time, rel=1e-3),
        iso,
        pytest.approx(f_number, rel=1e-3),
    )


def test_the_grey_patches_of_a_colour_chart_lie_on_a_line_through_the_origin(data_dir):
    image = decode(data_dir / "raw" / "CRW_0101.CRW")
    reflectance = np.array([0.90, 0.59, 0.36, 0.20, 0.09, 0.03])
    columns, row = (362, 670, 982, 1292, 1602, 1910), 1250
    # The lamp lights the chart unevenly by 15%: the white paper around it shows how.
    paper = np.zeros(image.saturated.shape, bool)
    paper[:80] = paper[-180:] = paper[:, :140] = paper[:, -160:] = True
    y, x = np.nonzero(paper)
    y, x = y[::100], x[::100]

    def terms(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.stack(
            [(x / 1000 - 1) ** i * (y / 1000 - 1) ** j for i in range(3) for j in range(3)], axis=-1
        )

    for channel in range(3):
        seen = image.radiance[..., channel]
        surface = np.linalg.lstsq(terms(x, y), seen[y, x], rcond=None)[0]
        light = terms(np.array(columns), np.full(6, row)) @ surface
        around = [np.s_[row - 60 : row + 60, column - 60 : column + 60] for column in columns]
        patches = np.array([np.median(seen[at]) for at in around]) / light
        slope = patches @ reflectance / (reflectance @ reflectance)
        # Of the white patch. Veiling glare in this compact camera adds 1.5% of white to the dark patches.
        assert_allclose(patches / slope / 0.9, reflectance / 0.9, atol=0.03, equal_nan=False)


def mosaic_of(radiance: np.ndarray, black: np.ndarray, white: int) -> np.ndarray:
    """RGGB codes of an image (h, w, 3) in 0 to 1."""
    h, w = radiance.shape[:2]
    codes = np.zeros((h, w), np.int64)
    for index, (row, column, channel) in enumerate([(0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)]):
        part = radiance[row::2, column::2, channel]
        codes[row::2, column::2] = np.round(part * (white - black[index]) + black[index])
    return codes


def test_black_and_white_levels_are_the_files(tmp_path):
    flat = np.broadcast_to([0.2, 0.5, 0.7], (60, 80, 3))
    black = np.array([500, 512, 530, 600])
    write_dng(tmp_path / "a.dng", mosaic_of(flat, black, 15000), black=black.tolist(), white=15000)
    image = decode(tmp_path / "a.dng", noise=NO_NOISE)
    # Half a code of 14,500, and of the 16 bits of demosaicing.
    assert_allclose(image.radiance, flat, atol=5e-5, equal_nan=False)
    assert not image.saturated.any()
    assert_allclose(image.variance, (1 / 14500) ** 2 / 12, rtol=0.05)  # black levels differ by channel


def test_signal_is_proportional_to_exposure_even_in_the_dark(tmp_path):
    """Noise about black is kept: clipped at black, the mean of a dark patch would be too high."""
    rng = np.random.default_rng(0)
    means = []
    for time in (0.01, 0.04, 0.16, 0.64):
        electrons = rng.poisson(np.full((200, 240), 1500.0 * time))
        codes = np.round(1024 + electrons * 0.7 + rng.normal(0, 12, electrons.shape))
        write_dng(tmp_path / "a.dng", codes.astype(int), black=1024, white=15000, exposure_s=time)
        image = decode(tmp_path / "a.dng", exposure=time)
        means.append(image.radiance.mean())
    # 48,000 photosites of noise 12 codes: 0.05 of the darkest signal's 10.5 codes, 0.5%.
    assert_allclose(means, 1500 * 0.7 / (15000 - 1024), rtol=0.01, equal_nan=False)


def test_a_saturated_photosite_spoils_its_neighbours_and_nothing_else(tmp_path):
    codes = np.full((40, 40), 3000)
    codes[20, 13] = 15000
    write_dng(tmp_path / "a.dng", codes, black=0, white=15000)
    expected = np.zeros((40, 40), bool)
    expected[19:22, 12:15] = True
    image = decode(tmp_path / "a.dng")
    assert_array_equal(image.saturated, expected)
    # Beyond that reach nothing has changed.
    assert_allclose(image.radiance[~expected], 0.2, atol=2e-5)


def test_photosites_that_pile_up_below_the_white_level_are_saturated(tmp_path):
    rng = np.random.default_rng(1)
    codes = np.minimum(rng.normal(9000, 3000, (200, 200)), 13500).clip(0).astype(int)
    write_dng(tmp_path / "a.dng", codes, black=0, white=16383)
    saturated = decode(tmp_path / "a.dng").saturated
    rows, columns = np.nonzero(codes == 13500)
    assert saturated[rows, columns].all()
    write_dng(tmp_path / "b.dng", rng.normal(9000, 1000, (200, 200)).astype(int), black=0, white=16383)
    assert not decode(tmp_path / "b.dng").saturated.any()


def test_white_balance_multiplies_and_saturation_stays_the_sensors(tmp_path):
    flat = np.broadcast_to([0.2, 0.5, 0.4], (40, 40, 3))
    codes = mosaic_of(flat, np.zeros(4), 15000)
    write_dng(tmp_path / "a.dng", codes, white=15000, neutral=(0.4, 1.0, 0.8))
    factors = camera_white_balance(tmp_path / "a.dng")
    assert_allclose(factors, [2.5, 1, 1.25], rtol=1e-4)
    image = decode(tmp_path / "a.dng", white_balance=factors)
    assert_allclose(image.radiance, 0.5, rtol=1e-3)
    assert not image.saturated.any()


def test_the_noise_of_a_raw_file_is_estimated_from_its_mosaic(tmp_path):
    rng = np.random.default_rng(2)
    signal = np.linspace(0.02, 0.8, 600)[:, None] * np.ones(800)
    electrons = rng.poisson(signal * 20_000)
    codes = np.round(512 + (electrons + rng.normal(0, 8, signal.shape)) / 20_000 * 15000)
    write_dng(tmp_path / "a.dng", codes.clip(0, 16000).astype(int), black=512, white=15512)
    image = decode(tmp_path / "a.dng")
    truth = signal / 20_000 + (8 / 20_000) ** 2 + 1 / 15000**2 / 12
    # What one photograph tells of its own noise.
    assert_allclose(image.variance[50:-50, ::50, 1], truth[50:-50, ::50], rtol=0.25)


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.95, 0.999])
@pytest.mark.parametrize("name", REAL)
def test_a_truncated_raw_file_is_named(data_dir, tmp_path, name, share):
    path = tmp_path / f"cut {name}"
    whole = (data_dir / "raw" / name).read_bytes()
    path.write_bytes(whole[: int(len(whole) * share)])
    with pytest.raises(
        ValueError, match=rf"cut {name}: (is an empty file|is cut off|is no|cannot be decoded|is a)"
    ):
        decode(path)


def test_an_ending_that_lies_is_told(data_dir, tmp_path):
    jpeg = tmp_path / "photo.nef"
    jpeg.write_bytes((data_dir / "mirrorball" / "raw0.jpg").read_bytes())
    with pytest.raises(ValueError, match=r"photo\.nef: is a JPEG file, not camera RAW"):
        decode(jpeg)
    for name in ("RAW_NIKON_D1.NEF", "canon_eos_6d.dng"):
        raw = tmp_path / "photo.tif"
        raw.write_bytes((data_dir / "raw" / name).read_bytes())
        with pytest.raises(ValueError, match=r"photo\.tif: is a camera RAW file under another ending"):
            decode(raw)
    with pytest.raises(ValueError, match=r"nowhere\.dng: does not exist"):
        read_raw(tmp_path / "nowhere.dng")
    assert is_raw(Path("A.CR3"))
    assert not is_raw(Path("a.tif"))


def test_an_exposure_that_a_raw_file_does_not_tell_is_missing(tmp_path):
    write_dng(tmp_path / "a.dng", np.zeros((40, 40), int), exposure_s=0.0, f_number=0.0, iso=200)
    assert read_exif_exposure(tmp_path / "a.dng") == ExposureSettings(None, 200, None)
