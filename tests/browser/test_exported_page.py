"""The page of `export --format html` in a real browser: its pixels are those of `render`."""

from __future__ import annotations

import base64
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Page

import lightfactor as lf
from invrender.output.export.html import ExportedPage, object_page
from invrender.output.live.drawn import LiveError
from invrender.output.live.scene import live_scene
from invrender.output.render import view as views
from invrender.result.saved_textures import SavedTextures
from recon.mesh.trianglemesh import TriangleMesh
from synthetic.shapes.doll import doll_mesh
from tests.invrender.livescenes import gloss, studio_of

_RADIANCE = """([change, width, height]) => {
    const { picture, state } = window.lightfactor;
    const bytes = new Uint8Array(picture.radiance({ ...state, ...change }, width, height).buffer);
    let text = "";
    for (let k = 0; k < bytes.length; k += 8192) text += String.fromCharCode(...bytes.subarray(k, k + 8192));
    return btoa(text);
}"""


def opened(page: Page, file: Path) -> list[str]:
    """Opens a page and waits for its picture; returns what it asked for, which is the file alone."""
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto(file.as_uri())
    page.wait_for_function("window.lightfactor")
    return asked


def radiance(page: Page, side: int, **change: Any) -> np.ndarray:
    """Radiance and coverage (side, side, 4) of the state with some changes."""
    text = page.evaluate(_RADIANCE, [change, side, side])
    return np.frombuffer(base64.b64decode(text), np.float32).reshape(side, side, 4)


def apart(found: np.ndarray, radiance: np.ndarray, coverage: np.ndarray) -> float:
    """Relative RMS over pixels that both cover whole."""
    whole = (found[..., 3] > 0.999) & (coverage >= 1)
    assert whole.sum() > 0.7 * (coverage > 0).sum()
    return float(np.sqrt(((found[..., :3] - radiance)[whole] ** 2).sum() / (radiance[whole] ** 2).sum()))


@pytest.fixture(scope="module")
def sphere(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ExportedPage]:
    """A glossy sphere's result and its page."""
    folder = tmp_path_factory.mktemp("sphere")
    gloss(folder / "result")
    with pytest.MonkeyPatch.context() as patch:
        # What it states of its pictures is measured on a quarter of the pixels.
        patch.setattr("invrender.output.live.drawn._SIDE", 80)
        return folder / "result", lf.export_page(folder / "result", folder / "page", view=(15, 35))


def test_a_sphere_looks_as_it_renders_under_its_light_turned_and_under_a_lamp(
    page: Page, sphere: tuple[Path, ExportedPage]
) -> None:
    folder, exported = sphere
    fit = lf.read_fit(folder)
    asked = opened(page, exported.files[0])
    assert asked == [exported.files[0].as_uri()]
    side, stated = 80, exported.error.worst
    for turn, azimuth, elevation in ((0, 15, 35), (50, -100, 10)):
        picture = fit.render((azimuth, elevation), size=(side, side), rotate_light=turn)
        found = radiance(page, side, turn=turn, azimuth=azimuth, elevation=elevation)
        # Bits of half floats come on top of what is stated.
        assert apart(found, picture.radiance, picture.coverage) < stated + 0.002
        np.testing.assert_allclose(found[..., 3], picture.coverage, atol=0.3)  # four samples of a pixel
    # A lamp of one's own: its irradiance is pi times the light's unit.
    unit = page.evaluate("window.lightfactor.picture.lights[0].unit")
    lamp = {"azimuth": 70, "elevation": 30, "strength": 0.5}
    both = fit.render(
        (15, 35), size=(side, side), light=folder / "lighting.exr", sources=[(70, 30, 0.5 * np.pi * unit)]
    )
    assert apart(radiance(page, side, lamps=[lamp]), both.radiance, both.coverage) < stated + 0.005
    alone = fit.render((15, 35), size=(side, side), sources=[(70, 30, 0.5 * np.pi * unit)])
    assert apart(radiance(page, side, lamps=[lamp], room=0), alone.radiance, alone.coverage) < 0.01


@pytest.mark.slow
def test_a_mesh_shadows_itself_as_it_does_when_rendered(
    page: Page, cat_mesh: TriangleMesh, tmp_path: Path
) -> None:
    studio, lighting = studio_of(gloss(tmp_path / "result"), cat_mesh)
    scene = live_scene(studio, [lighting])
    error = LiveError(0.02, 0.03)  # as `test_live` measures it
    (tmp_path / "cat.html").write_text(
        object_page(studio.result, scene, error, studio.notes), encoding="utf-8"
    )
    opened(page, tmp_path / "cat.html")
    side = 100
    optics = studio.optics((side, side))
    for turn, azimuth, elevation in ((0, 0, 20), (130, 200, 40)):
        picture = studio.take(studio.camera(views.View(azimuth, elevation, None), optics), turn)
        found = radiance(page, side, turn=turn, azimuth=azimuth, elevation=elevation)
        assert apart(found, picture.radiance, picture.coverage) < error.worst + 0.01


