"""What charts and tables share: colours that all eyes tell apart, marks that tell without colour, and captions."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from textwrap import fill

from matplotlib.figure import Figure

# Okabe and Ito's.
BLUE, ORANGE, GREEN, PINK, YELLOW, SKY = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"
GREY = "#666666"
COLOURS = (BLUE, ORANGE, GREEN, PINK, YELLOW, SKY)
MARKS = ("o", "s", "^", "D", "v", "P")

_CAPTION_LETTERS_PER_INCH = 16


def save(figure: Figure, path: Path, caption: str) -> None:
    """Write a figure with the machine, versions and settings below it."""
    width = int(_CAPTION_LETTERS_PER_INCH * figure.get_figwidth())
    figure.supxlabel(fill(caption, width), fontsize=6, color=GREY, x=0.01, ha="left")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def write_table(path: Path, lines: Iterable[str], caption: str) -> None:
    """Write a page of Markdown with the machine, versions and settings at its end."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join([*lines, f"\nMeasured on {caption}."]) + "\n", encoding="utf-8")
