"""The command `plan` at work: progress and answers on the terminal, plan.json and plan.png on disk."""

from __future__ import annotations

from pathlib import Path

from capture.files.outfolder import result_folder
from capture.terminal import console, leave_cleanly_when_stopped, track
from invrender.plan.asked import asked_experiment
from invrender.plan.planned import PLAN_FILES, PlannedScene, check_effort, plan_experiment
from invrender.plan.summary import quantity_table
from synthetic.lights.illumination import Given


def run_plan(
    name: str, out: Path | None, given: Given | None, photoset: Path | None, degree: int, samples: int
) -> None:
    """Plan a scene or a result, say what will be determined, and write it into a folder if one is given."""
    check_effort(degree, samples)
    leave_cleanly_when_stopped()
    with console.status("Setting up the plan"):
        experiment, path = asked_experiment(name, given, photoset)
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
