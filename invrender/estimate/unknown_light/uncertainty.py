"""How certain a blind fit is: the joint covariance, and what the lighting's degrees owe to the photographs.

As for known light, of the two answers for each nonlinear parameter the larger is kept: what independent noise implies,
and what residuals imply that are correlated within tiles of a photograph or patches of the surface.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from capture.parallel import parallel_map
from invrender.estimate.clusters import (
    beyond_chance,
    finest_tiles,
    lobe_misfit,
    patch_of,
    structured_share,
    sums_by,
    tiles_of,
)
from invrender.estimate.uncertainty import NUMERICAL, PRIOR_STD
from invrender.estimate.unknown_light.cross_validation import Joint, joint_equations
from invrender.estimate.unknown_light.lighting_design import LightingDesign
from invrender.estimate.unknown_light.projection import (
    BlindFit,
    predicted,
    prior_precision,
    reduced,
)
from invrender.estimate.unknown_light.rows import LightingRows
from invrender.estimate.unknown_light.source_ambiguity import SourceAmbiguity
from invrender.estimate.unknown_light.source_width import source_widths
from invrender.estimate.unknown_light.start import Search
from invrender.estimate.unknown_light.state import BlindState
from invrender.theory.conditioning import Information

Floats = NDArray[np.float64]

# Of a share, flat between 0 and 1; of a source's turns, about half a hemisphere.
_SHARE_STD, _TURN_STD = 1 / np.sqrt(12), 1.0


@dataclass(frozen=True, eq=False)
class BlindUncertainty:
    """Standard deviations of a fit.

    covariance : (t, t), of the shares, mu, sigma (radians), the sources' turns (radians) and closeness, as
    `BlindState.names` lists them. light_std : (k + j, 3) of each lighting, of coefficients and irradiances. fragility :
    (t,), by how much each moves when the model is off by all its radiance in tiles or patches. degree_shares : (l_max +
    1,) of each lighting, mean share of what is known of a coefficient that comes from the photographs, not from the
    prior. causes : by name, variances (t,) in the covariance that aren't misfit; noise's first. misfit : what of the
    sources' highlights isn't explained, relative to them (`clusters.lobe_misfit`). radii : (j,) radians, of discs that
    the sources look like; 0 of those that may be points. other_mu : by name, of forms of the lobe that explain as well
    and have mu beyond its own doubt elsewhere.
    """

    covariance: Floats
    light_std: Mapping[int, Floats]
    fragility: Floats
    degree_shares: Mapping[int, Floats]
    causes: Mapping[str, Floats]
    misfit: float = 0.0
    radii: Floats = field(default_factory=lambda: np.zeros(0))
    other_mu: Mapping[str, float] = field(default_factory=dict)
    leverage: Mapping[int, Floats] = field(default_factory=dict)
    alone: Mapping[int, Floats] = field(default_factory=dict)

    @property
    def variances(self) -> dict[str, Floats]:
        """Variances (t,) by cause, which add up to the covariance's diagonal."""
        rest = np.diag(self.covariance) - sum(self.causes.values())
        return {**self.causes, "misfit": np.maximum(rest, 0)}

    def directions_std_deg(self, state: BlindState) -> Floats:
        """Of directions of a state's sources, (k,), along the worse of two ways."""
        turns = self._of_sources(state)[: 2 * len(state.directions)]
        return np.degrees(turns.reshape(-1, 2).max(axis=1, initial=0))

    def closeness_std(self, state: BlindState) -> Floats:
        """Of the closeness of a state's sources, (k,), in its units; 0 of those far away."""
        found = np.zeros(len(state.directions))
        found[state.near] = self._of_sources(state)[2 * len(state.directions) :]
        return found

    def _of_sources(self, state: BlindState) -> Floats:
        """Of all turns, then of what closeness there is."""
        return np.sqrt(np.diag(self.covariance))[len(self.covariance) - state.numbers_of_sources :]


