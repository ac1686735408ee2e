"""Masks drawn in the browser are the ones that the program reads."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from playwright.sync_api import Browser, Page, expect

from capture.decode import photo_mask
from capture.photoset import load_photoset
from tests.browser.visits import visited
from tests.invrender.faultysets import SIZE, change_manifest

Place = tuple[float, float]


def opened(page: Page) -> Callable[[float, float], Place]:
    """Waits for the first photograph; returns where its pixels lie on the page."""
    expect(page.locator("#photo-facts")).to_contain_text("68 x 68 pixels")
    box = page.locator("#photo").bounding_box()
    assert box is not None
    scale = min(box["width"], box["height"]) / SIZE
    left, top = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    return lambda u, v: (left + scale * (u - SIZE / 2), top + scale * (v - SIZE / 2))


def saved(page: Page, folder: Path) -> NDArray[np.float32]:
    """Saves the mask and reads it as fits do."""
    page.get_by_role("button", name="Save the mask").click()
    expect(page.locator("#mask-said")).to_contain_text("Saved as")
    expect(page.get_by_role("button", name="Discard")).to_be_disabled()
    mask = photo_mask(load_photoset(folder).photos[0])
    assert mask is not None
    return mask


def square(first: int, last: int) -> NDArray[np.bool_]:
    """Pixels (h, w) of a square between two edges."""
    found = np.zeros((SIZE, SIZE), np.bool_)
    found[first:last, first:last] = True
    return found


def test_a_polygon_becomes_the_mask_and_a_stroke_takes_some_of_it_away(page: Page, ball_copy: Path) -> None:
    change_manifest(ball_copy, r'mask = "000_mask.png"\n', lambda _: "")
    with visited(page, ball_copy):
        at = opened(page)
        expect(page.locator("#photo-facts")).to_contain_text("none")
        page.get_by_role("radio", name="Polygon").check()
        expect(page.locator("#mask-hint")).to_contain_text("There is no mask yet")
        # About the sphere: the page says where a mask lies elsewhere.
        for corner in ((7, 7), (61, 7), (61, 61)):
            page.mouse.click(*at(*corner))
        page.mouse.dblclick(*at(7, 61))
        found = saved(page, ball_copy)
        np.testing.assert_array_equal(found[square(8, 60)], 1)
        np.testing.assert_array_equal(found[~square(6, 62)], 0)
        # The page has read the set anew: the mask is one of its facts.
        expect(page.locator("#photo-facts")).to_contain_text(
            f"{100 * (found > 0.5).mean():.1f}% of the picture"
        )
        # Rows 30 to 38 go. So do 20 to 28, which is undone, as is a corner.
        page.get_by_role("radio", name="Brush").check()
        page.get_by_label("Take away").check()
        page.locator("#brush-size").fill("8")
        for row in (34, 24):
            page.mouse.move(*at(2, row))
            page.mouse.down()
            page.mouse.move(*at(66, row), steps=4)
            page.mouse.up()
        page.get_by_role("button", name="Undo").click()
        page.get_by_role("radio", name="Polygon").check()
        page.mouse.click(*at(30, 30))
        expect(page.get_by_role("button", name="Save the mask")).to_be_disabled()
        page.locator("#photo").press("Backspace")
        rest = saved(page, ball_copy)
        np.testing.assert_array_equal(rest[31:37], 0)
        np.testing.assert_array_equal(rest[:29], found[:29])
        np.testing.assert_array_equal(rest[39:], found[39:])
    # The file that the manifest no longer named is left alone, and the first mask is kept when the second replaces it.
    assert {path.name for path in ball_copy.glob("000*_mask.png")} == {"000_mask.png", "000-2_mask.png"}
    assert [path.name for path in (ball_copy / ".studio" / "masks").iterdir()] == ["000-2_mask-1.png"]


@pytest.mark.slow
def test_a_mask_is_drawn_with_the_keyboard_alone_from_the_one_that_is_there(
    page: Page, ball_copy: Path
) -> None:
    before = photo_mask(load_photoset(ball_copy).photos[0])
    assert before is not None
    with visited(page, ball_copy):
        opened(page)
        page.get_by_role("radio", name="Polygon").focus()
        page.keyboard.press("Space")
        expect(page.locator("#mask-hint")).to_contain_text("Click corner by corner")
        page.get_by_label("Take away").focus()
        page.keyboard.press("Space")
        page.locator("#photo").focus()
        # The cross starts in the middle; a triangle out of the sphere, and corners that are dropped.
        page.keyboard.press("Shift+ArrowRight")
        page.keyboard.press("Space")
        page.keyboard.press("Escape")
        for _ in range(33):
            page.keyboard.press("Shift+ArrowUp")
        for keys in (
            ("Space",),
            ("Shift+ArrowRight",) * 33 + ("Space",),
            ("Shift+ArrowDown",) * 33 + ("Space", "Enter"),
        ):
            for key in keys:
                page.keyboard.press(key)
        expect(page.get_by_role("button", name="Discard")).to_be_enabled()
        # It stays while another photograph is looked at.
        page.locator("#photos button").nth(1).click()
        expect(page.locator("#photo-name")).to_have_text("001.exr")
        expect(page.get_by_role("button", name="Discard")).to_be_disabled()
        page.locator("#photos button").nth(0).click()
        expect(page.get_by_role("button", name="Discard")).to_be_enabled()
        after = saved(page, ball_copy)
    rows, columns = np.mgrid[:SIZE, :SIZE]
    taken = columns - 34 > rows + 3
    np.testing.assert_array_equal(after[taken & (rows > 1) & (columns < 66)], 0)
    kept = columns - 34 < rows - 3
    np.testing.assert_allclose(after[kept], before[kept], atol=1e-6)
    assert {0, 1} < set(np.unique(before[kept])), "partial cover is part of it"


@pytest.mark.slow
def test_a_draft_can_be_discarded_and_a_mask_that_is_empty_is_refused(
    browser: Browser, ball_copy: Path
) -> None:
    # Not the fixture's page: browsers report the answer that says what is wrong as an error.
    page = browser.new_page(viewport={"width": 1280, "height": 720})
    before = (ball_copy / "000_mask.png").read_bytes()
    with visited(page, ball_copy):
        at = opened(page)
        page.get_by_role("radio", name="Polygon").check()
        page.get_by_label("Take away").check()
        expect(page.locator("#mask-hint")).to_contain_text("Click corner by corner")
        for corner in ((0.5, 0.5), (67.5, 0.5), (67.5, 67.5), (0.5, 67.5)):
            page.mouse.click(*at(*corner))
        page.locator("#photo").press("Enter")
        page.get_by_role("button", name="Save the mask").click()
        expect(page.locator("#mask-said")).to_contain_text("000.exr: the mask that was sent is empty")
        page.get_by_role("button", name="Discard").click()
        expect(page.get_by_role("button", name="Save the mask")).to_be_disabled()
    page.close()
    assert (ball_copy / "000_mask.png").read_bytes() == before
