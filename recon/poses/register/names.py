"""Which photograph of a set a name in another program's file means."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from difflib import get_close_matches
from pathlib import PurePosixPath

# From strict to lenient: the path as it is, the file's name, the name without its ending, whatever its case.
_KEYS: tuple[Callable[[str], str], ...] = (
    lambda name: str(PurePosixPath(name.replace("\\", "/"))),
    lambda name: PurePosixPath(name.replace("\\", "/")).name,
    lambda name: _stem(name),
    lambda name: _stem(name).lower(),
)
# Endings of images; of "photo.001" the number is no ending.
_ENDINGS = {
    *(".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr", ".hdr", ".bmp", ".webp"),
    *(".dng", ".nef", ".cr2", ".cr3", ".arw", ".raf", ".orf", ".rw2", ".pef", ".crw", ".kdc"),
}


def match_names(photos: Sequence[str], others: Sequence[str], source: str) -> list[int | None]:
    """For each photograph of the manifest the place of its entry in another program's file, None where it has none.

    photos, others : files as either writes them; folders, endings and letters' case may differ where that leaves no
    doubt. source : the other file, for messages. ValueError where an entry could be two photographs, or none agrees.
    """
    found: list[int | None] = [None] * len(photos)
    for key in _KEYS:
        left = [place for place, entry in enumerate(found) if entry is None]
        free = [entry for entry in range(len(others)) if entry not in found]
        ours, theirs = [key(photos[place]) for place in left], [key(others[entry]) for entry in free]
        for name in dict.fromkeys(own for own in ours if own in theirs):
            places = [place for place, own in zip(left, ours, strict=True) if own == name]
            entries = [entry for entry, other in zip(free, theirs, strict=True) if other == name]
            if len(places) > 1 or len(entries) > 1:
                raise ValueError(
                    f"{source}: cannot decide which of {', '.join(others[entry] for entry in entries[:3])} is which of"
                    f" the manifest's {', '.join(photos[place] for place in places[:3])}; let names differ by more than"
                    " their folders or endings"
                )
            found[places[0]] = entries[0]
    if any(entry is not None for entry in found):
        return found
    raise ValueError(
        f"{source}: none of its {len(others)} photos is one of the manifest's: it names {others[0]!r}, the manifest"
        f" {photos[0]!r}; give the file that belongs to this set"
    )


def missing_reason(photo: str, others: Sequence[str], source: str) -> str:
    """Why a photograph of the manifest has no entry in a file, with the name that may have been meant."""
    near = get_close_matches(_stem(photo), [_stem(other) for other in others], 1, 0.8)
    meant = [other for other in others if near and _stem(other) == near[0]]
    return f"not in {source}" + (f"; is it {meant[0]!r} there?" if meant else "")


def _stem(name: str) -> str:
    path = PurePosixPath(name.replace("\\", "/"))
    return path.stem if path.suffix.lower() in _ENDINGS else path.name
