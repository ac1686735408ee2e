"""What is open: a photo set, and the results that were made of it. All of it lies on disk; nothing is kept here."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from capture.photo import Photo
from capture.photoset import MANIFEST_NAME, PhotoSet, load_photoset
from invrender.result.saved import RESULT_NAME, SavedResult, read_result
from invrender.result.source_set import find_photoset
from lightfactor.studio.starter import photographs

# Beside a set's manifest: what the workbench keeps for itself, and may be deleted.
OWN_FOLDER = ".studio"


class UnknownIdError(ValueError):
    """An id that stands for nothing that is open."""


@dataclass(frozen=True)
class Opened:
    """A photo set's folder, one that may become a set, or a result without its set.

    folder : the set's, in which results are looked for and made; of a result without a set the one above it.
    manifest : of the set, or where it would be. problem : why there is no photo set, empty where there may be one.
    first : the result that was asked for, if it was one.
    """

    folder: Path
    manifest: Path | None
    problem: str = ""
    first: Path | None = None

    @cached_property
    def own(self) -> Path:
        """Where the workbench keeps what is its own."""
        place = self.folder / OWN_FOLDER
        place.mkdir(exist_ok=True)
        return place

    def photoset(self) -> PhotoSet:
        """The set as its manifest is now; ValueError says what is wrong with it."""
        if self.manifest is None:
            raise ValueError(self.problem or "there is no photo set")
        return load_photoset(self.manifest)

    def as_far_as_it_goes(self) -> tuple[PhotoSet | None, str]:
        """The set without what it lacks yet, poses or the mesh's place, and what is wrong with it, or ""."""
        try:
            return self.photoset(), ""
        except (ValueError, OSError) as error:
            problem = str(error)
        for missing in ({"find_alignment": True}, {"find_poses": True}):
            try:
                if self.manifest is not None:
                    return load_photoset(self.manifest, **missing), problem
            except (ValueError, OSError):
                continue
        return None, problem

    def _shown(self) -> PhotoSet:
        """The set as far as it goes; ValueError where there is none."""
        photoset, problem = self.as_far_as_it_goes()
        if photoset is None:
            raise ValueError(problem)
        return photoset

    def photo(self, key: str) -> tuple[PhotoSet, Photo]:
        """A photograph of the set by its id."""
        photoset = self._shown()
        for photo in photoset.photos:
            if key_of(photo.label) == key:
                return photoset, photo
        raise UnknownIdError(f"photo {key}: the set has none of this id; load the page again")

    def lighting(self, key: str) -> tuple[PhotoSet, int]:
        """The set, and which of its lightings has an id."""
        photoset = self._shown()
        for number, table in enumerate(photoset.lightings):
            if key_of(table.name) == key:
                return photoset, number
        raise UnknownIdError(f"light {key}: the set has none of this id; load the page again")

    def results(self) -> Iterator[Path]:
        """Folders of results, by name."""
        found = {path.parent for path in self.folder.glob(f"*/{RESULT_NAME}")}
        if self.first is not None:
            found.add(self.first)
        yield from sorted(found, key=lambda path: path.name)

    def result(self, key: str) -> SavedResult:
        """A result by its id; ValueError says what is wrong with it."""
        for path in self.results():
            if key_of(path.name) == key:
                return read_result(path)
        raise UnknownIdError(f"result {key}: there is none of this id; load the page again")


def open_path(path: Path) -> Opened:
    """What a path names: a set's folder or manifest, or a result; ValueError where it is none of these."""
    if not path.exists():
        raise ValueError(f"{path}: does not exist; give the folder of a photo set, or of a result")
    path = path.resolve()
    if path.name == RESULT_NAME or (path / RESULT_NAME).is_file():
        folder = path.parent if path.is_file() else path
        result = read_result(folder)
        photoset = find_photoset(result, None)
        if photoset is None:
            problem = f"the photo set that {result.path} was made from isn't beside it: open the set's folder instead"
            return Opened(folder.parent, None, problem, folder)
        return Opened(photoset.folder, photoset.manifest, first=folder)
    if path.is_file():
        return Opened(path.parent, path)
    if not (path / MANIFEST_NAME).is_file() and not photographs(path):
        raise ValueError(
            f"{path}: holds neither {MANIFEST_NAME} nor {RESULT_NAME}, nor photographs; docs/photosets.md says how to"
            " write one"
        )
    return Opened(path, path / MANIFEST_NAME)


def key_of(name: str) -> str:
    """The id that stands for a name: of what is open, and of nothing else."""
    return hashlib.sha256(name.encode()).hexdigest()[:16]
