"""The modules of the project, parsed once for all tests that look at them."""

from __future__ import annotations

import ast
import gc
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("capture", "recon", "invrender", "synthetic", "lightfactor")
# Parts of a statement that hold statements.
_HOLDING = ("body", "orelse", "finalbody", "handlers", "cases")


@dataclass(frozen=True)
class Outline:
    """What a module defines and imports, wherever in it. own_classes : those that aren't within another definition."""

    classes: list[str] = field(default_factory=list)
    functions: list[str] = field(default_factory=list)
    own_classes: list[str] = field(default_factory=list)
    imports: list[ast.Import | ast.ImportFrom] = field(default_factory=list)


def _statements(holder: ast.AST) -> Iterator[ast.AST]:
    """All statements of a module, those within others too."""
    for part in _HOLDING:
        for each in getattr(holder, part, ()):
            yield each
            yield from _statements(each)


def _outline(text: str) -> Outline:
    tree, found = ast.parse(text), Outline()
    for node in _statements(tree):
        match node:
            case ast.ClassDef():
                found.classes.append(node.name)
            case ast.FunctionDef():
                found.functions.append(node.name)
            case ast.Import() | ast.ImportFrom():
                found.imports.append(node)
    found.own_classes.extend(node.name for node in tree.body if isinstance(node, ast.ClassDef))
    return found


@cache
def outlines() -> dict[Path, Outline]:
    """Every module, by its path in the repository; not where tests are collected, which every process does."""
    # Trees hold hundreds of thousands of objects: to look for circles among them takes longer than to parse.
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        return {
            path.relative_to(ROOT): _outline(path.read_text())
            for package in PACKAGES
            for path in (ROOT / package).rglob("*.py")
        }
    finally:
        if was_enabled:
            gc.enable()
