"""The workbench in a real browser: from photographs to a relit object, without the command line."""

from __future__ import annotations

import re
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect

import lightfactor as lf
from capture.files.imagefile import write_exr
from capture.lighting import latlong_directions
from capture.photoset import load_photoset
from capture.source_region import source_regions
from tests.browser.test_exported_page import apart, radiance
from tests.browser.visits import visited
from tests.invrender.faultysets import write_set
from tests.invrender.fewforms import few_forms_tried
from tests.lightfactor.studios import Served, served

# What looks at relit pictures has a small window: exact ones are computed as large as it shows them.
SMALL = {"width": 640, "height": 480}


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight photographs of a ball; what tests of this file fit lies with them."""
    return write_set(tmp_path_factory.mktemp("ball") / "set")


@pytest.fixture(scope="module")
def bench(ball: Path) -> Iterator[Served]:
    with served(ball) as found:
        yield found


def see_to_a_fit(ball: Path) -> None:
    """Fits the set where the newcomer's test hasn't done it before."""
    if not (ball / "fit-1").is_dir():
        with few_forms_tried():
            lf.process(ball, 1500).save(ball / "fit-1")


def until(page: Page, expression: str) -> None:
    """Waits for what scripts of the page can't be asked for: its policy lets no text be run."""
    end = time.monotonic() + 60
    while not page.evaluate(expression):
        assert time.monotonic() < end, expression
        page.wait_for_timeout(50)


@pytest.mark.usefixtures("coarse_error")
def test_a_newcomer_looks_fits_judges_and_relights(page: Page, bench: Served, ball: Path) -> None:
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto(bench.address)
    # Capture.
    expect(page.locator("#photos button")).to_have_count(8)
    expect(page.locator("#title")).to_have_text("faulty")
    expect(page.locator("#photo-facts")).to_contain_text("68 x 68 pixels")
    expect(page.get_by_role("tab", name="Judge")).to_be_disabled()
    page.locator("#photos button").nth(3).click()
    expect(page.locator("#photo-name")).to_have_text("003.exr")
    # Fit; the page is loaded again while it runs.
    page.get_by_role("tab", name="Fit").click()
    page.get_by_label("Pixels in the fit").fill("2000")
    page.get_by_role("button", name="Fit this set").click()
    expect(page.locator("#fits > li")).to_contain_text("running")
    # The ladder, as it climbs.
    expect(page.locator("#fits .ladder")).to_contain_text("lambertian: ")
    page.reload()
    page.get_by_role("tab", name="Fit").click()
    expect(page.locator("#fits > li")).to_contain_text("done")
    expect(page.locator("#results article")).to_contain_text("sigma (rad)")
    expect(page.locator("#results tr.chosen")).to_have_count(1)
    # Judge: the worst photograph first; the pixel under the pointer.
    page.get_by_role("tab", name="Judge").click()
    expect(page.locator("#judged button")).to_have_count(8)
    fit = lf.read_fit(ball / "fit-1")
    worst = max(fit.photos, key=lambda photo: photo.rms_relative)
    expect(page.locator("#judge-name")).to_have_text(worst.file)
    expect(page.locator("#judge-state")).to_have_text("")
    box = page.locator("#observed").bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    expect(page.locator("#probe")).to_contain_text("standard deviations of the noise")
    # Relight.
    page.set_viewport_size(SMALL)
    page.get_by_role("tab", name="Relight").click()
    until(page, "!!window.lightfactor")
    expect(page.locator("#stated")).to_contain_text("Live pictures are off by")
    picture = fit.render((0, 20), size=(100, 100), lighting=fit.lightings[0].name, rotate_light=30)
    found = radiance(page, 100, turn=30)
    # What is stated, and rounding: 0.1 to 0.2% of a sphere under lamps.
    assert apart(found, picture.radiance, picture.coverage) < 0.01
    expect(page.locator("#relight-state")).to_have_text("exact")
    assert page.locator("#still").is_visible()
    page.locator("#picture").focus()
    page.keyboard.press("ArrowRight")
    assert page.locator("#still").is_hidden()
    assert page.evaluate("window.lightfactor.state.azimuth") == 5
    # Another of the set's lamps, fetched when it is chosen.
    page.locator("#relight select").select_option("5")
    until(page, "window.lightfactor.state.light === 5")
    own = f"http://127.0.0.1:{bench.port}/"
    assert all(url.startswith((own, "blob:", "data:")) for url in asked)


