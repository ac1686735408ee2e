"""Many photographs, each under a lamp of its own: the report and the warnings stay short."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from benchmarks.gloss.photosets import read_lamps, write_photoset
from lightfactor.cli import main

from .fewforms import few_forms_tried, no_causes_sought

# Photographs that are said to be others: places among those of the set.
SWAPPED = (2, 7)


@pytest.fixture(scope="module")
def result(data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """The result of twelve photographs of the glossy ball, two of which are others, and the names of these."""
    source = data_dir / "glossball"
    folder = write_photoset(source, tmp_path_factory.mktemp("many"), range(0, 48, 4))
    names = read_lamps(source).names[::4]
    manifest = folder / "photoset.toml"
    text = manifest.read_text()
    for k in SWAPPED:
        # A photograph whose lamp stood elsewhere, that isn't in the set.
        other = read_lamps(source).names[4 * ((k + 6) % 12) + 1]
        text = text.replace(f"{names[k]}.png", f"{other}.png")
    manifest.write_text(text)
    command = ["lightfactor", "process", str(folder), "-o", str(folder / "out"), "--samples", "2000"]
    with few_forms_tried(), no_causes_sought(), pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", command)
        with pytest.raises(SystemExit, match="0"):
            main()
    files = re.findall(r'file = ".*/([^/"]*)"', text)
    return folder / "out", [files[k] for k in SWAPPED]


def test_lightings_are_summed_up_and_listed_in_a_fold(result: tuple[Path, list[str]]) -> None:
    page = (result[0] / "report.html").read_text()
    assert "12 lightings, all given, with 12 directional sources" in page
    fold = page[page.index("<details>") : page.index("</details>")]
    assert fold.count("<tr>") == 1 + 12
    # A line for each: no channel below the other.
    assert "<br>" not in fold
    assert page.count("lamp 001 <span") == fold.count("lamp 001 <span") == 1


def test_wrong_photographs_are_named_in_one_warning(result: tuple[Path, list[str]]) -> None:
    folder, wrong = result
    page = (folder / "report.html").read_text()
    (warning,) = [text for text in re.findall(r'class="warning">([^<]*)<', page) if "far worse" in text]
    for name in wrong:
        assert name in warning
