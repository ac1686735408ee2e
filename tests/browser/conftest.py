"""A real browser for tests of pages: Debian's Chromium, drawing on the processor."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect, sync_playwright

from tests.invrender.faultysets import write_set

_NAMES = ("chromium", "chromium-browser", "google-chrome")
_OPTIONS = (
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--no-first-run",
    # Pages are put together on the processor at once, not by a graphics card that the processor imitates: that takes
    # twice the processor's time and more. Only WebGL is drawn by that card.
    "--disable-gpu-compositing",
)
# Milliseconds that tests wait for what a page should show: other tests share the cores.
expect.set_options(timeout=60_000)


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """The browser; skips where there is none, fails where continuous integration promises one."""
    found = next(filter(None, map(shutil.which, _NAMES)), None)
    if found is None:
        message = f"no browser: install one of {', '.join(_NAMES)} to test pages"
        if os.environ.get("CI") == "true":
            pytest.fail(message)
        pytest.skip(message)
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=found, args=list(_OPTIONS))
        yield started
        started.close()


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    """A page of 1280 x 720 that fails the test on any error of its scripts."""
    opened = browser.new_page(viewport={"width": 1280, "height": 720})
    errors: list[str] = []
    opened.on("pageerror", lambda error: errors.append(str(error)))
    opened.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    yield opened
    opened.close()
    assert not errors


@pytest.fixture
def ball_copy(tmp_path: Path) -> Path:
    """Eight photographs of a ball under a lamp each, which a test may change."""
    return write_set(tmp_path / "set")


@pytest.fixture
def coarse_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages state how far live pictures are off from pictures of a sixteenth of the pixels."""
    monkeypatch.setattr("invrender.output.live.drawn._SIDE", 40)
