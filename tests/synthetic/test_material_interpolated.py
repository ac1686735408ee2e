"""Measured paints: colours of spectra, and a table that holds what was measured."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.reflectance import spectra
from capture.reflectance.cornell import read_cornell
from capture.reflectance.spectra import colour_matching, reflectance_to_srgb
from synthetic.materials.energy import check_energy, directional_albedo
from synthetic.materials.interpolated import interpolated

WAVELENGTHS = np.arange(400.0, 701.0, 10.0)


def test_colour_matching_functions_are_the_standard_observers() -> None:
    # CIE 1931, as tabulated; the fit's authors give its error as about a hundredth of the peak.
    standard = {
        450: (0.3362, 0.0380, 1.7721),
        500: (0.0049, 0.3230, 0.2720),
        550: (0.4334, 0.9950, 0.0087),
        600: (1.0622, 0.6310, 0.0008),
        650: (0.2835, 0.1070, 0.0000),
    }
    assert_allclose(colour_matching(list(standard)), list(standard.values()), atol=0.02)


def test_white_is_white_and_daylights_own_white_comes_close() -> None:
    assert_allclose(reflectance_to_srgb(WAVELENGTHS, np.full(31, 0.7)), np.full(3, 0.7), rtol=1e-12)
    # Before scaling, too: the matrix of sRGB has its white at D65, (0.3127, 0.3290).
    xyz = spectra._D65 @ colour_matching(WAVELENGTHS)
    assert_allclose(xyz[:2] / xyz.sum(), [0.3127, 0.3290], atol=5e-4)  # the fit, and steps of 10 nm


def test_spectra_have_the_colour_of_their_wavelengths() -> None:
    red, green, blue = (
        reflectance_to_srgb(WAVELENGTHS, (np.clip(WAVELENGTHS, low, high - 1) == WAVELENGTHS).astype(float))
        for low, high in ((600, 701), (500, 600), (400, 500))
    )
    assert [red.argmax(), green.argmax(), blue.argmax()] == [0, 1, 2]
    assert_allclose(red + green + blue, np.ones(3), rtol=1e-12)


@pytest.mark.parametrize(
    ("wavelengths", "message"), [([400.0, 410.0, 430.0], "evenly spaced"), ([380.0, 390.0], "380 to 390 nm")]
)
def test_unknown_wavelengths_are_refused(wavelengths: list[float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        reflectance_to_srgb(wavelengths, np.ones(len(wavelengths)))


@pytest.mark.parametrize(
    ("name", "hue"), [("krylon_blue", 2), pytest.param("garnet_red", 0, marks=pytest.mark.slow)]
)
def test_measured_paint_is_reproduced(data_dir: Path, name: str, hue: int, rng: np.random.Generator) -> None:
    samples = read_cornell(data_dir / "brdf" / f"{name}.brdf")
    assert len(samples.rgb) == 1439
    material = interpolated(samples)
    # As enamel reflects it: a coloured base below a white highlight.
    assert np.median(samples.rgb, axis=0).argmax() == hue
    measured = np.maximum(samples.rgb, 0)
    found = material.lobe(samples.wi, samples.wo)
    # Of 0.02 / sr, a dark paint, at least: linear interpolation in bins of a degree or two.
    error = np.abs(found - measured) / (measured + 0.02)
    assert np.median(error) < 0.01
    assert np.quantile(error, 0.95) < 0.12
    assert error.max() < 0.5
    # As light is counted, by cosines: highlights are kept.
    cosines = samples.wi[:, 2:] * samples.wo[:, 2:]
    assert np.sqrt(((found - measured) ** 2 * cosines**2).mean()) < 1e-3 * (measured * cosines).max()
    # Nowhere more than was measured, nor more than is received.
    assert material.table.max() <= measured.max() * (1 + 1e-6)
    check_energy(material)
    # Mirror-symmetric about the plane of incidence.
    wi, wo = samples.wi[::7], samples.wo[::7]
    flip = np.array([1, -1, 1])
    assert_allclose(material.lobe(wi * flip, wo * flip), material.lobe(wi, wo), rtol=1e-6)
    # Paint under a coat: brighter towards grazing, as far as was measured, and no steps on the way.
    albedo = directional_albedo(material, np.cos(np.radians(np.arange(0, 80, 5))))
    assert albedo[-2].min() > albedo[0].min()
    assert np.abs(np.diff(albedo, axis=0)).max() < 0.06


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("2\n400 410\n0.1 0 0.2 0 1 1\n0.1 0 0.2 0 1\n", "numbers are no count"),
        ("# empty\n", "0 numbers are no count"),
        ("2\n400 410\n0.1 0 0.2 zero 1 1\n", r"paint.brdf, line 3: .*zero"),
        ("2\n400 410\n0.1 0 0.2 0 nan 1\n", "row 0 is not finite"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "paint.brdf"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        read_cornell(path)
