"""Results that are whole or absent, whatever becomes of the process that writes them."""

from __future__ import annotations

import errno
import re
import shutil
import signal
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from capture.files.outfolder import added_files, claimed, result_files, result_folder

OWN = ("result.json", "more")


@contextmanager
def another_process(within: str, out: Path) -> Iterator[subprocess.Popen[str]]:
    """A process that has begun to write `out` and waits; within : the context that it waits in."""
    text = f"""
        import sys
        from pathlib import Path
        from capture.files import outfolder
        out = Path(sys.argv[1])
        with {within} as folder:
            if folder: (folder / "result.json").write_text("another")
            print("begun", flush=True)
            sys.stdin.read()
    """
    command = [sys.executable, "-c", textwrap.dedent(text), str(out)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "begun\n"
        try:
            yield process
        finally:
            process.kill()


def written(out: Path, text: str = "mine") -> None:
    with result_folder(out, OWN) as folder:
        (folder / "result.json").write_text(text)


def hidden(out: Path) -> list[str]:
    return [path.name for path in out.parent.iterdir() if path.name.startswith(".")]


@pytest.mark.parametrize(
    "within", ["outfolder.result_folder(out, ('result.json',))", "outfolder.claimed(out)"]
)
def test_a_second_run_into_a_folder_is_refused_while_the_first_lives(tmp_path: Path, within: str) -> None:
    out = tmp_path / "out [1]"
    written(out)
    with another_process(within, out) as process:
        for writing in (result_folder(out, OWN), claimed(out), added_files(out, "pictures")):
            with pytest.raises(ValueError, match="another run is writing there"), writing:
                pass
        written(tmp_path / "out")
        assert len(hidden(out)) == 1
        process.send_signal(signal.SIGKILL)
        process.wait()
    # It left its folder, which belongs to nobody now.
    assert len(hidden(out)) == 1
    written(out, "after")
    assert hidden(out) == []
    assert (out / "result.json").read_text() == "after"


def test_the_first_goes_on_when_a_second_is_refused(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with another_process("outfolder.result_folder(out, ('result.json',))", out) as process:
        with pytest.raises(ValueError, match="another run"):
            written(out)
        process.communicate("")
    assert (out / "result.json").read_text() == "another"
    assert hidden(out) == []


def test_of_a_file_the_last_who_writes_it_wins(tmp_path: Path) -> None:
    out = tmp_path / "result.json"
    with another_process("outfolder.result_files(out)", out) as process:
        with result_files(out) as folder:
            (folder / out.name).write_text("mine")
        assert out.read_text() == "mine"
        process.communicate("")
    assert out.read_text() == "another"


@pytest.mark.parametrize("is_whole", [True, False])
def test_a_run_killed_while_its_result_took_an_older_ones_place_is_finished(
    tmp_path: Path, is_whole: bool
) -> None:
    out = tmp_path / "out"
    written(out, "old")
    written(tmp_path / ".out-0123456789abcdef01234567", "new")
    out.rename(tmp_path / ".out-0123456789abcdef01234567-old")
    if not is_whole:
        shutil.rmtree(tmp_path / ".out-0123456789abcdef01234567")
    with added_files(out, "more"):
        assert (out / "result.json").read_text() == ("new" if is_whole else "old")
    assert hidden(out) == []


def test_what_only_looks_like_a_leftover_stays(tmp_path: Path) -> None:
    for name in (".out-notes", ".out-0123456789abcdef01234567-mine", ".outer-0123456789abcdef01234567"):
        (tmp_path / name).mkdir()
    before = hidden(tmp_path / "out")
    written(tmp_path / "out")
    assert hidden(tmp_path / "out") == before


def test_within_a_claim_its_own_process_writes(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with claimed(out):
        written(out)
        with added_files(out, "more") as folder:
            (folder / "more").touch()
    assert sorted(path.name for path in out.iterdir()) == ["more", "result.json"]
    assert hidden(out) == []


def test_on_a_full_disk_an_earlier_result_stays_and_a_sentence_says_so(tmp_path: Path) -> None:
    out = tmp_path / "out"

    def write(error: OSError | None) -> None:
        with result_folder(out, ["result.json"]) as folder:
            (folder / "result.json").write_text("half" if error else "earlier")
            if error:
                raise error

    write(None)
    said = f"{out}: cannot be written (No space left on device); nothing was written, an earlier result is untouched"
    with pytest.raises(ValueError, match=re.escape(said)):
        write(OSError(errno.ENOSPC, "No space left on device"))
    assert (out / "result.json").read_text() == "earlier"
    assert list(tmp_path.iterdir()) == [out]
