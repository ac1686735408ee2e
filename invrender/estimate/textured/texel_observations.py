"""What photographs say of a textured object's points, before any BRDF is known: rows of their tiny linear problems."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import LobeForm
from invrender.estimate.noise import NoiseModel
from invrender.estimate.textured.texel_equations import PointValues, TexelEquations
from invrender.transport.columns import column_weights

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
# mu and sigma, as far as a model has them.
Numbers = tuple[float | None, float | None]


@dataclass(frozen=True, eq=False)
class TexelRows:
    """What a photograph says of the points that it sees.

    points : (r,), each once. columns : (channels, r, q), as of `PhotoColumns`. radiance : (r, 3); brightness : (r, 3),
    about the same, by which noise is judged. share : (r,), the variance of these interpolated numbers over that of a
    pixel, divided by how far its geometry is trusted. tiles : (r,), from 0, the tile of the photograph that each is in.
    """

    points: Ints
    columns: NDArray[np.float32]
    radiance: Floats
    brightness: Floats
    share: Floats
    tiles: Ints


@dataclass(frozen=True, eq=False)
class TexelObservations:
    """The rows of all photographs together, sorted by point.

    form : of the columns. points : (p,), those seen, of `size` in all; starts : (p,), their first rows. at, photo,
    tiles : (r,), point, photograph and tile of each row. columns : (channels * r, q). radiance, weight : (r, 3).
    trust : (r, 3), as of `Weights`. share : as of `TexelRows`, (r, 1).
    """

    form: LobeForm
    size: int
    points: Ints
    starts: Ints
    at: Ints
    photo: Ints
    tiles: Ints
    columns: NDArray[np.float32]
    radiance: Floats
    weight: Floats
    trust: Floats
    share: Floats

    @classmethod
    def of(
        cls, photos: Sequence[TexelRows], size: int, noise: NoiseModel, form: LobeForm
    ) -> TexelObservations:
        photo = np.repeat(np.arange(len(photos)), [len(rows.points) for rows in photos])
        first = np.cumsum([0, *(rows.tiles.max(initial=-1) + 1 for rows in photos)])
        at = np.concatenate([rows.points for rows in photos])
        order = np.argsort(at, kind="stable")
        columns = np.concatenate([rows.columns for rows in photos], axis=1)[:, order]
        brightness = np.concatenate([rows.brightness for rows in photos])[order]
        share = np.concatenate([rows.share for rows in photos])[order, None]
        tiles = np.concatenate([rows.tiles + start for rows, start in zip(photos, first, strict=False)])
        points, starts = np.unique(at[order], return_index=True)
        return cls(
            form=form,
            size=size,
            points=points,
            starts=starts,
            at=at[order],
            photo=photo[order],
            tiles=tiles[order],
            columns=columns.reshape(-1, columns.shape[2]),
            radiance=np.concatenate([rows.radiance for rows in photos])[order],
            weight=1 / (noise.variance(brightness) * share),
            trust=np.ones_like(brightness),
            share=share,
        )

    def transfers(self, numbers: Numbers) -> tuple[Floats, Floats]:
        """Diffuse and specular transfers (r, 3) at mu and sigma."""
        return self.transfers_at([numbers])[0]

    def transfers_at(self, places: Sequence[Numbers]) -> list[tuple[Floats, Floats]]:
        """`transfers` at several mu and sigma, in one pass over the columns."""
        if any(sigma is None for _, sigma in places):
            return [(self._lambertian, np.zeros_like(self._lambertian))] * len(places)
        return self._combined([self._weights(numbers) for numbers in places])

    def around(
        self, numbers: Numbers, ends: Sequence[tuple[Numbers, Numbers]], widths: Floats
    ) -> list[tuple[Floats, Floats]]:
        """`transfers`, then the slopes of both between pairs of mu and sigma that so much lies between."""
        slopes = [
            (self._weights(more) - self._weights(less)) / width
            for (less, more), width in zip(ends, widths, strict=True)
        ]
        return self._combined([self._weights(numbers), *slopes])

    def _weights(self, numbers: Numbers) -> Floats:
        mu, sigma = numbers
        assert sigma is not None
        return column_weights(mu, sigma, self.form)

    def _combined(self, weights: Sequence[Floats]) -> list[tuple[Floats, Floats]]:
        """Combinations of the columns with weights (q, 2) each, for the base and the lobe, (r, 3) each."""
        # Columns are read at the speed of memory: once for all.
        rows = np.stack(weights).transpose(0, 2, 1).astype(np.float32)
        values = (rows.reshape(-1, rows.shape[2]) @ self.columns.T).reshape(*rows.shape[:2], -1)
        return [(self._in_channels(base), self._in_channels(lobe)) for base, lobe in values]

    @cached_property
    def _lambertian(self) -> Floats:
        return self._in_channels(self.columns[:, 0])

    def _in_channels(self, values: NDArray[np.float32]) -> Floats:
        """Values (channels * r,) as (r, 3)."""
        rows = len(self.at)
        return np.broadcast_to(values.reshape(-1, rows).T, (rows, 3)).astype(float)

    def sums(self, numbers: Numbers) -> TexelEquations:
        """Normal equations of all points at mu and sigma."""
        return self.equations(*self.transfers(numbers))

    def equations(self, d: Floats, s: Floats, photo: int | None = None) -> TexelEquations:
        """Normal equations of all points by transfers (r, 3), of all photographs or of one."""
        if photo is not None:
            own = self.photo == photo
            return self._where(own)._equations(d[own], s[own])
        return self._equations(d, s, None if self.form.interface else self._of_lambertian)

    def _equations(
        self, d: Floats, s: Floats, base: tuple[Floats, Floats, Floats, Floats] | None = None
    ) -> TexelEquations:
        y, weighted = self.radiance, self.weight * s
        with_s = np.concatenate([weighted * d, weighted * s, weighted * y], axis=1)
        ds, ss, sy = np.split(self.added(with_s), 3, axis=1)
        dd, dy, yy, count = self._without_s(d) if base is None else base
        return TexelEquations(dd, ds, ss, dy, sy, yy, count)

    @cached_property
    def _of_lambertian(self) -> tuple[Floats, Floats, Floats, Floats]:
        return self._without_s(self._lambertian)

    def _without_s(self, d: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        y = self.radiance
        parts = [part * self.weight for part in (d * d, d * y, y * y)]
        dd, dy, yy, count = np.split(
            self.added(np.concatenate([*parts, np.ones((len(d), 1))], axis=1)), [3, 6, 9], axis=1
        )
        return dd, dy, yy, count[:, 0]

    def added(self, values: Floats) -> Floats:
        """Sums (size, k) over the rows of each point of values (r, k)."""
        total = np.zeros((self.size, values.shape[1]))
        if len(self.starts):
            total[self.points] = np.add.reduceat(values, self.starts)
        return total

    def _where(self, own: NDArray[np.bool_]) -> TexelObservations:
        """Some of the rows, without their columns."""
        points, starts = np.unique(self.at[own], return_index=True)
        return replace(
            self,
            points=points,
            starts=starts,
            at=self.at[own],
            photo=self.photo[own],
            tiles=self.tiles[own],
            columns=self.columns[:0],
            radiance=self.radiance[own],
            weight=self.weight[own],
            trust=self.trust[own],
            share=self.share[own],
        )

    def predicted(self, values: PointValues, numbers: Numbers) -> Floats:
        """Radiance (r, 3) of the rows, of points with given values."""
        d, s = self.transfers(numbers)
        return values.kd[self.at] * d + values.ks[self.at] * s
