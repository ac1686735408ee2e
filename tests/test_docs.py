"""What the documentation says exists and works."""

from __future__ import annotations

import importlib
import re
import runpy
import sys
from pathlib import Path

import pytest

from capture.photoset import load_photoset

ROOT = Path(__file__).parents[1]


def equations() -> list[tuple[str, str]]:
    rows = re.findall(r"\| `([\w.]+)` \| `([\w/.]+)` \|", (ROOT / "docs/equations.md").read_text())
    assert len(rows) > 10
    return rows


@pytest.mark.parametrize(("function", "test"), equations())
def test_every_equation_names_a_function_and_the_test_that_holds_it(function: str, test: str) -> None:
    module, _, name = function.rpartition(".")
    assert callable(getattr(importlib.import_module(module), name))
    # The test file reaches the function: by its own name, or through the command that ends in it.
    assert name in (ROOT / test).read_text()


def test_the_index_lists_every_page() -> None:
    listed = set(
        re.findall(r"^- \[.*?\]\((.*?)\): ", (ROOT / "docs/index.md").read_text(), flags=re.MULTILINE)
    )
    pages = {path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs").glob("*.md")} - {
        "index.md"
    }
    assert listed >= pages


@pytest.mark.parametrize(
    "page", [*sorted((ROOT / "docs").glob("*.md")), ROOT / "README.md", ROOT / "CHANGELOG.md"]
)
def test_links_of_a_page_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text()):
        assert (page.parent / target).exists(), target


def test_the_readme_fits_on_two_screens() -> None:
    assert len((ROOT / "README.md").read_text().splitlines()) <= 120


def test_the_readme_opens_with_the_two_commands() -> None:
    blocks = re.findall(r"```\n(.*?)\n```", (ROOT / "README.md").read_text(), flags=re.DOTALL)
    assert blocks[0].endswith(".venv/bin/pip install . && .venv/bin/lightfactor demo")
    assert blocks[1].endswith('.venv/bin/pip install ".[test]" && .venv/bin/pytest')


def test_the_manifests_of_the_readme_and_of_the_page_on_photo_sets_are_valid(tmp_path: Path) -> None:
    blocks = [
        re.findall(r"```toml\n(.*?)```", (ROOT / page).read_text(), flags=re.DOTALL)[0]
        for page in ("README.md", "docs/photosets.md")
    ]
    (tmp_path / "photoset.toml").write_text(blocks[0])
    assert load_photoset(tmp_path).photos[0].camera.focal_px == 1600
    (tmp_path / "photoset.toml").write_text(
        re.sub(r"(?s)\[\[lighting\]\].*?(?=\n\[\[photo)", blocks[1], blocks[0]).replace('"room"', '"lamp 1"')
    )
    assert load_photoset(tmp_path).lightings[0].mirror_ball is not None


@pytest.mark.slow
def test_the_calibration_script_runs_and_comes_near_the_truth(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["calibration.py", str(tmp_path / "é")])
    runpy.run_path(str(ROOT / "docs/calibration.py"), run_name="__main__")
    printed = capsys.readouterr().out
    focal = re.search(r"focal length ([\d.]+) \+- ([\d.]+) px, in truth ([\d.]+)", printed)
    assert focal is not None
    value, std, truth = map(float, focal.groups())
    assert abs(value - truth) < 3 * std < 6
    grey = re.search(r"middle grey ([\d.]+)%, in truth ([\d.]+)%", printed)
    assert grey is not None
    assert float(grey[1]) == pytest.approx(
        float(grey[2]), rel=0.1
    )  # the curve's slope is known to a few per cent
    errors = re.search(r"([\d.]+) \(RMS", printed)
    assert errors is not None
    assert 0.8 < float(errors[1]) < 1.4
