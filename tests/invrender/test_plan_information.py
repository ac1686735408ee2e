"""A plan's derivatives by finite differences, and its sums of information by dense matrices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import block_diag

from capture.lighting import Lighting, latlong_directions
from invrender.brdf.microfacet import Microfacet
from invrender.estimate.unknown_light.projection import arrow_of
from invrender.plan.experiment import PlannedLight
from invrender.plan.information import Marginal, Posterior, Tally, photograph_tally
from invrender.plan.light_prospect import UnknownLight
from invrender.plan.unknowns import unknowns_of
from invrender.transport.predict import predict
from invrender.transport.transfer import light_elements
from recon.harmonics.basis import evaluate_harmonics
from recon.mesh.tangents import tangents

from .planscenes import BRDF, MATTE, columns_of


def shifted(brdf: Microfacet, name: str, step: float) -> Microfacet:
    return replace(brdf, **{name: getattr(brdf, name) + step})


@pytest.mark.parametrize("brdf", [BRDF, MATTE], ids=["glossy", "matte"])
def test_columns_are_the_slopes_of_predicted_radiance(bench, brdf):
    lighting = bench.known_lighting()
    # One ray of each pixel: of several, columns see a map by fewer.
    field = bench.sphere_field(70.0, samples=200, sources=lighting.directions).merged(1.0)
    # Away from the horizon of the source, where a highlight ends abruptly.
    field = field.where(np.abs(field.mean_over_rays(field.normals) @ lighting.directions[0]) > 0.1)
    unknowns, (seen,) = columns_of(brdf, PlannedLight(lighting, known=False), [field])

    def radiance(of: Microfacet, under: Lighting) -> np.ndarray:
        elements = light_elements(under)
        return predict(of, elements, np.ones((len(elements), 3)), field)

    def check(jacobian, up, down, width: float, rtol: float, channels=range(3)) -> None:
        """A number's own column (3, n) of the Jacobian, in those channels that depend on it."""
        slope = (radiance(*up) - radiance(*down)) / width
        for channel in channels:
            scale = max(np.abs(slope).max(), 1e-6)  # of degree 3 a matte object shows nothing
            assert_allclose(jacobian[channel], slope[:, channel], rtol=0, atol=rtol * scale)

    # Single precision.
    assert_allclose(seen.radiance, radiance(brdf, lighting), rtol=1e-5)
    assert list(unknowns.brdf.places) == (["kd"] if brdf is MATTE else ["mu", "sigma", "kd", "ks"])
    for name, place in unknowns.brdf.places.items():
        h = 1e-4
        up, down = shifted(brdf, name, h), shifted(brdf, name, -h)
        # Kd and Ks of each channel, and what all share, as the columns of one matrix.
        of_channels = seen.shared[:, :, place].sum(axis=2)
        # The map's half-vector rule sums other rings for other roughnesses: 1e-3 of the slope in sigma.
        check(of_channels, (up, lighting), (down, lighting), 2 * h, 2e-3)
        if name in ("kd", "ks"):
            assert not seen.shared[0, :, place.start + 1 : place.stop].any()
    # The source: one more unit of irradiance, and a turn about either axis.
    more = replace(lighting, irradiances=lighting.irradiances + 1)
    check(seen.lit[:, :, -1], (brdf, more), (brdf, lighting), 1.0, 1e-6)
    turned = seen.shared[:, :, unknowns.lights[0].turns]
    for tangent, jacobian in zip(tangents(lighting.directions[0]), np.moveaxis(turned, 2, 0), strict=True):
        ends = [replace(lighting, directions=lighting.directions + s * 1e-4 * tangent) for s in (1, -1)]
        check(jacobian, (brdf, ends[0]), (brdf, ends[1]), 2e-4, 1e-3)
    # A harmonic of the light: by the half-vector walk through a map that has more of it, not by the operator.
    assert lighting.radiance_map is not None
    directions = latlong_directions(len(lighting.radiance_map))
    for degree, order in ((0, 0), (1, -1), (2, 1), (3, 3)):
        k = degree * degree + degree + order
        wave = evaluate_harmonics(directions.reshape(-1, 3), 3)[:, k].reshape(directions.shape[:2])
        bright, brighter = (
            replace(
                lighting, radiance_map=(lighting.radiance_map + 2 + s * wave[..., None]).astype(np.float32)
            )
            for s in (0, 1)
        )
        # 2% where some of a sample's rays are more grazing than the lobe's table; of most it is 0.1%.
        check(seen.lit[:, :, k], (brdf, brighter), (brdf, bright), 1.0, 2e-2)


