"""Plans of photographs under near lamps, against what a fit of such photographs states."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Command = Callable[..., tuple[int, str, str]]

SCENE = """
format = 1
name = "near"
[object]
shape = "sphere"
[material]
name = "delrin"
[[lighting]]
name = "lamp"
lamp = [{ azimuth_deg = 40, elevation_deg = 25, distance = 0.12, irradiance = 2.0 }]
[camera]
width = 120
height = 90
focal_px = 1080
[gantry]
step_deg = 20
photos = 5
"""


@pytest.fixture
def stated(
    lightfactor: Command, tmp_path: Path, few_forms: None, no_causes: None
) -> Callable[[str], tuple[dict[str, Any], dict[str, Any]]]:
    """What a plan and a fit state of the scene, the set giving of its light what is asked."""

    def run(given: str) -> tuple[dict[str, Any], dict[str, Any]]:
        scene, folder = tmp_path / "scene.toml", tmp_path / "set"
        scene.write_text(SCENE.replace("irradiance = 2.0 }]", f'irradiance = 2.0 }}]\ngiven = "{given}"'))
        code, _, err = lightfactor("plan", scene, "-o", tmp_path / "plan", "--degree", 0)
        assert code == 0, err
        assert lightfactor("synth", scene, "-o", folder)[0] == 0
        manifest = folder / "photoset.toml"
        manifest.write_text(manifest.read_text().replace("unknown = true", "unknown = true\ndark = true"))
        code, _, err = lightfactor("process", folder, "-o", tmp_path / "result")
        assert code == 0, err
        return tuple(
            json.loads((tmp_path / name).read_text()) for name in ("plan/plan.json", "result/result.json")
        )

    return run


@pytest.mark.sweep
def test_a_near_lamp_of_unknown_light_is_planned_with_its_distance(stated: Any) -> None:
    plan, result = stated("nothing")
    planned = {entry["name"]: entry for entry in plan["quantities"]}
    (source,) = result["lighting"][0]["directional"]
    distance = planned["lamp/source 1 distance"]
    assert distance["truth"] == pytest.approx([0.12])
    # Both are bounds by the same noise; a fit of five photographs estimates that, and draws other samples.
    assert distance["std"] == pytest.approx([source["distance_std"]], rel=0.4)
    for name in ("mu", "sigma"):
        assert planned[name]["std"] == pytest.approx([result["brdf"][name]["std"]], rel=0.4), name


@pytest.mark.sweep
def test_a_near_lamp_that_is_given_is_planned_where_it_is(stated: Any) -> None:
    plan, result = stated("all")
    assert plan["notes"] == []
    planned = {entry["name"]: entry for entry in plan["quantities"]}
    for name in ("mu", "sigma"):
        assert planned[name]["std"] == pytest.approx([result["brdf"][name]["std"]], rel=0.4), name
