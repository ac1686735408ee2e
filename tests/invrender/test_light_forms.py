"""Inverse lighting through lobes of any form."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss
from numpy.testing import assert_allclose

from invrender.brdf.form import LobeForm
from invrender.brdf.lobes import BECKMANN, FORMS, GGX_FORM, PLASTICS
from invrender.brdf.microfacet import Microfacet
from invrender.theory.specialcases import microfacet_transfer
from invrender.transport.harmonic_rows import lobe_blur, photo_rows
from recon.harmonics.basis import evaluate_harmonics
from synthetic.materials.facets import GGXSlopes
from synthetic.materials.material import Material
from synthetic.materials.plastic import Plastic
from synthetic.materials.smith import SmithMaterial

from .renders import KD, KS, write_result

Command = Callable[..., tuple[int, str, str]]


GGX_TRUTH = SmithMaterial(np.array(KD), np.array(KS), 1.5, GGXSlopes(0.25, 0.25))


@pytest.mark.parametrize(
    ("form", "material"),
    [(GGX_FORM, GGX_TRUTH), (PLASTICS[GGX_FORM], Plastic(GGX_TRUTH))],
    ids=["GGX", "plastic"],
)
def test_rows_are_the_forms_own_transfer(
    bench: SimpleNamespace, rng: np.random.Generator, form: LobeForm, material: Material
) -> None:
    field = bench.sphere_field(20.0, 30)
    field = field.where(field.weight > 0)
    brdf = Microfacet(np.array(KD), np.array(KS), 1.5, 0.25, form)
    light = rng.normal(size=(16, 3))
    found = photo_rows(field, brdf, 3).predict(brdf, light)
    # By a product rule over all directions, of another implementation of the BRDF. What the horizon cuts, by halves of
    # cells: a thousandth.
    z, weight = leggauss(120)
    phi = np.arange(240) * 2 * np.pi / 240
    level = np.sqrt(1 - z**2)[:, None]
    wi = np.stack(
        [level * np.cos(phi), level * np.sin(phi), np.broadcast_to(z[:, None], (120, 240))], axis=-1
    )
    arriving = (
        evaluate_harmonics(wi.reshape(-1, 3), 3) @ light * np.repeat(weight, 240)[:, None] * 2 * np.pi / 240
    )
    expected = np.zeros((len(field.normals), 3))
    for k, (normal, view) in enumerate(zip(field.normals, field.views, strict=True)):
        directions = wi.reshape(-1, 3)
        normals, views = (np.broadcast_to(one, directions.shape) for one in (normal, view))
        cos = np.maximum(directions @ normal, 0)[:, None]
        expected[k] = (material.evaluate(normals, directions, views) * cos * arriving).sum(axis=0)
    expected = field.mean_over_rays(expected)
    assert_allclose(found, expected, atol=2e-3 * np.abs(expected).max())


def test_what_lobes_leave_of_each_degree_is_alike_where_sigma_is_small() -> None:
    printed = microfacet_transfer(0.05, 20)
    for form in FORMS.values():
        if form is GGX_FORM:
            continue  # its tails are long however small sigma is
        blur = lobe_blur(
            Microfacet(np.ones(3), np.ones(3), 1.5 if form.has_fresnel else None, 0.05, form), 20
        )
        # Forms differ by sigma^2.
        assert_allclose(blur, printed / printed[0], atol=3 * 0.05**2)
    narrow, wide = (lobe_blur(Microfacet(np.ones(3), np.ones(3), None, s, GGX_FORM), 20) for s in (0.05, 0.1))
    assert (np.diff(narrow) < 0).all()
    assert (wide[1:] < narrow[1:]).all()


def test_coarser_transfers_are_for_the_papers_lobe_only(lightfactor: Command, tmp_path: Path) -> None:
    result = write_result(tmp_path / "result", BECKMANN.name, 1.5, 0.2)
    code, _, err = lightfactor(
        "light", tmp_path, "--brdf", result, "--rung", "filtered", "-o", tmp_path / "x"
    )
    assert code == 1
    assert "'half-angle microfacet'" in err
    assert "leave --rung out" in err
