"""Poses of all photographs of a textured object at once, its Kd and Ks solved for anew as they move.

A photograph has put a part of itself into the texture that predicts it, and so seems to be where it is. Points of the
surface are therefore followed through the photographs: what these show of one follows from its Kd and its Ks, the same
in all of them, whatever the texture has there. These are eliminated from the equations of the poses [variable
projection, Golub and Pereyra 1973, "The differentiation of pseudo-inverses and nonlinear least squares problems whose
variables separate"], and Gauss-Newton steps move all poses together. Outlines of masks and the prior have their say as
they have for a single photograph (`photometric`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from capture.parallel import parallel_map
from capture.progress import Track, silent
from invrender.estimate.evidence import relative_rms
from invrender.estimate.linear import symmetric_pinv
from invrender.estimate.noise import photo_weights
from invrender.refine.blocks import block_equations
from invrender.refine.photometric import RefinedPose
from invrender.refine.rim import SilhouetteRim
from invrender.refine.surface_tracking import Followed

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_STEPS, _HALVINGS = 10, 3
# A step this small against what a pose may be off is the last.
_SMALL = 0.01
# A point that photographs other than one determine by less than this share says nothing of that one's pose.
_LEAST_OTHERS = 1e-3


@dataclass(frozen=True, eq=False)
class _Rows:
    """Points in photographs, those of all photographs one after the other.

    point : (n,), from 0 to `count` less one; photo : (n,). diffuse : (n, 3). trust : (n, 1).
    """

    photos: Sequence[Followed]
    point: Ints
    count: int
    photo: Ints
    diffuse: Floats
    trust: Floats

    @classmethod
    def of(cls, photos: Sequence[Followed]) -> _Rows:
        numbers, point = np.unique(np.concatenate([own.points for own in photos]), return_inverse=True)
        return cls(
            photos,
            point,
            len(numbers),
            np.repeat(np.arange(len(photos)), [len(own.points) for own in photos]),
            np.concatenate([own.diffuse for own in photos]),
            np.concatenate([own.trust for own in photos])[:, None],
        )

    def added(self, values: Floats) -> Floats:
        """Sums (count, 3) over the rows of each point of values (n, 3)."""
        return np.stack([np.bincount(self.point, channel, self.count) for channel in values.T], axis=1)

    def weight(self, radiance: Floats, seen: NDArray[np.bool_]) -> Floats:
        """Weights (n, 3) by the noise of a radiance (n, 3) that is observed; 0 of rows not `seen`, (n,)."""
        found = np.zeros_like(radiance)
        for k, own in enumerate(self.photos):
            mine = (self.photo == k) & seen
            found[mine] = self.trust[mine] / own.target.noise.variance(np.maximum(radiance[mine], 0))
        return found

    def of_others(self, weight: Floats, gradient: Floats) -> Floats:
        """Gradients of each row's radiance, (n, 3, 2), as the point's rows in other photographs have them.

        A photograph's own gradient has its noise, and poses would be drawn to where that is smaller.
        """
        own = (weight * self.diffuse)[..., None] * gradient
        total = np.stack([self.added(way)[self.point] for way in own.transpose(2, 0, 1)], axis=-1)
        heavy = weight * self.diffuse**2
        others = self.added(heavy)[self.point] - heavy
        known = others > _LEAST_OTHERS * heavy
        share = np.where(known, self.diffuse / np.where(known, others, 1), 0)
        return np.asarray(share[..., None] * (total - own))


@dataclass(frozen=True, eq=False)
class _PointReflectance:
    """What changes of the points' Kd and Ks explain of the rows: two functions of them, orthogonal under the weights.

    columns : (2, n, 3); a row's sum of squares over them, times its weight, is how much of it goes into its point.
    """

    rows: _Rows
    weight: Floats
    columns: Floats

    @classmethod
    def under(cls, rows: _Rows, weight: Floats, specular: Floats) -> _PointReflectance:
        """Of rows of weights (n, 3) that show Ks = 1 as they do, (n, 3)."""
        d, s, firmness = rows.diffuse, specular, rows.photos[0].lobe.firmness
        dd, ds, ss = (rows.added(weight * one * other)[rows.point] for one, other in ((d, d), (d, s), (s, s)))
        dd = np.maximum(dd, 1e-300)
        rest = np.maximum(ss + firmness - ds**2 / dd, 1e-300)
        return cls(rows, weight, np.stack([d / np.sqrt(dd), (s - d * ds / dd) / np.sqrt(rest)]))

    @property
    def leverage(self) -> Floats:
        """How much of each row goes into its point's Kd and Ks, (n, 3), 0 to 1."""
        return np.asarray(self.weight * (self.columns**2).sum(axis=0))

    def less(self, values: Floats) -> Floats:
        """Of values (n, 3), what no change of Kd and Ks explains."""
        rows = self.rows
        explained = [
            column * rows.added(self.weight * column * values)[rows.point] for column in self.columns
        ]
        return np.asarray(values - np.sum(explained, axis=0))

    def lost(self, slopes: Floats) -> Floats:
        """What of the information (6 p, 6 p) of slopes (n, 3, 6) on the poses is lost to Kd and Ks."""
        rows, size = self.rows, 6 * len(self.rows.photos)
        places = (np.repeat(rows.point, 6), (6 * rows.photo[:, None] + np.arange(6)).ravel())
        lost = np.zeros((size, size))
        for column in self.weight * self.columns:
            for channel in range(3):
                values = column[:, channel, None] * slopes[:, channel]
                shared = csr_array((values.ravel(), places), shape=(rows.count, size))
                lost += (shared.T @ shared).toarray()
        return lost