@pytest.mark.usefixtures("coarse_error")
def test_the_exact_picture_is_the_one_that_is_rendered(page: Page, bench: Served, ball: Path) -> None:
    """Lamps of one's own are in it, and don't turn with the light."""
    see_to_a_fit(ball)
    page.set_viewport_size(SMALL)
    page.goto(bench.address)
    page.get_by_role("tab", name="Relight").click()
    until(page, "!!window.lightfactor")
    lamp = {"azimuth": 70, "elevation": 30, "strength": 0.5}
    live = radiance(page, 100, turn=40, room=0.5, lamps=[lamp])
    still = page.evaluate(
        """async ([change]) => {
            const { askedBytes } = await import("/page/asking.js");
            const { singles, unpacked } = await import("/page/packed.js");
            const state = { ...window.lightfactor.state, ...change }, id = document.getElementById("result").value;
            const body = JSON.stringify({ state, width: 100, height: 100 });
            const answer = await askedBytes(`/api/results/${id}/still`, { method: "POST", body });
            const { arrays, unit } = await unpacked(answer);
            const radiance = Array.from(singles(arrays.radiance.data), (value) => value * unit);
            return [radiance, Array.from(arrays.coverage.data)];
        }""",
        [{"turn": 40, "room": 0.5, "lamps": [lamp]}],
    )
    exact, coverage = np.array(still[0]).reshape(100, 100, 3), np.array(still[1]).reshape(100, 100)
    assert apart(live, exact, coverage) < 0.01
    # A lamp at 70 degrees that is turned back by the light's 40 would stand elsewhere: the picture is not symmetric.
    assert (
        apart(radiance(page, 100, turn=40, room=0.5, lamps=[lamp | {"azimuth": 110}]), exact, coverage) > 0.1
    )


@pytest.mark.sweep
def test_results_are_compared_and_relit_under_a_map_of_ones_own(
    page: Page, bench: Served, ball: Path, tmp_path: Path
) -> None:
    see_to_a_fit(ball)
    shutil.copytree(ball / "fit-1", ball / "another")
    # A red sky to the left of the azimuth that panoramas have in their middle, as one sees them.
    way = latlong_directions(32)[:, ::-1]
    sky = (1 + way[..., 1:2] + 0.5 * way[..., 2:]).clip(0) ** 2 * np.array([1.0, 0.3, 0.1])
    write_exr(tmp_path / "sky.exr", sky.astype(np.float32))
    page.goto(bench.address)
    page.get_by_label("Result", exact=True).select_option("fit-1")
    page.get_by_role("tab", name="Fit").click()
    expect(page.locator("#results article")).to_have_count(1)
    page.get_by_role("checkbox", name="another").check()
    expect(page.locator("#results article h2:first-child")).to_contain_text(["another: ", "fit-1: "])
    shutil.rmtree(ball / "another")
    page.get_by_role("tab", name="Relight").click()
    until(page, "!!window.lightfactor")
    page.get_by_label("Another light").set_input_files(tmp_path / "sky.exr")
    light = page.locator("#controls select[name=light]")
    expect(light.locator("option")).to_contain_text(["sky"])
    light.select_option("sky")
    until(page, "window.lightfactor.state.light === 8")
    expect(page.locator("#stated")).to_contain_text("Live pictures are off by")
    picture = lf.read_fit(ball / "fit-1").render(
        (0, 20), size=(100, 100), light=tmp_path / "sky.exr", panorama=True, rotate_light=30
    )
    assert apart(radiance(page, 100, turn=30), picture.radiance, picture.coverage) < 0.01


@pytest.mark.slow
def test_without_webgl_stills_are_shown(page: Page, bench: Served, ball: Path) -> None:
    see_to_a_fit(ball)
    page.add_init_script(
        "const own = HTMLCanvasElement.prototype.getContext;"
        "HTMLCanvasElement.prototype.getContext = function (kind, ...more) {"
        " return kind === 'webgl2' ? null : own.call(this, kind, ...more); };"
    )
    page.set_viewport_size(SMALL)
    page.goto(bench.address)
    page.get_by_role("tab", name="Relight").click()
    expect(page.locator("#relight-state")).to_have_text(
        "This browser has no WebGL2, which live pictures need. Stills take its place."
    )
    expect(page.locator("#still")).to_be_visible()
    page.locator("#picture").focus()
    page.keyboard.press("ArrowRight")
    expect(page.locator("#still")).to_be_hidden()
    expect(page.locator("#still")).to_be_visible()


