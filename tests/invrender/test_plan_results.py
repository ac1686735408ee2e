"""A plan of a result says what its fit says, and refuses what it can't be made of."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from invrender.plan.asked import asked_experiment
from invrender.plan.planning import make_plan
from invrender.result.saved import read_result


@pytest.fixture(scope="module")
def fitted(fitted_original: Path) -> Path:
    return fitted_original / "fit"


def test_deviations_are_those_that_the_fit_states(fitted: Path):
    experiment, path = asked_experiment(str(fitted))
    assert path == fitted / "result.json"
    expected = {one.name: one for one in make_plan(experiment, samples=6000).expected}
    brdf = read_result(fitted).content.brdf
    # Both count on all pixels; fits add what residuals share, up to as much again in Kd.
    for name, found in (("mu", brdf.mu), ("sigma", brdf.sigma), ("kd", brdf.kd), ("ks", brdf.ks)):
        assert_allclose(expected[name].truth, found.value)
        ratio = expected[name].noise_std / np.array(found.std)
        assert ((ratio > 0.4) & (ratio < 1.2)).all(), (name, ratio)


def test_light_may_be_taken_for_unknown(fitted: Path):
    given, _ = asked_experiment(str(fitted))
    hidden, _ = asked_experiment(str(fitted), "nothing")
    assert given.gauge_light is None
    assert hidden.gauge_light == 0
    with pytest.raises(ValueError, match="--light ball"):
        asked_experiment(str(fitted), "ball")


def test_what_a_plan_cannot_be_made_of_is_said(fitted: Path, tmp_path: Path):
    alone = tmp_path / "alone"
    shutil.copytree(fitted, alone)
    with pytest.raises(ValueError, match="name its folder with --set"):
        asked_experiment(str(alone))
    found, _ = asked_experiment(str(alone), photoset=fitted.parent)
    assert len(found.views) == 8
    result = json.loads((alone / "result.json").read_text())
    result["brdf"] |= {"model": "brushed GGX", "brushed_about": [0, 0, 1]}
    (alone / "result.json").write_text(json.dumps(result))
    with pytest.raises(ValueError, match="its lobe is brushed"):
        asked_experiment(str(alone), photoset=fitted.parent)
    with pytest.raises(ValueError, match=r"set: holds no result\.json"):
        asked_experiment(str(fitted.parent))
    with pytest.raises(ValueError, match="--set is for results"):
        asked_experiment("demo", photoset=fitted.parent)
