"""The pictures of studio.md: the workbench on a photo set, in a headless browser.

    python docs/studio.py SET OUT [--browser CHROMIUM]

SET : a photo set with a result and its plan in it, as the workbench leaves it. Writes OUT/studio-capture.png and so
on, one for each tab.
Needs the extra `test`.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

_OPTIONS = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
_TABS = ("capture", "pick", "fit", "judge", "plan", "relight")


def main() -> None:
    """Serve the set, and take a picture of each tab."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("photoset", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--browser", default=shutil.which("chromium"))
    options = parser.parse_args()
    options.out.mkdir(exist_ok=True)
    program = [sys.executable, "-c", "from lightfactor.cli import main; main()"]
    command = [*program, "studio", str(options.photoset), "--no-browser"]
    with (
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server,
        ExitStack() as stack,
        sync_playwright() as playwright,
    ):
        stack.callback(server.terminate)
        assert server.stdout is not None
        address = re.search(r"http\S+", server.stdout.readline())
        assert address is not None
        browser = playwright.chromium.launch(executable_path=options.browser, args=list(_OPTIONS))
        page = browser.new_page(viewport={"width": 1280, "height": 720})
        started = time.monotonic()
        page.goto(address.group())
        page.locator("#photos button").first.wait_for()
        print(f"First paint after {time.monotonic() - started:.2f} s")
        for tab in _TABS:
            _picture(page, tab, options.out / f"studio-{tab}.png")
        browser.close()


def _picture(page: Page, tab: str, out: Path) -> None:
    button = page.locator(f"#tab-{tab}")
    if button.is_hidden() or button.is_disabled():
        return
    button.click()
    page.wait_for_load_state("networkidle")
    if tab == "capture":
        page.get_by_label("Outline the object where it is placed").check()
    if tab == "relight":
        page.get_by_text("Live pictures are off by").wait_for(timeout=120_000)
        page.get_by_text("exact", exact=True).wait_for(timeout=120_000)
    page.wait_for_timeout(1500)
    page.screenshot(path=out)
    print(out)
    regions = page.locator("#regions-summary")
    if tab == "fit" and regions.is_visible():
        regions.click()
        page.get_by_text("crosses are its lamps").wait_for()
        out = out.with_name("studio-lamps.png")
        page.screenshot(path=out, clip={"x": 0, "y": 100, "width": 1280, "height": 370})
        print(out)


if __name__ == "__main__":
    main()
