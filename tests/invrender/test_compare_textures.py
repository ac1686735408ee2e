"""A textured result beside the truth: means over the part of the surface that the photographs determine."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from capture.files.imagefile import write_exr
from invrender.estimate.textured.layout import TexelLayout, VertexLayout, texel_layout
from invrender.output.compare.sides import read_side
from invrender.output.compare.textured import over_same_part
from invrender.output.compare.verdicts import number_rows
from recon.mesh.atlas import with_atlas
from recon.mesh.bodies import MeshBody
from recon.mesh.tessellated import tessellated
from recon.mesh.trianglemesh import read_mesh, write_mesh

from .renders import write_result

Command = Callable[..., tuple[int, str, str]]

# Rows of the true map, and texels along a side of the result's, which are larger.
TRUE_ROWS, SIDE = 64, 24
STD = 1e-3
GLOSS = [0.06, 0.05, 0.04]


def true_kd(height: np.ndarray) -> np.ndarray:
    """The paint's Kd (n, 3) at heights -1 to 1 on a unit sphere: linear, so that its means are known."""
    return (0.2 + 0.1 * height)[:, None] * np.array([1.0, 0.8, 0.5])


@pytest.fixture
def painted_set(tmp_path: Path) -> Path:
    """truth.json of a ball whose Kd rises with height, its mesh and its maps; no photographs."""
    folder = tmp_path / "set"
    (folder / "truth").mkdir(parents=True)
    write_mesh(folder / "object.obj", tessellated(np.zeros(3), 1.0, 48))
    # v is the polar angle from -Z over pi.
    height = np.cos((np.arange(TRUE_ROWS) + 0.5) * np.pi / TRUE_ROWS)
    rows = np.repeat(true_kd(height)[:, None], 2 * TRUE_ROWS, axis=1)
    write_exr(folder / "truth" / "texture_kd.exr", rows.astype(np.float32))
    write_exr(folder / "truth" / "texture_ks.exr", np.full_like(rows, GLOSS, np.float32))
    document = {
        "brdf": {
            "model": "microfacet",
            # As `synth` has it: means over the map, not over the surface.
            "kd": rows.mean(axis=(0, 1)).tolist(),
            "ks": GLOSS,
            "mu": 1.5,
            "sigma": 0.15,
            "kd_map": "truth/texture_kd.exr",
            "ks_map": "truth/texture_ks.exr",
        },
        "object": {"shape": "mesh", "mesh": "object.obj"},
        "lighting": [],
        "photos": [],
        "sensor": {},
    }
    (folder / "truth.json").write_text(json.dumps(document))
    return folder


def write_textured(folder: Path, painted_set: Path, kind: str, least_height: float) -> Path:
    """A right result of the painted ball that determines what is above a height. kind : where its textures lie."""
    mesh = read_mesh(painted_set / "object.obj")
    table: dict[str, Any] = {"kd": "texture_kd.exr", "kd_std": None, "at": "texels"}
    layout: TexelLayout | VertexLayout
    if kind == "vertices":
        layout, table["at"] = VertexLayout(MeshBody(mesh)), "vertices"
    else:
        mesh = with_atlas(mesh) if kind == "atlas" else mesh
        table["mesh"] = "textured.obj" if kind == "atlas" else None
        found = texel_layout(MeshBody(mesh), SIDE)
        assert isinstance(found, TexelLayout)
        layout = found
    height = layout.points.positions[:, 2]
    known = height > least_height
    areas = layout.areas[known]
    # Of the zone above a height, by Archimedes, whatever the map's texels.
    mean = true_kd(np.array([(1 + height[known].min()) / 2]))[0]
    assert np.average(true_kd(height[known]), axis=0, weights=areas) == pytest.approx(mean, rel=0.03)

    def quantity(value: Any) -> dict[str, Any]:
        return {"value": value, "std": (STD * np.ones_like(value)).tolist(), "status": "determined"}

    brdf = {
        "model": "microfacet",
        "kd": quantity(np.average(true_kd(height[known]), axis=0, weights=areas).tolist()),
        "ks": quantity(GLOSS),
        "mu": quantity(1.5),
        "sigma": quantity(0.15),
        "normalised": {"kd": None, "ks": None},
        "covariance": {"names": [], "values": []},
    }
    table["known"] = float(areas.sum() / layout.areas.sum())
    write_result(folder, brdf=brdf, texture=table)
    image = layout.image(np.where(known[:, None], true_kd(height), 0))
    write_exr(folder / "texture_kd.exr", image, layers={"A": layout.image(known.astype(float))})
    if kind == "atlas":
        write_mesh(folder / "textured.obj", mesh)
    return folder


