"""A BRDF that others measured, and the lobe that explains it."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capture.parallel import one_blas_thread
from capture.progress import counted, silent
from capture.terminal import track as terminal_track
from invrender.estimate.explanation import EXPLANATION_STEPS
from invrender.estimate.quantities import Quantity
from invrender.inverse_brdf import measured
from invrender.inverse_brdf.measured_figure import measured_figure
from invrender.inverse_brdf.measured_run import SAMPLES
from invrender.tables import text_table
from lightfactor.arguments import naming_arguments
from lightfactor.brdf import FittedNumber

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

_LEAST_SAMPLES = 50


class MeasuredBrdf:
    """A measured BRDF as `fit_brdf` explains it."""

    def __init__(self, name: str, fit: measured.MeasuredFit) -> None:
        self._fit = fit
        self.name = name

    @property
    def model(self) -> str:
        """The chosen model, in words."""
        return self._fit.model.estimate.model.name

    @cached_property
    def numbers(self) -> dict[str, FittedNumber]:
        """Kd (1/sr), Ks, mu, sigma (radians) and the form's own numbers, by name, as `Fit.brdf` has them."""
        return {name: _number(name, quantity) for name, quantity in self._fit.solution.quantities.items()}

    @property
    def error(self) -> float:
        """Relative RMS of the reflected radiance, mean over angles of incidence."""
        return float(self._fit.errors.mean())

    @property
    def unseen_error(self) -> float:
        """The same at angles of incidence that the fit has not seen."""
        return float(self._fit.unseen_errors.mean())

    @property
    def orders(self) -> dict[str, tuple[int, int] | None]:
        """F and P of each lobe's reflection map that hold 97% of its energy; None of one too narrow for maps."""
        return self._fit.orders

    def evaluate(self, incident: ArrayLike, exitant: ArrayLike) -> Floats:
        """The fitted BRDF (n, 3), 1/sr, at unit directions (n, 3) to light and viewer, z along the normal.

        ValueError for directions below the surface.
        """
        wi, wo = (np.atleast_2d(np.asarray(directions, float)) for directions in (incident, exitant))
        if (wi[:, 2] <= 0).any() or (wo[:, 2] <= 0).any():
            raise ValueError(
                "incident and exitant directions must lie above the surface: their z must be positive"
            )
        return measured.brdf_values(self._fit.solution.brdf, wi, wo)

    def plot(self) -> Figure:
        """Slices at three angles of incidence, measured and fitted, and errors over the angle."""
        return measured_figure(self.name, self._fit)

    def __repr__(self) -> str:
        shown = [one for one in self.numbers.values() if not one.name.endswith("_normalised")]
        rows = [(*line, one.status) for one in shown for line in one.lines()]
        errors = f"Error (relative RMS): {self.error:.2%} fitted, {self.unseen_error:.2%} at unseen angles."
        return "\n".join(
            [f"{self.name}: {self.model}", text_table(("parameter", "value ± std", "status"), rows), errors]
        )


@naming_arguments
def fit_brdf(table: Path | str, samples: int = SAMPLES, progress: bool = False) -> MeasuredBrdf:
    """Fit the lobes that `process` knows to a measured isotropic BRDF, and choose by what they predict.

    table : Cornell's text (`.brdf`), MERL's binary (`.binary`), or the brdf.json of `lightfactor brdf --method table`.
    samples : so many of its values at most, 50 or more. progress : show a bar on the terminal.
    Does what `lightfactor brdf TABLE` does. ValueError says what is wrong with the file.
    """
    if samples < _LEAST_SAMPLES:
        raise ValueError(f"samples is {samples}; give {_LEAST_SAMPLES} or more")
    path = Path(table)
    if not path.is_file():
        raise ValueError(f"table {path}: there is no such file; give a measured BRDF")
    values = measured.read_measured(path)
    steps = counted(terminal_track if progress else silent, EXPLANATION_STEPS, "Fitting and cross-validating")
    with one_blas_thread(), steps as on_step:
        return MeasuredBrdf(path.name, measured.fit_measured(values, samples, on_step))


def _number(name: str, quantity: Quantity) -> FittedNumber:
    value, std = (
        None if of is None else of if len(of) > 1 else float(of[0]) for of in (quantity.value, quantity.std)
    )
    return FittedNumber(name, value, std, quantity.status, quantity.reason or "", quantity.remedy or "")
