"""The page's modules as one script, for files that stand alone."""

from __future__ import annotations

import re
from functools import cache
from importlib.resources import files

_PAGE = files("invrender.output.live") / "page"
_IMPORT = re.compile(r'^import \{[^}]*\} from "\./(\w+)\.js";\n', re.MULTILINE)


@cache
def page_files() -> dict[str, str]:
    """The texts of the page's scripts and style, by name."""
    return {each.name: each.read_text(encoding="utf-8") for each in _PAGE.iterdir() if each.is_file()}


def bundled(entry: str) -> str:
    """A module of the page with all that it imports before it, each once; names are distinct across modules."""
    done: list[str] = []
    parts: list[str] = []

    def add(name: str) -> None:
        if name in done:
            return
        done.append(name)
        text = page_files()[f"{name}.js"]
        for needed in _IMPORT.findall(text):
            add(needed)
        parts.append(re.sub(r"^export ", "", _IMPORT.sub("", text), flags=re.MULTILINE))

    add(entry)
    return "\n".join(parts)
