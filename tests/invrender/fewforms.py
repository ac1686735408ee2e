"""Results with less: few forms of highlights tried, no causes of misfits sought, no figures or pictures drawn.

All of these take seconds and have their own tests.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from invrender.brdf.form import LobeForm
from invrender.brdf.lobes import BECKMANN, RH01_FORM


@contextmanager
def few_forms_tried(*others: LobeForm, tables: bool = True) -> Iterator[None]:
    """Beside RH01's form the given ones alone, and what they extend to; if none is given, Beckmann's facets as such.

    tables : False leaves tabulated lobes of the given forms out.
    """
    with pytest.MonkeyPatch.context() as patch:
        if not tables or not others:
            patch.setattr("invrender.estimate.forms.tabulated", lambda _: ())
        if not others:
            others = (BECKMANN,)
            patch.setattr("invrender.estimate.forms.extended", lambda _: ())
        patch.setattr("invrender.estimate.forms.OTHER_FORMS", others)
        patch.setattr("invrender.estimate.unknown_light.forms.FIRST_FORMS", (RH01_FORM, *others))
        yield


@contextmanager
def no_causes_sought() -> Iterator[None]:
    """Fits seek no causes of what they leave beyond noise; those found would only add warnings and widen error bars."""
    with pytest.MonkeyPatch.context() as patch:
        for solver in ("explained", "unknown_light"):
            patch.setattr(f"invrender.process.{solver}.diagnose", lambda *_: None)
        yield


@contextmanager
def no_report_written() -> Iterator[None]:
    """`process` writes numbers and predicted photographs, and no report."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("invrender.output.report.files.write_report", lambda *_: None)
        yield


@contextmanager
def no_pictures_drawn() -> Iterator[None]:
    """`process` writes its numbers, and neither predicted photographs nor a report; errors are those of the samples."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "invrender.output.report.run.write_pictures", lambda run, folder, document, *_, **__: document
        )
        # A sentence about the pictures' errors.
        patch.setattr("invrender.output.report.run.errors_in_words", lambda _: "")
        yield


@contextmanager
def no_figures_drawn() -> Iterator[None]:
    """Figures of reports and results are empty files."""

    def saved(_: Figure, file: Path | BytesIO, **__: object) -> None:
        if isinstance(file, Path):
            file.write_bytes(b"")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", saved)
        yield
