"""A newcomer's whole way on a mesh that lies elsewhere, without the command line: from picks to a page to mail."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Page, expect

import lightfactor as lf
from tests.browser.cats import align_by_picks, displaced, middle_and_reach, pick_six, write_cat
from tests.browser.test_exported_page import apart, opened, radiance
from tests.browser.test_workbench import SMALL, until
from tests.browser.visits import visited


@pytest.mark.slow
@pytest.mark.usefixtures("coarse_error")
def test_a_displaced_cat_is_picked_fitted_judged_planned_relit_and_mailed(page: Page, tmp_path: Path) -> None:
    cat = write_cat(tmp_path / "cat")
    truth = displaced(cat)
    with visited(page, cat) as bench:
        asked: list[str] = []
        page.on("request", lambda request: asked.append(request.url))
        # Nobody knows yet where the mesh is, and the page says so.
        expect(page.locator("#problem")).to_contain_text("has not been aligned yet")
        expect(page.locator("#cameras-said")).to_contain_text("has not been aligned yet")
        picks = pick_six(page, cat, truth)
        expect(page.locator("#pick-fit")).to_contain_text("They place the mesh to")
        rows = (cat / "picks.csv").read_text().splitlines()
        assert rows[0] == "photo,u,v,x,y,z"
        for row, (number, vertex, _, pixel) in zip(rows[1:], picks, strict=True):
            label, *numbers = row.split(",")
            assert label == f"{number:03d}.exr"
            # Mice click whole pixels of the screen, which are a quarter of the photograph's and of the mesh's edges.
            np.testing.assert_allclose([float(x) for x in numbers[:2]], pixel, atol=0.6)
            np.testing.assert_allclose(
                [float(x) for x in numbers[2:]], vertex, atol=0.02 * middle_and_reach(cat)[1]
            )
        align_by_picks(page, cat, truth)
        # A pick can be taken back.
        page.get_by_role("button", name="Remove pick 6").click()
        expect(page.locator("#picks tr")).to_have_count(6)
        assert len((cat / "picks.csv").read_text().splitlines()) == 6
        page.get_by_role("tab", name="Capture").click()
        page.get_by_label("Outline the object where it is placed").check()
        expect(page.locator("#checks-said")).to_contain_text("samples of it")
        page.get_by_role("tab", name="Fit").click()
        page.get_by_label("Pixels in the fit").fill("1000")
        page.get_by_role("button", name="Fit this set").click()
        expect(page.locator("#fits > li")).to_contain_text("done", timeout=240_000)
        expect(page.locator("#results article")).to_contain_text("Kd")
        page.get_by_role("tab", name="Judge").click()
        expect(page.locator("#judged button")).to_have_count(3)
        expect(page.locator("#judge-state")).to_have_text("")
        page.get_by_role("tab", name="Plan").click()
        page.get_by_role("button", name="Plan it").click()
        expect(page.locator("#plan-best")).to_contain_text("Best view: azimuth", timeout=240_000)
        page.get_by_label("a lamp more").check()
        expect(page.locator("#plan-best")).to_contain_text("Best lamp: azimuth")
        page.set_viewport_size(SMALL)
        page.get_by_role("tab", name="Relight").click()
        until(page, "!!window.lightfactor")
        expect(page.locator("#stated")).to_contain_text("Live pictures are off by", timeout=120_000)
        fit = lf.read_fit(cat / "fit-1")
        picture = fit.render((0, 20), size=(100, 100), rotate_light=30)
        # The page states how far it is off in the worst of some views; a percent more, as this is none of them.
        bound = 0.01 + 0.01 * float(
            page.locator("#stated").inner_text().split("worst of them by ")[1].split("%")[0]
        )
        found = radiance(page, 100, azimuth=0, elevation=20, zoom=1, turn=30)
        assert apart(found, picture.radiance, picture.coverage) < bound
        with page.expect_download(timeout=240_000) as saving:
            page.get_by_role("button", name="Save as a page to mail").click()
        assert saving.value.suggested_filename == "fit-1.html"
        saving.value.save_as(tmp_path / "cat.html")
        own = f"http://127.0.0.1:{bench.port}/"
        assert all(url.startswith((own, "blob:", "data:")) for url in asked)
    assert opened(page, tmp_path / "cat.html") == [(tmp_path / "cat.html").as_uri()]
    assert (
        apart(
            radiance(page, 100, azimuth=0, elevation=20, zoom=1, turn=30), picture.radiance, picture.coverage
        )
        < bound
    )
