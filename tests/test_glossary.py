"""The words of the documentation and of the code: each documented name exists, and former private words are gone."""

from __future__ import annotations

import ast
import importlib
import re

import pytest

from .sourcetrees import ROOT, outlines

# The field has terms for these: candidate, lighting design, scene geometry, specular share, outlier, transmittance.
FORMER = (
    *(
        "rung",
        "rungs",
        "sight",
        "specimen",
        "kappa",
        "strays",
        "nonsense",
        "hanging_together",
        "hang_together",
    ),
    *(
        "let_through",
        "lets_through",
        "paint",
        "painted",
        "told",
        "rivals",
        "antipodes",
        "lampcount",
        "lightframe",
    ),
    *("newlight", "many_pixels", "manypixels"),
)


def terms() -> list[str]:
    rows = re.findall(r"\| `([\w.]+)` \|$", (ROOT / "docs/glossary.md").read_text(), flags=re.MULTILINE)
    assert len(rows) > 50
    return sorted(set(rows))


@pytest.mark.parametrize("name", terms())
def test_every_term_lives_where_the_glossary_says(name: str) -> None:
    module, _, thing = name.rpartition(".")
    assert hasattr(importlib.import_module(module), thing)


def test_every_row_of_the_glossary_is_a_term_with_one_sentence() -> None:
    for row in re.findall(
        r"^\| (?!term|---)(.*) \|$", (ROOT / "docs/glossary.md").read_text(), flags=re.MULTILINE
    ):
        if row.startswith("---"):
            continue
        term, _, meaning, _ = (cell.strip() for cell in row.split("|"))
        assert term
        assert meaning.endswith("."), row
        assert len(meaning.split()) <= 25, row


def test_no_public_name_is_a_former_private_word() -> None:
    found = []
    for path, outline in outlines().items():
        if path.parts[0] == "synthetic":
            continue  # its doll is painted
        names = [part.removesuffix(".py") for part in path.parts]
        names += [name for name in (*outline.classes, *outline.functions) if not name.startswith("_")]
        for name in names:
            snake = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()
            padded = f"_{snake}_"
            found += [(str(path), name) for word in FORMER if f"_{word}_" in padded]
    assert not found


def test_the_architecture_names_types_that_exist() -> None:
    text = (ROOT / "docs/architecture.md").read_text()
    classes = {name for outline in outlines().values() for name in outline.classes}
    named = set(re.findall(r"`([A-Z]\w+[a-z]\w*)`", text))
    assert len(named) > 20
    assert not named - classes
    for module in re.findall(r"`((?:capture|recon|invrender|synthetic|lightfactor)(?:\.\w+)*)`", text):
        importlib.import_module(module)
    for file in re.findall(r"`((?:capture|recon|invrender|synthetic|lightfactor)/[\w/]+(?:\.py)?)`", text):
        assert (ROOT / file).exists(), file


def test_the_architecture_lists_packages_in_the_order_of_their_imports() -> None:
    text = (ROOT / "docs/architecture.md").read_text().split("## The way of the data")[0]
    listed = [
        name
        for row in re.findall(r"^\| (`.*?) \| ", text, flags=re.MULTILINE)
        for name in re.findall(r"`([\w.]+)`", row)
    ]
    assert len(listed) > 15

    def place(module: str) -> int | None:
        """Of the row whose package holds a module; None for commands and wording, which have none."""
        if ".commands" in module:
            return None
        holding = [name for name in listed if f"{module}.".startswith(f"{name}.")]
        return listed.index(max(holding, key=len)) if holding else None

    wrong = set()
    for path, outline in outlines().items():
        own = place(".".join(path.with_suffix("").parts))
        for node in outline.imports:
            if isinstance(node, ast.ImportFrom) and node.module and own is not None:
                target = place(node.module)
                if target is not None and target > own:
                    wrong.add((listed[own], listed[target]))
    assert not wrong
