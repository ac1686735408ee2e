"""Fits that try few forms of highlights, or seek no causes of misfits: both take seconds and have their own tests."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from invrender.brdf.form import LobeForm
from invrender.brdf.lobes import BECKMANN, RH01_FORM


@contextmanager
def few_forms_tried(*others: LobeForm) -> Iterator[None]:
    """Beside RH01's form the given ones alone, and what they extend to; if none is given, Beckmann's facets as such."""
    with pytest.MonkeyPatch.context() as patch:
        if not others:
            others = (BECKMANN,)
            for extension in ("extended", "tabulated"):
                patch.setattr(f"invrender.estimate.forms.{extension}", lambda _: ())
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
