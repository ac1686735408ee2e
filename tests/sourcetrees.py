"""The modules of the project, parsed once for all tests that look at them."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("capture", "recon", "invrender", "synthetic", "lightfactor")


@cache
def trees() -> dict[Path, ast.Module]:
    """Every module, by its path in the repository; not where tests are collected, which every process does."""
    return {
        path.relative_to(ROOT): ast.parse(path.read_text())
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
    }