def blind_uncertainty(
    search: Search, fit: BlindFit, split: BlindFit | None = None, sides: SourceAmbiguity | None = None
) -> BlindUncertainty:
    """Certainty at a fit, which must be the best of its model, and what else its standard deviations must hold.

    split : the fit with one of the sources as two, if that explains more. sides : on which of two its lamps may be.
    """
    certainty = _with_widths(_of_noise(search, fit), search, fit)
    certainty = _with_sides(_with_split(certainty, fit, split), sides)
    fields = [photo for design in search.designs for photo in design.photos]
    left = [
        photo
        for design, trust, rows in zip(search.designs, search.trust, fit.rows, strict=True)
        for photo in design.split(np.sqrt(trust) * (design.radiance - predicted(design, fit, rows)))
    ]
    # In clean sets nothing of it is left.
    structured = structured_share(fields, left, finest_tiles(fields))
    # As for known light: how misfit is shared among the numbers is unknown, as a share of each, and of a
    # radian: by as much does shading that is wrong by so much of itself turn a source.
    # A lobe that a wrong model has made narrow is not the better known for it.
    # Light that falls off with the distance squared changes by twice the closeness across a radius.
    widths = {
        "mu": fit.state.mu or 0.0,
        "sigma": max(fit.state.sigma or 0.0, PRIOR_STD["sigma"]),
        "closeness": 0.5,
    }
    own = np.array([structured * widths.get(name.split(" ")[0], 1.0) for name in fit.state.names])
    misfit = _lobe_misfit(search, fit)
    # A lamp's own width, which nobody knows, passes for sigma's.
    of_width = np.array([misfit * (fit.state.sigma or 0) * (name == "sigma") for name in fit.state.names])
    own = np.sqrt(own**2 + of_width**2 + (NUMERICAL * certainty.fragility) ** 2)
    certainty = replace(certainty, misfit=misfit)
    return replace(certainty, covariance=certainty.covariance + np.diag(own**2))


