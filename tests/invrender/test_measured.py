"""Measured BRDFs of others: their files, and what is fitted to them."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import lightfactor as lf
from capture.reflectance.samples import ReflectanceSamples
from invrender.brdf.lobes import GGX_FORM
from invrender.inverse_brdf.halfangles import directions, half_angles
from invrender.inverse_brdf.measured import brdf_values, fit_measured, read_measured
from invrender.inverse_brdf.table import bin_centres
from lightfactor.cli import main
from synthetic.materials.facets import GGXSlopes
from synthetic.materials.smith import SmithMaterial
from synthetic.materials.tabulated import RusinkiewiczAngles
from synthetic.materials.tabulated import directions as other_directions

from .fewforms import few_forms_tried

# Bins of the tables here; MERL's are 90 x 90 x 180.
BINS = (45, 30, 24)
KD, KS, MU, SIGMA = np.array([0.1, 0.05, 0.02]), np.full(3, 0.04), 1.5, 0.2
UP = np.array([0.0, 0.0, 1.0])
PAINT = SmithMaterial(KD, KS, MU, GGXSlopes(SIGMA, SIGMA))


def table_of(material: SmithMaterial, bins: tuple[int, int, int] = BINS) -> np.ndarray:
    """A material's table, by the formulas that render it; NaN below the horizon."""
    wi, wo = other_directions(RusinkiewiczAngles(*bin_centres(bins)))
    above = np.minimum(wi[..., 2], wo[..., 2]) > 0
    values = np.where(above[..., None], material.evaluate(UP, wi, wo), np.nan)
    # Noise of 1%, as a gonioreflectometer's.
    return values * np.random.default_rng(0).normal(1, 0.01, values.shape)


def write_merl(path: Path, table: np.ndarray) -> None:
    """A table as the database's files have it."""
    integers = np.where(np.isfinite(table), table, -1) / (np.array([1.0, 1.15, 1.66]) / 1500)
    path.write_bytes(
        np.array(table.shape[:3], "<i4").tobytes() + np.moveaxis(integers, -1, 0).astype("<f8").tobytes()
    )


def test_directions_have_the_angles_that_they_were_made_of() -> None:
    angles = bin_centres((7, 6, 5))
    wi, wo = directions(angles)
    normal = np.broadcast_to([0.0, 0.0, 1.0], wi.shape)
    for found, given in zip(half_angles(normal, wi, wo), angles, strict=True):
        assert_allclose(found, given, atol=1e-12)
    # Another's formula, up to where the half vector points.
    for own, other in zip((wi, wo), other_directions(RusinkiewiczAngles(*angles)), strict=True):
        assert_allclose(own[..., 2], other[..., 2], atol=1e-12)


