"""Measured BRDFs as lobes without a formula: formulas measured, Cornell's paint, and what is prefiltered for them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.files.imagefile import read_pixels, write_exr
from capture.lighting import latlong_directions, latlong_solid_angles
from capture.reflectance.cornell import read_cornell
from capture.reflectance.samples import ReflectanceSamples
from invrender.inverse_brdf.table_lobe import measured_table, scattered_table, table_lobes
from synthetic.materials.tabulated import RusinkiewiczAngles, bin_centres, directions

Floats = np.ndarray
UP = np.array([0.0, 0.0, 1.0])
COLOUR = np.array([0.3, 0.2, 0.1])


def paint(wi: Floats, wo: Floats) -> Floats:
    """A broad highlight on a matt base, (..., 3) 1/sr; reciprocal."""
    half = wi + wo
    cos = half[..., 2:] / np.linalg.norm(half, axis=-1, keepdims=True)
    return COLOUR / np.pi + 0.2 * np.clip(cos, 0, 1) ** 12


def above(rng: np.random.Generator, count: int, least: float) -> Floats:
    """Random directions (n, 3) of a height of `least` or more."""
    up, turn = rng.uniform(least, 1, count), rng.uniform(0, 2 * np.pi, count)
    level = np.sqrt(1 - up**2)
    return np.stack([level * np.cos(turn), level * np.sin(turn), up], axis=-1)


def lobe_values(table: Floats, wi: Floats, wo: Floats) -> Floats:
    """The BRDF (n, 3) that a table's lobes are of, at directions (n, 3)."""
    lobes = table_lobes(table)
    return np.array([[lobe(UP, i, o) for lobe in lobes] for i, o in zip(wi, wo, strict=True)]) / wi[:, 2:]


@pytest.fixture(scope="module")
def merl(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The paint in MERL's format, with its gaps below the horizon."""
    path = tmp_path_factory.mktemp("merl") / "paint.binary"
    wi, wo = directions(RusinkiewiczAngles(*np.broadcast_arrays(*bin_centres((40, 30, 24)))))
    values = np.where(np.minimum(wi, wo)[..., 2:] > 0, paint(wi, wo), -1)
    integers = np.moveaxis(values / (np.array([1.0, 1.15, 1.66]) / 1500), -1, 0)
    path.write_bytes(np.array(values.shape[:3], "<i4").tobytes() + integers.astype("<f8").tobytes())
    return path


def test_a_dense_table_is_the_formula_that_it_was_made_of(merl: Path, rng: np.random.Generator) -> None:
    table = measured_table(merl)
    assert np.isfinite(table).all()
    wi, wo = above(rng, 300, 0.15), above(rng, 300, 0.15)
    assert_allclose(lobe_values(table, wi, wo), paint(wi, wo), rtol=0.01)
    lobe = table_lobes(table)[0]
    assert lobe(UP, -wi[0], wo[0]) == lobe(UP, wi[0], -wo[0]) == 0


def test_scattered_samples_say_what_lies_between_them(rng: np.random.Generator) -> None:
    wi, wo = above(rng, 1500, 0.15), above(rng, 1500, 0.15)
    table = scattered_table(ReflectanceSamples(wi, wo, paint(wi, wo)))
    others = above(rng, 200, 0.2), above(rng, 200, 0.2)
    found, truth = lobe_values(table, *others), paint(*others)
    assert np.median(np.abs(found / truth - 1)) < 0.01
    assert np.percentile(np.abs(found / truth - 1), 95) < 0.06
    # Beyond what was measured reflection stays as it was there.
    steep, least = np.array([[0.9995, 0, 0.03]]), np.array([[np.sqrt(1 - 0.15**2), 0, 0.15]])
    assert_allclose(lobe_values(table, steep, wo[:1]), lobe_values(table, least, wo[:1]), rtol=0.1)


def test_a_paint_reflects_what_was_measured(data_dir: Path) -> None:
    samples = read_cornell(data_dir / "brdf" / "garnet_red.brdf")
    found = lobe_values(measured_table(data_dir / "brdf" / "garnet_red.brdf"), samples.wi, samples.wo)
    off = np.abs(found - samples.rgb) / (samples.rgb + 0.02)
    assert np.median(off) < 0.015
    assert np.percentile(off, 95) < 0.09


@pytest.mark.sweep
def test_light_is_prefiltered_for_a_measured_brdf(
    lightfactor: Callable[..., tuple[int, str, str]], merl: Path, tmp_path: Path
) -> None:
    write_exr(tmp_path / "sky.exr", 1 + 0.8 * latlong_directions(16)[..., [2]].repeat(3, axis=-1))
    code, said, _ = lightfactor(
        *(
            "prefilter",
            tmp_path / "sky.exr",
            "--brdf",
            merl,
            "--epsilon",
            "0.002",
            "--view",
            "0,90",
            "-o",
            tmp_path / "out",
        )
    )
    assert code == 0
    assert "sky.exr for paint.binary, as measured" in said
    shown = read_pixels(tmp_path / "out" / "whole-view-1.exr")
    centres = latlong_directions(len(shown))
    viewer = UP
    wi = latlong_directions(48).reshape(-1, 3)
    light = 1 + 0.8 * wi[:, 2:]
    solid = np.broadcast_to(latlong_solid_angles(48), (48, 96)).reshape(-1, 1)
    # Normals half way between mirrored direction and viewer, up to 60 degrees from either.
    for row in range(0, int(len(shown) * 120 / 180), 9):
        normal = centres[row, 3] + viewer
        normal /= np.linalg.norm(normal)
        side = np.cross([0.0, 1, 0], normal)
        side /= np.linalg.norm(side)
        frame = np.stack([side, np.cross(normal, side), normal])
        cos = wi @ normal
        lit = cos > 0
        reflected = paint(wi[lit] @ frame.T, frame @ viewer) * (cos[:, None] * light * solid)[lit]
        assert_allclose(shown[row, 3], reflected.sum(axis=0), rtol=0.02)


def test_what_was_not_measured_is_refused(
    tmp_path: Path, lightfactor: Callable[..., tuple[int, str, str]]
) -> None:
    path = tmp_path / "nothing.binary"
    path.write_bytes(np.array([2, 2, 2], "<i4").tobytes() + np.full(24, -1.0).astype("<f8").tobytes())
    with pytest.raises(ValueError, match="nothing was measured"):
        measured_table(path)
    write_exr(tmp_path / "sky.exr", np.ones((4, 8, 3)))
    arguments = ("prefilter", tmp_path / "sky.exr", "--brdf", path, "-o", tmp_path / "out")
    code, _, err = lightfactor(*arguments, "--assume", "mu=1.5")
    assert code == 1
    assert "has no open numbers" in err