@pytest.mark.slow
def test_keys_and_fields_turn_object_light_and_lamp(page: Page, sphere: tuple[Path, ExportedPage]) -> None:
    page.set_viewport_size({"width": 900, "height": 400})
    opened(page, sphere[1].files[0])
    canvas = page.locator("canvas")
    canvas.focus()
    state = "window.lightfactor.state"
    before = page.screenshot()
    for keys in ("ArrowRight", "ArrowUp", "Shift+ArrowLeft", "Alt+ArrowUp"):
        page.keyboard.press(keys)
    after = page.evaluate(state)
    assert (after["azimuth"], after["elevation"], after["turn"]) == (20, 40, -5)
    assert after["lamps"] == [{"azimuth": 45, "elevation": 45, "strength": 1}]
    assert page.get_by_label("Lamp of my own").is_checked()
    page.wait_for_timeout(300)
    assert page.screenshot() != before
    page.get_by_label("Turn of the light").fill("120")
    assert page.evaluate(state)["turn"] == 120
    assert page.locator("output[for=turn]").inner_text() == "120°"
    page.mouse.move(180, 200)
    page.mouse.down()
    page.mouse.move(280, 200)
    page.mouse.up()
    assert page.evaluate(state)["azimuth"] == pytest.approx(20 - 40)
    page.mouse.move(182, 200)
    assert page.locator("#readout").inner_text().startswith("radiance ")
    page.keyboard.press("0")
    assert page.evaluate(state)["azimuth"] == 15


def test_a_slow_card_draws_fewer_pixels_while_the_picture_moves_and_all_when_it_rests(
    page: Page, sphere: tuple[Path, ExportedPage]
) -> None:
    page.set_viewport_size({"width": 900, "height": 400})
    opened(page, sphere[1].files[0])
    page.evaluate("""() => {
        const { picture } = window.lightfactor, draw = picture.draw.bind(picture);
        let start = 0;
        window.widths = [];
        window.early = 0;
        // A card that takes a tenth of a second, of which thirty would make three seconds.
        picture.busy = () => performance.now() - start < 100;
        picture.draw = (state) => {
            window.widths.push(picture.canvas.width);
            window.early += picture.busy();
            start = performance.now();
            draw(state);
        };
    }""")
    for _ in range(12):
        page.locator("canvas").press("ArrowRight")
        page.wait_for_timeout(50)
    whole = page.evaluate("window.lightfactor.picture.canvas.clientWidth")
    page.wait_for_function(f"window.lightfactor.picture.canvas.width === {whole}")
    widths = page.evaluate("window.widths")
    assert min(widths) <= 0.51 * whole
    # None is begun while the card draws another.
    assert page.evaluate("window.early") == 0


@pytest.mark.slow
def test_a_painted_doll_is_one_small_page(page: Page, tmp_path: Path) -> None:
    studio, lighting = studio_of(gloss(tmp_path / "result"), doll_mesh(0.003))
    # Paint with edges, as that of the synthetic doll, and a patch that no photograph shows.
    rows = np.broadcast_to(np.arange(256)[:, None], (256, 512))
    stripes = 0.5 + 0.4 * np.sign(np.sin(rows / 9))[..., None] * np.array([1.0, 0.6, -0.4])
    known = np.ones((256, 512))
    known[90:130, 200:280] = 0
    nothing = np.zeros((1, 1, 3))
    textures = SavedTextures(
        stripes * np.array([0.2, 0.15, 0.1]), np.full((1, 1, 3), 0.05), nothing, nothing, known
    )
    studio = replace(studio, material=replace(studio.material, textures=textures))
    scene = live_scene(studio, [lighting])
    error = LiveError(0.02, 0.02)
    text = object_page(studio.result, scene, error, studio.notes)
    assert len(text) < 10_000_000
    assert "Fill what the photographs left open" in text
    (tmp_path / "doll.html").write_text(text, encoding="utf-8")
    opened(page, tmp_path / "doll.html")
    side = 200
    picture = studio.take(studio.camera(views.View(30, 15, None), studio.optics((side, side))), 60)
    found = radiance(page, side, turn=60, azimuth=30, elevation=15)
    # Browsers take the mean over a texture's pixels in their own way: 1% on edges of paint.
    assert apart(found, picture.radiance, picture.coverage) < error.worst + 0.015
    filled = radiance(page, side, turn=60, azimuth=30, elevation=15, filled=True)
    assert (filled[..., 3] > 0.999).sum() > (found[..., 3] > 0.999).sum()