@pytest.fixture(scope="module")
def merl(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("measured") / "paint.binary"
    write_merl(path, table_of(PAINT))
    return path


def test_a_materials_numbers_are_found_in_its_table(merl: Path) -> None:
    with few_forms_tried(GGX_FORM, tables=False):
        fit = fit_measured(read_measured(merl), 6000)
    assert fit.model.estimate.model.form is GGX_FORM
    numbers = fit.solution.quantities
    for name, true in {"kd": KD, "ks": KS, "mu": MU, "sigma": SIGMA}.items():
        found = numbers[name]
        assert found.value is not None
        assert found.std is not None
        assert found.status == "determined", name
        # 6000 values with noise of 1% each; the bars hold what they leave.
        assert_allclose(found.value, true, rtol=0.02, err_msg=name)
        assert (np.abs(found.value - true) < 4 * found.std).all(), name
    # Noise is 1% of each value.
    assert 0.008 < fit.errors.mean() < 0.012
    # Elsewhere too it is the material.
    rng = np.random.default_rng(1)
    pairs = rng.normal(size=(2, 500, 3))
    pairs[..., 2] = np.abs(pairs[..., 2]) + 0.1
    wi, wo = pairs / np.linalg.norm(pairs, axis=-1, keepdims=True)
    assert_allclose(brdf_values(fit.solution.estimate.brdf, wi, wo), PAINT.evaluate(UP, wi, wo), rtol=0.03)


def test_a_real_paint_has_the_index_of_paint(data_dir: Path) -> None:
    with few_forms_tried(GGX_FORM):
        fit = fit_measured(read_measured(data_dir / "brdf" / "garnet_red.brdf"))
    assert len(fit.groups) == 8
    assert_allclose([fit.incidence_deg(group) for group in fit.groups], np.arange(10, 90, 10), atol=0.01)
    mu, kd, ks = (fit.solution.quantities[name] for name in ("mu", "kd", "ks"))
    # Binders of paints have indices of 1.45 to 1.55; (mu - 1)^2 / (mu + 1)^2 is then their reflectance.
    assert mu.value is not None
    assert ks.value is not None
    assert kd.value is not None
    assert 1.4 < mu.value[0] < 1.6
    assert ks.value == pytest.approx(float(((mu.value[0] - 1) / (mu.value[0] + 1)) ** 2), rel=0.3)
    # A specular lobe of some degrees takes R02's small orders over views (section 5.6.2).
    specular = fit.orders["specular"]
    assert specular is not None
    assert specular[1] <= 4 < specular[0]
    # Garnet red.
    assert kd.value[0] > 5 * kd.value[1:].max()
    # RH01's form leaves a third on angles of incidence that it has not seen.
    errors = {each.estimate.model.name: each.error for each in fit.solution.candidates}
    assert fit.model.error < 0.5 * errors["microfacet"]


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    monkeypatch.setattr(sys, "argv", ["lightfactor", "brdf", *map(str, arguments)])
    with pytest.raises(SystemExit) as done:
        main()
    return int(done.value.code or 0)


def test_our_own_table_is_read_and_the_result_written(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    bins = (30, 20, 16)
    table = table_of(PAINT, bins)
    nested = np.where(np.isfinite(table), table.astype(object), None).tolist()
    path = tmp_path / "brdf.json"
    path.write_text(json.dumps({"format": 1, "method": "table", "bins": bins, "values": nested}))
    with few_forms_tried(GGX_FORM, tables=False):
        assert run(monkeypatch, path, "-o", tmp_path / "out", "--samples", 1500) == 0
    found = json.loads((tmp_path / "out" / "brdf.json").read_text())
    assert (found["method"], found["samples"], found["brdf"]["model"]) == ("measured", 1500, "GGX")
    assert found["brdf"]["mu"]["value"] == pytest.approx(MU, rel=0.02)
    assert sum(each["samples"] for each in found["incidence"]) == 1500
    assert (tmp_path / "out" / "brdf.png").stat().st_size > 20_000
    # The same from Python.
    with few_forms_tried(GGX_FORM, tables=False):
        fit = lf.fit_brdf(path, samples=1500)
    assert fit.numbers["mu"].value == found["brdf"]["mu"]["value"]
    assert fit.unseen_error == found["fit"]["cross_validated_rms_relative"]
    assert_allclose(fit.evaluate(UP, UP), PAINT.evaluate(UP, UP[None], UP[None]), rtol=0.03)
    with pytest.raises(ValueError, match="must lie above the surface"):
        fit.evaluate(UP, -UP)
    with pytest.raises(ValueError, match="there is no such file"):
        lf.fit_brdf(tmp_path / "none.brdf")


@pytest.mark.parametrize(
    ("name", "content", "options", "message"),
    [
        ("cut.binary", "half", (), "no MERL file, or was cut short"),
        ("paint.binary", "whole", ("--order", 3), "--method and --order are for photo sets"),
        ("brdf.json", '{"method": "harmonic", "format": 1}', (), "only tables can be fitted"),
        (
            "brdf.json",
            '{"method": "table", "bins": [1, 1, 2], "values": [1]}',
            (),
            r"shape \(1,\); bins says",
        ),
        ("paint.brdf", "2\n400 410\n0.1 0 0.2 0 nan 1\n", (), "row 0 is not finite"),
        ("paint.brdf", "2\n400 410\n0.1 0 0.2 0 1 1\n", (), "1 samples have light and sensor"),
    ],
)
def test_files_that_hold_no_brdf_are_refused(
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    tmp_path: Path,
    merl: Path,
    name: str,
    content: str,
    options: tuple[object, ...],
    message: str,
) -> None:
    path, whole = tmp_path / name, merl.read_bytes()
    path.write_bytes({"half": whole[:-8], "whole": whole}.get(content, content.encode()))
    assert run(monkeypatch, path, "-o", tmp_path / "out", *options) == 1
    error = " ".join(capfd.readouterr().err.split())
    assert re.search(message, error), error
    assert not (tmp_path / "out").exists()


def test_samples_that_are_no_reflectances_are_refused() -> None:
    up = np.tile([0.0, 0.0, 1.0], (60, 1))
    with pytest.raises(ValueError, match="no value is positive"):
        fit_measured(ReflectanceSamples(up, up, np.zeros((60, 3))))
    with pytest.raises(ValueError, match="one angle of incidence"):
        fit_measured(ReflectanceSamples(up, up, np.ones((60, 3))))
    with pytest.raises(ValueError, match="sample 3 is"):
        fit_measured(
            ReflectanceSamples(up, up, np.where(np.arange(60)[:, None] == 3, np.nan, np.ones((60, 3))))
        )
