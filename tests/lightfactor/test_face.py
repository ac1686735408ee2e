"""The public face, `import lightfactor as lf`: the tour, fresh and saved fits, a kept result, and errors."""

from __future__ import annotations

import importlib
import json
import re
import runpy
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lightfactor as lf
from capture.files.imagefile import read_exr_layers, read_pixels
from tests.invrender.fewforms import few_forms_tried

ROOT = Path(__file__).parents[2]
# A result.json of `lightfactor process tour`, written before this package had functions.
KEPT = Path(__file__).with_name("kept")
NAMES = ("kd", "ks", "mu", "sigma", "exponent", "albedo", "kd_normalised", "ks_normalised")


@pytest.fixture(scope="module")
def tour(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What docs/tour.py leaves: its variables, its files under `out`, and what it printed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tempfile, "tempdir", str(tmp_path_factory.mktemp("tour")))
        patch.setattr(sys, "argv", ["tour.py"])
        with few_forms_tried():
            return runpy.run_path(str(ROOT / "docs/tour.py"))


@pytest.fixture(scope="module")
def fit(tour: dict[str, Any]) -> lf.Fit:
    """The tour's fit, as `process` returned it."""
    found = tour["fit"]
    assert isinstance(found, lf.Fit)
    return found


@pytest.fixture
def kept() -> lf.Fit:
    return lf.read_fit(KEPT)


def test_the_tour_comes_near_the_truth(tour: dict[str, Any], fit: lf.Fit) -> None:
    truth = json.loads((tour["folder"] / "truth.json").read_text())["brdf"]
    for name, allowed in (("kd", 0.002), ("ks", 0.0006), ("mu", 0.04), ("sigma", 0.001)):
        number = getattr(fit.brdf, name)
        off = np.abs(number.value - np.array(truth[name]))
        assert (off < np.minimum(4 * np.array(number.std), allowed)).all(), name
        assert (number.status, number.reason) == ("determined", "")
    assert {"lighting.png", "errors.png", "brdf.png", "side.exr", "lamp.png", "result", "web"} <= {
        path.name for path in tour["out"].iterdir()
    }
    assert (tour["out"] / "web" / "object.glb").is_file()
    # Two numbers of eight right ones may be two deviations off.
    assert sum(not row.agrees for row in lf.compare(fit, tour["folder"] / "truth.json").rows) <= 2
    side = read_pixels(tour["out"] / "side.exr")
    np.testing.assert_array_equal(side, tour["side"].radiance)
    np.testing.assert_array_equal(read_exr_layers(tour["out"] / "side.exr")["std"], tour["side"].std)


def test_the_tour_is_a_notebook_of_cells() -> None:
    text = (ROOT / "docs/tour.py").read_text()
    assert text.count("\n# %% ") >= 8
    assert len(text.splitlines()) <= 105


def test_a_fresh_fit_and_its_folder_agree_number_by_number(tour: dict[str, Any], fit: lf.Fit) -> None:
    again = tour["saved"]
    assert again.folder != fit.folder
    for name in NAMES:
        one, other = getattr(fit.brdf, name), getattr(again.brdf, name)
        for field in fields(one):
            np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name))
    np.testing.assert_array_equal(fit.covariance, again.covariance)
    assert fit.covariance_names == again.covariance_names
    assert (fit.photos, fit.models, fit.error, fit.warnings) == (
        again.photos,
        again.models,
        again.error,
        again.warnings,
    )
    for light, same in zip(fit.lightings, again.lightings, strict=True):
        for field in fields(light):
            np.testing.assert_array_equal(getattr(light, field.name), getattr(same, field.name))
    np.testing.assert_array_equal(fit.render(size=(40, 30)).radiance, again.render(size=(40, 30)).radiance)
    assert (repr(fit), fit._repr_html_()) == (repr(again), again._repr_html_())


def test_numbers_are_those_of_result_json(fit: lf.Fit) -> None:
    document = json.loads((fit.folder / "result.json").read_text())
    kd, mu = fit.brdf.kd, fit.brdf.mu
    assert isinstance(kd.value, np.ndarray)
    assert kd.value.tolist() == document["brdf"]["kd"]["value"]
    assert (mu.value, mu.std) == (document["brdf"]["mu"]["value"], document["brdf"]["mu"]["std"])
    names = document["brdf"]["covariance"]["names"]
    assert fit.covariance[names.index("mu"), names.index("mu")] == pytest.approx(mu.std**2, rel=1e-6)
    assert (fit.error.fitted, fit.error.unseen, fit.error.held_out) == (
        document["fit"]["rms_relative"],
        document["fit"]["cross_validated_rms_relative"],
        document["fit"]["held_out_rms_relative"],
    )
    # What the model doesn't have is no number, and says so.
    assert (fit.brdf.exponent.value, fit.brdf.exponent.status) == (None, "not needed")


