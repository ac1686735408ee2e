"""A scene or a result planned: what its photographs will determine, and what one more would bring. No terminal."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from capture.files.documents import input_hashes, write_json
from capture.progress import Track, silent
from invrender.plan.advice import Advice, advise
from invrender.plan.document import plan_document
from invrender.plan.experiment import Experiment
from invrender.plan.figure import plan_figure
from invrender.plan.planning import DEFAULT_DEGREE, DEFAULT_SAMPLES, Plan, make_plan
from invrender.plan.summary import QUANTITY_HEADINGS, quantity_rows, sentences
from invrender.tables import html_list, html_table, text_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PLAN_FILES = ("plan.json", "plan.png")


@dataclass(frozen=True, eq=False, repr=False)
class PlannedScene:
    """A plan with advice. path : the scene file, or result.json."""

    path: Path
    plan: Plan
    advice: Advice

    @cached_property
    def document(self) -> Mapping[str, Any]:
        """Everything that the plan says, as plan.json has it."""
        return plan_document(self.plan, self.advice, self.lines, input_hashes([self.path]))

    @property
    def lines(self) -> list[str]:
        """What is to be said beside the table of quantities, in sentences."""
        return list(sentences(self.plan, self.advice))

    def __str__(self) -> str:
        return "\n".join([text_table(QUANTITY_HEADINGS, quantity_rows(self.plan)), *self.lines])

    __repr__ = __str__

    def _repr_html_(self) -> str:
        """For notebooks."""
        return html_table(QUANTITY_HEADINGS, quantity_rows(self.plan)) + html_list(self.lines)

    def figure(self) -> Figure:
        """The plan as a picture, as plan.png has it."""
        return plan_figure(self.plan, self.advice)

    def write(self, folder: Path) -> None:
        """Write plan.json and plan.png into a folder."""
        write_json(folder / "plan.json", self.document)
        self.figure().savefig(folder / "plan.png")


def check_effort(degree: int, samples: int) -> None:
    """ValueError where a plan can't be made with so high a degree of the light, or so few samples."""
    if not 0 <= degree <= 30:
        raise ValueError(f"--degree is {degree}; the highest degree of the light must be 0 to 30")
    if samples < 1000:
        raise ValueError(f"--samples is {samples}; look at 1000 pixels or more")


def plan_experiment(
    experiment: Experiment,
    path: Path,
    degree: int = DEFAULT_DEGREE,
    samples: int = DEFAULT_SAMPLES,
    track: Track = silent,
) -> PlannedScene:
    """Plan an experiment; path : the file that it was read from."""
    plan = make_plan(experiment, degree, samples, track)
    return PlannedScene(path, plan, advise(plan, track))
