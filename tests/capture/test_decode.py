from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from capture.bracket.response import Response
from capture.camera import ORTHOGRAPHIC, Camera
from capture.decode import decode, decode_in_set, decode_photo, read_mask
from capture.exposure import ExposureSettings, bracket_exposures, read_exif_exposure, relative_exposure
from capture.files.imagefile import read_pixels, write_exr
from capture.photo import Photo
from capture.radiance import RadianceImage
from capture.radiometry import Radiometry
from capture.sensor.flatfield import FlatFieldMap
from capture.sensor.noise import SensorNoise
from capture.srgb import linear_to_srgb, srgb_to_linear

from .pictures import write

NO_NOISE = SensorNoise(np.zeros(3), np.zeros(3))
FLOAT32 = 2.0**-23  # relative rounding of a float32 result


def ramp(dtype) -> np.ndarray:
    """Every code of an integer type once, as a colour image whose channels differ."""
    codes = np.arange(np.iinfo(dtype).max + 1).astype(dtype).reshape(-1, 16)
    return np.stack([codes, codes[::-1], codes[:, ::-1]], axis=-1)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_linear_codes_are_shares_of_the_white_level(tmp_path, dtype, suffix):
    white = np.iinfo(dtype).max
    rgb = ramp(dtype)
    image = decode(write(tmp_path / f"a{suffix}", rgb), exposure=0.25, noise=NO_NOISE)
    assert_allclose(image.radiance, rgb / (0.25 * white), rtol=FLOAT32, equal_nan=False)
    assert_allclose(image.variance, (1 / (0.25 * white)) ** 2 / 12, rtol=1e-6, equal_nan=False)
    # Any channel at the white level saturates the pixel, and only that.
    assert_array_equal(image.saturated, (rgb == white).any(axis=-1))
    assert image.saturated.sum() == 3


def test_srgb_curve_agrees_with_published_values(tmp_path):
    # IEC 61966-2-1: the linear piece ends at 0.04045 (0.0031308); 0.5 is 0.21404; to the printed digits.
    assert_allclose(srgb_to_linear([0, 0.04045, 0.5, 1]), [0, 0.0031308, 0.21404, 1], atol=5e-6)
    codes = np.linspace(0, 1, 101)
    assert_allclose(linear_to_srgb(srgb_to_linear(codes)), codes, atol=1e-6)  # the pieces meet to 1e-7
    # Both pieces agree where they meet, to the digits of the standard's constants.
    assert np.diff(srgb_to_linear([0.04045, 0.0404501]))[0] == pytest.approx(0, abs=1e-7)
    # Mid grey of an 8-bit file: code 188 is half of the white level's light, to one code's step.
    image = decode(write(tmp_path / "a.png", np.full((2, 3, 3), 188, np.uint8)), "srgb")
    assert_allclose(image.radiance, 0.5, atol=0.005)


@pytest.mark.parametrize("encoding", ["linear", "srgb"])
def test_variance_is_that_of_quantisation(tmp_path, encoding):
    rng = np.random.default_rng(3)
    truth = rng.uniform(0.2, 0.9, (400, 500, 3))
    # The encoding curve by interpolating the decoding one, so that the two are one curve.
    knots = np.linspace(0, 1, 4001)
    encoded = truth if encoding == "linear" else np.interp(truth, srgb_to_linear(knots), knots)
    path = write(tmp_path / "a.png", np.round(encoded * 255).astype(np.uint8))
    image = decode(path, encoding, exposure=0.5, noise=NO_NOISE)
    error = image.radiance - truth / 0.5
    for low, high in ((0.2, 0.4), (0.4, 0.6), (0.6, 0.9)):
        part = (truth >= low) & (truth < high)
        # 100,000 samples of a uniform error: a relative standard error of the variance of 0.3%; take 3.
        assert np.mean(error[part] ** 2) == pytest.approx(image.variance[part].mean(), rel=0.01)


