"""Columns that hold neither mu nor sigma, against the direct prediction that knows both."""

from __future__ import annotations

import numpy as np
import pytest

from capture.tasks.stage import Workplace, working_in
from capture.tasks.store import TaskStore
from invrender.brdf.brushed import brushed, window_about
from invrender.brdf.lobes import GGX_FORM, RH01_FORM, UNCORRELATED
from invrender.brdf.microfacet import Microfacet
from invrender.brdf.richer import COATED_HAZY, extended, tabulated
from invrender.brdf.smith import Smith
from invrender.estimate.search import OTHER_FORMS
from invrender.transport import columns
from invrender.transport.column_basis import around, step_ends
from invrender.transport.columns import all_columns, photo_columns
from invrender.transport.diffuse_base import base_size
from invrender.transport.predict import predict, predict_columns
from invrender.transport.transfer import light_elements
from synthetic.materials.rh01 import RH01_MATERIALS, radiometric


@pytest.mark.parametrize(
    "recover", [{}, {"recover_irradiance": True}, {"recover_irradiance": True, "recover_ambient": True}]
)
def test_prediction_through_columns_agrees_with_the_direct_one(recover: dict[str, bool], bench, rng):
    lighting = bench.known_lighting(**recover)
    elements = light_elements(lighting)
    strengths = rng.uniform(0.5, 1.5, (len(elements), 3))
    # The highlight near normal exitance, and near grazing.
    for angle in (10.0, 150.0):
        field = bench.sphere_field(angle, samples=250)
        assert len(field.normals) > len(field)  # some samples have several rays
        photo = photo_columns(lighting.name, elements, field)
        brdfs = [radiometric(row) for row in RH01_MATERIALS.values()]
        for truth in brdfs:
            brdf = Microfacet(truth.kd, truth.ks, truth.mu, truth.sigma)
            direct = predict(brdf, elements, strengths, field)
            through = predict_columns(photo, brdf, strengths)
            # Interpolation in sigma (1e-4 of the lobe's peak) and the Fresnel sum (4e-4 at these indices).
            assert np.abs(through - direct).max() < 5e-4 * direct.max()
            assert np.sqrt(np.mean((through - direct) ** 2)) < 5e-4 * np.sqrt(np.mean(direct**2))


def test_a_lambertian_has_no_highlight(bench):
    lighting = bench.known_lighting()
    elements = light_elements(lighting)
    field = bench.sphere_field(20.0)
    photo = photo_columns(lighting.name, elements, field)
    matte = Microfacet(np.full(3, 0.2), np.zeros(3), None, None)
    direct = predict(matte, elements, np.ones((1, 3)), field)
    assert (
        np.abs(predict_columns(photo, matte, np.ones((1, 3))) - direct).max() < 1e-6 * direct.max()
    )  # float32
    assert direct.max() > 0.1


@pytest.mark.parametrize("form", [RH01_FORM, COATED_HAZY[GGX_FORM]], ids=["one lobe", "several"])
@pytest.mark.parametrize("name", ["mu", "sigma"])
def test_columns_around_one_brdf_hold_its_radiance_and_that_of_a_small_step(bench, name, form):
    truth = radiometric(RH01_MATERIALS["teflon"])
    brdf = Microfacet(truth.kd, truth.ks, truth.mu, truth.sigma, form)
    # One ray of each pixel: of several, columns see a map by fewer.
    elements, field = light_elements(bench.known_lighting()), bench.sphere_field(150.0).thinned(1)
    photo = photo_columns("light", elements, field, form, basis=around(brdf.mu, brdf.sigma))
    assert photo.columns.shape[-1] == base_size(form) + 3 * 3
    for end in (getattr(brdf, name), *step_ends(getattr(brdf, name)), 1.0003 * getattr(brdf, name)):
        moved = brdf.moved_to(name, end)
        direct = predict(moved, elements, np.ones((1, 3)), field)
        through = predict_columns(photo, moved, np.ones((1, 3)))
        # Single precision, a thousandth of what the step itself changes.
        assert np.abs(through - direct).max() < 1e-6 * direct.max()


def test_columns_of_the_base_alone_hold_no_lobe(bench):
    matte = Microfacet(np.full(3, 0.2), np.zeros(3), None, None)
    elements, field = light_elements(bench.known_lighting()), bench.sphere_field(20.0)
    photo = photo_columns("light", elements, field, basis=around(None, None))
    assert photo.columns.shape[-1] == 1
    direct = predict(matte, elements, np.ones((1, 3)), field)
    assert np.abs(predict_columns(photo, matte, np.ones((1, 3))) - direct).max() < 1e-6 * direct.max()


def test_columns_of_all_forms_are_kept_and_read_again(bench, tmp_path, monkeypatch: pytest.MonkeyPatch):
    lighting = bench.known_lighting()
    elements = {lighting.name: light_elements(lighting)}
    fields = [bench.sphere_field(angle, samples=20) for angle in (0.0, 150.0)]
    names = [lighting.name] * len(fields)
    single = [form for form in OTHER_FORMS if isinstance(form, Smith)]
    richer = [more for form in single for more in (*extended(form), *tabulated(form), UNCORRELATED[form])]
    window = brushed(GGX_FORM, (0.6, 0.0, 0.8), window_about(0.15, 0.4, (0.35, 0.6)))

    def made() -> list[np.ndarray]:
        return [
            photo.columns
            for form in (RH01_FORM, *OTHER_FORMS, *richer, window)
            for photo in all_columns(names, elements, fields, form)
        ]

    expected = made()
    with working_in(Workplace(TaskStore(tmp_path))):
        made()
        monkeypatch.setattr(columns, "_columns", lambda *_: pytest.fail("they were made anew"))
        found = made()
    assert all(np.array_equal(*pair) for pair in zip(found, expected, strict=True))
