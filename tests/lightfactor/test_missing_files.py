"""A photo set of which a file is missing: said at once."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from tests.capture.test_photoset import EXAMPLE


def test_a_file_that_is_missing_is_named_before_anything_is_loaded_to_compute_with(tmp_path: Path) -> None:
    (tmp_path / "photoset.toml").write_text(EXAMPLE)
    program = (
        "import sys; from lightfactor.cli import main\ntry: main()\nfinally: print('scipy' in sys.modules)"
    )
    for present, said in (
        (
            [],
            "000.exr: does not exist; check its name, and the folder that it is relative to; 2 of the set's other",
        ),
        (
            ["000.exr", "000_mask.png"],
            "room.exr: does not exist; check its name, and the folder that it is rel",
        ),
    ):
        for name in present:
            (tmp_path / name).touch()
        command = [sys.executable, "-c", program, "process", str(tmp_path), "-o", str(tmp_path / "out")]
        run = subprocess.run(command, capture_output=True, text=True)
        assert (run.returncode, run.stdout) == (1, "False\n")
        assert said in run.stderr
