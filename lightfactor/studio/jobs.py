"""Fits, alignments and plans as processes that outlive page and server: what is known of them is on disk."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from threading import Thread
from typing import Any, Literal

from capture.terminal import PROGRESS_VARIABLE
from invrender.result.saved import RESULT_NAME
from lightfactor.program import PROGRAM
from lightfactor.studio.opened import Opened, UnknownIdError, key_of

State = Literal["running", "done", "failed", "stopped"]
# Runs a command, and writes its exit status where it is looked for, whoever has gone in the meantime. A signal to
# both ends the command, which removes its temporary folders, and then the watch.
_WATCHED = """
import os, signal, subprocess, sys
status, *command = sys.argv[1:]
signal.signal(signal.SIGTERM, signal.SIG_IGN)
stoppable = lambda: signal.signal(signal.SIGTERM, signal.SIG_DFL)
code = subprocess.run(command, preexec_fn=stoppable).returncode
with open(status + ".part", "w") as file: file.write(str(code))
os.replace(status + ".part", status)
"""


@dataclass(frozen=True)
class Job:
    """A fit, an alignment or a plan that was started.

    name : a fit's is that of its result's folder. process : the group of processes that computes it.
    """

    name: str
    process: int
    folder: Path

    @property
    def key(self) -> str:
        return key_of(self.name)

    def state(self) -> State:
        """How it stands."""
        status = self.folder / "status"
        if status.is_file():
            if int(status.read_text()) == 0:
                return "done"
            return "stopped" if (self.folder / "cancelled").is_file() else "failed"
        return "running" if _is_alive(self.process) else "stopped"

    def progress(self) -> dict[str, Any] | None:
        """What it is doing, {doing, done, of}, and the outcomes of its steps so far."""
        file = self.folder / "progress"
        # The last line may just be written.
        whole = file.read_text(encoding="utf-8").split("\n")[:-1] if file.is_file() else []
        if not whole:
            return None
        lines = [json.loads(line) for line in whole]
        return lines[-1] | {"outcomes": [line["outcome"] for line in lines if "outcome" in line]}

    def said(self) -> str:
        """What it printed, errors included."""
        log = self.folder / "log"
        return log.read_text(encoding="utf-8", errors="replace") if log.is_file() else ""


def start_fit(opened: Opened, samples: int | None) -> Job:
    """Start `lightfactor process` on what is open; ValueError where something else runs on it."""
    manifest = opened.photoset().manifest
    name = _free_name(opened, "fit")
    more = [] if samples is None else ["--samples", str(samples)]
    return _start(opened, name, ["process", str(manifest), "-o", str(opened.folder / name), *more])


def start_alignment(opened: Opened, picks: Path) -> Job:
    """Start `lightfactor align` by a file of picks; ValueError where something else runs on the set."""
    return _start(
        opened, _free_name(opened, "alignment"), ["align", str(opened.manifest), "--picks", str(picks)]
    )


def start_plan(opened: Opened, result: Path) -> Job:
    """Start `lightfactor plan` on a result's folder; ValueError where something else runs on the set."""
    out = plan_folder(opened, result)
    arguments = ["plan", str(result), "--set", str(opened.photoset().manifest), "-o", str(out)]
    return _start(opened, _free_name(opened, "plan"), arguments)


def plan_folder(opened: Opened, result: Path) -> Path:
    """Where the plan of a result's folder is kept."""
    return opened.own / "plans" / result.name


def _start(opened: Opened, name: str, arguments: list[str]) -> Job:
    if any(job.state() == "running" for job in jobs(opened)):
        raise ValueError("a fit of this set is running: wait for it, or stop it")
    folder = opened.own / "jobs" / name
    folder.mkdir(parents=True)
    command = [*PROGRAM, *arguments]
    environment = os.environ | {PROGRESS_VARIABLE: str(folder / "progress"), "COLUMNS": "120"}
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(
            [sys.executable, "-c", _WATCHED, str(folder / "status"), *command],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            env=environment,
            start_new_session=True,
        )
    # A child that has ended is listed until somebody has waited for it.
    Thread(target=process.wait, daemon=True).start()
    (folder / "process").write_text(json.dumps({"process": process.pid}))
    return Job(name, process.pid, folder)


def jobs(opened: Opened) -> list[Job]:
    """All fits that were started from the workbench, the oldest first."""
    found = []
    for path in sorted((opened.own / "jobs").glob("*/process"), key=lambda path: path.stat().st_mtime_ns):
        found.append(Job(path.parent.name, int(json.loads(path.read_text())["process"]), path.parent))
    return found


def job(opened: Opened, key: str) -> Job:
    """A fit by its id."""
    for each in jobs(opened):
        if each.key == key:
            return each
    raise UnknownIdError(f"fit {key}: none of this id was started; load the page again")


def cancel(running: Job) -> None:
    """Stop a fit; one that has ended stays as it is."""
    if running.state() == "running":
        (running.folder / "cancelled").touch()
        os.killpg(running.process, signal.SIGTERM)


def _free_name(opened: Opened, kind: str) -> str:
    taken = {path.name for path in opened.folder.iterdir()} | {each.name for each in jobs(opened)}
    return next(name for k in range(1, 10_000) if (name := f"{kind}-{k}") not in taken)


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except OSError:
        return False
    return True


def result_exists(opened: Opened, name: str) -> bool:
    """Whether a fit has left a result."""
    return (opened.folder / name / RESULT_NAME).is_file()
