"""The house: packages import one way, a name has one meaning, and what computes doesn't know what prints."""

from __future__ import annotations

import ast
from collections import defaultdict
from functools import cache
from graphlib import TopologicalSorter

import pytest

from .sourcetrees import Outline, outlines


@cache
def modules() -> dict[str, Outline]:
    """Every module of ours, by its name."""
    return {
        ".".join(path.with_suffix("").parts).removesuffix(".__init__"): outline
        for path, outline in outlines().items()
    }


def imported(outline: Outline) -> set[str]:
    """Modules of ours that a module imports, wherever in it."""
    found = set()
    for node in outline.imports:
        if isinstance(node, ast.ImportFrom) and node.module:
            found |= {
                full if (full := f"{node.module}.{name.name}") in modules() else node.module
                for name in node.names
            }
        elif isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
    return {name for name in found if name in modules()}


def package(module: str) -> str:
    """The room of a module: a package of `invrender` or `recon`, or one of the others as a whole."""
    parts = module.split(".")
    return ".".join(parts[:2]) if parts[0] in ("invrender", "recon") else parts[0]


@cache
def imports() -> dict[str, set[str]]:
    """Modules of ours that each imports."""
    return {module: imported(outline) for module, outline in modules().items()}


def test_packages_import_one_way() -> None:
    rooms = defaultdict(set)
    for module, targets in imports().items():
        rooms[package(module)] |= {package(target) for target in targets} - {package(module)}
    assert len(rooms) > 20
    TopologicalSorter(rooms).prepare()  # CycleError names the circle


def test_modules_import_without_circles() -> None:
    # A package's own __init__ hands names on; who imports them goes through it.
    TopologicalSorter(
        {module: {target for target in targets if target != module} for module, targets in imports().items()}
    ).prepare()


@pytest.mark.parametrize(
    ("below", "above"),
    [
        ("capture", ("recon", "invrender", "synthetic", "lightfactor")),
        ("recon", ("invrender", "synthetic", "lightfactor")),
        ("synthetic", ("invrender", "lightfactor")),
        ("invrender.estimate", ("invrender.output", "invrender.commands", "invrender.process")),
        ("invrender.process", ("invrender.output", "invrender.commands")),
        ("invrender.theory", ("invrender.estimate", "invrender.transport")),
    ],
)
def test_what_is_below_does_not_know_what_is_above(below: str, above: tuple[str, ...]) -> None:
    wrong = [
        (module, target)
        for module, targets in imports().items()
        if module.startswith(below)
        for target in targets
        if target.startswith(above)
    ]
    assert not wrong


def test_only_the_program_imports_commands() -> None:
    wrong = [
        (module, target)
        for module, targets in imports().items()
        for target in targets
        if ".commands." in target and ".commands" not in module and module != "lightfactor.cli"
    ]
    assert not wrong


def test_a_public_class_is_defined_once() -> None:
    homes = defaultdict(list)
    for module, outline in modules().items():
        for name in outline.own_classes:
            if not name.startswith("_"):
                homes[name].append(module)
    assert len(homes) > 300
    assert not {name: modules for name, modules in homes.items() if len(modules) > 1}
