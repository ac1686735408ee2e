"""What samples see of unknown light: slopes against differences of rows, and rows near those that were computed."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.lighting import cosines
from invrender.brdf.form import LobeForm
from invrender.brdf.lobes import FORMS, PLASTICS
from invrender.estimate.unknown_light.lamp_frame import LampFrame
from invrender.estimate.unknown_light.lighting_design import LightingDesign
from invrender.estimate.unknown_light.rows import rows_of, slopes_of
from invrender.estimate.unknown_light.state import BlindState
from recon.sampling.lightfield import LightField

DEGREE = 6
ALL = FORMS | {form.name: form for form in PLASTICS.values()}
TOWARDS = np.array([[0.48, 0.6, 0.64], [-0.8, 0.36, 0.48]])


def _state(form: LobeForm) -> BlindState:
    shares = np.array([0.3, 0.4, 0.5])
    mu, owners, closeness = 1.6 if form.has_fresnel else None, np.zeros(2, int), np.array([0.0, 0.3])
    return BlindState(shares, mu, 0.2, TOWARDS, form, owners, closeness)


def _design(field: LightField) -> LightingDesign:
    return LightingDesign.of([field], DEGREE, frame=LampFrame.of([field]))


@pytest.mark.parametrize("form", ALL.values(), ids=ALL)
def test_slopes_are_differences_of_what_rows_yield(
    form: LobeForm, bench: SimpleNamespace, rng: np.random.Generator
) -> None:
    field, state, step = bench.sphere_field(40.0, 60), _state(form), 4e-3
    light = rng.normal(size=((DEGREE + 1) ** 2 + 2, 3))

    def radiance(state: BlindState) -> np.ndarray:
        return rows_of(_design(field), state, DEGREE).radiance(state.specular_share, light)

    # At a horizon what a source does bends within the step.
    towards, _ = _design(field).towards(state.sources)
    off = np.abs(cosines(field.normals, towards)).min(axis=1) > 2 * step
    off = field.mean_over_rays(off.astype(float)) == 1
    design = _design(field)
    found = slopes_of(design, state, rows_of(design, state, DEGREE), light)
    for c in range(3):
        for k, place in enumerate(state.own(c, 0)):
            way = step * np.eye(len(state.names))[place]
            expected = (radiance(state.moved(way)) - radiance(state.moved(-way)))[:, c] / (2 * step)
            # Central differences leave out a sixth of the step's square times the third derivative, and single
            # precision a hundred thousandth.
            assert_allclose(found[off, c, k], expected[off], atol=2e-3 * np.abs(expected).max())


@pytest.mark.parametrize("form", ALL.values(), ids=ALL)
def test_rows_near_those_that_were_computed_are_what_they_would_be(
    form: LobeForm, bench: SimpleNamespace
) -> None:
    field, state = bench.sphere_field(40.0, 60), _state(form)
    near = state.moved(np.array([8e-4 if name in ("mu", "sigma") else 0.0 for name in state.names]))
    design = _design(field)
    rows_of(design, state, DEGREE)
    found = rows_of(design, near, DEGREE).of_channel(1.0)
    fresh = rows_of(_design(field), near, DEGREE).of_channel(1.0)
    far = rows_of(_design(field), state, DEGREE).of_channel(1.0)
    # Half of the step's square, and single precision's sums.
    assert_allclose(found, fresh, atol=3e-6 * np.abs(fresh).max())
    assert np.abs(far - fresh).max() > 1e-4 * np.abs(fresh).max()
