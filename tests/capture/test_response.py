"""Camera responses: the curve as an object, the two methods, and what their standard deviations promise."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from capture.bracket.bracketcheck import check_exposures
from capture.bracket.bracketsample import BracketSample, sample_bracket
from capture.bracket.debevec import LogExposureSpline, solve_debevec
from capture.bracket.mitsunaga import ExposurePolynomial
from capture.bracket.response import Response, read_response, response_channels
from capture.bracket.responsefit import ChannelFit, correction_basis, fit_curves
from capture.bracket.responserecovery import Recovery, believed_steps, recover_from_sample, recover_response
from capture.files.documents import write_json
from synthetic.sensing.sensor import RESPONSES, Sensor, expose


def scene(rng: np.random.Generator, height: int = 40, width: int = 54) -> np.ndarray:
    """Smooth random radiance over about eight stops, the same in no two channels."""
    noise = cv2.GaussianBlur(rng.normal(size=(height, width, 3)), (0, 0), 8)
    slope = np.linspace(-2, 2, height)[:, None, None]
    return 0.1 * np.exp2(slope + 2 * noise / noise.std(axis=(0, 1)))


def bracket(folder: Path, sensor: Sensor, times, seed: int, change=None) -> list[Path]:
    """PNG files of a bracket; change(radiance, index) is what the scene is in photograph `index`."""
    rng = np.random.default_rng(seed)
    radiance = scene(rng)
    paths = []
    for index, time in enumerate(times):
        paths.append(folder / f"photo {index} ä.png")
        seen = radiance if change is None else change(radiance.copy(), index)
        codes = expose(seen, time, sensor, rng)
        encoded, data = cv2.imencode(".png", np.ascontiguousarray(codes[..., ::-1]))
        assert encoded
        paths[-1].write_bytes(data.tobytes())
    return paths


def truth(response: str, values: np.ndarray) -> np.ndarray:
    """Log exposure of values by the sensor's own formula, inverted on a fine grid."""
    signal = np.concatenate([[0], np.geomspace(1e-9, 1, 400_001)])
    return np.log(np.interp(values, RESPONSES[response](signal), signal))


def covered(found: Response, response: str) -> list[float]:
    """Per channel, the share of determined values whose 95% interval holds the truth."""
    shares = []
    for curve, std in zip(found.log_exposure, found.log_std, strict=True):
        known = np.isfinite(curve)
        error = curve[known] - truth(response, found.values[known])
        error -= error[np.argmin(np.abs(found.values[known] - 128 / 255))]
        shares.append(float(np.mean(np.abs(error) <= 1.96 * std[known])))
    return shares


def without_power(recovery: Recovery) -> Response:
    """The response with the standard deviations of its shape alone."""
    found = recovery.response
    middle = np.array([curve[np.isfinite(curve)][0] for curve in found.log_exposure])
    for channel, curve in enumerate(found.log_exposure):
        known = np.flatnonzero(np.isfinite(curve))
        middle[channel] = curve[known[np.argmin(np.abs(found.values[known] - 128 / 255))]]
    power = recovery.exponent_std * (found.log_exposure - middle[:, None])
    return Response(found.log_exposure, np.sqrt(np.maximum(found.log_std**2 - power**2, 0)), found.clip)


def gamma_response(gamma: float = 2.0, knots: int = 256) -> Response:
    with np.errstate(divide="ignore"):
        curve = gamma * np.log(np.linspace(0, 1, knots))
    curve[:4], curve[-2:] = np.nan, np.nan
    std = np.where(np.isfinite(curve), 0.01, np.nan)
    return Response(np.tile(curve, (3, 1)), np.tile(std, (3, 1)), np.tile([0.0, 1.0], (3, 1)))


# The curve as an object.


