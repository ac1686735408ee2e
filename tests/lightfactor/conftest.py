"""A small set, and the workbench that serves it to one file of tests."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.invrender.faultysets import write_set

from .studios import Served, served


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_set(tmp_path_factory.mktemp("ball") / "set")


@pytest.fixture(scope="module")
def bench(ball: Path) -> Iterator[Served]:
    with served(ball) as found:
        yield found