@dataclass(frozen=True, eq=False)
class _View:
    """The rows at some poses, (p, 6).

    observed, specular : (n, 3), blocks : (n,), as of `Shown`. off : (n, 3), what a surface of the mean Ks alone shows,
    less observed; slopes : (n, 3, 6), by how much a change of the pose lowers it. What isn't seen any more is zero, and
    not `seen`, (n,). rims : one a photograph.
    """

    change: Floats
    seen: NDArray[np.bool_]
    observed: Floats
    specular: Floats
    off: Floats
    slopes: Floats
    blocks: Ints
    rims: Sequence[SilhouetteRim | None]


@dataclass(frozen=True, eq=False)
class _Step:
    """A step (p, 6) from a view, the information (6 p, 6 p) on the poses, and by what views are compared.

    weight : (n, 3) of the rows. rims : of each photograph, the standard deviation of its rim, pixels, and how many of
    its points count as one. errors : (p,), relative RMS of what it shows of points against what all do.
    """

    step: Floats
    information: Floats
    weight: Floats
    rims: Sequence[tuple[float, float]]
    errors: Floats

    def deviance(self, rows: _Rows, view: _View) -> float:
        """Of rows, rims and prior; rows that are lacking have the others' mean."""
        weight = self.weight * view.seen[:, None]
        left = weight * _PointReflectance.under(rows, weight, view.specular).less(view.off) ** 2
        lacking = (self.weight > 0).sum() / max(int((weight > 0).sum()), 1)
        rims = sum(
            rim.deviance(std) / together
            for rim, (std, together) in zip(view.rims, self.rims, strict=True)
            if rim is not None
        )
        return float(left.sum() * lacking + rims + (view.change**2).sum())


def refine_together(photos: Sequence[Followed], start: Floats, track: Track = silent) -> list[RefinedPose]:
    """Changes (6,) of the poses of all photographs, in units, from a start (p, 6) on."""
    rows = _Rows.of(photos)
    change, begun = start, []
    # From afar the picture as it was predicted leads there, nearby what the other photographs show leads further.
    for from_afar in track((True, False), "Refining poses together"):
        change, first, last = _descended(rows, change, from_afar)
        begun.append(first)
    covariance = np.asarray(np.linalg.inv(last.information), float)
    return [
        RefinedPose(
            change[k],
            covariance[_own(k), _own(k)],
            len(own.points),
            float(begun[0].errors[k]),
            float(last.errors[k]),
        )
        for k, own in enumerate(photos)
    ]


def _descended(rows: _Rows, start: Floats, from_afar: bool) -> tuple[Floats, _Step, _Step]:
    """Where Gauss-Newton steps end, (p, 6), and the first and the last of them; from_afar : as of `_viewed`."""
    view = _viewed(rows, start, from_afar)
    first = judge = _step(rows, view)
    # Not `capture.gaussnewton`: a trial renders all photographs, and halvings cost less than rising damping.
    for _ in range(_STEPS):
        now = judge.deviance(rows, view)
        for halvings in range(_HALVINGS + 1):
            there = _viewed(rows, view.change + judge.step / 2**halvings, from_afar)
            if judge.deviance(rows, there) < now:
                break
        else:
            break
        moved = np.abs(there.change - view.change).max()
        view = there
        judge = _step(rows, view)
        if moved < _SMALL:
            break
    return view.change, first, judge


def _own(photo: int) -> slice:
    """Where a photograph's six numbers are among those of all."""
    return slice(6 * photo, 6 * photo + 6)


