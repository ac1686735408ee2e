"""The dual angular and frequency-space lighting: nine coefficients and a map [RH01, section 6.2, fig. 8].

The nine coefficients give the diffuse part; what is left shows the light as a mirror sphere would, and the map's own
nine coefficients must be the same. All is linear in the nine, so the condition is a system of nine equations.

Where no reflection reaches, the map is completed by the coefficients of the direct method, blurred as the lobe would.
The nine alone would do too; but on a part of the sphere nine harmonics are nearly dependent (the condition of their
Gram matrix is 250 on one half, 900 on 41%), while the direct method weighs all that the diffuse part says of the rest,
and knows how little that is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from capture.lighting import latlong_directions, latlong_solid_angles
from invrender.brdf.microfacet import Microfacet
from invrender.inverse_lighting.coefficients import LightCoefficients
from invrender.transport.harmonic_rows import PhotoRows, lobe_blur, mirrored_views
from invrender.transport.lobe_table import Transfer
from recon.harmonics.basis import degree_of, degrees, evaluate_harmonics

Floats = NDArray[np.float64]

_NINE, _L_MAX = 9, 2
# Heights of maps: pixels of half the roughness, as far as the samples of an ordinary set fill them.
_LEAST_HEIGHT, _MOST_HEIGHT = 64, 256
# A direction gathers reflections within so many pixels of it.
_REACH = 1.5


@dataclass(frozen=True, eq=False)
class DualLight:
    """Lighting as a map and nine coefficients.

    radiance : (H, 2H, 3), the light as the lobe blurs it; noise leaves dark parts slightly negative. std : the same.
    reached : (H, 2H), directions that some reflection reaches. nine, nine_std : (9, 3), coefficients up to degree 2 of
    the light itself.
    """

    radiance: Floats
    std: Floats
    reached: NDArray[np.bool_]
    nine: Floats
    nine_std: Floats

    @property
    def coverage(self) -> float:
        """Share of all directions that some reflection reaches, by solid angle."""
        height = len(self.reached)
        return float((self.reached * latlong_solid_angles(height)).sum() / (4 * np.pi))


def map_height(sigma: float) -> int:
    """Rows of a lat-long map whose pixels are no larger than half the roughness (radians), 64 to 256."""
    return int(np.clip(2 * np.ceil(np.pi / sigma), _LEAST_HEIGHT, _MOST_HEIGHT))


def estimate_dual(
    photos: Sequence[PhotoRows], brdf: Microfacet, direct: LightCoefficients, transfer: Transfer = "exact"
) -> DualLight:
    """The dual lighting of photographs whose rows, of that transfer, go up to degree 2 at least.

    direct : the direct method's answer to the same photographs; its noise weighs the samples, its coefficients complete
    the map. The transfers `mirror` and `filtered` gather the radiance itself. The transfer `exact` gathers what the
    direct answer leaves of it, and adds that to this answer, blurred as seen head-on: so the lobe's stretch and shift
    at grazing angles, degrees above 2 of the diffuse part and slopes of the light within the reach of a direction don't
    count as light. Raises ValueError for a BRDF without specular part.
    """
    if brdf.sigma is None or not brdf.ks.all():
        raise ValueError(
            "the dual method looks at mirrored light, but a channel of the BRDF has no specular part"
        )
    height = map_height(brdf.sigma)
    directions = latlong_directions(height).reshape(-1, 3)
    solid_angles = np.repeat(latlong_solid_angles(height)[:, 0], 2 * height)
    l_max = degree_of(len(direct.full_values))
    blur = lobe_blur(brdf, l_max, transfer)[degrees(l_max)]
    grid = _Grid(
        *_gathering(photos, directions, _REACH * np.pi / height),
        projection=evaluate_harmonics(directions, _L_MAX).T * solid_angles,
        blurred=evaluate_harmonics(directions, l_max) * blur,
        blur=blur[:_NINE],
    )
    found = [_solve(grid, photos, brdf, direct, channel, transfer) for channel in range(3)]
    light, std, nine, nine_std = (np.stack(each, axis=-1) for each in zip(*found, strict=True))
    shape = (height, 2 * height)
    return DualLight(
        radiance=light.reshape(*shape, 3),
        std=std.reshape(*shape, 3),
        reached=grid.reached.reshape(shape),
        nine=nine,
        nine_std=nine_std,
    )


@dataclass(frozen=True, eq=False)
class _Grid:
    """The map's P directions, R of which are reached by some of n samples.

    kernel : (R, n), by which samples count. reached : (P,). projection : (9, P), a map's first coefficients. blurred :
    (P, k), the light's coefficients as a map that the lobe has blurred. blur : (9,), what it leaves of the first.
    """

    kernel: csr_array
    reached: NDArray[np.bool_]
    projection: Floats
    blurred: Floats
    blur: Floats


def _solve(
    grid: _Grid,
    photos: Sequence[PhotoRows],
    brdf: Microfacet,
    direct: LightCoefficients,
    channel: int,
    transfer: Transfer,
) -> tuple[Floats, Floats, Floats, Floats]:
    """One channel's map (P,) and nine coefficients (9,), each followed by its standard deviations."""
    values, covariance = direct.full_values[:, channel], direct.full_covariance(channel)
    seen = _seen(photos, brdf, direct, channel)
    mean = grid.kernel * (1 / seen.variance)
    mean = mean.multiply(1 / np.maximum(mean.sum(axis=1), 1e-300)[:, None]).tocsr()
    # What is gathered is added to `known`, whose blurred map and nine coefficients are exact.
    known = values if transfer == "exact" else np.zeros_like(values)
    left = seen.radiance - seen.rows @ known
    shown, diffuse = mean @ left, mean @ seen.diffuse
    missing = grid.blurred[~grid.reached]
    # The map's nine, of `shown - diffuse @ (nine - known)` where reached, must be blur * (nine - known).
    projection = grid.projection[:, grid.reached]
    system = np.diag(grid.blur) + projection @ diffuse
    from_map = np.linalg.solve(system, projection)
    from_direct = np.linalg.solve(system, grid.projection[:, ~grid.reached] @ missing)
    added = from_map @ shown + from_direct @ (values - known)
    nine = known[:_NINE] + added
    # The samples' noise, by way of the map, and what the completion doesn't know.
    from_samples = mean.T @ from_map.T
    weighted = from_samples * seen.variance[:, None]
    spread = weighted.T @ from_samples + from_direct @ covariance @ from_direct.T
    light, variance = np.empty(len(grid.reached)), np.empty(len(grid.reached))
    light[grid.reached] = grid.blurred[grid.reached] @ known + shown - diffuse @ added
    own, shared = mean.power(2) @ seen.variance, ((mean @ weighted) * diffuse).sum(axis=1)
    variance[grid.reached] = own - 2 * shared + _quadratic(diffuse, spread)
    light[~grid.reached] = missing @ values
    variance[~grid.reached] = _quadratic(missing, covariance)
    nine_variance = np.diagonal(spread)
    if transfer == "exact":
        # The samples are the direct method's too. What they leave of its prediction does not depend on its error, and
        # varies by what its answer has not taken up of their noise.
        by_rows = from_samples.T @ seen.rows
        of_fit = _quadratic(by_rows, direct.posterior[channel])
        of_left = np.maximum((from_samples**2).T @ left**2 - of_fit, 0)
        shift = direct.shift[:_NINE, channel] - by_rows @ direct.shift[:, channel]
        own = np.diagonal(direct.posterior[channel]) * direct.widening[:, channel] ** 2
        nine_variance = own[:_NINE] + of_left + shift**2
    return light, np.sqrt(np.maximum(variance, 0)), nine, np.sqrt(nine_variance)


