"""The scenes that come along, by name."""

from __future__ import annotations

import difflib
from pathlib import Path

_LIBRARY = Path(__file__).with_name("library")


def scene_names() -> tuple[str, ...]:
    """Names of all built-in scenes."""
    return tuple(sorted(path.stem for path in _LIBRARY.glob("*.toml")))


def scene_path(name: str) -> Path:
    """The scene file of a name, or the file itself if that is what `name` is; ValueError if it is neither."""
    path = Path(name)
    # A built-in scene's name is that, even where a photo set of that name lies in the working folder.
    if name in scene_names():
        return _LIBRARY / f"{name}.toml"
    if path.suffix == ".toml" or path.is_file():
        return path
    near = difflib.get_close_matches(name, scene_names(), n=1, cutoff=0.5)
    hint = f"did you mean {near[0]!r}?" if near else "`lightfactor synth --list` shows them"
    raise ValueError(f"{name!r} is no built-in scene and no scene file (NAME.toml); {hint}")