def test_marginals_add_up_to_the_inverse_of_the_whole(bench, rng):
    """Two unknown lightings that share a BRDF, against one matrix of all numbers, and scores against brute force."""
    lights = [PlannedLight(bench.known_lighting(name=name), known=False) for name in ("one", "two")]
    unknowns = unknowns_of(BRDF, lights, 1, 0)
    p, t = unknowns.lights[0].size, len(unknowns.std)
    s, whole_size = 3 * p + t, 6 * p + t
    tallies, whole = [], np.diag(np.r_[np.zeros(6 * p), np.ones(t)])
    tile_scores, patch_scores = np.zeros((0, whole_size)), {}
    for k, own in enumerate(unknowns.lights):
        places = np.r_[3 * p * k : 3 * p * (k + 1), 6 * p : whole_size]
        lit, shared = rng.normal(size=(3, 2 * s, p)), rng.normal(size=(3, 2 * s, t))
        weights = rng.uniform(0.5, 2, (2 * s, 3))
        tiles, patch = rng.normal(size=(5, s)), rng.normal(size=(4, s))
        equations = arrow_of(lit, shared, weights, np.zeros((2 * s, 3)))
        tallies.append(Tally(equations, tiles.T @ tiles, {k + j: score for j, score in enumerate(patch)}))
        for channel in range(3):
            rows = np.zeros((2 * s, s))
            rows[:, channel * p : (channel + 1) * p], rows[:, 3 * p :] = lit[channel], shared[channel]
            whole[np.ix_(places, places)] += rows.T @ (weights[:, channel, None] * rows)
        whole[np.ix_(places[: 3 * p], places[: 3 * p])] += block_diag(*own.precision)
        padded = np.zeros((5, whole_size))
        padded[:, places] = tiles
        tile_scores = np.vstack([tile_scores, padded])
        for j, score in enumerate(patch):
            total = patch_scores.setdefault(k + j, np.zeros(whole_size))
            total[places] += score
    covariance = np.linalg.inv(whole)
    asked = rng.normal(size=(4, s))
    errors = {"poses": rng.normal(size=(whole_size, 5)), "lenses": rng.normal(size=(whole_size, 1))}
    # Those of the shared numbers come first there, and last in the matrix.
    scores = {cause: np.roll(columns, t, axis=0) for cause, columns in errors.items()}
    marginals = [Marginal(u, tally, asked) for u, tally in zip(unknowns.lights, tallies, strict=True)]
    posterior = Posterior(marginals, scores)
    patches = np.array(list(patch_scores.values()))

    def check(spread, rows: np.ndarray) -> None:
        assert_allclose(spread.std**2, np.diag(rows @ covariance @ rows.T), rtol=1e-9)
        pulls = [((rows @ covariance @ scores.T) ** 2).sum(axis=1) for scores in (tile_scores, patches)]
        assert_allclose(spread.fragility**2, np.maximum(*pulls), rtol=1e-9)
        for cause, columns in errors.items():
            moved = rows @ covariance @ columns
            assert_allclose(spread.causes[cause], (moved**2).sum(axis=1), rtol=1e-9)

    of_shared, none = rng.normal(size=(3, t)), np.zeros((4, 3 * p))
    check(posterior.of_shared(of_shared), np.hstack([np.zeros((3, 6 * p)), of_shared]))
    check(posterior.of_lighting(0), np.hstack([asked[:, : 3 * p], none, asked[:, 3 * p :]]))
    check(posterior.of_lighting(1), np.hstack([none, asked]))
    # The gauge holds the first light's total, sources among it, to a part in ten thousand: its degree 0.
    for k, held in ((0, True), (1, False)):
        per_total = np.sqrt(4 * np.pi) / lights[k].total[:, None]
        total = UnknownLight.of(lights[k], unknowns, k, 0.02).rows[:3] * per_total
        assert ((posterior.asked(k, total).of_lighting(k).std < 1.001e-4) == held).all()


def test_information_is_additive(bench):
    light = PlannedLight(bench.known_lighting(), known=False)
    field = bench.sphere_field(40.0, samples=150, sources=light.lighting.directions)
    unknowns, (seen,) = columns_of(BRDF, light, [field])
    weights = 1 / (0.01 * seen.radiance) ** 2
    half = np.arange(len(field)) % 2 == 0

    def tally(keep: np.ndarray) -> Tally:
        return photograph_tally(unknowns, 0, field.where(keep), seen.where(keep), weights[keep])

    whole, parts = tally(np.ones(len(field), bool)), tally(half) + tally(~half)
    for name, matrix in vars(whole.equations).items():
        assert_allclose(getattr(parts.equations, name), matrix, rtol=1e-12, atol=1e-12 * np.abs(matrix).max())
    assert parts.patches.keys() == whole.patches.keys()
    # A patch is seen in both, and its scores add up, unlike those of tiles, which are of one photograph.
    for patch, score in whole.patches.items():
        assert_allclose(parts.patches[patch], score, atol=1e-12 * np.abs(score).max())
    twice = whole.times(2)
    assert_allclose(twice.equations.corner, 2 * whole.equations.corner, rtol=1e-15)
    assert_allclose(twice.pull, 4 * whole.pull, rtol=1e-15)
