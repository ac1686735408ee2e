"""What is known of a set's light beside its photographs, to hold recovered light against; no fit sees it."""

from __future__ import annotations

from dataclasses import dataclass

from capture.lighting import Lighting
from capture.photoset import PhotoSet
from invrender.result.truth import TRUTH_NAME, truth_side
from recon.lighting import read_lighting


@dataclass(frozen=True, eq=False)
class GivenLight:
    """A light that is known. given_by : the name of the file that gives it."""

    lighting: Lighting
    given_by: str


def given_lights(photoset: PhotoSet) -> dict[str, GivenLight]:
    """The known lights of a set by the names that its photographs have for them.

    From the manifest where it knows all of a light, and that is distant, else from a truth.json beside it. ValueError
    where either is unreadable.
    """
    names = list(dict.fromkeys(photo.lighting for photo in photoset.photos))
    found = {}
    path = photoset.folder / TRUTH_NAME
    if path.is_file():
        true = {entry.lighting.name: entry for entry in truth_side(path).lightings}
        for name in names:
            entry = true.get(name, next(iter(true.values())) if len(true) == len(names) == 1 else None)
            if entry is not None and entry.lighting.closeness is None:
                found[name] = GivenLight(entry.lighting, TRUTH_NAME)
    for table in photoset.lightings:
        if table.name in names and not table.unknown and not table.recover and not table.near:
            lighting = read_lighting(photoset, table)
            if not lighting.recovers:
                found[table.name] = GivenLight(lighting, photoset.manifest.name)
    return found
