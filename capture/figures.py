"""Texts in figures: names that photographers gave, in the font that matplotlib draws with."""

from __future__ import annotations


def printable(name: str) -> str:
    """A name with a box in place of each character that matplotlib's default font lacks, such as Chinese ones.

    Otherwise matplotlib warns of every one; drawn would be the same box. $ stays a $ and starts no formula.
    """
    from matplotlib import font_manager

    font = font_manager.get_font(font_manager.findfont(font_manager.FontProperties()))
    shown = "".join(letter if font.get_char_index(ord(letter)) else "\N{WHITE SQUARE}" for letter in name)
    return shown.replace("$", r"\$")


def short_name(name: str) -> str:
    """A name for an axis: printable, and of a long one its end, which distinguishes photographs."""
    return printable(name if len(name) <= 24 else f"...{name[-21:]}")
