"""A page that visits a workbench and leaves before its server ends: what it still asks for is no error then."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import Page

from tests.lightfactor.studios import Served, served


@contextmanager
def visited(page: Page, path: Path) -> Iterator[Served]:
    """The workbench of a path, opened in the page."""
    with served(path) as bench:
        page.goto(bench.address)
        try:
            yield bench
        finally:
            page.goto("about:blank")