@dataclass(frozen=True, eq=False)
class _Seen:
    """What is gathered of the samples of one channel, (n,): radiance over Ks F, and its variance.

    rows : (n, K), what each coefficient of the light adds to it. diffuse : (n, 9), what the first nine do by diffuse
    reflection.
    """

    radiance: Floats
    variance: Floats
    rows: Floats
    diffuse: Floats


def _seen(photos: Sequence[PhotoRows], brdf: Microfacet, direct: LightCoefficients, channel: int) -> _Seen:
    degree = degree_of(len(direct.full_values))
    parts = []
    for photo, weight in zip(photos, direct.weights, strict=True):
        assert photo.specular is not None
        # The specular row's first entry is its answer to light Y_00 from everywhere: per unit of light, Ks F.
        gain = brdf.ks[channel] * np.sqrt(4 * np.pi) * photo.specular[:, 0].astype(float)
        parts.append(
            (
                photo.field.radiance[:, channel] / gain,
                1 / (weight[:, channel] * gain**2),
                photo.of_channel(brdf, channel, degree) / gain[:, None],
                brdf.kd[channel] * photo.diffuse[:, :_NINE] / gain[:, None],
            )
        )
    return _Seen(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def _gathering(
    photos: Sequence[PhotoRows], directions: Floats, reach: float
) -> tuple[csr_array, NDArray[np.bool_]]:
    """Weights (R, n) by which samples count for the R of the map's P directions that are reached, and which are, (P,).

    A sample counts by its reflection's distance from the direction, down to 0 at the reach (Epanechnikov's kernel).
    """
    mirrored = np.concatenate([mirrored_views(photo.field) for photo in photos])
    near = cKDTree(directions).sparse_distance_matrix(cKDTree(mirrored), reach, output_type="coo_matrix")
    kernel = csr_array((1 - (near.data / reach) ** 2, (near.row, near.col)), shape=near.shape)
    reached = np.asarray(kernel.sum(axis=1)) > 0
    return kernel[np.flatnonzero(reached)], reached


def _quadratic(rows: Floats, covariance: Floats) -> Floats:
    """Variances (n,) of rows (n, k) times unknowns of a covariance (k, k)."""
    return np.asarray(((rows @ covariance) * rows).sum(axis=1))
