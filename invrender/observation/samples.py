"""Photographs of an object to samples: decoded, masked, drawn, checked."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.decode import decode_photo
from capture.photo import Photo
from capture.photoset import PhotoSet
from capture.progress import Track
from capture.radiance import RadianceImage
from capture.radiometry import Radiometry
from capture.tasks.stage import stage_results
from invrender.observation.clock import Clock
from recon.mesh.bodies import Body
from recon.sampling.candidates import WHOLE, candidates, within_mask
from recon.sampling.draw import NO_SOURCES, Importance, sample_body, usable_among
from recon.sampling.find import FoundBody
from recon.sampling.lightfield import LightField, off_terminators

# Samples below which a photograph says too little, and that each has at least, however many share the budget.
_TOO_FEW, _FEWEST = 20, 20
# Pixels that are looked at together where all are: they take a kilobyte each.
_AT_A_TIME = 100_000
# Noise about black makes half of a dark photograph's numbers negative.
_MOSTLY_NEGATIVE = 0.6
# Relative difference up to which two radiances are one value of a file.
_SAME = 1e-6
# Share of the object's pixels that are saturated in a photograph, or grey in its mask well inside of the outline, from
# which a warning says so.
_CUT_OFF, _GREY = 0.001, 0.05


@dataclass(frozen=True, eq=False)
class PhotoSamples:
    """The samples of a photograph, and what is said of it as a whole.

    saturated : share of the object's pixels. grey : of those well inside of its mask's outline, the share that isn't
    wholly the object's. ceiling : (3,), the largest radiance where some is saturated. seconds : by package.
    """

    field: LightField
    saturated: float
    grey: float
    ceiling: NDArray[np.floating] | None
    seconds: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class PhotoReader:
    """Reads the photographs of a set: how they become radiance, the body that they show, and their masks."""

    radiometry: Radiometry
    body: Body
    mask_of: Callable[[Photo], NDArray[np.float32] | None]

    @classmethod
    def of(cls, photoset: PhotoSet, found: FoundBody) -> PhotoReader:
        return cls(photoset.radiometry, found.body, found.mask_of)

    def pixels_around(
        self,
        photo: Photo,
        squares: NDArray[np.int64],
        count: int,
        sources: NDArray[np.float64],
        rng: np.random.Generator,
        clock: Clock,
    ) -> tuple[LightField, NDArray[np.bool_]]:
        """The usable pixels among squares of four, and among others drawn at random.

        squares : (n, 2), row and column of each one's upper left pixel. count : about so many of those drawn turn out
        usable, or more. sources : (k, 3), at whose terminators no pixel is usable. Returns the samples, and which of
        them the draw has.
        """
        with clock.on("capture"):
            image = decode_photo(self.radiometry, photo)
        with clock.on("recon"), clock.on("visibility"):
            mask, width = self.mask_of(photo), photo.camera.width
            looked_at = candidates(self.body, photo.camera, image, mask, count, False, rng)
            drawn = looked_at.rows * width + looked_at.columns
            around = np.unique((squares @ [width, 1])[:, None] + [0, 1, width, width + 1])
            around = around[~image.saturated.ravel()[around]]
            if mask is not None:
                around = around[within_mask(mask, *np.divmod(around, width))]
            rows, columns = np.divmod(np.union1d(around, drawn), width)
            field = usable_among(self.body, photo.camera, image, mask, rows, columns, sources)
            field = off_terminators(field, sources).through(photo.polariser)
            check_usable(photo, image, field, mask)
        return field, np.isin(field.rows * width + field.columns, drawn)

    def pixels(
        self, photo: Photo, most: int, sources: NDArray[np.float64], clock: Clock
    ) -> Iterator[LightField]:
        """The usable pixels of a photograph, `most` of them, some at a time; sources as of `pixels_around`."""
        with clock.on("capture"):
            image = decode_photo(self.radiometry, photo)
        with clock.on("recon"):
            rng, mask = np.random.default_rng(0), self.mask_of(photo)
            looked_at = candidates(self.body, photo.camera, image, mask, None, False, rng)
            order = np.arange(len(looked_at.rows))
            if len(order) > most:
                rng.shuffle(order)
        for first in range(0, len(order), _AT_A_TIME):
            with clock.on("recon"), clock.on("visibility"):
                some = looked_at.where(np.sort(order[first : first + _AT_A_TIME]))
                field = usable_among(self.body, photo.camera, image, mask, some.rows, some.columns, sources)
                field = off_terminators(field, sources).through(photo.polariser)
                if len(field) > most:
                    field = field.where(rng.permutation(len(field)) < most)
            # Without masks some of them may be all beside the object.
            if len(field):
                yield field
            most -= len(field)
            if not most:
                return


@dataclass(frozen=True, eq=False)
class _Drawn:
    """Reads a photograph and draws its samples; the fields are as in `read_samples` and `sample_body`."""

    reader: PhotoReader
    sources: Mapping[str, NDArray[np.float64]]
    budget: int
    importance: Mapping[str, Importance]
    highlights: bool

    def __call__(self, numbered: tuple[int, Photo]) -> PhotoSamples:
        """The samples of a photograph and its number in the set."""
        index, photo = numbered
        clock = Clock()
        with clock.on("capture"):
            image = decode_photo(self.reader.radiometry, photo)
        with clock.on("recon"):
            mask = self.reader.mask_of(photo)
            directions = self.sources.get(photo.lighting, NO_SOURCES)
            # Seeded by place, so that neither order nor threads change what is drawn.
            rng = np.random.default_rng(index)
            informative = self.importance.get(photo.lighting)
            view = self.reader.body, photo.camera, image, mask, directions
            field = sample_body(*view, self.budget, rng, informative, self.highlights)
            field = off_terminators(field, directions).through(photo.polariser)
            check_usable(photo, image, field, mask, min(_TOO_FEW, self.budget // 2))
        saturated = float(image.saturated[_inside(image, mask)].mean())
        ceiling = image.radiance.max(axis=(0, 1)) if image.saturated.any() else None
        grey = 0.0 if mask is None else _grey_inside(mask)
        return PhotoSamples(field, saturated, grey, ceiling, clock.seconds)


def read_samples(
    photoset: PhotoSet,
    found: FoundBody,
    sources: Mapping[str, NDArray[np.float64]],
    samples: int,
    clock: Clock,
    track: Track,
    importance: Mapping[str, Importance] = MappingProxyType({}),
    highlights: bool = False,
) -> tuple[dict[str, LightField], list[str]]:
    """Samples of every photograph by its label, on all cores; and sentences on what was left out.

    sources : per lighting that has any, those (k, 3) or (k, 4) at whose terminators nothing is sampled. samples : about
    how many in all, evenly over the photographs that are fitted; each that is held out gets as many. importance : per
    lighting, how informative pixels are; of one without it samples are spread evenly. highlights : as of `sample_body`.
    """
    budget = max(samples // len(photoset.fitted), _FEWEST)
    drawn = _Drawn(PhotoReader.of(photoset, found), sources, budget, importance, highlights)
    work = stage_results("samples", drawn, enumerate(photoset.photos), lambda item: str(item[1].file))
    fields: dict[str, LightField] = {}
    cut_off: dict[str, float] = {}
    grey: dict[str, float] = {}
    ceilings = []
    for photo in track(photoset.photos, "Reading photographs"):
        read = next(work)
        fields[photo.label], cut_off[photo.label], grey[photo.label] = read.field, read.saturated, read.grey
        ceilings += [] if read.ceiling is None else [read.ceiling]
        clock.add(read.seconds)
    if ceilings and photoset.radiometry.exposure == "equal":
        fields = {label: _below(np.array(ceilings), field) for label, field in fields.items()}
    return fields, [*_saturation(_above(_CUT_OFF, cut_off)), *_grey_masks(_above(_GREY, grey))]


def _below(ceilings: NDArray[np.floating], field: LightField) -> LightField:
    """The samples that are at none of the values (k, 3) where photographs of equal exposure are cut off.

    A photograph in which few pixels are cut off doesn't show it itself.
    """
    at = np.abs(field.radiance[:, None] - ceilings) <= _SAME * np.abs(ceilings)
    free = ~at.any(axis=(1, 2))
    return field if free.all() else field.where(free)


def _above(limit: float, shares: Mapping[str, float]) -> dict[str, float]:
    return {label: share for label, share in shares.items() if share > limit}


def _saturation(shares: Mapping[str, float]) -> list[str]:
    if not shares:
        return []
    worst = max(shares, key=lambda label: shares[label])
    return [
        f"Saturated pixels are left out, in {len(shares)} photograph{'s' if len(shares) > 1 else ''}: up to"
        f" {shares[worst]:.1%} of the object ({worst}). Expose shorter, or export floats that are not cut off, so that"
        " highlights show their peaks."
    ]


def _grey_masks(shares: Mapping[str, float]) -> list[str]:
    if not shares:
        return []
    worst = max(shares, key=lambda label: shares[label])
    return [
        "Pixels that masks call only partly the object's are left out with their neighbours, well inside of its outline"
        f" too: up to {shares[worst]:.0%} of these ({worst}; {len(shares)} mask{'s' if len(shares) > 1 else ''})."
        " Masks must be white inside, of their largest value: is one noisy, or has it holes?"
    ]


def _grey_inside(coverage: NDArray[np.float32]) -> float:
    """Of the pixels that are two and more away from the outline, the share that isn't wholly the object's."""
    cross, square = (cv2.getStructuringElement(form, (3, 3)) for form in (cv2.MORPH_CROSS, cv2.MORPH_RECT))
    inner = cv2.dilate((coverage >= 0.5).astype(np.uint8), cross, iterations=2)
    for element in (cross, square):
        inner = cv2.erode(inner, element, iterations=2, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    seen = coverage[inner > 0]
    return float((seen < WHOLE).mean()) if len(seen) else 0.0


def _inside(image: RadianceImage, coverage: NDArray[np.float32] | None) -> NDArray[np.bool_]:
    return np.ones(image.saturated.shape, bool) if coverage is None else coverage >= 0.5


def check_usable(
    photo: Photo,
    image: RadianceImage,
    samples: LightField,
    coverage: NDArray[np.float32] | None,
    least: int = _TOO_FEW,
) -> None:
    """ValueError if a photograph says nothing: saturated, too small, negative, or black throughout the object.

    least : samples that it needs.
    """
    if image.saturated[_inside(image, coverage)].all():
        raise ValueError(
            f"{photo.file}: every pixel of the object is saturated; expose shorter, or leave it out"
        )
    if len(samples) < least:
        raise ValueError(
            f"{photo.file}: only {len(samples)} pixels of the object are usable (not saturated, not at its rim);"
            " the object must be larger in the image, or the exposure shorter"
        )
    negative = float((samples.radiance < 0).mean())
    if negative > _MOSTLY_NEGATIVE:
        raise ValueError(
            f"{photo.file}: {negative:.0%} of the object's radiances are negative, more than noise about black leaves;"
            " check the black level (is it subtracted twice?) and the mask"
        )
    if not samples.radiance.any():
        raise ValueError(f"{photo.file}: the object is black in every pixel; expose longer, or leave it out")
