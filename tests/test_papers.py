"""The index of the papers' figures: all of them are in it, and each is drawn or says why not."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.papers.__main__ import main
from benchmarks.papers.catalogue import ENTRIES, PAPERS

_DOCS = Path(__file__).parents[1] / "docs" / "papers"
# As the works number them; chapter 2 of R02 has no tables.
_NUMBERED = {
    *(f"rh01-fig{k}" for k in range(1, 16)),
    *(f"r02-fig2.{k}" for k in range(1, 5)),
    *(f"r02-fig5.{k}" for k in range(1, 10)),
    *(f"r02-table5.{k}" for k in range(1, 6)),
}


def test_every_numbered_figure_and_table_is_drawn_or_says_why_not():
    assert set(ENTRIES) >= _NUMBERED
    assert all(bool(entry.reason) != (entry.draw is not None) for entry in ENTRIES.values())
    assert all(sum(name.startswith(paper) for paper in PAPERS) == 1 for name in ENTRIES)


def test_the_page_shows_all_that_is_drawn():
    page = (_DOCS / "README.md").read_text(encoding="utf-8")
    drawn = {name for name, entry in ENTRIES.items() if entry.draw is not None}
    kept = json.loads((_DOCS / "papers.json").read_text(encoding="utf-8"))
    assert set(kept["entries"]) == drawn
    assert not kept["settings"]["quick"]
    assert all(f"### {name}: " in page for name in drawn)
    pictures = {entry["picture"] for entry in kept["entries"].values() if entry["picture"]}
    assert pictures == {path.name for path in _DOCS.glob("*.png")}


def test_one_figure_is_drawn_into_the_index(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    main(["rh01-fig4", "--quick", "--out", str(tmp_path / "out"), "--sets", str(tmp_path / "sets")])
    page = (tmp_path / "out" / "README.md").read_text(encoding="utf-8")
    # [RH01, section 4.2]: more than 99% of the energy.
    assert "| [rh01-fig4](#rh01-fig4-the-clamped-cosine-and-its-coefficients) |" in page
    assert "degrees 0 to 2 hold 99.22% of the energy" in page
    assert "not drawn yet" in page
    assert (tmp_path / "out" / "rh01-fig4.png").stat().st_size > 10_000
    assert "written:" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "said"),
    [("rh01-fig44", "did you mean 'rh01-fig4'"), ("rh01-fig2", "there is nothing to draw"), ("x", "--list")],
)
def test_a_figure_that_cannot_be_drawn_is_refused(name: str, said: str):
    with pytest.raises(SystemExit, match=said):
        main([name])
