"""The command `plan` at work: a scene by name, progress and answers on the terminal, plan.json and plan.png on disk."""

from __future__ import annotations

from pathlib import Path

from capture.files.outfolder import result_folder
from capture.terminal import console, leave_cleanly_when_stopped, track
from invrender.plan.from_scene import read_experiment
from invrender.plan.planned import PLAN_FILES, PlannedScene, check_effort, plan_experiment
from invrender.plan.summary import quantity_table
from synthetic.lights.illumination import Given


def run_plan(scene: str, out: Path | None, given: Given | None, degree: int, samples: int) -> None:
    """Plan a scene, say what will be determined, and write it into a folder if one is given."""
    check_effort(degree, samples)
    leave_cleanly_when_stopped()
    with console.status("Setting up the scene"):
        experiment, path = read_experiment(scene, given)
    if out is None:
        _report(plan_experiment(experiment, path, degree, samples, track))
        return
    with result_folder(out, PLAN_FILES) as folder:
        planned = plan_experiment(experiment, path, degree, samples, track)
        planned.write(folder)
    _report(planned)
    places = f"Plan: {out / 'plan.json'}   Look at it: {out / 'plan.png'}"
    console.print(places, soft_wrap=True, markup=False)


def _report(planned: PlannedScene) -> None:
    console.print(quantity_table(planned.plan))
    for sentence in planned.lines:
        console.print(sentence, markup=False)
