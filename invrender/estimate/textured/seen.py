"""What photographs show of points of a surface, with all that its rows are made of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from capture.parallel import parallel_map
from invrender.brdf.form import LobeForm
from invrender.brdf.microfacet import Microfacet
from invrender.estimate.clusters import tile_of
from invrender.estimate.forms import together
from invrender.estimate.textured.observe import PointObservations
from invrender.estimate.textured.texel_observations import TexelRows
from invrender.transport.columns import columns_of_forms
from invrender.transport.predict import reflected
from invrender.transport.reflected import ReflectedMap
from invrender.transport.transfer import LightElement
from invrender.transport.visibility import Shadows
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int64]

# Pixels whose transfers are computed together: harmonics of a high degree take 10 kilobytes a pixel.
_PIXELS_AT_A_TIME = 20_000


@dataclass(frozen=True, eq=False)
class Seen:
    """What a photograph shows of points: the samples around them, and the light that it was under.

    bounced : (r, 3), radiance of the points by light from other parts of the object, which doesn't count; None for
    nothing.
    """

    lighting: str
    points: PointObservations
    pixels: LightField
    bounced: Floats | None = None

    @classmethod
    def of(cls, lighting: str, points: PointObservations, field: LightField) -> Seen:
        """With those samples only that are used."""
        used = points.of_samples(len(field))
        return cls(lighting, points.renumbered(used), field.where(used))

    def of_points(self, some: NDArray[np.bool_]) -> Seen:
        """Of the points that are marked."""
        marked = some[self.points.points]
        fewer = Seen.of(self.lighting, self.points.where(marked), self.pixels)
        return fewer if self.bounced is None else replace(fewer, bounced=self.bounced[marked])

    @property
    def radiance(self) -> Floats:
        """Radiance of the points, (r, 3), without what bounced."""
        shown = self.points.at_points(self.pixels.radiance)
        return shown if self.bounced is None else shown - self.bounced

    @property
    def brightness(self) -> Floats:
        """About the radiance as photographed, (r, 3), by which noise is judged."""
        return np.maximum(self.pixels.radiance[self.points.samples].mean(axis=1), 0)

    @property
    def share(self) -> Floats:
        """Variance (r,) of interpolated numbers over a pixel's, more where its geometry is trusted less."""
        return self.points.variance_share() / np.maximum(self.points.at_points(self.pixels.weight), 0.01)

    @property
    def tiles(self) -> Ints:
        """The tile of the photograph (r,) that each point is in, from 0."""
        return np.unique(tile_of(self.pixels)[self.points.samples[:, 0]], return_inverse=True)[1]


def rows_of(
    seen: Seen,
    elements: Mapping[str, Sequence[LightElement]],
    forms: Sequence[LobeForm],
    shadows: Shadows | None,
) -> dict[LobeForm, TexelRows]:
    """What a photograph says of points, as columns that hold neither mu nor sigma; forms as of `columns_of_forms`."""
    entries = columns_of_forms([seen.lighting], elements, [seen.pixels], forms, shadows)
    result = {}
    for form, (entry,) in entries.items():
        columns = np.stack([seen.points.at_points(channel) for channel in entry.columns[:, :, 0]])
        result[form] = TexelRows(
            seen.points.points,
            columns.astype(np.float32),
            seen.radiance,
            seen.brightness,
            seen.share,
            seen.tiles,
        )
    return result


def rows_in_forms(
    shown: Sequence[Seen],
    elements: Mapping[str, Sequence[LightElement]],
    forms: Sequence[LobeForm],
    shadows: Shadows | None,
) -> dict[LobeForm, list[TexelRows]]:
    """`rows_of` photographs, in forms of any kinds."""
    result: dict[LobeForm, list[TexelRows]] = {form: [] for form in forms}
    for group in together(forms):
        make = partial(rows_of, elements=elements, forms=group, shadows=shadows)
        for rows in parallel_map(make, shown):
            for form, own in rows.items():
                result[form].append(own)
    return result


def transfers_of(
    elements: Sequence[LightElement],
    field: LightField,
    brdf: Microfacet,
    shadows: Shadows | None,
    prepared: ReflectedMap | None = None,
) -> tuple[Singles, Singles]:
    """Diffuse and specular transfers (n, 3) of samples under a lighting: radiance of Kd = 1, and of Ks = 1.

    prepared : of the only element's map, in place of an integral for each ray.
    """
    strengths = np.ones((len(elements), 3))
    found = np.empty((2, len(field), 3), np.float32)
    for part in np.array_split(np.arange(len(field)), len(field) // _PIXELS_AT_A_TIME + 1):
        keep = np.zeros(len(field), bool)
        keep[part] = True
        some = field.where(keep)
        rays = reflected(brdf, elements, strengths, some, shadows, prepared)
        found[:, part] = [some.mean_over_rays(one) for one in rays]
    return found[0], found[1]