@pytest.mark.parametrize("kind", ["own", "atlas", "vertices"])
def test_a_textured_result_is_held_against_the_truth_of_the_part_it_determines(
    painted_set: Path, tmp_path: Path, kind: str
) -> None:
    result = read_side(write_textured(tmp_path / "result", painted_set, kind, 0.2))
    for pair in ((result, truth := read_side(painted_set / "truth.json")), (truth, result)):
        matched = over_same_part(*pair)
        rows = number_rows(matched.first, matched.second, matched.unlike)
        # A right result: what is left is how finely the zone's edge is drawn, 1.5% of Kd at most for 24 rows.
        assert [row.agrees for row in rows] == [True] * 8
        # Over all of the surface the truth's Kd is a third lower: 60 deviations of red.
        whole = number_rows(*pair)
        assert max(abs(row.z or 0) for row in whole) > 30


def test_a_wrong_textured_result_still_differs(painted_set: Path, tmp_path: Path) -> None:
    folder = write_textured(tmp_path / "result", painted_set, "own", 0.2)
    document = json.loads((folder / "result.json").read_text())
    document["brdf"]["kd"]["value"][0] += 8 * STD
    (folder / "result.json").write_text(json.dumps(document))
    matched = over_same_part(read_side(folder), read_side(painted_set / "truth.json"))
    rows = {row.label: row for row in number_rows(matched.first, matched.second, matched.unlike)}
    assert rows["Kd red (1/sr)"].verdict == "differ"
    assert rows["Kd green (1/sr)"].verdict == "agree"


def test_means_over_different_parts_are_not_judged(
    lightfactor: Command, painted_set: Path, tmp_path: Path
) -> None:
    first = write_textured(tmp_path / "first", painted_set, "own", 0.2)
    second = write_textured(tmp_path / "second", painted_set, "own", -0.5)
    code, out, err = lightfactor("compare", first, second)
    assert (code, err) == (0, "")
    # Kd and Ks of three channels stay out of it; both results are right, and Kd differs by many deviations.
    assert "All 2 numbers agree" in out
    assert "Kd and Ks are not judged: A and B determine different parts" in out
    code, out, _ = lightfactor("compare", first, write_textured(tmp_path / "same", painted_set, "own", 0.2))
    assert "All 8 numbers agree" in out
    (painted_set / "truth" / "texture_kd.exr").unlink()
    code, out, err = lightfactor("compare", first, painted_set / "truth.json")
    assert (code, err) == (0, "")
    assert "not judged" in out
    assert "texture_kd.exr is missing" in out


def test_one_brdf_for_a_painted_object_is_not_held_against_the_paints_mean(
    painted_set: Path, tmp_path: Path
) -> None:
    folder = write_textured(tmp_path / "result", painted_set, "own", 0.2)
    whole = replace(read_side(folder), textures=None)
    matched = over_same_part(whole, read_side(painted_set / "truth.json"))
    assert matched.unlike
    judged = [row.label for row in number_rows(whole, matched.second, matched.unlike) if row.z is not None]
    assert judged == ["mu", "sigma (rad)"]