def test_save_writes_what_the_command_writes(tour: dict[str, Any], fit: lf.Fit, tmp_path: Path) -> None:
    out = fit.save(tmp_path / "out")
    assert out == tmp_path / "out"
    assert sorted(path.name for path in out.iterdir()) == [
        "lighting.exr",
        "predicted",
        "report.html",
        "result.json",
    ]
    assert sorted(path.name for path in (out / "predicted").iterdir()) == [f"00{k}.exr" for k in range(4)]
    # Again, over itself and over the earlier one.
    assert lf.read_fit(lf.read_fit(out).save(out)).name == fit.name
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("precious")
    with pytest.raises(ValueError, match=r"thesis\.tex.*give another folder"):
        fit.save(tmp_path / "mine")


def test_a_fresh_fits_files_go_with_it(fit: lf.Fit, monkeypatch: pytest.MonkeyPatch) -> None:
    import gc

    import lightfactor.runs

    made = []

    def write(run: Any, folder: Path) -> dict[str, Any]:
        shutil.copytree(fit.folder, folder, dirs_exist_ok=True)
        made.append(folder)
        return {}

    monkeypatch.setattr(lightfactor.runs, "run_pipeline", lambda *given: None)
    monkeypatch.setattr(lightfactor.runs, "write_fit", write)
    monkeypatch.setattr(lightfactor.runs, "write_pictures", lambda *given: None)
    other = lf.process(fit.photoset)
    assert made[0].is_dir()
    assert other.brdf.mu.value == fit.brdf.mu.value
    del other
    gc.collect()
    assert not made[0].exists()


def test_a_kept_result_is_readable(kept: lf.Fit, fit: lf.Fit) -> None:
    assert kept.name == "small teflon sphere"
    assert kept.brdf.model == "microfacet"
    assert kept.brdf.kd.value[0] == pytest.approx(0.243653, abs=1e-6)
    assert kept.brdf.mu.std == pytest.approx(0.0069, abs=1e-4)
    assert [photo.held_out for photo in kept.photos] == [False, False, False, True]
    assert [model.name for model in kept.models if model.chosen] == ["neutral microfacet"]
    (light,) = kept.lightings
    assert light.map is None
    np.testing.assert_allclose(light.irradiances, [[1.6, 1.5, 1.35], [0.5, 0.6, 0.7]])
    # It is of the tour's set: another version's numbers may move within their deviations.
    assert all(row.agrees for row in lf.compare(kept, fit).rows)


def test_a_result_without_newer_keys_is_readable(tmp_path: Path) -> None:
    document = json.loads((KEPT / "result.json").read_text())
    for key in ("fit", "models", "warnings", "texture", "interreflection", "causes"):
        document.pop(key, None)
    for key in ("albedo", "exponent", "form_numbers", "specular"):
        document["brdf"].pop(key, None)
    (tmp_path / "result.json").write_text(json.dumps(document))
    shutil.copy(KEPT / "lighting.exr", tmp_path)
    old = lf.read_fit(tmp_path)
    assert (old.error.fitted, old.models, old.warnings) == (None, (), ())
    assert old.brdf.albedo.value is None
    assert "mu" in repr(old)
    assert old.plot_lighting().axes


def test_undetermined_numbers_have_a_reason_and_a_remedy(tmp_path: Path) -> None:
    document = json.loads((KEPT / "result.json").read_text())
    document["brdf"]["mu"] = {"value": None, "std": None, "status": "undetermined"}
    document["identifiability"][2] = {
        "parameter": "mu",
        "status": "undetermined",
        "reason": "no highlight grazes",
        "remedy": "move the lamp behind the sphere",
    }
    (tmp_path / "result.json").write_text(json.dumps(document))
    shutil.copy(KEPT / "lighting.exr", tmp_path)
    fit = lf.read_fit(tmp_path)
    mu = fit.brdf.mu
    assert (mu.value, mu.std, mu.status) == (None, None, "undetermined")
    assert (mu.reason, mu.remedy) == ("no highlight grazes", "move the lamp behind the sphere")
    assert "mu: no highlight grazes. To settle it: move the lamp behind the sphere." in repr(fit)
    with pytest.raises(ValueError, match=r"mu is undetermined.*assume mu=VALUE") as refused:
        fit.render()
    assert "--" not in str(refused.value)
    picture = fit.render(assume={"mu": 1.5})
    assert "mu = 1.5 is assumed" in picture.notes[0]


