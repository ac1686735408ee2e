"""What errors of calibration do to the numbers of a textured fit: points of the surface are looked for elsewhere.

What a photograph shows changes over a pixel because the surface bends, which its shading says, and because its Kd and
Ks vary: that is what is left of the picture's gradient.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from capture.calibrationerrors import CalibrationErrors
from capture.lighting import Lighting
from capture.photo import Photo
from invrender.brdf.microfacet import Microfacet
from invrender.estimate.calibration import WeighedPhoto, calibration_scores, is_mapped, some_rays
from invrender.estimate.textured.fit import TexturedFit
from invrender.estimate.textured.seen import Seen
from invrender.gradients.slopes import Light, PhotoRadiance
from invrender.transport.transfer import light_elements
from invrender.transport.visibility import Shadows
from recon.displacement.rays import SeenBody, pixel_change
from recon.mesh.bodies import Body
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]


def moved_by_calibration(
    fit: TexturedFit,
    weights: Floats,
    photos: Sequence[Photo],
    shown: Sequence[Seen],
    body: Body,
    errors: CalibrationErrors,
    lightings: Mapping[str, Lighting],
    shadows: Shadows | None,
) -> dict[str, Floats]:
    """What errors of one standard deviation move, (k + 6, q) by cause: numbers as of `RowInfluence.of_means`.

    weights : of the fit's points in means. photos : fitted; shown : what they show of these points. Errors of colours
    and of filters aren't among them.
    """
    weighed = weighed_points(fit, weights, photos, shown, body, lightings, shadows)
    return calibration_scores(weighed, body, np.zeros(4, bool), errors.geometric, lightings)


def weighed_points(
    fit: TexturedFit,
    weights: Floats,
    photos: Sequence[Photo],
    shown: Sequence[Seen],
    body: Body,
    lightings: Mapping[str, Lighting],
    shadows: Shadows | None,
) -> Iterator[WeighedPhoto]:
    """The photographs' samples next to the points that they show, each with the influence of its rows."""
    elements = {name: light_elements(lighting) for name, lighting in lightings.items()}
    nearest = [seen.points.nearest for seen in shown]
    fields = [
        seen.pixels.where(np.isin(np.arange(len(seen.pixels)), own))
        for seen, own in zip(shown, nearest, strict=True)
    ]
    influence = fit.rows.of_means(weights)
    kept = some_rays(fields, is_mapped(elements.values()))
    for k, (photo, seen, (keep, field, weight)) in enumerate(zip(photos, shown, kept, strict=True)):
        # Two points may share a sample.
        used, sample = np.unique(nearest[k], return_inverse=True)
        mine = fit.rows.photo == k
        moved = np.zeros((len(used), *influence.shape[1:]))
        np.add.at(moved, sample, influence[mine])
        of_points = np.concatenate([fit.rows.kd[mine], fit.rows.ks[mine], _gradient(seen).reshape(-1, 6)], 1)
        values = np.zeros((len(used), 12))
        values[sample] = of_points
        kd, ks, gradient = np.split(values[keep], [3, 6], axis=1)
        scene = SeenBody(photo.camera, body)
        brdf = Microfacet(
            kd[field.ray_sample], ks[field.ray_sample], fit.brdf.mu, fit.brdf.sigma, fit.brdf.form
        )
        strengths = np.ones((len(elements[photo.lighting]), 3))
        radiance = PhotoRadiance(brdf, Light(elements[photo.lighting], strengths), field, shadows)
        yield WeighedPhoto(
            photo.label,
            photo.lighting,
            scene,
            field,
            [weight * moved[keep, channel] for channel in range(3)],
            radiance,
            strengths,
            texture=gradient.reshape(-1, 3, 2) - _shading(field, scene, radiance),
        )


def _gradient(seen: Seen) -> Floats:
    """Of the picture at the points, (r, 3, 2) per pixel to the right and down."""
    weights, radiance = seen.points.weights, seen.pixels.radiance[seen.points.samples]
    upper, lower, left, right = (
        weights[:, pair].sum(axis=1)[:, None] for pair in ([0, 1], [2, 3], [0, 2], [1, 3])
    )
    across = upper * (radiance[:, 1] - radiance[:, 0]) + lower * (radiance[:, 3] - radiance[:, 2])
    down = left * (radiance[:, 2] - radiance[:, 0]) + right * (radiance[:, 3] - radiance[:, 1])
    return np.stack([across, down], axis=-1)


def _shading(field: LightField, scene: SeenBody, radiance: PhotoRadiance) -> Floats:
    """Of what samples would show if their Kd and Ks were those of all around them, (n, 3, 2) per pixel."""
    ways = [radiance.slopes.change(pixel_change(field, scene, way)) for way in np.eye(2)]
    return np.stack([field.mean_over_rays(way) for way in ways], axis=-1)