@pytest.mark.parametrize("levels", [255, 65535])
def test_a_curve_is_applied_where_it_is_known(levels):
    response = gamma_response()
    table = response.table(levels)
    values = np.arange(levels + 1) / levels
    known = (values >= 4 / 255) & (values <= 253 / 255)
    # Straight in the logarithm between knots: at 4/255 the square of a half-way value is off by (1/9)^2 / 4.
    assert_allclose(table[:, known], np.tile(values[known] ** 2, (3, 1)), rtol=0.02, equal_nan=False)
    assert_allclose(table[:, levels * 128 // 255], (128 / 255) ** 2, rtol=1e-4, equal_nan=False)
    # Below what is known: in proportion, and anything from darkness on; above: flagged.
    assert_allclose(table[:, 0], 0, atol=0)
    assert_allclose(response.variance_table(levels)[:, 0], (4 / 255) ** 4 / 12, rtol=1e-6, equal_nan=False)
    assert_array_equal(response.brightest(levels), levels * 253 // 255)
    assert (np.diff(table, axis=1)[:, : response.brightest(levels)[0]] > 0).all()


def test_codes_become_light():
    codes = np.random.default_rng(0).integers(5, 250, (4, 5, 3), np.uint8)
    assert_allclose(gamma_response().linear(codes), (codes / 255.0) ** 2, rtol=1e-6, equal_nan=False)


def test_a_gap_is_as_uncertain_as_it_is_wide():
    response = gamma_response()
    curve, std = response.log_exposure.copy(), response.log_std.copy()
    curve[:, 100:120], std[:, 100:120] = np.nan, np.nan
    gapped = Response(curve, std, response.clip)
    low, high = (99 / 255) ** 2, (120 / 255) ** 2
    assert_allclose(gapped.variance_table(255)[:, 110], (high - low) ** 2 / 12, rtol=1e-9, equal_nan=False)
    assert_allclose(gapped.table(255)[:, 110], low + (high - low) * 11 / 21, rtol=1e-9, equal_nan=False)


def test_a_response_survives_its_file(tmp_path):
    response = gamma_response()
    write_json(tmp_path / "r é.json", {"format": 1, "channels": response_channels(response)})
    again = read_response(tmp_path / "r é.json")
    assert_allclose(again.log_exposure, response.log_exposure, rtol=1e-6)  # seven digits; NaN where it was
    assert_array_equal(np.isnan(again.log_std), np.isnan(response.log_std))
    assert_array_equal(again.clip, response.clip)


def test_a_bad_response_is_named(tmp_path):
    channels = response_channels(gamma_response())
    falling = {**channels["green"], "log_exposure": channels["green"]["log_exposure"][::-1]}
    cases = (
        ({"format": 2, "channels": channels}, "format"),
        ({"format": 1}, "lacks the key 'channels'"),
        ({"format": 1, "channels": {"red": channels["red"]}}, "lacks the channel 'green'"),
        ({"format": 1, "channels": {**channels, "green": falling}}, "green: "),
        (
            {"format": 1, "channels": {**channels, "blue": {"log_exposure": [1]}}},
            "channel 'blue' cannot be read",
        ),
    )
    for document, message in cases:
        write_json(tmp_path / "r.json", document)
        with pytest.raises(ValueError, match=rf"r\.json: .*{message}"):
            read_response(tmp_path / "r.json")


# The methods, without noise.


def codes_of(curve, times: np.ndarray, pixels: int = 3000) -> np.ndarray:
    """Values (n, p) of exposures that are spread evenly in the logarithm, unquantised."""
    log_exposure = np.random.default_rng(1).uniform(np.log(2e-3), np.log(2), (pixels, 1))
    return np.clip(curve(np.exp(log_exposure) * times), 0, 1)


def sample_of(values: np.ndarray, patch: np.ndarray, step: float = 1 / 255) -> BracketSample:
    """The same values (n, p) in all channels, of files that clip at both ends."""
    channels = np.stack([values] * 3)
    clip = np.tile([0.0, 1.0], (3, 1))
    return BracketSample(channels, (channels > 0) & (channels < 1), patch, clip, step)


def test_equation_3_gives_a_gamma_curve_back():
    times = np.array([0.25, 1, 3])
    values = codes_of(lambda exposure: exposure ** (1 / 2.2), times)
    curve = LogExposureSpline(0, 1)
    params = solve_debevec(curve, values, (values > 0) & (values < 1), np.log(times), smoothing=1e-6)
    at = np.linspace(0.15, 0.95, 50)
    found = curve.log_exposure(params, at)
    expected = 2.2 * np.log(at)
    # What the smoothing, small as it is, takes away at the ends.
    assert_allclose(found - found[25], expected - expected[25], atol=0.01, equal_nan=False)


def test_a_polynomial_of_the_right_order_is_exact():
    # z of exposure I = (z + 2 z^3) / 3, inverted numerically.
    grid = np.linspace(0, 1, 100_001)
    times = np.array([0.25, 1, 3])
    values = codes_of(lambda exposure: np.interp(exposure, (grid + 2 * grid**3) / 3, grid), times)
    patch = np.arange(len(values)) % 50
    sample = sample_of(values, patch, 1 / 65535)
    at = np.linspace(0.05, 0.95, 40)
    curve = ExposurePolynomial(0, 1, 3)
    start = curve.fitted_to(at, 1.5 * np.log(at), np.ones(40))
    channels = [ChannelFit(curve, start, 0.0, np.full(20, 1e-3)) for _ in range(3)]
    fitted, log_times = fit_curves(sample, np.log(times), channels, 30)
    found = curve.log_exposure(fitted[0].params, at)
    expected = np.log(at + 2 * at**3)
    assert_allclose(
        found - found[20], expected - expected[20], atol=2e-3, equal_nan=False
    )  # the table's inversion
    assert_allclose(log_times, np.log(times), atol=1e-3, equal_nan=False)


def test_corrections_leave_scale_and_span_alone():
    times = np.array([0.3, -1.0, 2.0, 0.5, 4.0])
    basis = correction_basis(times)
    assert basis.shape == (5, 3)
    assert_allclose(basis.T @ basis, np.eye(3), atol=1e-12)
    assert_allclose(basis.T @ np.stack([np.ones(5), times], axis=1), 0, atol=1e-12)
    assert correction_basis(times[:2]).shape == (2, 0)


# Recovery from a synthetic sensor, which counts photons.


@pytest.mark.slow
def test_intervals_cover_the_truth(tmp_path):
    shares = []
    for seed, (response, times) in enumerate([("gamma", (4, 0.5)), ("film", (0.2, 0.8, 2, 6))]):
        folder = tmp_path / str(seed)
        folder.mkdir()
        paths = bracket(folder, Sensor(response=response, bits=8), times, seed)
        recovery = recover_response(paths, times)
        assert (np.isfinite(recovery.response.log_exposure).mean(axis=1) > 0.7).all()
        # The exposures are as given here: only the curve's shape is put to the test.
        shares += covered(without_power(recovery), response)
    # 95% intervals; six curves whose errors are correlated along them: the mean scatters by some 4%.
    assert 0.9 <= np.mean(shares) <= 1


def test_exposures_off_by_a_common_power_are_within_the_intervals(tmp_path):
    times = np.array([0.25, 1.0, 4.0])
    # 3% of the span: one and a half standard deviations of the slope through three times known to 4% each.
    paths = bracket(tmp_path, Sensor(response="srgb", bits=8), times**1.03, 8)
    recovery = recover_response(paths, times)
    assert recovery.exponent_std == pytest.approx(0.04 / np.linalg.norm(np.log(times)), rel=1e-3)
    assert np.mean(covered(recovery.response, "srgb")) > 0.95
    assert np.mean(covered(without_power(recovery), "srgb")) < 0.5
    for step in believed_steps(recovery):
        assert step.std == pytest.approx(4 * np.log(4) * recovery.exponent_std, rel=0.05)


def test_what_moves_is_left_out(tmp_path):
    def change(radiance, index):  # a box over a twelfth of the picture, elsewhere in each photograph
        radiance[8:30, 3 + 15 * index : 11 + 15 * index] = (0.4, 0.5, 0.6)
        return radiance

    times = (0.1, 0.5, 2.5)
    recovery = recover_response(bracket(tmp_path, Sensor(response="film", bits=8), times, 9, change), times)
    assert 0.1 < recovery.moved < 0.3  # a quarter of the picture is the box's in some photograph
    assert np.mean(covered(without_power(recovery), "film")) > 0.9
    assert np.nanmedian(recovery.response.log_std) < 0.03  # not covered by knowing nothing


@pytest.mark.slow
def test_colour_that_a_jpeg_smears_from_saturated_neighbours_does_not_bend_the_curve(tmp_path):
    rng = np.random.default_rng(10)
    # Coloured patches, whose edges the halved colour of a JPEG blurs.
    patches = np.exp2(rng.normal(-3, 1.7, (20, 24, 1)) + rng.normal(0, 0.8, (20, 24, 3)))
    radiance = cv2.GaussianBlur(patches.repeat(10, axis=0).repeat(10, axis=1), (0, 0), 4)
    times = (0.25, 1.0, 4.0)
    paths = []
    for index, time in enumerate(times):
        paths.append(tmp_path / f"{index}.jpg")
        codes = expose(radiance, time, Sensor(response="srgb", bits=8), rng)
        Image.fromarray(codes).save(paths[-1], quality=92, subsampling=2)
    found = recover_response(paths, times).response
    assert found.determined(1)[1] > 200 / 255
    error = found.log_exposure[:, 40:] - truth("srgb", found.values[40:])
    # Smeared saturation bends blue by 3%; without it 0.8% of noise is left.
    assert np.nanmax(np.abs(error)) < 0.015


@pytest.mark.sweep
def test_the_order_of_the_photographs_does_not_matter(tmp_path):
    times = (1.0, 0.25, 4.0)
    paths = bracket(tmp_path, Sensor(response="gamma", bits=16), times, 5)
    found = recover_response(paths, times)
    again = recover_response(paths[::-1], times[::-1])
    assert found.response.log_exposure.shape == (3, 1024)
    # The same sums in another order, iterated: far below the standard deviations, 1e-3.
    assert_allclose(again.response.log_exposure, found.response.log_exposure, atol=1e-4)
    assert_allclose(again.stops[::-1], found.stops, atol=1e-4)


def test_a_wrong_exposure_is_found_and_named(tmp_path):
    true = np.array([0.25, 0.5, 1.0, 2.0, 4.0])
    paths = bracket(tmp_path, Sensor(response="srgb", bits=8), true * [1, 1, 1.15, 1, 1], 6)
    recovery = recover_response(paths, true)
    assert len(recovery.warnings) == 1
    assert "photo 2 ä.png" in recovery.warnings[0]
    # Of 15%, a fifth is taken up by the mean of the five.
    off = recovery.stops - recovery.nominal_stops
    assert off[2] == pytest.approx(0.8 * np.log2(1.15), abs=4 * recovery.stops_std[2] + 0.01)
    # The 15% tells how exactly these times are known: 15% x sqrt(4/5) over three degrees of freedom.
    assert recovery.exponent_std * np.linalg.norm(np.log(true)) == pytest.approx(0.072, abs=0.02)
    assert [step.given for step in believed_steps(recovery)] == pytest.approx([2, 2, 2, 2])


# What isn't a bracket.


def test_what_contradicts_itself_is_refused_by_name():
    names = ("a.png", "b.png", "c.png")
    times = np.log([1.0, 2.0, 4.0])
    values = codes_of(lambda exposure: exposure**0.45, np.array([0.2, 0.4, 0.8]))
    patch = np.arange(len(values)) % 20
    check_exposures(sample_of(values, patch), times, names)
    folded = np.where(values > 0.6, 1.2 - values, values)
    cases = (
        (values, np.zeros(3), r"a\.png and the others: all exposures are equal"),
        (
            values,
            times[::-1],
            r"b\.png is darker than c\.png.* 2 times as long \(and 1 more pairs\).*reversed",
        ),
        (folded, times, r"b\.png is darker than a\.png where values are about .*isn't monotonic"),
        (
            np.repeat(values[:, :1], 3, axis=1),
            times,
            r"b\.png is as bright as a\.png, .* 2 times as long: check",
        ),
        (0 * values, times, r"a\.png and the others: in red, .*nearly all of it is black"),
        (0 * values + 1, times, r"a\.png and the others: in red, .*nearly all of it is saturated"),
    )
    for bad, exposures, message in cases:
        with pytest.raises(ValueError, match=message):
            recover_from_sample(sample_of(bad, patch), np.exp(exposures), names, 256)


def test_files_that_do_not_belong_together_are_named(tmp_path):
    paths = bracket(tmp_path, Sensor(bits=8), (0.5, 1), 7)
    small, deep = tmp_path / "small.png", tmp_path / "deep.png"
    codes = cv2.imread(str(paths[0]))
    cv2.imwrite(str(small), codes[:10])
    cv2.imwrite(str(deep), codes.astype(np.uint16))
    rng = np.random.default_rng(0)
    for bad, message in (
        (small, r"small\.png: is 54x10 pixels, but .*54x40"),
        (deep, r"deep\.png: is uint16, but"),
    ):
        with pytest.raises(ValueError, match=message):
            sample_bracket([*paths, bad], rng)
    with pytest.raises(ValueError, match=r"photo 0 ä\.png: a bracket needs two"):
        sample_bracket(paths[:1], rng)