def _lobe_misfit(search: Search, fit: BlindFit) -> float:
    """What of the sources' highlights is left that isn't noise, relative to them."""
    if fit.state.sigma is None or not len(fit.state.directions):
        return 0.0
    parts = []
    size = (fit.l_max + 1) ** 2
    for design, weight, trust, rows in zip(
        search.designs, search.weights, search.trust, fit.rows, strict=True
    ):
        sent = fit.light[design.lighting][size:]
        radiance = predicted(design, fit, rows)
        lobes = fit.state.specular_share * (rows.lamps_specular @ sent)
        parts.append((lobes, radiance, design.radiance - radiance, trust, weight))
    return lobe_misfit(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def _with_widths(certainty: BlindUncertainty, search: Search, fit: BlindFit) -> BlindUncertainty:
    """Standard deviations that hold by how much lamps as wide as they look put all else elsewhere."""
    precision = (fit.state.scales() / [_prior_std(name) for name in fit.state.names]) ** 2
    widths = source_widths(search, fit, precision, _noise(search, fit))
    return replace(
        certainty,
        covariance=certainty.covariance + np.diag(widths.moved**2),
        light_std={k: np.hypot(std, widths.light_moved[k]) for k, std in certainty.light_std.items()},
        radii=widths.radii,
    )


def _with_split(certainty: BlindUncertainty, fit: BlindFit, split: BlindFit | None) -> BlindUncertainty:
    """Standard deviations that hold by how much two sources instead of one put the BRDF and that source elsewhere."""
    if split is None or split.state.names[: len(fit.state.names)] != fit.state.names:
        return certainty
    state, other, kept = fit.state, split.state, len(fit.state.directions)
    ends = [
        np.array(
            [*of.specular_share, *(x for x in (of.mu, of.sigma) if x is not None), *of.form.numbers.values()]
        )
        for of in (state, other)
    ]
    off = np.concatenate([ends[1] - ends[0], np.zeros(state.numbers_of_sources)])
    for second, owner in zip(other.directions[kept:], other.owners[kept:], strict=True):
        # The one stands between the two, on a line that it doesn't determine.
        nearest = int(np.where(state.owners == owner, state.directions @ second, -1).argmax())
        apart = np.array([second, other.directions[nearest]]) @ state.directions[nearest]
        turns = off[len(ends[0]) + 2 * nearest :][:2]
        turns[:] = np.maximum(turns, np.arccos(np.clip(apart.min(), -1, 1)))
    return replace(certainty, covariance=certainty.covariance + np.diag(off**2))


def _with_sides(certainty: BlindUncertainty, sides: SourceAmbiguity | None) -> BlindUncertainty:
    """Standard deviations that hold by how much lamps that may be at their antipodes are elsewhere there."""
    if sides is None:
        return certainty
    # No lobe, so that the sources' turns are all that there is.
    off = np.where(np.repeat(sides.open, 2), np.pi, 0.0)
    light_std = {k: np.hypot(std, sides.moved[k]) for k, std in certainty.light_std.items()}
    return replace(certainty, covariance=certainty.covariance + np.diag(off**2), light_std=light_std)


def _of_noise(search: Search, fit: BlindFit) -> BlindUncertainty:
    joint = joint_equations(search, fit)
    equations = reduced(joint.whole)
    scales, noise = fit.state.scales(), _noise(search, fit)
    prior_std = np.array([_prior_std(name) for name in fit.state.names]) / scales
    inverse = np.asarray(np.linalg.inv(equations.corner / noise + np.diag(1 / prior_std**2)), float)
    ratio, fragility = _sandwich(search, fit, joint, equations.leverage, inverse / noise, np.diag(inverse))
    root = np.sqrt(ratio)
    covariance = inverse * np.outer(root, root)
    light_std, shares, leverages, alone = {}, {}, {}, {}
    wider = _wider_light(search, fit, noise)
    for lighting in fit.light:
        prior = prior_precision(search.scales[lighting], fit.l_max, int((fit.state.owners == lighting).sum()))
        gram, leverage = joint.whole[lighting].gram, equations.leverage[lighting]
        light_std[lighting], shares[lighting], alone[lighting] = _of_light(
            gram, leverage, prior, noise, covariance, wider[lighting], fit.l_max
        )
        leverages[lighting] = leverage / np.where(scales, scales, 1)
    return BlindUncertainty(
        covariance * np.outer(scales, scales),
        light_std,
        fragility * np.abs(scales),
        shares,
        {"noise": np.diag(inverse) * scales**2},
        leverage=leverages,
        alone=alone,
    )


def _noise(search: Search, fit: BlindFit) -> float:
    """Variance of the noise, in units of the weights'."""
    count = sum(np.count_nonzero(weight) for weight in search.weights)
    return fit.cost / max(count - fit.parameters, 1)


def _of_light(
    gram: Floats,
    leverage: Floats,
    prior: Floats,
    noise: float,
    covariance: Floats,
    wider: Floats,
    l_max: int,
) -> tuple[Floats, Floats, Floats]:
    """Standard deviations (k + j, 3) of a lighting, and the photographs' share (l_max + 1,) in what is known of it.

    wider : (k + j, 3), times the variances that independent noise leaves. Returned, too, is its covariance
    (3, k + j, k + j) where all other numbers are known.
    """
    size = (l_max + 1) ** 2
    stds, shares, covariances = [], [], []
    for c in range(3):
        before = np.diag(prior[c])
        data = (gram[c] - before) / noise
        alone, shared = np.linalg.inv(data + before), leverage[c] @ covariance @ leverage[c].T
        posterior = alone + shared
        root = np.sqrt(wider[:, c])
        covariances.append(alone * np.outer(root, root))
        stds.append(np.sqrt(np.diag(covariances[-1]) + np.diag(shared)))
        gained = np.linalg.inv(posterior[:size, :size]) - before[:size, :size]
        known = Information((gained + gained.T) / 2).against(prior[c, :size] ** -0.5)
        shares.append(known.share_per_degree())
    return np.stack(stds, axis=-1), np.mean(shares, axis=0), np.stack(covariances)


def _prior_std(name: str) -> float:
    return PRIOR_STD.get(name, _SHARE_STD if name.startswith("share") else _TURN_STD)


def _sandwich(
    search: Search,
    fit: BlindFit,
    joint: Joint,
    leverage: Mapping[int, Floats],
    gain: Floats,
    independent: Floats,
) -> tuple[Floats, Floats]:
    """Variances from clustered residuals over independent ones, at least 1, and fragility, (t,) each."""
    t = len(independent)
    by_tile: list[Floats] = []
    by_patch: dict[int, Floats] = {}
    by_photo: list[Floats] = []

    def scores_of(item: tuple[LightingDesign, Floats, LightingRows, Floats]) -> Floats:
        design, weight, rows, shared = item
        radiance = predicted(design, fit, rows)
        both = [np.zeros((len(radiance), t)) for _ in range(2)]
        for c, (share, by) in enumerate(
            zip(fit.state.specular_share, leverage[design.lighting], strict=True)
        ):
            # What of a parameter's effect the lighting can't undo.
            own = (shared[c] - rows.radiance(share, by)) * weight[:, c, None]
            both[0] += own * (design.radiance - radiance)[:, c, None]
            both[1] += own * radiance[:, c, None]
        return np.hstack(both)

    items = zip(search.designs, search.weights, fit.rows, joint.shared, strict=True)
    for design, scores in zip(search.designs, parallel_map(scores_of, items), strict=True):
        by_tile += list(sums_by(tiles_of(design.photos), scores).values())
        by_photo += [of.sum(axis=0) for of in design.split(scores)]
        for patch, score in sums_by(patch_of(design.field), scores).items():
            by_patch[patch] = by_patch.get(patch, 0) + score
    ratio, fragility = np.ones(t), np.zeros(t)
    for clusters in (np.array(by_tile), np.array(list(by_patch.values()))):
        few = len(clusters) / max(len(clusters) - 1, 1)
        of_noise, of_model = (
            few * ((half @ gain) ** 2).sum(axis=0) for half in (clusters[:, :t], clusters[:, t:])
        )
        ratio = np.maximum(ratio, of_noise / np.maximum(independent, 1e-300))
        fragility = np.maximum(fragility, np.sqrt(of_model))
    # What a wrong model does differs between photographs, as under known light.
    count = len(by_photo)
    between = count / max(count - 1, 1) * ((np.array(by_photo)[:, :t] @ gain) ** 2).sum(axis=0)
    between /= np.maximum(independent, 1e-300)
    return np.where(between > beyond_chance(count) * ratio, between, ratio), fragility


def _wider_light(search: Search, fit: BlindFit, noise: float) -> dict[int, Floats]:
    """Variances of each lighting (k + j, 3) from clustered residuals over independent ones, at least 1."""
    inverses = {lighting: np.linalg.inv(gram) for lighting, gram in fit.grams.items()}
    by_tile: dict[int, list[Floats]] = {lighting: [] for lighting in inverses}
    by_patch: dict[int, dict[int, Floats]] = {lighting: {} for lighting in inverses}

    def scores_of(item: tuple[LightingDesign, Floats, LightingRows]) -> Floats:
        design, weight, rows = item
        left = weight * (design.radiance - predicted(design, fit, rows))
        return np.hstack(
            [
                rows.of_channel(specular_share, left[:, c]) @ inverses[design.lighting][c]
                for c, specular_share in enumerate(fit.state.specular_share)
            ]
        )

    items = zip(search.designs, search.weights, fit.rows, strict=True)
    for design, scores in zip(search.designs, parallel_map(scores_of, items), strict=True):
        by_tile[design.lighting] += list(sums_by(tiles_of(design.photos), scores).values())
        patches = by_patch[design.lighting]
        for patch, score in sums_by(patch_of(design.field), scores).items():
            patches[patch] = patches.get(patch, 0) + score
    wider = {}
    for lighting, inverse in inverses.items():
        independent = noise * np.diagonal(inverse, axis1=1, axis2=2)
        found = np.ones_like(independent)
        for clusters in (np.array(by_tile[lighting]), np.array(list(by_patch[lighting].values()))):
            few = len(clusters) / max(len(clusters) - 1, 1)
            together = few * (clusters**2).sum(axis=0).reshape(independent.shape)
            found = np.maximum(found, together / np.maximum(independent, 1e-300))
        wider[lighting] = found.T
    return wider
