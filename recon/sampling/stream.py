"""The samples of a whole set, photograph by photograph: memory is that of a few photographs, whatever their number."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from capture.decode import decode_photo, photo_mask
from capture.parallel import parallel_map
from capture.photoset import Photo, PhotoSet
from recon.mesh.bodies import Body
from recon.sampling.draw import sample_body
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]
Mask = NDArray[np.float32]


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

    def read(index: int) -> LightField:
        photo = photoset.photos[index]
        image = decode_photo(photoset.radiometry, photo)
        # Seeded by place, so that neither order nor threads change what is drawn.
        rng = np.random.default_rng(index)
        return sample_body(body, photo.camera, image, mask_of(photo), sources[photo.lighting], share, rng)

    return parallel_map(read, range(len(photoset.photos)))
