"""Renders of results whose lobe is of any form, judged by brute-force photographs and by finite differences."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.files.imagefile import write_exr
from invrender.brdf.lobes import FORMS, RH01_FORM
from invrender.brdf.phong import phong_exponent
from invrender.inverse_lighting.known_brdf import read_brdf
from synthetic.lights.arealight import AreaLight
from synthetic.lights.illumination import Illumination, latlong_map
from synthetic.lights.sources import DirectionalSource
from synthetic.materials.facets import BeckmannSlopes, GGXSlopes
from synthetic.materials.material import Material
from synthetic.materials.phong import PhongMaterial
from synthetic.materials.smith import SmithMaterial
from synthetic.render.photograph import photographs
from synthetic.scene import Scene, Shot
from synthetic.shapes.ball import Ball

from .renders import KD, KS, cameras, read, within, write_result

Command = Callable[..., tuple[int, str, str]]

SIGMA, MU = 0.2, 1.5
VIEW = ("--view", "40,20,0.4", "--fov", "7", "--size", "40x40")
FACETS: dict[str, Material] = {
    "half-angle microfacet": SmithMaterial(KD, KS, MU, BeckmannSlopes(SIGMA, SIGMA)),
    "GGX": SmithMaterial(KD, KS, MU, GGXSlopes(SIGMA, SIGMA)),
    "Phong": PhongMaterial(KD, KS, float(phong_exponent(SIGMA))),
}


def index_of(form: str) -> float | None:
    return MU if FORMS[form].has_fresnel else None


@pytest.mark.parametrize("form", list(FACETS))
def test_a_lobe_of_any_form_is_what_brute_force_integration_says(
    lightfactor: Command, bench: SimpleNamespace, tmp_path: Path, form: str
) -> None:
    write_result(tmp_path / "result", form, index_of(form), SIGMA)
    area = AreaLight(np.array([0.5, -0.4, 0.77]), np.array([0.8, 1.0, 1.3]), width_rad=0.5)
    # From behind, so that the lobe is met at grazing angles, where the forms differ.
    source = DirectionalSource(bench.direction(170, 30), np.array([1, 0.8, 0.6]))
    write_exr(tmp_path / "room.exr", latlong_map([area], 64))
    code, _, err = lightfactor(
        *("render", tmp_path / "result", "--light", tmp_path / "room.exr", "--source", "170,30,1,0.8,0.6"),
        *(*VIEW, "--turntable", 1, "-o", tmp_path / "turn"),
    )
    assert (code, err) == (0, "")
    (camera,) = cameras(tmp_path / "turn")
    ball = Ball(np.zeros(3), 0.02)
    light = Illumination("both", (area,), (source,))
    ((truth, _),) = photographs(Scene("form", ball, FACETS[form], (Shot(camera, light),)))
    radiance, layers = read(tmp_path / "turn" / "000.exr")
    inside = within(layers["A"])
    assert inside.sum() > 500
    apart = (radiance - truth)[inside]
    # The quadratures of a map are good to 0.5% of full light, single pixels at the rim to twice that.
    assert np.abs(apart).max() < 0.01 * truth.max()
    assert np.sqrt((apart**2).mean() / (truth[inside] ** 2).mean()) < 0.002


def test_deviations_follow_the_forms_own_slopes(lightfactor: Command, tmp_path: Path) -> None:
    form, step = "half-angle microfacet", 0.01
    light = ("--source", "100,30,1", *VIEW)
    for name, value in (("mu", MU), ("sigma", SIGMA)):
        radiance = []
        for side in (-1, 1):
            moved = {"mu": MU, "sigma": SIGMA} | {name: value * (1 + side * step)}
            folder = write_result(tmp_path / f"{name}{side}", form, **moved)
            lightfactor("render", folder, *light, "-o", tmp_path / "moved.exr")
            radiance.append(read(tmp_path / "moved.exr")[0])
        covariance = ((name,), np.array([[(value * step) ** 2]]))
        folder = write_result(tmp_path / name, form, MU, SIGMA, covariance)
        assert lightfactor("render", folder, *light, "--std", "-o", tmp_path / "x.exr")[0] == 0
        std = read(tmp_path / "x.exr")[1]["std"]
        # Of second order in a step of 1%.
        assert_allclose(std, np.abs(radiance[1] - radiance[0]) / 2, rtol=0.01, atol=1e-3 * std.max())


def test_a_form_is_read_by_its_name_or_refused(lightfactor: Command, tmp_path: Path) -> None:
    for name, form in FORMS.items():
        folder = write_result(tmp_path / name, name, index_of(name), SIGMA)
        assert read_brdf(folder).form is form
    assert read_brdf(write_result(tmp_path / "plain")).form is RH01_FORM
    document = json.loads((folder / "result.json").read_text())
    document["brdf"]["model"] = "Fong"
    (folder / "result.json").write_text(json.dumps(document))
    for command in (("render", folder), ("light", folder, "--brdf", folder), ("compare", folder, folder)):
        code, _, err = lightfactor(*command, "-o", tmp_path / "x.html" if "compare" in command else "x.exr")
        assert code == 1
        assert "'Fong'" in err
        assert "did you mean 'Phong'?" in err
