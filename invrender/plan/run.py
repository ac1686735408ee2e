"""The command `plan` at work: a scene by name, progress and answers on the terminal, plan.json and plan.png on disk."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from capture.files.documents import input_hashes, write_json
from capture.files.outfolder import result_folder
from capture.terminal import console, leave_cleanly_when_stopped, track
from invrender.plan.advice import Advice, advise
from invrender.plan.document import plan_document
from invrender.plan.experiment import Experiment
from invrender.plan.figure import plan_figure
from invrender.plan.from_scene import read_experiment
from invrender.plan.planning import Plan, make_plan
from invrender.plan.summary import quantity_table, sentences

OWN_FILES = ("plan.json", "plan.png")


def run_plan(
    scene: str, out: Path | None, given: Literal["all", "ball", "nothing"] | None, degree: int, samples: int
) -> None:
    """Plan a scene, say what will be determined, and write it into a folder if one is given."""
    leave_cleanly_when_stopped()
    with console.status("Setting up the scene"):
        experiment, path = read_experiment(scene, given)
    if out is None:
        _report(*_planned(experiment, degree, samples))
        return
    with result_folder(out, OWN_FILES) as folder:
        plan, advice = _planned(experiment, degree, samples)
        write_json(folder / "plan.json", plan_document(plan, advice, input_hashes([path])))
        plan_figure(plan, advice).savefig(folder / "plan.png")
    _report(plan, advice)
    places = f"Plan: {out / 'plan.json'}   Look at it: {out / 'plan.png'}"
    console.print(places, soft_wrap=True, markup=False)


def _planned(experiment: Experiment, degree: int, samples: int) -> tuple[Plan, Advice]:
    plan = make_plan(experiment, degree, samples, track)
    return plan, advise(plan, track)


def _report(plan: Plan, advice: Advice) -> None:
    console.print(quantity_table(plan))
    for sentence in sentences(plan, advice):
        console.print(sentence, markup=False)
