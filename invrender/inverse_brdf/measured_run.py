"""The command `brdf` on a BRDF that others measured: progress and tables on the terminal, brdf.json and brdf.png."""

from __future__ import annotations

from pathlib import Path

from rich.table import Table

from capture.files.documents import input_hashes, write_json
from capture.files.outfolder import result_folder
from capture.parallel import one_blas_thread
from capture.progress import counted
from capture.terminal import console, leave_cleanly_when_stopped, track
from invrender.estimate.explanation import EXPLANATION_STEPS
from invrender.inverse_brdf.document import document, measured_document
from invrender.inverse_brdf.measured import ENERGY_LEFT, MeasuredFit, fit_measured, read_measured
from invrender.inverse_brdf.measured_figure import measured_figure
from invrender.inverse_brdf.run import OWN_FILES
from invrender.wording import parameter_lines

# Samples that are used where nobody says how many: an even share of MERL's million and a half.
SAMPLES = 60_000
_SHOWN = 5


def run_measured(source: Path, out: Path, samples: int | None) -> MeasuredFit:
    """Fit the lobes to a measured BRDF, write the result into a folder, and print what was found."""
    leave_cleanly_when_stopped()
    measured = read_measured(source)
    with one_blas_thread(), result_folder(out, OWN_FILES) as folder:
        with counted(track, EXPLANATION_STEPS, "Fitting and cross-validating") as on_step:
            fit = fit_measured(measured, samples, on_step)
        found = document(source.name, measured_document(fit), [], [], input_hashes([source]))
        write_json(folder / "brdf.json", found)
        measured_figure(source.name, fit).savefig(folder / "brdf.png")
    _print(source.name, fit, len(measured))
    console.print(
        f"Result: {out / 'brdf.json'}   Look at it: {out / 'brdf.png'}", soft_wrap=True, markup=False
    )
    return fit


def _print(name: str, fit: MeasuredFit, available: int) -> None:
    chosen = fit.model.estimate.model
    shown = Table("parameter", "value ± std", "status", title=f"{name}: {chosen.name}", title_justify="left")
    for key, quantity in fit.solution.quantities.items():
        if key.endswith("_normalised") or key == "albedo":
            continue
        for label, text in parameter_lines(key, quantity.value, quantity.std):
            shown.add_row(label, text, quantity.status)
    console.print(shown)
    models = Table("model", "numbers", "error at unseen angles of incidence", title_justify="left")
    for candidate in sorted(fit.solution.candidates, key=lambda candidate: candidate.error)[:_SHOWN]:
        mark = "  (chosen)" if candidate is fit.model else ""
        models.add_row(
            candidate.estimate.model.name + mark,
            str(candidate.parameters),
            f"{candidate.error:.2%} ± {candidate.standard_error:.2%}",
        )
    console.print(models)
    unseen = f"{fit.unseen_errors.mean():.2%}"
    errors = f"{fit.errors.mean():.2%} of the reflected radiance (RMS, mean over angles), and {unseen}"
    console.print(
        f"{len(fit.samples)} of {available} samples at {len(fit.groups)} angles of incidence. The chosen model misses"
        f" {errors} at an angle that it has not seen.",
        soft_wrap=True,
    )
    orders = ", ".join(
        f"{name} needs a degree beyond 200" if found is None else f"{name} F = {found[0]}, P = {found[1]}"
        for name, found in fit.orders.items()
    )
    console.print(
        f"Reflection maps that hold {1 - ENERGY_LEFT:.0%} of each lobe's energy have the orders: {orders}.",
        soft_wrap=True,
    )
    for quantity in fit.solution.quantities.values():
        if quantity.value is None:
            console.print(
                f"Undetermined: {quantity.reason}. To settle it: {quantity.remedy}.", soft_wrap=True
            )
            break
