"""Fits that try few forms of highlights: each takes seconds, and which of them fits is for tests of forms to say."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from invrender.brdf.form import LobeForm
from invrender.brdf.lobes import BECKMANN, RH01_FORM


@contextmanager
def few_forms_tried(*others: LobeForm) -> Iterator[None]:
    """Beside RH01's form the given ones alone, and what they extend to; that of Beckmann's facets if none is given."""
    others = others or (BECKMANN,)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("invrender.estimate.forms.OTHER_FORMS", others)
        patch.setattr("invrender.estimate.unknown_light.forms.FIRST_FORMS", (RH01_FORM, *others))
        yield
