"""How what went wrong is said to users."""

from __future__ import annotations

from collections.abc import Iterable


def sentences(texts: Iterable[str]) -> list[str]:
    """Texts as they stand in errors, without capital and full stop, as sentences."""
    return [f"{text[0].upper()}{text[1:]}." for text in texts]