def test_a_broken_photograph_does_not_look_like_the_one_before_it(browser: Browser, ball_copy: Path) -> None:
    # Not the fixture's page: browsers report the two answers that say what is wrong as errors.
    page, errors = browser.new_page(), []
    page.on("pageerror", lambda error: errors.append(error))
    whole = (ball_copy / "002.exr").read_bytes()
    (ball_copy / "002.exr").write_bytes(whole[: len(whole) // 2])
    drawn = "() => document.getElementById('photo').getContext('2d').getImageData(0, 0, 2000, 2000).data.some((x) => x)"
    with visited(page, ball_copy):
        expect(page.locator("#photo-facts")).to_contain_text("68 x 68 pixels")
        assert page.evaluate(drawn)
        page.locator("#photos button").nth(2).click()
        expect(page.locator("#photo-state")).to_contain_text("002.exr: cannot be decoded")
        assert not page.evaluate(drawn)
        expect(page.locator("#photos li").nth(2)).to_contain_text("broken")
        page.locator("#photos button").nth(3).click()
        expect(page.locator("#photo-facts")).to_contain_text("68 x 68 pixels")
        assert page.evaluate(drawn)
        page.get_by_role("tab", name="Fit").click()
        expect(page.locator("#compare")).to_be_hidden()
    page.close()
    assert not errors


def test_photographs_are_held_out_without_touching_the_rest_of_the_manifest(
    page: Page, bench: Served, ball: Path
) -> None:
    manifest = ball / "photoset.toml"
    before = manifest.read_text()
    page.goto(bench.address)
    page.locator("#photos button").nth(1).click()
    expect(page.locator("#photo-name")).to_have_text("001.exr")
    page.get_by_label("Hold it out of the fit").check()
    expect(page.locator("#photos button").nth(1)).to_contain_text("held out")
    expect(page.locator("#photo-name")).to_have_text("001.exr")
    changed = manifest.read_text()
    assert set(changed.splitlines()) - set(before.splitlines()) == {"held_out = true"}
    page.get_by_label("Hold it out of the fit").uncheck()
    expect(page.locator("#photos button").nth(1)).not_to_contain_text("held out")
    assert manifest.read_text() == before


def test_tabs_are_reached_by_keyboard_and_a_wrong_key_is_said(page: Page, bench: Served) -> None:
    page.goto(bench.address)
    expect(page.locator("#photos button")).to_have_count(8)
    page.get_by_role("tab", name="Capture").focus()
    page.keyboard.press("ArrowRight")
    expect(page.get_by_role("tab", name="Fit")).to_have_attribute("aria-selected", "true")
    expect(page.locator("#fit")).to_be_visible()
    for control in page.locator("input, select, button").all():
        name = control.evaluate("each => each.labels?.[0]?.textContent || each.ariaLabel || each.textContent")
        assert name.strip()


def test_without_the_key_the_page_says_what_to_do(browser, bench: Served) -> None:
    page = browser.new_page()
    page.goto(f"http://127.0.0.1:{bench.port}/")
    expect(page.locator("#problem")).to_contain_text("open the address that was printed")
    page.close()


def test_lamps_are_looked_for_where_a_person_marks_them(page: Page, ball_copy: Path) -> None:
    manifest = ball_copy / "photoset.toml"
    manifest.write_text(re.sub(r"directional = .*", "unknown = true\ndark = true", manifest.read_text()))
    with visited(page, ball_copy):
        page.get_by_role("tab", name="Fit").click()
        expect(page.locator("#regions-summary")).to_have_text("Where lamps may be: anywhere")
        page.locator("#regions-summary").click()
        expect(page.locator("#region-said")).to_contain_text("Nothing is known of this light yet")
        page.get_by_label("Light to mark regions of").select_option("lamp 4")
        # A click, and the keyboard: elevation 45 at azimuth 270, and 30 degrees from there.
        box = page.locator("#region-map").bounding_box()
        assert box is not None
        page.mouse.click(box["x"] + 0.75 * box["width"], box["y"] + 0.25 * box["height"])
        expect(page.locator("#regions-summary")).to_have_text("Where lamps may be: 1 region")
        for key in (*["ArrowRight"] * 6, "Space"):
            page.locator("#region-map").press(key)
        expect(page.locator("#regions-summary")).to_have_text("Where lamps may be: 2 regions")
        page.get_by_label("Region 2: radius, degrees").fill("7")
        page.get_by_label("Region 2: radius, degrees").press("Tab")
        until(page, "document.querySelectorAll('#region-list input')[5].value === '7'")
        page.get_by_role("button", name="Remove region 1").click()
        expect(page.locator("#regions-summary")).to_have_text("Where lamps may be: 1 region")
    ((name, region),) = source_regions(load_photoset(ball_copy).lightings).items()
    assert name == "lamp 4"
    away = np.radians(300)
    level = np.sqrt(0.5)
    # To a pixel of the page, 0.6 degrees.
    assert region.directions[0] @ [level * np.cos(away), level * np.sin(away), level] > np.cos(np.radians(1))
    assert np.degrees(region.radii) == pytest.approx([7])


def test_a_folder_of_photographs_becomes_a_set(page: Page, tmp_path: Path) -> None:
    folder = tmp_path / "photos"
    folder.mkdir()
    for name in ("a.png", "b.png"):
        cv2.imwrite(str(folder / name), np.full((40, 60, 3), 90, np.uint8))
    with visited(page, folder):
        expect(page.locator("#starter-photos")).to_have_text("2 photographs: a.png, b.png")
        expect(page.get_by_role("tab", name="Fit")).to_be_disabled()
        page.locator("#manifest select[name=light]").select_option("dark")
        page.get_by_role("button", name="Write photoset.toml").click()
        expect(page.locator("#photos button")).to_have_count(2)
        expect(page.locator("#problem")).to_contain_text("lightfactor register")
