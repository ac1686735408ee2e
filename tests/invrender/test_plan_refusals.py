"""What can't be planned is refused in a sentence; what is planned as something else is said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from invrender.brdf.microfacet import Microfacet
from invrender.plan.experiment import Experiment
from invrender.plan.from_scene import experiment_of
from invrender.plan.planning import make_plan
from synthetic.scenes.build import read_staging
from synthetic.scenes.builtin import scene_path

from .planscenes import GANTRY, LAMP, SKY, scene


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"degree": -1}, "degree is -1"),
        ({"samples": 0}, "samples is 0"),
    ],
)
def test_numbers_out_of_range_are_named(change: dict[str, int], words: str):
    experiment = experiment_of(read_staging(scene_path("fail-no-grazing")))
    with pytest.raises(ValueError, match=words):
        make_plan(experiment, **change)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            f'name = "teflon"\n[[lighting]]\nname = "lab"\n{LAMP}',
            f'model = "mirror"\nkd = 0.1\nks = 0.5\n[[lighting]]\nname = "lab"\n{SKY}',
            "has no roughness and index",
        ),
        (
            'name = "teflon"',
            'model = "anisotropic"\nkd = 0.1\nks = 0.1\nalpha_x = 0.1\nalpha_y = 0.2',
            "two roughnesses",
        ),
        ('name = "teflon"', 'model = "lambertian"\nkd = 0.0', "reflects nothing"),
        ("photos = 7", "photos = 2\nheld_out = [0, 1]", "held out"),
        ("azimuth_deg = 0, elevation_deg = 4", "azimuth_deg = 180, elevation_deg = 0", "no light reaches"),
        ("focal_px = 900", "focal_px = 60", r"shows \d+ usable pixels"),
    ],
)
def test_what_cannot_be_planned_is_refused_in_a_sentence(tmp_path: Path, old: str, new: str, words: str):
    path = tmp_path / "bench.toml"
    text = scene(LAMP, "[gantry]\nphotos = 7\nstep_deg = 1\n")
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(ValueError, match=words):
        make_plan(experiment_of(read_staging(path)))


def test_other_materials_are_planned_as_their_like_and_it_is_said(tmp_path: Path):
    def brdf_and_notes(material: str) -> tuple[Microfacet, str]:
        path = tmp_path / "bench.toml"
        path.write_text(scene(LAMP, GANTRY, material))
        experiment: Experiment = experiment_of(read_staging(path))
        return experiment.brdf, " ".join(experiment.notes)

    brdf, notes = brdf_and_notes('model = "ggx"\nkd = 0.1\nks = 0.05\nalpha = 0.2\nmu = 1.5')
    assert (brdf.sigma, brdf.mu) == (0.2, 1.5)
    assert "GGX of alpha 0.2" in notes
    brdf, notes = brdf_and_notes('model = "smith"\nkd = 0.1\nks = 0.05\nsigma = 0.2')
    assert (brdf.sigma, brdf.mu) == (0.2, None)
    brdf, notes = brdf_and_notes('model = "plastic"\nkd = 0.1\nks = 0.05\nalpha = 0.2\nmu = 1.5')
    assert "GGX of alpha 0.2" in notes
    assert "the base under an interface is planned as a Lambertian one" in notes
    assert (brdf.mu, brdf.sigma) == (1.5, 0.2)
    brdf, notes = brdf_and_notes('model = "phong"\nkd = 0.1\nks = 0.1\nexponent = 50')
    assert "Phong" in notes
    # Head-on both lobes are as high: ks (s + 2) / 2 pi, and Ks / (4 pi sigma^2).
    assert brdf.sigma is not None
    assert_allclose(brdf.ks / (4 * np.pi * brdf.sigma**2), 0.1 * 52 / (2 * np.pi))
    # And fall to half at the same half angle, to a percent.
    half = np.arccos(0.5 ** (1 / 50)) / 2
    assert np.exp(-((half / brdf.sigma) ** 2)) == pytest.approx(0.5, rel=0.01)
