"""The command `brdf` as a user meets it."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from capture.files.imagefile import read_pixels
from lightfactor.cli import main

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def brdf(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Run:
    """Run `lightfactor brdf` in this process: exit status, standard output, standard error."""

    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["lightfactor", "brdf", *map(str, arguments)])
        with pytest.raises(SystemExit) as done:
            main()
        out, err = capfd.readouterr()
        return int(done.value.code or 0), out, err

    return run


def edit(folder: Path, pattern: str, replacement: str) -> None:
    """Replace what must occur in a set's manifest."""
    path = folder / "photoset.toml"
    text, count = re.subn(pattern, replacement, path.read_text())
    assert count, f"{pattern!r} does not occur in {path}"
    path.write_text(text)


def under_one_source(folder: Path) -> None:
    """Tell of the light that it is one source in darkness, whatever the photographs show."""
    edit(folder, r"(?m)^map = .*\n", "")


def test_harmonics_are_written_with_errors_conditioning_and_a_figure(
    brdf: Run, small_set: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    status, printed, err = brdf(small_set, "-o", out, "--order", "3")
    assert (status, err) == (0, "")
    document = json.loads((out / "brdf.json").read_text())
    assert document["method"] == "harmonic"
    assert len(document["coefficients"]) == 20
    first = document["coefficients"][0]
    # Degree 0 is mostly the diffuse part's: Kd of the delrin sphere times (pi / sqrt(4 pi))^2.
    albedo = json.loads((small_set / "truth.json").read_text())["brdf"]["kd"][0] * np.pi
    assert first["value"][0] == pytest.approx(albedo / 4, rel=0.2)
    assert all(0 < std < 0.05 for std in first["std"])
    assert len(document["conditioning"]["lighting_gain"]) == 4
    assert np.array(document["conditioning"]["singular_values"]).shape == (3, 20)
    assert [photo["held_out"] for photo in document["photos"]] == [False, False, False, True]
    assert 0 < document["photos"][3]["relative_rms"] < 1
    assert any(name.endswith("photoset.toml") for name in document["inputs"])
    assert read_pixels(out / "brdf.png").std() > 0
    assert "coefficients up to degree 3 determined" in printed
    assert "ringing" in printed


def test_a_table_is_written_with_its_fit_and_null_where_nothing_was_seen(
    brdf: Run, small_set: Path, tmp_path: Path
) -> None:
    under_one_source(small_set)
    out = tmp_path / "out"
    status, printed, err = brdf(small_set, "-o", out, "--method", "table")
    assert (status, err) == (0, "")
    document = json.loads((out / "brdf.json").read_text())
    shape = tuple(document["bins"])
    values = np.array(document["values"], object)
    counts = np.array(document["counts"])
    assert values.shape == (*shape, 3)
    assert counts.shape == shape
    assert all(value is not None for value in values[counts > 0].ravel())
    assert None in set(values[counts == 0].ravel())
    coverage = document["coverage"]
    assert 0 < coverage["measured"] <= coverage["with_reciprocity"] < 1
    assert set(document["fit"]) == {"kd", "ks", "mu", "sigma", "relative_rms", "chi2"}
    assert "of those above the surface" in printed
    assert (out / "brdf.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("change", "options", "sentence"),
    [
        (None, ["--order", "-1"], "--order is -1; the highest degree must be 0 to 16"),
        (None, ["--samples", "-5"], "--samples is -5; it must be >= 0"),
        (None, ["--order", "9", "--samples", "300"], "samples for the 220 coefficients of order 9"),
        (
            None,
            ["--method", "table"],
            '[[lighting]] "lighting" has 1 source(s) and a map: a table is measured under a single source',
        ),
        (
            (r"(?m)^map = .*\n", 'recover = ["ambient"]\n'),
            [],
            "recover = ['ambient']: this measurement needs light that is known",
        ),
        (
            (r"(?ms)^\[\[lighting\]\].*?(?=^\[\[photo\]\])", ""),
            [],
            "unknown = true: this measurement needs light that is known; give map",
        ),
    ],
)
def test_what_is_wrong_is_said_in_a_sentence(
    brdf: Run,
    small_set: Path,
    tmp_path: Path,
    change: tuple[str, str] | None,
    options: list[str],
    sentence: str,
) -> None:
    if change is not None:
        edit(small_set, *change)
    status, _, err = brdf(small_set, "-o", tmp_path / "out", *options)
    assert status == 1
    assert err.startswith("lightfactor: error: ")
    assert sentence in err
    assert not (tmp_path / "out").exists()