@pytest.mark.parametrize("kind", ["half", "rgbe"])
def test_variance_of_float_files_is_that_of_their_step(tmp_path, kind):
    rng = np.random.default_rng(4)
    # Colours whose channels differ by a factor of up to 30, over many binary orders of magnitude.
    brightness = np.exp(rng.uniform(-6, 3, (300, 300, 1)))
    truth = (brightness * rng.uniform(0.03, 1, (300, 300, 3))).astype(np.float32)
    if kind == "half":
        path = tmp_path / "a.exr"
        write_exr(path, truth, half=True)
    else:
        path = write(tmp_path / "a.hdr", truth)
    image = decode(path, exposure=2.0)
    error = (image.radiance - truth / 2) / np.sqrt(image.variance)
    if kind == "rgbe":
        # OpenCV's writer cuts off where it could round: its error has a mean. What is left is the step's.
        error -= error.mean()
    for part in (truth < np.median(truth), truth >= np.median(truth)):
        # 135,000 uniform errors: 0.3% standard error; the step's model is exact, so 1% is three of them.
        assert np.mean(error[part] ** 2) == pytest.approx(1, rel=0.01)


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "fine.jpg", "a.exr"])
def test_variance_of_a_few_pixels_is_that_of_the_whole(tmp_path, name):
    rng = np.random.default_rng(8)
    # Sides that are no multiple of a block, or of two where colour is halved.
    picture = cv2.GaussianBlur(rng.normal(120, 60, (93, 71, 3)), (0, 0), 2) + rng.normal(0, 4, (93, 71, 3))
    codes = np.clip(picture, 0, 255).astype(np.uint8)
    path = tmp_path / name
    if name.endswith("exr"):
        write_exr(path, codes.astype(np.float16), half=True)
    else:
        halving = (
            cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444
            if name == "fine.jpg"
            else cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420
        )
        cv2.imwrite(str(path), codes, [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, halving] if "jpg" in name else [])
    rows, columns = rng.integers(0, 93, 300), rng.integers(0, 71, 300)
    rows[:3], columns[:3] = (0, 92, 92), (70, 0, 70)
    few = decode(path, "srgb").variance_at(rows, columns)
    whole = decode(path, "srgb").variance
    assert (whole > 0).all()
    assert decode(path, "srgb").variance_at(rows[:0], columns[:0]).shape == (0, 3)
    assert_allclose(
        few, whole[rows, columns], rtol=1e-5, equal_nan=False
    )  # sums of a transform in another order


@pytest.mark.parametrize("half", [False, True])
def test_exr_keeps_what_was_written(tmp_path, half):
    rng = np.random.default_rng(5)
    radiance = rng.uniform(0, 100, (7, 5, 3)).astype(np.float16 if half else np.float32)
    write_exr(tmp_path / "a.exr", radiance, half=half)
    stored = read_pixels(tmp_path / "a.exr")
    assert stored.dtype == radiance.dtype
    assert_array_equal(stored, radiance)
    image = decode(tmp_path / "a.exr", "srgb", exposure=2.0)  # an EXR is linear, whatever the set's encoding
    assert_array_equal(image.radiance, radiance.astype(np.float32) / 2)
    assert not image.saturated.any()
    assert (image.variance > 0).all() == half


def test_float_tiff_is_linear_and_has_no_quantum(tmp_path):
    radiance = np.random.default_rng(6).uniform(0, 9, (4, 5, 3)).astype(np.float32)
    image = decode(write(tmp_path / "a.tif", radiance), "srgb")
    assert_array_equal(image.radiance, radiance)
    assert not image.variance.any()


def test_grey_repeats_and_alpha_is_dropped(tmp_path):
    grey = np.arange(12, dtype=np.uint8).reshape(3, 4)
    assert_array_equal(read_pixels(write(tmp_path / "grey.png", grey)), np.stack([grey] * 3, axis=-1))
    rgba = np.random.default_rng(7).integers(0, 256, (3, 4, 4), np.uint8)
    Image.fromarray(rgba).save(tmp_path / "rgba.png")
    assert_array_equal(read_pixels(tmp_path / "rgba.png"), rgba[..., :3])
    Image.fromarray(rgba[..., [0, 3]]).save(tmp_path / "la.png")
    assert_array_equal(read_pixels(tmp_path / "la.png"), np.repeat(rgba[..., :1], 3, axis=-1))


