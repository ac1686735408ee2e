"""Many photo sets at once: which are meant, what becomes of them, and what a second run does."""

from __future__ import annotations

import csv
import json
import re
import shutil
import subprocess
from pathlib import Path

import pyarrow.parquet
import pytest

from lightfactor.batch.asked import asked_sets
from lightfactor.program import PROGRAM
from tests.invrender.faultysets import change_manifest, write_set


@pytest.fixture
def sets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folders with empty manifests: shoot/a, shoot/b, other/a."""
    for name in ("shoot/a", "shoot/b", "other/a"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "photoset.toml").touch()
    (tmp_path / "shoot" / "notes").mkdir()
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("given", "names"),
    [
        (["shoot/b", "shoot/a/photoset.toml"], ["b", "a"]),
        (["shoot"], ["a", "b"]),
        (["shoot/*"], ["a", "b"]),
        (["shoot", "other/a"], ["shoot-a", "b", "other-a"]),
        (["list.csv"], ["first", "b"]),
    ],
)
def test_sets_are_named_by_their_folders(sets: Path, given: list[str], names: list[str]) -> None:
    (sets / "list.csv").write_text("set,name,samples,published\nother/a,first,2000,\nshoot/b,,,yes\n")
    asked = asked_sets(given, 5000)
    assert [each.name for each in asked] == names
    if given == ["list.csv"]:
        assert [each.settings for each in asked] == [
            {"samples": 2000, "published": False},
            {"samples": 5000, "published": True},
        ]


@pytest.mark.parametrize(
    ("given", "listed", "said"),
    [
        (["shoot", "shoot/a"], "", "shoot/a: is listed twice, by shoot and by shoot/a; leave one"),
        (["nowhere"], "", "nowhere: does not exist"),
        (["shoot/x*"], "", "shoot/x*: matches no photo set"),
        (["shoot/notes"], "", "shoot/notes: is no photo set, and holds none"),
        (["list.csv"], "folder\nshoot/a\n", "list.csv: has a column 'folder'"),
        (["list.csv"], "", "list.csv: has no rows"),
        (["list.csv"], "set\nshoot/a\nshoot/c\n", "list.csv: line 3: shoot/c: is no photo set"),
        (["list.csv"], "set,samples\nshoot/a,ten\n", "list.csv: line 2: samples is 'ten'"),
        (["list.csv"], "set,published\nshoot/a,maybe\n", "line 2: published is 'maybe'; give true or false"),
        (["list.csv"], "set,name\nshoot/a,x\nshoot/b,x\n", "two sets are to be called 'x'"),
        (["list.csv"], "set,name\nshoot/a,../x\n", "a set is to be called '../x'"),
        (["lost.csv"], "", "lost.csv: cannot be read as a CSV file"),
    ],
)
def test_what_names_no_sets_is_refused(sets: Path, given: list[str], listed: str, said: str) -> None:
    (sets / "list.csv").write_text(listed)
    with pytest.raises(ValueError, match=re.escape(said)):
        asked_sets(given)


def numbers(result: Path) -> dict[str, object]:
    """What a result says, but for the time it took."""
    document = json.loads((result / "result.json").read_text())
    del document["timing_s"]
    return document


@pytest.mark.slow
def test_a_set_that_fails_stops_no_other_and_a_second_run_does_the_rest(tmp_path: Path) -> None:
    sets, out = tmp_path / "sets", tmp_path / "out"
    write_set(sets / "a")
    for name in ("b", "c"):
        shutil.copytree(sets / "a", sets / name)
    (sets / "b" / "003.exr").rename(tmp_path / "003.exr")

    def batch() -> tuple[int, str, list[dict[str, str]]]:
        command = [*PROGRAM, "batch", str(sets), "-o", str(out), "--samples", "2000", "--workers", "2"]
        done = subprocess.run(command, capture_output=True, text=True)
        with (out / "results.csv").open(newline="") as stream:
            return done.returncode, done.stdout, list(csv.DictReader(stream))

    code, said, rows = batch()
    assert (code, [row["status"] for row in rows]) == (1, ["done", "failed", "done"])
    assert "003.exr: does not exist" in rows[1]["error"]
    assert "003.exr: does not exist" in said
    assert not (out / "b").exists()
    # With another's photograph in its place, and a manifest that holds one out.
    shutil.copyfile(sets / "a" / "003.exr", sets / "b" / "003.exr")
    change_manifest(sets / "a", r'file = "001.exr"\n', lambda line: f"{line[0]}held_out = true\n")
    code, _, rows = batch()
    assert (code, [row["status"] for row in rows]) == (0, ["done", "done", "kept"])
    assert [row["error_held_out"] != "" for row in rows] == [True, False, False]
    # As `process` has it, whatever ran beside it and on however many cores.
    subprocess.run(
        [*PROGRAM, "process", str(sets / "c"), "-o", str(tmp_path / "c"), "--samples", "2000"],
        check=True,
        capture_output=True,
    )
    assert numbers(out / "c") == numbers(tmp_path / "c")
    table = pyarrow.parquet.read_table(out / "results.parquet").to_pylist()
    assert [float(row["sigma"]) for row in rows] == [row["sigma"] for row in table]
    page = (out / "index.html").read_text()
    assert all(f'href="{name}/report.html"' in page for name in "abc")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["003.exr", "c", "out", "sets"]
