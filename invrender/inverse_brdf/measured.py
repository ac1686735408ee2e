"""A BRDF that others measured, explained as photographs are: by the same models, chosen by the same evidence.

A pair of directions with its reflectance is a sample of a light field: a point whose normal is turned so that the
source stands where it always stands. Samples of one angle of incidence make up a photograph. What is then fitted,
chosen and stated is what `process` does under known light.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.files.documents import read_json
from capture.files.tables import Table
from capture.lighting import Lighting
from capture.progress import OnStep, unwatched
from capture.reflectance.cornell import read_cornell
from capture.reflectance.merl import read_merl
from capture.reflectance.samples import ReflectanceSamples
from invrender.brdf.microfacet import Microfacet
from invrender.estimate.evidence import Candidate, relative_rms
from invrender.estimate.explanation import explain
from invrender.estimate.solution import Solution, solution_of
from invrender.inverse_brdf.halfangles import directions
from invrender.inverse_brdf.table import bin_centres
from invrender.transport.centred_lobes import centred_microfacet
from invrender.transport.columns import photo_columns
from invrender.transport.predict import predict, predict_columns
from invrender.transport.transfer import light_elements
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# How the files are told: Cornell's text, MERL's binary, `brdf --method table`'s own.
SUFFIXES = (".brdf", ".binary", ".json")
_WHAT = "to be fitted, it must be a brdf.json of 'lightfactor brdf --method table'"
# Light or sensor nearer to the horizon than that says little, and divides by next to nothing.
_LEAST_COS = 0.05
# Angles of incidence that differ by less are one, radians; of more than so many, as many groups of equal size are made.
_SAME_ANGLE, _MOST_ANGLES = np.radians(0.5), 20
# Fewer samples than that determine no lobe.
_FEWEST = 50
# Share of a lobe's energy that its reflection map may leave out.
ENERGY_LEFT = 0.03
_SOURCE = np.array([0.0, 0.0, 1.0])
_LIGHT = Lighting("source", None, _SOURCE[None], np.ones((1, 3)))


@dataclass(frozen=True, eq=False)
class MeasuredFit:
    """What explains a measured BRDF.

    samples : those that were used. groups : for each angle of incidence which of them, (k,) int each. solution : the
    models, the chosen one, its numbers. predicted : (n, 3), 1/sr.
    """

    samples: ReflectanceSamples
    groups: tuple[NDArray[np.int64], ...]
    solution: Solution
    predicted: Floats

    @property
    def model(self) -> Candidate:
        """The chosen candidate."""
        return self.solution.model

    @cached_property
    def _left(self) -> tuple[Floats, Floats]:
        """What is left of each sample's reflected radiance under a distant light, and that, (n, 3)."""
        cos = self.samples.wi[:, 2:]
        return (self.samples.rgb - self.predicted) * cos, self.samples.rgb * cos

    @property
    def errors(self) -> Floats:
        """Relative RMS of radiance at each angle of incidence, (k,)."""
        left, radiance = self._left
        return np.array([relative_rms(left[group], radiance[group]) for group in self.groups])

    @property
    def unseen_errors(self) -> Floats:
        """The same, (k,), by fits without that angle: evidence leaves outliers out, which are added again."""
        left, radiance = self._left
        trusted = [
            relative_rms(left[group], radiance[group], weights.trust)
            for group, weights in zip(self.groups, self.solution.weights, strict=True)
        ]
        return np.sqrt(
            np.maximum(self.errors**2 + self.model.photo_errors**2 - np.square(trusted), self.errors**2)
        )

    @cached_property
    def orders(self) -> dict[str, tuple[int, int] | None]:
        """Orders F and P of each lobe's reflection map that hold all but `ENERGY_LEFT` of its energy [R02, sec. 5.5.1].

        None where a lobe is too narrow for maps.
        """
        found: dict[str, tuple[int, int] | None] = {}
        for lobe in centred_microfacet(self.solution.brdf, self.model.estimate.model.name).lobes:
            try:
                found[lobe.name] = lobe.orders(ENERGY_LEFT)
            except ValueError:
                found[lobe.name] = None
        return found

    def incidence_deg(self, group: NDArray[np.int64]) -> float:
        """The mean angle of incidence of a group, degrees."""
        return float(np.degrees(np.arccos(self.samples.wi[group, 2]).mean()))


def read_measured(path: Path) -> ReflectanceSamples:
    """A measured BRDF: `.brdf`, Cornell's text; `.binary`, MERL's; `.json`, the table that `brdf --method table` wrote.

    Raises ValueError for files of other kinds, and for those cut short.
    """
    if path.suffix == ".brdf":
        return read_cornell(path)
    if path.suffix == ".binary":
        return _of_table(read_merl(path))
    if path.suffix == ".json":
        table = read_json(path, _TableFile, ("method",), _WHAT, ("bins", "values"))
        if table.method != "table" or table.values is None or table.bins is None:
            raise ValueError(
                f"{path}: method is {table.method!r}; of our own files only tables can be fitted, as 'lightfactor"
                " brdf SET --method table' writes them"
            )
        values = np.array(table.values, float)
        if values.shape != (*table.bins, 3):
            raise ValueError(f"{path}: values has the shape {values.shape}; bins says {(*table.bins, 3)}")
        return _of_table(values)
    raise ValueError(f"{path}: is none of {', '.join(SUFFIXES)}; it must be a measured BRDF")


