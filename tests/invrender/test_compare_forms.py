"""Results and truths whose lobes are of one form or of several, side by side."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from capture.files.imagefile import write_exr
from invrender.brdf.lobes import FORMS, GGX_FORM, PLASTICS
from invrender.output.compare.lightings import light_pairs
from invrender.output.compare.pictures import material_panels
from invrender.output.compare.sides import read_side
from invrender.output.compare.verdicts import number_rows

from .renders import KD, KS, write_result

Command = Callable[..., tuple[int, str, str]]

SIGMA, MU = 0.2, 1.5
ALL = FORMS | {form.name: form for form in PLASTICS.values()}
# What the synthetic models call the same lobes.
MODELS: dict[str, tuple[str, dict[str, float]]] = {
    "microfacet": ("microfacet", {"mu": MU, "sigma": SIGMA}),
    "half-angle microfacet": ("smith", {"mu": MU, "sigma": SIGMA}),
    "GGX": ("ggx", {"mu": MU, "alpha": SIGMA}),
    # cos^s of twice theta_h falls to 1 / e where theta_h is about sigma: s = 1 / (2 sigma^2).
    "Phong": ("phong", {"exponent": 12.5}),
    "half-angle microfacet plastic": ("plastic", {"mu": MU, "sigma": SIGMA}),
    "GGX plastic": ("plastic", {"mu": MU, "alpha": SIGMA}),
}


def write_truth(folder: Path, model: str, numbers: dict[str, float]) -> Path:
    """The truth of a photo set under the sky of `write_result`."""
    folder.mkdir()
    write_exr(folder / "lighting.exr", np.ones((64, 128, 3), np.float32))
    light: dict[str, Any] = {"name": "sky", "map": "lighting.exr", "directional": [], "lamps": []}
    document = {
        "brdf": {"model": model, "kd": KD, "ks": KS, **numbers},
        "lighting": [light | {"mirror_ball": None}],
        "photos": [],
        "sensor": {},
    }
    (folder / "truth.json").write_text(json.dumps(document))
    return folder / "truth.json"


@pytest.mark.parametrize("form", list(MODELS))
def test_a_form_and_the_synthetic_model_of_the_same_lobe_agree(
    lightfactor: Command, tmp_path: Path, form: str
) -> None:
    model, numbers = MODELS[form]
    result = write_result(tmp_path / "result", form, numbers.get("mu"), SIGMA)
    truth = write_truth(tmp_path / "set", model, numbers)
    code, out, err = lightfactor("compare", result, truth)
    assert (code, err) == (0, "")
    count = 8 if "mu" in numbers else 7
    assert f"All {count} numbers agree" in out
    assert "of the form" not in out
    first, second = read_side(result), read_side(truth)
    assert first.brdf is not None
    assert second.brdf is not None
    assert first.brdf.form is second.brdf.form is ALL[form]
    assert (second.brdf.mu, second.brdf.sigma) == (first.brdf.mu, first.brdf.sigma)


def test_lobes_of_different_forms_are_compared_with_a_warning(lightfactor: Command, tmp_path: Path) -> None:
    lamp = {"direction": [0, 0, 1], "irradiance": [1, 1, 1], "irradiance_std": [0, 0, 0]}
    light = {"name": "sky", "sh": {"value": []}, "directional": [lamp], "map": "lighting.exr"}
    result = write_result(tmp_path / "result", "microfacet", MU, SIGMA, lighting=[light])
    write_exr(result / "lighting.exr", np.zeros((64, 128, 3), np.float32))
    truth = write_truth(tmp_path / "set", *MODELS["GGX"])
    code, out, err = lightfactor("compare", result, truth)
    assert (code, err) == (0, "")
    assert "The lobe of A is of the form 'microfacet', that of B 'GGX'" in out
    assert "The truth's sigma stands for its alpha, 0.2" in out
    first, second = read_side(result), read_side(truth)
    panels = list(material_panels(first, second, light_pairs(first, second)))
    # Under a lamp, since that is quickly drawn: half of GGX's light is in its long tails.
    assert min(panel.rms for panel in panels) > 0.01


def test_of_a_truth_without_such_a_lobe_only_kd_is_compared(tmp_path: Path) -> None:
    result = write_result(tmp_path / "result", "microfacet", MU, SIGMA)
    truth = write_truth(tmp_path / "set", "mirror", {"mu": MU})
    rows = number_rows(read_side(result), read_side(truth))
    assert [row.label for row in rows if row.agrees is not None] == [
        "Kd red (1/sr)",
        "Kd green (1/sr)",
        "Kd blue (1/sr)",
    ]
    assert "only Kd" in read_side(truth).notes[0]


def test_a_brushed_truth_is_compared_by_its_two_widths(tmp_path: Path) -> None:
    result = write_result(tmp_path / "result", "microfacet", MU, SIGMA)
    truth = read_side(
        write_truth(tmp_path / "set", "anisotropic", {"mu": MU, "alpha_x": 0.1, "alpha_y": 0.4})
    )
    rows = {row.label: row for row in number_rows(read_side(result), truth)}
    assert rows["sigma (rad)"].second == pytest.approx((0.2, 0))
    assert (rows["alpha_x (rad)"].first, rows["alpha_x (rad)"].second) == (None, (0.1, 0))
    assert rows["alpha_y (rad)"].verdict == "not in its model in A"
    assert truth.form is not None
    assert truth.form.axis == (0, 0, 1)


PLASTIC = """
format = 1
name = "plastic"
object = { shape = "sphere" }
material = { model = "plastic", kd = [0.12, 0.09, 0.06], ks = 0.04, mu = 1.5, alpha = 0.15 }
camera = { width = 80, height = 68, focal_px = 600 }

[[lighting]]
name = "lab"
directional = [
    { azimuth_deg = 60, elevation_deg = 35, irradiance = [1.1, 1.2, 1.35] },
    { azimuth_deg = -50, elevation_deg = 30, irradiance = [1.2, 1.1, 1.0] },
]

[gantry]
start_deg = -75
step_deg = 25
photos = 7

[render]
directions = 64
"""


@pytest.mark.sweep
def test_a_plastic_is_made_found_and_compared(lightfactor: Command, tmp_path: Path) -> None:
    (tmp_path / "plastic.toml").write_text(PLASTIC)
    assert lightfactor("synth", tmp_path / "plastic.toml", "-o", tmp_path / "set")[0] == 0
    assert lightfactor("process", tmp_path / "set", "-o", tmp_path / "out", "--samples", 4000)[0] == 0
    # RH01's lobe over a Lambertian base leaves a seventh; forms that it leaves alike are told apart none the less.
    side = read_side(tmp_path / "out")
    assert side.form is PLASTICS[GGX_FORM]
    code, out, err = lightfactor("compare", tmp_path / "out", tmp_path / "set" / "truth.json")
    assert (code, err) == (0, "")
    # One noise moves all eight together, and three of them are one number: none is three standard deviations off.
    off = [abs(float(z)) for z in re.findall(r"([+-]\d+\.\d) *│ *(?:agree|differ)", out)]
    assert len(off) == 8
    assert max(off) < 3
