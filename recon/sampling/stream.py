"""The samples of a whole set, photograph by photograph: memory is that of a few photographs, whatever their number."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.decode import decode_photo, photo_mask
from capture.parallel import parallel_map
from capture.photo import Photo
from capture.photoset import PhotoSet
from capture.radiometry import Radiometry
from capture.tasks.stage import stage_results
from recon.mesh.bodies import Body
from recon.sampling.draw import sample_body
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]
Mask = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class _Sampled:
    """Reads a photograph and draws its samples; the fields are as in `light_fields`, share being a photograph's."""

    radiometry: Radiometry
    body: Body
    sources: Mapping[str, Floats]
    share: int | None
    mask_of: Callable[[Photo], Mask | None]

    def __call__(self, numbered: tuple[int, Photo]) -> LightField:
        """The samples of a photograph and its number in the set."""
        index, photo = numbered
        image = decode_photo(self.radiometry, photo)
        # Seeded by place, so that neither order nor threads change what is drawn.
        rng = np.random.default_rng(index)
        directions = self.sources[photo.lighting]
        field = sample_body(self.body, photo.camera, image, self.mask_of(photo), directions, self.share, rng)
        return field.through(photo.polariser)


def light_fields(
    photoset: PhotoSet,
    body: Body,
    sources: Mapping[str, Floats],
    budget: int | None = None,
    mask_of: Callable[[Photo], Mask | None] = photo_mask,
) -> Iterator[LightField]:
    """Samples of each photograph of a set, in its order; one photograph per core is in memory, and one more.

    sources : per lighting, its sources, (k, 3) or (k, 4), whose visibility is computed. budget : samples of all
    photographs together, the same number from each as far as it has them; None for all usable pixels. mask_of : gives a
    photograph's mask (h, w) in 0 to 1, if it has one.
    """
    share = None if budget is None else -(-budget // len(photoset.photos))
    sampled = _Sampled(photoset.radiometry, body, sources, share, mask_of)
    # All pixels aren't kept: they are many times as large as the photographs.
    if share is None:
        return parallel_map(sampled, enumerate(photoset.photos))
    return stage_results("fields", sampled, enumerate(photoset.photos), lambda item: str(item[1].file))