class _TableFile(Table):
    """What is read of brdf.json."""

    method: str
    bins: tuple[int, int, int] | None = None
    values: tuple[Any, ...] | None = None


def _of_table(values: Floats) -> ReflectanceSamples:
    """Samples of a table (n_h, n_d, n_p, 3), NaN where nothing was measured, at its bins' centres."""
    wi, wo = directions(bin_centres(values.shape[:3]))
    known = np.isfinite(values).all(axis=-1) & (np.minimum(wi[..., 2], wo[..., 2]) > 0)
    return ReflectanceSamples(wi[known], wo[known], values[known])


def fit_measured(
    samples: ReflectanceSamples,
    most: int | None = None,
    on_step: OnStep = unwatched,
) -> MeasuredFit:
    """The lobe, chosen by evidence, and its numbers, of a measured isotropic BRDF.

    most : so many samples at most are used, drawn evenly; all if None. Each model is judged by angles of incidence that
    it has not seen. `on_step` is called `explanation.EXPLANATION_STEPS` times at most. Raises ValueError for values
    that aren't finite or all without light, and where samples or angles of incidence are too few.
    """
    samples = _usable(samples, most)
    groups = _by_incidence(samples)
    if len(groups) < 2:
        raise ValueError(
            "all samples have one angle of incidence; a model can't be judged by what it has not seen: measure others"
        )
    elements = light_elements(_LIGHT)
    photos = [photo_columns(_LIGHT.name, elements, _as_light_field(samples, group)) for group in groups]
    known = explain(photos, [_LIGHT], on_step)
    solution = solution_of(known, [_LIGHT])
    predicted = np.empty_like(samples.rgb)
    for group, photo in zip(groups, known.photos, strict=True):
        predicted[group] = predict_columns(photo, solution.brdf, np.ones((1, 3))) / samples.wi[group, 2:]
    return MeasuredFit(samples, groups, solution, predicted)


def brdf_values(brdf: Microfacet, wi: Floats, wo: Floats) -> Floats:
    """The fitted BRDF (n, 3), 1/sr, at local directions (n, 3) above the surface."""
    samples = ReflectanceSamples(wi, wo, np.zeros_like(wi))
    field = _as_light_field(samples, np.arange(len(wi)))
    return predict(brdf, light_elements(_LIGHT), np.ones((1, 3)), field) / wi[:, 2:]


def _usable(samples: ReflectanceSamples, most: int | None) -> ReflectanceSamples:
    wrong = ~np.isfinite(samples.rgb).all(axis=1)
    if wrong.any():
        place = int(np.flatnonzero(wrong)[0])
        raise ValueError(f"sample {place} is {samples.rgb[place].tolist()}; reflectances must be finite")
    used = np.flatnonzero(np.minimum(samples.wi[:, 2], samples.wo[:, 2]) > _LEAST_COS)
    if len(used) < _FEWEST:
        raise ValueError(
            f"{len(used)} samples have light and sensor more than 3 degrees above the surface; a fit takes {_FEWEST}"
        )
    if not (samples.rgb[used] > 0).any():
        raise ValueError("no value is positive: the material reflects nothing, or was not measured")
    if most is not None and len(used) > most:
        used = np.sort(np.random.default_rng(0).choice(used, most, replace=False))
    return ReflectanceSamples(samples.wi[used], samples.wo[used], samples.rgb[used])


def _by_incidence(samples: ReflectanceSamples) -> tuple[NDArray[np.int64], ...]:
    """Indices of samples by angle of incidence: as measured, or in groups of equal size where they are everywhere."""
    theta = np.arccos(np.clip(samples.wi[:, 2], -1, 1))
    order = np.argsort(theta, kind="stable")
    starts = np.flatnonzero(np.diff(theta[order]) > _SAME_ANGLE) + 1
    groups: Sequence[NDArray[np.int64]] = np.split(order, starts)
    if len(groups) > _MOST_ANGLES or any(np.ptp(theta[group]) > _SAME_ANGLE for group in groups):
        groups = np.array_split(order, _MOST_ANGLES)
    return tuple(np.sort(group) for group in groups)


def _as_light_field(samples: ReflectanceSamples, group: NDArray[np.int64]) -> LightField:
    """Samples as a photograph under a source along z: normals and views turn, as the light stays."""
    wi, wo, count = samples.wi[group], samples.wo[group], len(group)
    # Rows of each turn: two directions across the light, the first towards the normal, and the light.
    normal = np.broadcast_to(_SOURCE, wi.shape)
    across = normal - wi[:, 2:] * wi
    length = np.linalg.norm(across, axis=1, keepdims=True)
    first = np.where(length > 1e-9, across / np.maximum(length, 1e-9), [1.0, 0.0, 0.0])
    turn = np.stack([first, np.cross(wi, first), wi], axis=1)
    return LightField(
        rows=np.arange(count),
        columns=np.zeros(count, int),
        radiance=samples.rgb[group] * wi[:, 2:],
        variance=np.zeros((count, 3)),
        weight=np.ones(count),
        ray_sample=np.arange(count),
        positions=np.zeros((count, 3)),
        normals=(turn @ normal[..., None])[..., 0],
        views=(turn @ wo[..., None])[..., 0],
        reflected_visible=np.ones(count, bool),
        sources_visible=np.ones((count, 1), bool),
    )
