"""What tests of tasks share."""

from __future__ import annotations

from pathlib import Path

import pytest

from capture.tasks.store import TaskStore


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> TaskStore:
    """A store in a cache of its own, for the set in `tmp_path / "set"`."""
    monkeypatch.setenv("LIGHTFACTOR_CACHE", str(tmp_path / "cache"))
    manifest = tmp_path / "set" / "photoset.toml"
    found = TaskStore.of(manifest)
    found.prepare(manifest)
    return found