def test_a_picture_under_other_light(fit: lf.Fit) -> None:
    size = (40, 30)
    sky = fit.render(light=np.ones((16, 32, 3)), size=size)
    inside = sky.coverage == 1
    # Under uniform light of 1 radiance is the albedo towards the camera: no less than the matte base's.
    assert (sky.radiance[inside] > 0.99 * np.asarray(fit.brdf.albedo.value)).all()
    assert sky.std is None
    quick = fit.render(light=np.ones((16, 32, 3)), size=size, preview=True)
    np.testing.assert_allclose(quick.radiance[inside], sky.radiance[inside], rtol=0.05)
    assert "degrees from the normal a ball in the map's light is off by" in quick.notes[-1]
    one = fit.render(sources=[(0, 20, 1.0)], size=size).radiance
    np.testing.assert_allclose(
        fit.render(sources=[(0, 20, (2, 2, 2))], size=size).radiance, 2 * one, rtol=1e-6
    )
    as_taken = fit.render(photo="003.exr").radiance
    predicted = read_pixels(fit.folder / "predicted" / "003.exr")
    assert as_taken.shape == predicted.shape
    both = predicted.any(axis=2) & as_taken.any(axis=2)
    assert np.abs(as_taken - predicted)[both].mean() < 0.01 * predicted[both].mean()


def test_gradients_are_those_of_the_predicted_picture(fit: lf.Fit) -> None:
    found = fit.gradients("003.exr", pixels=100_000)
    assert found.stride == 1
    radiance = fit.render(photo="003.exr").radiance
    columns, rows = np.floor(found.middles).astype(int).T
    # Of three pixels the middle one's slope is half of the outer two's difference, but for what bends between them.
    across = (radiance[rows, columns + 1] - radiance[rows, columns - 1]) / 2
    down = (radiance[rows + 1, columns] - radiance[rows - 1, columns]) / 2
    whole = found.terms.whole
    for axis, by_pixels in enumerate((across, down)):
        off = np.abs(whole[:, axis] - by_pixels)
        assert np.median(off) < 0.03 * np.sqrt(np.mean(by_pixels**2))
    titles = [axes.get_title() for axes in fit.plot_gradients("003.exr").axes]
    assert any("curvature" in title for title in titles), titles


