"""The command `factor` at work: progress and tables on the terminal, a result and a figure on disk."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from rich.markup import escape
from rich.table import Table

from capture.files.outfolder import added_files, claimed, result_folder
from capture.photoset import load_photoset
from capture.radiance import CHANNELS
from capture.tasks.stage import kept_result
from capture.tasks.workplace import opened_workplace
from capture.terminal import console, leave_cleanly_when_stopped, track
from invrender.estimate.quantities import Quantity
from invrender.estimate.solution import Solution
from invrender.factor.choices import FactorChoices
from invrender.factor.figure import ShownPhoto, factor_figure, pictured
from invrender.factor.given import Given, LightError, given_document, light_error, read_given
from invrender.factor.solve import factor
from invrender.output.report.files import PICTURES, RESULT_FILES, photoset_hashes, write_fit, write_pictures
from invrender.output.report.keptfit import solved_from
from invrender.result.document import identifiability
from invrender.result.run import Run
from invrender.result.sentences import errors_in_words
from invrender.wording import with_error

OWN_FILES = (*RESULT_FILES, "factor.png")
_LABELS = {
    "kd_normalised": "Kd",
    "ks_normalised": "Ks",
    "mu": "mu",
    "sigma": "sigma (rad)",
}


def run_factor(source: Path, out: Path, choices: FactorChoices, fresh: bool = False) -> Run:
    """Factor a photo set into a result folder and print what was found.

    fresh : as of `opened_workplace`.
    """
    leave_cleanly_when_stopped()
    photoset = load_photoset(source)
    given = read_given(photoset)
    with claimed(out), opened_workplace(photoset.manifest, fresh=fresh):
        inputs = photoset_hashes(photoset)
        with result_folder(out, OWN_FILES) as folder:
            made_of = solved_from(photoset, inputs, choices)
            run = kept_result("factor", partial(factor, photoset, choices, track), made_of)
            error = light_error(given, run.solution)
            more = {"choices": choices.document(), "given": given_document(given, error)}
            document = write_fit(run, folder, more, inputs)
        with added_files(out, PICTURES) as folder:
            document = write_pictures(run, folder, document, track)
            shown = [
                ShownPhoto.of(prediction)
                for prediction in run.predictions(pictured(photoset, document["photos"]))
            ]
            factor_figure(run, given, shown).savefig(folder / "factor.png")
    _print_numbers(run, given)
    _print_light(run.solution, given, error)
    console.print(errors_in_words(document["fit"]), soft_wrap=True)
    _print_rest(run)
    console.print(f"Results: {out / 'result.json'}   Look at it: {out / 'factor.png'}", soft_wrap=True)
    return run


def _print_numbers(run: Run, given: Given) -> None:
    solution = run.solution
    headings = ["parameter", "value ± std", "status"]
    if given.numbers:
        headings += ["given", "off", "off / std"]
    title = f"{run.photoset.name}: {solution.model.estimate.model.name}; Kd + Ks = 1"
    table = Table(*headings, title=escape(title), title_justify="left")
    for name, label in _LABELS.items():
        quantity, truth = solution.quantities.get(name), given.numbers.get(name)
        count = 3 if name.endswith("normalised") else 1
        for k in range(count):
            row = [f"{label} {CHANNELS[k]}" if count == 3 else label, *_found(quantity, k, solution.misfits)]
            if given.numbers:
                row += _against(quantity, truth, k)
            table.add_row(*row)
    console.print(table)
    if given.numbers:
        console.print(f"Given: {given.brdf_from}.", soft_wrap=True)


def _found(quantity: Quantity | None, k: int, misfits: bool) -> tuple[str, str]:
    if quantity is None or quantity.value is None or quantity.std is None:
        return "-", quantity.status if quantity or misfits else "not needed"  # type: ignore[union-attr]
    std = float(quantity.std[k])
    status = quantity.status if np.isfinite(std) else "no error bar"
    return with_error(float(quantity.value[k]), std), status


def _against(quantity: Quantity | None, truth: np.ndarray | None, k: int) -> tuple[str, str, str]:
    """What is given, how far the value is off, and that in standard deviations."""
    if truth is None:
        return "-", "", ""
    if quantity is None or quantity.value is None or quantity.std is None:
        return f"{truth[k]:.5g}", "", ""
    off, std = float(quantity.value[k] - truth[k]), float(quantity.std[k])
    return f"{truth[k]:.5g}", f"{off:+.2g}", f"{off / std:+.1f}" if std > 0 else ""


def _print_light(solution: Solution, given: Given, error: LightError | None) -> None:
    (entry,) = solution.lightings
    lighting, harmonics = entry.lighting, entry.harmonics
    assert harmonics is not None
    if len(lighting.directions):
        headings = ["lamp", "azimuth, elevation", "± (deg)", "irradiance ± std"]
        table = Table(*headings, *(["off (deg)"] if error is not None else []), title_justify="left")
        for k, (direction, strength) in enumerate(
            zip(lighting.directions, lighting.irradiances, strict=True)
        ):
            std_deg = lighting.direction_std_deg
            row = [
                str(k + 1),
                _place(direction),
                "-" if std_deg is None else f"{std_deg[k]:.2g}",
                ", ".join(
                    with_error(float(v), float(s))
                    for v, s in zip(strength, entry.irradiance_std[k], strict=True)
                ),
            ]
            if error is not None:
                row.append("-" if np.isnan(error.sources_deg[k]) else f"{error.sources_deg[k]:.3f}")
            table.add_row(*row)
        console.print(table)
    degree = len(harmonics.shares) - 1
    said = f"Light: {_count(len(lighting.directions), 'lamp')} and harmonics up to degree {degree}"
    if harmonics.determined_degree >= 0:
        said += f", determined up to degree {harmonics.determined_degree}"
    if error is not None:
        said += (
            f". Against the given light ({given.light_from}, {_count(error.given_sources, 'lamp')}): the first nine"
            f" coefficients, each over that of degree 0, are off by up to {error.nine:.4f}"
        )
    console.print(f"{said}.", soft_wrap=True)
    if harmonics.reason and harmonics.determined_degree >= 0:
        console.print(f"Light: {harmonics.reason}. To settle it: {harmonics.remedy}.", soft_wrap=True)


def _print_rest(run: Run) -> None:
    console.print(f"Scale: {run.solution.gauge}.", soft_wrap=True)
    rows = identifiability(run.solution)
    for reason, remedy in dict.fromkeys((row["reason"], row["remedy"]) for row in rows if row["reason"]):
        names = ", ".join(row["parameter"] for row in rows if row["reason"] == reason)
        console.print(f"{names}: {reason}. To settle it: {remedy}.", soft_wrap=True)
    for warning in run.warnings:
        console.print(f"Warning: {escape(warning)}", style="yellow", soft_wrap=True)


def _place(direction: Sequence[float] | np.ndarray) -> str:
    x, y, z = direction
    return f"{np.degrees(np.arctan2(y, x)):.2f}, {np.degrees(np.arcsin(np.clip(z, -1, 1))):.2f}"


def _count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number or 'no'} {what}s"