def _viewed(rows: _Rows, change: Floats, from_afar: bool) -> _View:
    """The rows after a change; from_afar : slopes are those of the predicted pictures, not of the other photographs."""
    shown = list(parallel_map(lambda k: rows.photos[k].shown(change[k]), range(len(change))))
    observed = np.concatenate([its.radiance for its in shown])
    specular = np.concatenate([its.specular for its in shown])
    off = rows.photos[0].lobe.ks * specular - observed
    seen = np.isfinite(off).all(axis=1)
    if from_afar:
        gradient = np.concatenate([own.expected for own in rows.photos])
    else:
        gradient = np.concatenate([its.gradient for its in shown])
        usable = seen & np.isfinite(gradient).all(axis=(1, 2))
        gradient = rows.of_others(rows.weight(observed, usable), np.where(usable[:, None, None], gradient, 0))
    seen &= np.isfinite(gradient).all(axis=(1, 2))
    slopes = np.einsum("ncw,nwj->ncj", gradient, np.concatenate([its.moves for its in shown]))
    slopes = slopes - np.concatenate([its.highlight for its in shown])
    rims = [own.target.rim(its) for own, its in zip(rows.photos, change, strict=True)]
    return _View(
        change,
        seen,
        np.where(seen[:, None], observed, 0),
        specular,
        np.where(seen[:, None], off, 0),
        np.where(seen[:, None, None], slopes, 0),
        np.concatenate([its.blocks for its in shown]),
        rims,
    )


def _step(rows: _Rows, view: _View) -> _Step:
    """The Gauss-Newton step from a view: Kd and Ks eliminated, rims and prior added."""
    weight, left = _weighed(rows, view)
    for k in range(len(rows.photos)):
        mine = rows.photo == k
        slopes = view.slopes[mine].reshape(-1, 6)
        blocks = np.repeat(view.blocks[mine], 3)
        weight[mine] /= block_equations(blocks, weight[mine].ravel(), slopes, left[mine].ravel()).together
    # What is left must be what no Kd and Ks explain under the very weights that it pulls with.
    eliminated = _PointReflectance.under(rows, weight, view.specular)
    left = eliminated.less(view.off)
    size = view.change.size
    pixels, others = -eliminated.lost(view.slopes), np.eye(size)
    gradient, pull = np.zeros(size), -view.change.ravel()
    rims, errors = [], np.full(len(rows.photos), np.nan)
    for k, (own, rim) in enumerate(zip(rows.photos, view.rims, strict=True)):
        mine = rows.photo == k
        slopes, heavy = view.slopes[mine].reshape(-1, 6), weight[mine].ravel()
        pixels[_own(k), _own(k)] += (slopes * heavy[:, None]).T @ slopes
        gradient[_own(k)] = slopes.T @ (heavy * left[mine].ravel())
        used = mine & (weight > 0).all(axis=1)
        if used.any():
            errors[k] = relative_rms(left[used], view.observed[used])
        if rim is None:
            rims.append((np.inf, 1.0))
            continue
        outline = rim.equations(own.target.motion(view.change[k], rim.points), rim.std)
        others[_own(k), _own(k)] += outline.information
        pull[_own(k)] += outline.pull
        rims.append((rim.std, outline.together))
    # What turns have in common moves the texture along, all but: small mismatches would seem to say much of it.
    shared = _shared_turns(rows)
    moved = pixels @ shared
    share = moved @ symmetric_pinv(shared.T @ moved)
    information = pixels - share @ moved.T + others
    step = np.asarray(np.linalg.solve(information, gradient - share @ (shared.T @ gradient) + pull), float)
    return _Step(step.reshape(view.change.shape), information, weight, rims, errors)


def _shared_turns(rows: _Rows) -> Floats:
    """Turns of all photographs by as much about each axis of the world, (6 p, 3), in units."""
    own = [
        np.vstack([photo.target.camera.world_to_camera[:3, :3], np.zeros((3, 3))])
        / photo.target.units[:, None]
        for photo in rows.photos
    ]
    return np.concatenate(own)


def _weighed(rows: _Rows, view: _View) -> tuple[Floats, Floats]:
    """Weights (n, 3) of the rows, and what is left of them, (n, 3), when each point has the Kd and Ks that suit it."""
    observed = np.maximum(view.observed, 0)
    weight = rows.weight(observed, view.seen)
    for _ in range(2):
        eliminated = _PointReflectance.under(rows, weight, view.specular)
        alone, left = 1 - eliminated.leverage, eliminated.less(view.off)
        predicted = observed + left
        use = view.seen & (alone > _LEAST_OTHERS).all(axis=1)
        weight = np.zeros_like(view.off)
        for k, own in enumerate(rows.photos):
            mine = (rows.photo == k) & use
            residual = left[mine] * np.sqrt(rows.trust[mine] / alone[mine])
            weight[mine] = (
                photo_weights(own.target.noise, predicted[mine], residual).weight * rows.trust[mine]
            )
    return weight, _PointReflectance.under(rows, weight, view.specular).less(view.off)