def test_orientation_tag_does_not_turn_the_pixels(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6  # "turn by 90 degrees to display"
    Image.fromarray(np.zeros((4, 6, 3), np.uint8)).save(tmp_path / "a.jpg", exif=exif)
    assert read_pixels(tmp_path / "a.jpg").shape == (4, 6, 3)


def test_result_is_read_only_and_checks_its_shapes():
    zeros = np.zeros((2, 3, 3), np.float32)
    image = RadianceImage(zeros, zeros, np.zeros((2, 3), bool))
    with pytest.raises(ValueError, match="read-only"):
        image.radiance[0] = 1
    with pytest.raises(ValueError, match=r"\(2, 3, 3\) and variance \(2, 3, 1\)"):
        RadianceImage(zeros, zeros[..., :1], np.zeros((2, 3), bool))
    with pytest.raises(ValueError, match=r"saturated is \(3, 2\), the image \(2, 3\)"):
        RadianceImage(zeros, zeros, np.zeros((3, 2), bool))


def test_radiance_files_are_unbiased_in_their_darkest_channel_too(tmp_path):
    rng = np.random.default_rng(9)
    truth = (rng.uniform(0.5, 1, (300, 400, 1)) * np.array([1, 0.3, 0.03])).astype(np.float32)
    image = decode(write(tmp_path / "a.hdr", truth))
    # Half a step is 0.002; the darkest channel covers four steps, of which the first and last only in part.
    assert_allclose((image.radiance - truth).mean(axis=(0, 1)), 0, atol=1e-4)
    z = (image.radiance - truth) / np.sqrt(image.variance)
    assert z.std() == pytest.approx(1, abs=0.02)


def test_what_a_merged_bracket_states_of_its_errors_is_kept(tmp_path):
    rng = np.random.default_rng(5)
    radiance, variance = rng.random((2, 4, 5, 3)).astype(np.float32)
    saturated = rng.random((4, 5)) > 0.5
    write_exr(tmp_path / "a.exr", radiance, layers={"variance": variance, "saturated": saturated * 1.0})
    image = decode(tmp_path / "a.exr", exposure=0.5)
    assert_allclose(image.variance, variance / 0.25, rtol=2 * FLOAT32, equal_nan=False)
    assert_array_equal(image.saturated, saturated)
    write_exr(tmp_path / "a.exr", radiance, layers={"variance": -variance})
    with pytest.raises(ValueError, match=r"a\.exr: its channels variance\.R, \.G, \.B must hold variances"):
        decode(tmp_path / "a.exr")


def test_noise_flat_field_and_white_balance_act_on_the_sensors_signal(tmp_path):
    rgb = np.random.default_rng(6).integers(0, 65535, (4, 6, 3)).astype(np.uint16)
    path = write(tmp_path / "a.png", rgb)
    noise = SensorNoise(np.array([0.01, 0.02, 0.03]), np.array([1e-3, 2e-3, 3e-3]))
    illumination = np.linspace(0.5, 1, 72).reshape(4, 6, 3).astype(np.float32)
    flat_field = FlatFieldMap(illumination, np.zeros(3))
    balance = np.array([2.0, 1.0, 1.5])
    image = decode(path, exposure=0.25, noise=noise, flat_field=flat_field, white_balance=balance)
    signal = rgb / 65535
    factor = balance / 0.25 / illumination
    assert_allclose(image.radiance, signal * factor, rtol=4 * FLOAT32, equal_nan=False)
    expected = noise.read_std**2 + noise.shot * signal + 1 / 65535**2 / 12
    assert_allclose(image.variance, expected * factor**2, rtol=1e-5, equal_nan=False)
    assert_array_equal(image.saturated, (rgb == 65535).any(axis=2))
    with pytest.raises(ValueError, match=r"b\.png: .*4x6"):
        decode(write(tmp_path / "b.png", rgb.transpose(1, 0, 2).copy()), flat_field=flat_field)


def test_a_recovered_response_is_undone_and_what_it_leaves_open_is_saturated(tmp_path):
    values = np.linspace(0, 1, 256)
    curve = np.log(np.maximum(np.stack([values**2.2, values**1.8, values**2.0]), 1e-12))
    curve[:, 250:] = np.nan
    response = Response(curve, np.where(np.isfinite(curve), 0.0, np.nan), np.array([[-1.0, 2.0]] * 3))
    rgb = np.random.default_rng(7).integers(1, 256, (30, 40, 3)).astype(np.uint8)
    image = decode(write(tmp_path / "a.png", rgb), response, noise=NO_NOISE)
    assert_array_equal(image.saturated, (rgb >= 250).any(axis=2))
    known = ~image.saturated
    expected = (rgb / 255) ** np.array([2.2, 1.8, 2.0])
    assert_allclose(image.radiance[known], expected[known], rtol=1e-6, equal_nan=False)


# Exposure.


def test_radiance_does_not_depend_on_the_exposure_that_caught_it(tmp_path):
    radiometry = Radiometry(exposure="manual")
    scene = np.full((4, 4, 3), 20, np.uint16)
    settings = ExposureSettings(exposure_s=0.01, iso=200, f_number=8)
    image = decode_in_set(radiometry, write(tmp_path / "a.png", scene), settings, (4, 4))
    # Twice the time, half the ISO, one stop wider, each times four of the f-number squared: 2 x 1/2 x 4.
    settings = ExposureSettings(exposure_s=0.02, iso=100, f_number=4)
    other = decode_in_set(radiometry, write(tmp_path / "b.png", 4 * scene), settings, (4, 4))
    assert_allclose(image.radiance, 20 / 65535 / (0.01 * 2 / 64), rtol=2 * FLOAT32, equal_nan=False)
    assert_allclose(other.radiance, image.radiance, rtol=2 * FLOAT32, equal_nan=False)


def save_with_exif(path: Path, **tags: float | IFDRational) -> Path:
    numbers = {"exposure_s": 33434, "f_number": 33437, "iso": 34855}
    exif = Image.Exif()
    exif.get_ifd(34665).update({numbers[name]: value for name, value in tags.items()})
    exif[34665] = 0  # Pillow writes the sub-directory only where the main one mentions it
    Image.fromarray(np.full((4, 4, 3), 51, np.uint8)).save(path, exif=exif)
    return path


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".tif"])
def test_exposure_is_read_from_exif_and_the_manifest_overrides_it(tmp_path, suffix):
    tags = {"exposure_s": IFDRational(1, 40), "iso": 400, "f_number": IFDRational(56, 10)}
    path = save_with_exif(tmp_path / f"a{suffix}", **tags)
    assert read_exif_exposure(path) == ExposureSettings(0.025, 400, 5.6)
    assert relative_exposure(path, "exif", ExposureSettings()) == pytest.approx(0.025 * 4 / 5.6**2, rel=1e-12)
    settings = ExposureSettings(exposure_s=0.1)
    assert relative_exposure(path, "exif", settings) == pytest.approx(0.1 * 4 / 5.6**2, rel=1e-12)
    assert relative_exposure(path, "manual", settings) == 0.1
    assert relative_exposure(path, "equal", settings) == 1
    image = decode_in_set(Radiometry(exposure="exif"), path, ExposureSettings(iso=100), (4, 4))
    # JPEG keeps a flat grey to one code.
    assert_allclose(image.radiance, 0.2 / (0.025 / 5.6**2), rtol=1 / 50)


