"""Fits that try few forms of highlights: each takes seconds, and which of them fits is for tests of forms to say."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from invrender.brdf.lobes import BECKMANN, RH01_FORM


@contextmanager
def few_forms_tried() -> Iterator[None]:
    """Beside RH01's form that of Beckmann's facets alone, and what it extends to."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("invrender.estimate.forms.OTHER_FORMS", (BECKMANN,))
        patch.setattr("invrender.estimate.unknown_light.forms.FIRST_FORMS", (RH01_FORM, BECKMANN))
        yield
