"""What photographs show of texels, pixel by pixel: a pixel shows the mean over what it covers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack

from invrender.estimate.textured.texel_equations import TexelEquations, products

Singles = NDArray[np.float32]
Ints = NDArray[np.int64]

# Pixels' worth of coverage from which on a photograph counts as seeing a point.
_SEEN = 0.25


@dataclass(frozen=True, eq=False)
class PixelsOfPoints:
    """What a photograph says of n pixels: cover (n, points), as of `cover.cover`; the others (n, 3) float32.

    diffuse, specular : transfers. lit : (n,) float32, the largest channel of the diffuse one by the lighting itself,
    without what other parts of the object send. trust : how far pixels are trusted, (n, 1) or (n, 3). weight : trust
    over the variance of radiance; before `solve_joint` knows that, anything.
    """

    cover: csr_array
    diffuse: Singles
    specular: Singles
    lit: Singles
    radiance: Singles
    trust: Singles
    weight: Singles

    @classmethod
    def joined(cls, parts: Sequence[PixelsOfPoints]) -> PixelsOfPoints:
        """All pixels of one photograph, of parts of them."""
        if len(parts) == 1:
            return parts[0]
        cover = csr_array(vstack([part.cover for part in parts], format="csr"))
        others = [entry.name for entry in fields(cls) if entry.name != "cover"]
        return cls(cover, *(np.concatenate([getattr(part, name) for part in parts]) for name in others))

    def __len__(self) -> int:
        return len(self.radiance)

    def where(self, keep: NDArray[np.bool_]) -> PixelsOfPoints:
        """Some of the pixels."""
        return PixelsOfPoints(*(getattr(self, entry.name)[keep] for entry in fields(self)))

    def of_points(self, points: Ints) -> PixelsOfPoints:
        """The same of some of the points alone, in the order of their numbers (q,)."""
        return replace(self, cover=csr_array(self.cover[:, points]))

    @property
    def brightest(self) -> float:
        """The largest transfer, that of diffuse light being the lighting's own; 0 without pixels."""
        return float(max(self.lit.max(initial=0), self.specular.max(initial=0)))

    def predicted(self, values: Singles) -> Singles:
        """Radiance (n, 3) of points' values (points, 6), Kd then Ks."""
        seen = self.cover @ values
        return np.asarray(self.diffuse * seen[:, :3] + self.specular * seen[:, 3:])

    def pull(self, radiance: Singles) -> Singles:
        """Weighed radiance (n, 3) times either transfer, (n, 6); the cover's transpose deals it to the points."""
        weighed = self.weight * radiance
        return np.concatenate([weighed * self.diffuse, weighed * self.specular], axis=1)


def stacked(views: Sequence[PixelsOfPoints]) -> tuple[list[PixelsOfPoints], csr_array]:
    """The cover of all views' pixels, (n, points), and the views with its rows for theirs: they share its memory."""
    whole = csr_array(vstack([view.cover for view in views], format="csr"))
    ends = np.cumsum([0, *(len(view.radiance) for view in views)])
    parts = []
    for view, first, last in zip(views, ends[:-1], ends[1:], strict=True):
        starts = whole.indptr[first : last + 1]
        held = slice(starts[0], starts[-1])
        rows = (whole.data[held], whole.indices[held], starts - starts[0])
        parts.append(replace(view, cover=csr_array(rows, shape=view.cover.shape)))
    return parts, whole


def tiny_sums(views: Sequence[PixelsOfPoints], points: int, parents: Ints) -> TexelEquations:
    """Normal equations of each point, pixels being dealt to what they cover.

    parents : the point that each that is covered belongs to, -1 for none.
    """
    total = TexelEquations.zeros(points)
    # What belongs to no point goes to one more, which is left out.
    owners = np.where(parents >= 0, parents, points).astype(np.int32)
    for view in views:
        d, s, y, w = view.diffuse, view.specular, view.radiance, view.weight
        ones = np.ones((len(d), 1), np.float32)
        added = np.concatenate([products(d, s, y, w), ones], axis=1)
        rows = (view.cover.data, owners[view.cover.indices], view.cover.indptr)
        dealt = (csr_array(rows, shape=(len(d), points + 1)).T @ added)[:points]
        total = total + TexelEquations.of(dealt[:, :18], (dealt[:, 18] >= _SEEN).astype(float))
    return total