def test_exposure_in_apex_units_is_read(tmp_path):
    exif = Image.Exif()
    exif.get_ifd(34665).update({37377: IFDRational(6, 1), 37378: IFDRational(5, 1)})
    exif[34665] = 0
    Image.fromarray(np.zeros((4, 4, 3), np.uint8)).save(tmp_path / "a.jpg", exif=exif)
    found = read_exif_exposure(tmp_path / "a.jpg")
    assert (found.exposure_s, found.f_number) == (1 / 64, pytest.approx(2**2.5))


def test_what_is_known_of_some_photographs_only_is_refused(tmp_path):
    both = {"exposure_s": IFDRational(1, 40), "iso": 400}
    paths = [save_with_exif(tmp_path / f"{name}.jpg", **both) for name in "ab"]
    assert bracket_exposures(paths) == (0.1, 0.1)
    paths.append(save_with_exif(tmp_path / "c.jpg", exposure_s=IFDRational(1, 10)))
    with pytest.raises(
        ValueError, match=r"c\.jpg: its ISO is not known, but that of a\.jpg is; write iso = "
    ):
        bracket_exposures(paths)
    assert bracket_exposures(paths, (1, 2, 4)) == (1, 2, 4)


def test_exposures_of_real_photographs(data_dir):
    # The exposure times that come with these photographs: 1/10, 1/40 and 1/160 s.
    found = [read_exif_exposure(data_dir / "mirrorball" / f"raw{i}.jpg").exposure_s for i in (1, 2, 3)]
    assert found == pytest.approx([1 / 10, 1 / 40, 1 / 160], rel=1e-9)


