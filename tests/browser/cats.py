"""A small cat whose mesh lies elsewhere, and the picks by the mouse that place it."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
from playwright.sync_api import Page, expect
from scipy.spatial.transform import Rotation

from capture.photoset import load_photoset
from recon.mesh.bodies import MeshBody
from recon.mesh.shape import placed
from recon.mesh.simplified import simplified
from recon.mesh.trianglemesh import read_mesh, write_mesh
from synthetic.scenes.build import read_staging
from synthetic.writer import write_photoset

_FACES = 3000
_SCENE = """format = 1
name = "small cat"
[object]
shape = "cat"
[material]
model = "lambertian"
kd = 0.2
[[lighting]]
name = "lamp"
directional = [{ azimuth_deg = 25, elevation_deg = 35, irradiance = 2.0 }]
[camera]
width = 160
height = 120
focal_px = 527
[[view]]
azimuth_deg = -30
elevation_deg = 15
lighting = "lamp"
[[view]]
azimuth_deg = 40
elevation_deg = 25
lighting = "lamp"
[[view]]
azimuth_deg = 90
elevation_deg = 20
lighting = "lamp"
"""


def write_cat(folder: Path) -> Path:
    """A set of the built-in cat, 160 x 120, under a lamp, with a mesh of few faces: what is made of it comes fast."""
    folder.mkdir()
    (folder / "staged.toml").write_text(_SCENE)
    write_photoset(read_staging(folder / "staged.toml"), folder)
    write_mesh(folder / "object.obj", simplified(read_mesh(folder / "object.obj"), _FACES))
    return folder


def displaced(folder: Path) -> np.ndarray:
    """Put the mesh elsewhere in its file, without a word of it in the manifest; where it belongs, (4, 4)."""
    manifest = folder / "photoset.toml"
    text, count = re.subn(r"mesh_to_world = .*", 'align = "picks.csv"', manifest.read_text())
    assert count == 1
    manifest.write_text(text)
    truth = np.eye(4)
    truth[:3, :3] = Rotation.from_euler("xyz", [20, -35, 50], degrees=True).as_matrix()
    truth[:3, 3] = [0.01, -0.02, 0.03]
    mesh = read_mesh(folder / "object.obj")
    write_mesh(folder / "object.obj", placed(mesh, np.linalg.inv(truth)))
    return truth


def points_to_pick(folder: Path, truth: np.ndarray) -> list[tuple[int, np.ndarray, np.ndarray, np.ndarray]]:
    """Three points in each of two photographs: photograph, vertex of the mesh, its normal, its pixel."""
    photoset = load_photoset(folder, find_alignment=True)
    mesh = read_mesh(folder / "object.obj")
    world = placed(mesh, truth)
    body, found = MeshBody(world), []
    for number in (0, 1):
        camera = photoset.photos[number].camera
        views = camera.views(world.vertices)
        facing = ((world.normals * views).sum(axis=1) > 0.8) & body.visible(
            world.vertices, world.normals, views
        )
        # They are clicked on the mesh along their normals.
        facing &= body.visible(world.vertices, world.normals, world.normals) & (
            np.abs(mesh.normals[:, 2]) < 0.9
        )
        # Far apart: the lowest, the highest, and the one farthest to a side.
        shown = np.flatnonzero(facing)
        pixels = camera.project(world.vertices[shown])
        for k in (pixels[:, 1].argmin(), pixels[:, 1].argmax(), pixels[:, 0].argmax()):
            found.append((number, mesh.vertices[shown[k]], mesh.normals[shown[k]], pixels[k]))
    return found


def pick_six(
    page: Page, folder: Path, truth: np.ndarray
) -> list[tuple[int, np.ndarray, np.ndarray, np.ndarray]]:
    """Picks six points in an open workbench, by the mouse; returns them, as `points_to_pick` does."""
    picks = points_to_pick(folder, truth)
    middle, reach = middle_and_reach(folder)
    page.get_by_role("tab", name="Pick").click()
    expect(page.locator("#pick-fit")).to_contain_text("0 points are picked")
    for count, (number, vertex, normal, pixel) in enumerate(picks, start=1):
        page.locator("#pick-photos button").nth(number).click()
        page.wait_for_timeout(150)
        box = page.locator("#pick-photo").bounding_box()
        assert box is not None
        # The picture fills its canvas along the shorter side.
        scale = min(box["width"] / 160, box["height"] / 120)
        page.mouse.click(
            box["x"] + box["width"] / 2 + scale * (pixel[0] - 80),
            box["y"] + box["height"] / 2 + scale * (pixel[1] - 60),
        )
        # The mesh is turned until the point faces us.
        azimuth = float(np.degrees(np.arctan2(normal[1], normal[0])))
        elevation = float(np.degrees(np.arcsin(np.clip(normal[2], -0.98, 0.98))))
        x, y = page.evaluate(
            """async ([azimuth, elevation, point]) => {
                const { viewed } = await import("/page/vectors.js");
                const { state, turned, subject } = window.lightfactorPicking;
                Object.assign(state, { azimuth, elevation });
                turned();
                const canvas = document.getElementById("pick-mesh");
                const m = viewed(subject().camera, state, canvas.width, canvas.height).matrix;
                const [x, y, z] = point, box = canvas.getBoundingClientRect();
                const at = [0, 1, 3].map((i) => m[i] * x + m[4 + i] * y + m[8 + i] * z + m[12 + i]);
                const right = (at[0] / at[2] + 1) / 2, down = (1 - at[1] / at[2]) / 2;
                return [box.left + right * box.width, box.top + down * box.height];
            }""",
            [azimuth, elevation, ((vertex - middle) / reach).tolist()],
        )
        page.mouse.click(x, y)
        expect(page.locator("#picks tr")).to_have_count(count + 1)
    return picks


def middle_and_reach(folder: Path) -> tuple[np.ndarray, float]:
    """The middle of a set's mesh and how far it reaches from there, in its file's unit."""
    vertices = read_mesh(folder / "object.obj").vertices
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    return middle, float(np.linalg.norm(vertices - middle, axis=1).max())


def align_by_picks(page: Page, folder: Path, truth: np.ndarray) -> None:
    """Aligns by what was picked, and finds the mesh where it belongs, to a degree and a fiftieth of its reach."""
    page.get_by_role("button", name="Align the mesh by these").click()
    expect(page.locator("#alignments > li")).to_contain_text("done")
    found = np.array(json.loads((folder / "alignment.json").read_text())["mesh_to_world"])
    assert np.linalg.norm(found[:3, 3] - truth[:3, 3]) < 0.02 * middle_and_reach(folder)[1]
    turn = np.degrees(np.arccos(np.clip((np.trace(found[:3, :3] @ truth[:3, :3].T) - 1) / 2, -1, 1)))
    assert turn < 1
    # What is wrong with the set is gone without loading the page again.
    expect(page.locator("#problem")).to_be_hidden()