def test_figures_show_the_fit(fit: lf.Fit) -> None:
    assert [axes.get_title() for axes in fit.plot_lighting().axes] == ["lamps"]
    bars = fit.plot_errors().axes[0].patches
    assert sorted(bar.get_height() for bar in bars) == pytest.approx(
        sorted(100 * photo.rms_relative for photo in fit.photos)
    )
    head_on = fit.plot_brdf().axes[0].lines[0]
    at_peak = head_on.get_ydata()[len(head_on.get_ydata()) // 2]
    kd, ks, sigma = (np.asarray(of.value).flat[0] for of in (fit.brdf.kd, fit.brdf.ks, fit.brdf.sigma))
    assert at_peak == pytest.approx(kd + ks / (4 * np.pi * sigma**2), rel=1e-6)


WRONG: list[tuple[Callable[[lf.Fit, Path], Any], str]] = [
    (lambda fit, here: lf.read_fit(here / "none"), "does not exist; give the folder"),
    (lambda fit, here: lf.read_fit(here), r"holds no result\.json; give the folder"),
    (lambda fit, here: lf.load_photoset(here / "none"), "does not exist; give the folder of a photo set"),
    (lambda fit, here: lf.process(here), r"holds no photoset\.toml; give the folder"),
    (lambda fit, here: lf.process(fit.photoset, samples=10), "samples is 10; give 1000 or more"),
    (lambda fit, here: fit.render((0, 120)), "^view 0,120: the elevation.*must be -90 to 90"),
    (lambda fit, here: fit.render((0,)), "^view 0: cannot be read; give AZIMUTH,ELEVATION"),
    (lambda fit, here: fit.render(photo="03.exr"), r"no photo '03\.exr'; did you mean '003\.exr'"),
    (lambda fit, here: fit.gradients("03.exr"), r"no photo '03\.exr'; did you mean '003\.exr'"),
    (lambda fit, here: fit.gradients("003.exr", pixels=9), "^pixels is 9; gradients need 100"),
    (lambda fit, here: fit.render((0, 0), photo="003.exr"), "^photo is a whole camera: it excludes view"),
    (lambda fit, here: fit.render(size=(0, 9)), "^size 0x9: cannot be used; give width and height"),
    (lambda fit, here: fit.render(std=True, preview=True), "^preview knows no standard deviations"),
    (lambda fit, here: fit.render(tolerance=20), "^tolerance is 20%; it must be 0"),
    (
        lambda fit, here: fit.render(tolerance=1),
        "^tolerance: nothing is interpolated, for the light holds no map",
    ),
    (lambda fit, here: fit.render(lighting="lamp"), "no lighting 'lamp'; did you mean 'lamps'"),
    (lambda fit, here: fit.render(light=here / "room.exr"), r"room\.exr: does not exist; check its name"),
    (lambda fit, here: fit.render(sources=[(0, 20)]), "give .azimuth, elevation, irradiance"),
    (lambda fit, here: fit.render(sources=[(0, 20, -1)]), "irradiance is negative.*give 0 or more"),
    (
        lambda fit, here: fit.render(radius=0.1, mesh=here / "a.ply"),
        "^radius is a sphere's; it excludes mesh",
    ),
    (lambda fit, here: fit.render(assume={"tau": 1}), "^assume tau: 'tau' cannot be assumed; there are 'mu'"),
    (lambda fit, here: fit.render(assume={"mu": 1.5}), "only what they leave undetermined can be assumed"),
    (lambda fit, here: lf.export(fit, here / "web", "glft"), "no such format; did you mean 'gltf'"),
    (lambda fit, here: lf.export(fit, here / "web", "gltf", view=(0, 0)), "has no camera; leave out view"),
    (lambda fit, here: lf.export(fit, here / "web", "gltf", albedo=0.5), "is known .*; leave it out"),
    (lambda fit, here: lf.compare(fit, here), r"holds no result\.json"),
    (lambda fit, here: lf.compare(fit, fit, page=here / "a.txt"), r"must end in \.html"),
    (lambda fit, here: lf.plan("toor"), "no built-in scene .*did you mean 'tour'"),
    (lambda fit, here: lf.plan("tour", light="none"), "light is 'none'; did you mean 'nothing'"),  # type: ignore[arg-type]
    (lambda fit, here: lf.plan("tour", degree=99), "degree is 99; .* 0 to 30"),
    (
        lambda fit, here: lf.save_picture(fit.render(size=(9, 9)), here / "a.gif"),
        r"must end in \.exr or \.png",
    ),
    (lambda fit, here: lf.merge_hdr([]), "no photographs are given; a bracket needs two"),
]


@pytest.mark.parametrize(("wrong", "said"), WRONG)
def test_what_is_wrong_is_a_value_error_that_says_what_to_do(
    fit: lf.Fit, tmp_path: Path, wrong: Callable[[lf.Fit, Path], Any], said: str
) -> None:
    with pytest.raises(ValueError, match=said) as refused:
        wrong(fit, tmp_path)
    # Options are the command's; functions have arguments.
    assert not re.search(r"(?<![\w-])--[a-z]", str(refused.value))
    assert not list(tmp_path.iterdir())


def test_importing_loads_nothing_heavy() -> None:
    code = (
        "import sys, lightfactor as lf\n"
        "assert 'Fit' in dir(lf)\n"
        "print(sorted({'numpy', 'scipy', 'cv2', 'pycolmap', 'matplotlib', 'pydantic'} & set(sys.modules)))"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "[]"


def test_the_page_names_everything_that_can_be_imported() -> None:
    page = (ROOT / "docs/python.md").read_text()
    assert set(lf.__all__) == set(lf._HOME)
    for name in lf.__all__:
        assert f"`lf.{name}" in page, name
        assert getattr(lf, name).__doc__, name
    for name in vars(lf.Fit):
        assert name.startswith("_") or f"`fit.{name}" in page, name
    with pytest.raises(AttributeError, match="no attribute 'Fitt'"):
        importlib.import_module("lightfactor").Fitt  # noqa: B018