def test_a_missing_exposure_says_where_to_write_it(tmp_path):
    path = write(tmp_path / "a.png", np.zeros((4, 4, 3), np.uint8))
    zero = save_with_exif(tmp_path / "zero.jpg", exposure_s=IFDRational(0, 1), f_number=IFDRational(0, 0))
    write_exr(tmp_path / "a.exr", np.zeros((4, 4, 3)))
    for bad in (path, zero, tmp_path / "a.exr", tmp_path / "nowhere.png"):
        with pytest.raises(ValueError, match=rf"{bad.name}: its EXIF holds no exposure time; write"):
            relative_exposure(bad, "exif", ExposureSettings())
    with pytest.raises(ValueError, match=r"a\.png: the manifest gives no exposure_s; write exposure_s"):
        relative_exposure(path, "manual", ExposureSettings(iso=100))


# Masks and sets.


def test_a_mask_is_coverage_and_any_nonzero_value_is_the_object(tmp_path):
    mask = np.zeros((4, 6), np.uint8)
    mask[1:3, 2:4] = 200
    mask[1, 1] = 50
    coverage = read_mask(write(tmp_path / "m.png", mask), (4, 6))
    assert_allclose(coverage, mask / 200, rtol=FLOAT32, equal_nan=False)
    ones = read_mask(write(tmp_path / "ones.png", (mask > 0).astype(np.uint8)), (4, 6))
    assert_array_equal(ones, mask > 0)


@pytest.mark.parametrize("name", ["m.png", "m.tif", "m.exr"])
def test_alpha_is_the_mask_whatever_the_picture_shows(tmp_path, name):
    picture = np.random.default_rng(4).integers(0, 256, (4, 6, 3), np.uint8)
    alpha = np.zeros((4, 6), np.uint8)
    alpha[1:3, 2:4] = 255
    alpha[1, 1] = 51

    def written(alpha: np.ndarray) -> Path:
        path = tmp_path / name
        if path.suffix == ".exr":
            write_exr(path, picture / 255, layers={"A": alpha / 255})
        else:
            Image.fromarray(np.dstack([picture, alpha])).save(path)
        return path

    assert_allclose(read_mask(written(alpha), (4, 6)), alpha / 255, rtol=FLOAT32, equal_nan=False)
    # Opaque everywhere, it says nothing of the object: the channels do.
    expected = picture.max(axis=2) / picture.max()
    assert_allclose(
        read_mask(written(np.full_like(alpha, 255)), (4, 6)), expected, rtol=FLOAT32, equal_nan=False
    )


def test_a_bad_mask_is_named(tmp_path):
    path = write(tmp_path / "m.png", np.zeros((4, 6), np.uint8))
    with pytest.raises(ValueError, match=r"m\.png: the mask is empty"):
        read_mask(path, (4, 6))
    with pytest.raises(ValueError, match=r"m\.png: is 6x4 pixels, but its camera is 4x6"):
        read_mask(path, (6, 4))
    with pytest.raises(
        ValueError, match=r"its camera is 7x5; give the mask of this photo, drawn at its size"
    ):
        read_mask(path, (5, 7))
    write_exr(tmp_path / "m.exr", np.full((4, 6, 3), np.nan))
    with pytest.raises(ValueError, match=r"m\.exr: the mask holds 24 values that are not finite"):
        read_mask(tmp_path / "m.exr", (4, 6))


def photo_of_set(path: Path) -> Photo:
    camera = Camera(ORTHOGRAPHIC, [], 6, 4, np.eye(4))
    return Photo(path.name, path.name, path, None, camera, "", ExposureSettings(exposure_s=0.5), False)


def test_a_photo_is_decoded_as_its_set_says(tmp_path):
    path = write(tmp_path / "a.png", np.full((4, 6, 3), 188, np.uint8))
    radiometry = Radiometry(encoding="srgb", exposure="manual")
    assert_allclose(
        decode_photo(radiometry, photo_of_set(path)).radiance, 0.5 / 0.5, atol=0.01
    )  # one code's step


def test_a_photo_that_disagrees_with_its_set_is_named(tmp_path):
    path = write(tmp_path / "a.png", np.zeros((6, 4, 3), np.uint8))
    with pytest.raises(ValueError, match=r"a\.png: is 4x6 pixels, but its camera is 6x4"):
        decode_photo(Radiometry(), photo_of_set(path))
