"""What errors of calibration do to textured fits: rows' influence, and what photographs show of points elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.photo import Photo
from capture.photoset import PhotoSet, load_photoset
from invrender.brdf.lobes import GGX_FORM, RH01_FORM
from invrender.estimate.textured import calibration
from invrender.estimate.textured.influence import PointInfluence, influence_of
from invrender.estimate.textured.search import SolvedPoints, TexturedModel
from invrender.estimate.textured.seen import Seen, transfers_of
from invrender.estimate.textured.texel_observations import TexelObservations
from invrender.process import textured
from invrender.process.pipeline import process
from invrender.result.run import Run
from invrender.transport.transfer import light_elements
from recon.displacement.rays import SeenBody, pose_motion
from tests.invrender.test_textures import LAMP_LIT, write_doll_set


@pytest.mark.parametrize(
    ("specular", "ks_varies"), [(False, False), (True, False), (True, True)], ids=["matte", "even", "varies"]
)
def test_rows_move_means_as_solving_anew_does(specular: bool, ks_varies: bool) -> None:
    rng, points, photos = np.random.default_rng(2), 30, 5
    rows = points * photos
    at = np.repeat(np.arange(points), photos)
    d, s = rng.uniform(0.2, 1, (2, rows, 3))
    kd, ks = rng.uniform(0.2, 0.4, (2, points, 3))
    stack = TexelObservations(
        form=RH01_FORM,
        size=points,
        points=np.arange(points),
        starts=np.arange(0, rows, photos),
        at=at,
        photo=np.tile(np.arange(photos), points),
        tiles=np.zeros(rows, int),
        columns=np.repeat(d.T.reshape(-1, 1), 2, axis=1).astype(np.float32),
        radiance=kd[at] * d + specular * ks[at] * s + 0.01 * rng.standard_normal((rows, 3)),
        weight=rng.uniform(5000, 10000, (rows, 3)),
        trust=np.ones((rows, 3)),
        share=np.ones((rows, 1)),
    )
    model = TexturedModel("any", specular, specular, ks_varies=ks_varies)
    weights = rng.uniform(0, 1, points)

    def means(radiance: np.ndarray) -> np.ndarray:
        values = SolvedPoints.by(model, replace(stack, radiance=radiance), d, s).values
        return np.average(np.concatenate([values.kd, values.ks], axis=1), axis=0, weights=weights)

    here = SolvedPoints.by(model, stack, d, s)
    found = influence_of(PointInfluence.of(here), np.zeros((rows, 3, 0)), [])
    assert found.sure.all()
    change = 1e-3 * rng.standard_normal((rows, 3))
    expected = means(stack.radiance + change) - means(stack.radiance)
    moved = np.einsum("rcn,rc->n", found.of_means(weights), change)
    # The problems are linear; columns and influence are single precision.
    assert_allclose(moved, expected, rtol=1e-4, atol=1e-10)
    assert specular == bool(np.abs(expected[3:]).min() > 0)


@pytest.fixture(scope="module")
def photoset(tmp_path_factory: pytest.TempPathFactory) -> PhotoSet:
    """RH01's painted doll under lamps, six small photographs; what may be off is stated."""
    folder = write_doll_set(tmp_path_factory.mktemp("doll"), LAMP_LIT)
    with (folder / "photoset.toml").open("a") as manifest:
        manifest.write("\n[uncertainty]\nrotation_deg = 0.1\ndirection_deg = 0.2\nheight = 1e-4\n")
    return load_photoset(folder)


def fitted(photoset: PhotoSet) -> tuple[Run, tuple[Any, ...]]:
    """A fit, and what it gave to `moved_by_calibration`."""
    asked: list[tuple[Any, ...]] = []

    def ask(*arguments: Any) -> dict[str, np.ndarray]:
        asked.append(arguments)
        return calibration.moved_by_calibration(*arguments)

    with pytest.MonkeyPatch.context() as patch:
        # Each form takes seconds.
        patch.setattr("invrender.estimate.textured.fit.OTHER_FORMS", (GGX_FORM,))
        patch.setattr(textured, "moved_by_calibration", ask)
        run = process(photoset, 3000, causes=False)
    return run, asked[0]


@pytest.fixture(scope="module")
def doll(photoset: PhotoSet) -> tuple[Run, tuple[Any, ...]]:
    return fitted(photoset)


@pytest.mark.slow
def test_a_textures_numbers_say_what_calibration_has_of_their_bars(doll: tuple[Run, tuple[Any, ...]]) -> None:
    run, _ = doll
    for name in ("sigma", "mu", "kd", "ks"):
        shares = run.solution.quantities[name].shares
        assert {"noise", "poses", "light_directions", "heights"} <= shares.keys()
        assert sum(shares.values()) == pytest.approx(1)
        # Where highlights are as wide as a pixel, poses off by less than a tenth of one limit these.
        assert shares["poses"] > shares["noise"]
    assert not any("[uncertainty]" in warning for warning in run.warnings)


@pytest.mark.slow
def test_points_are_shown_as_turned_cameras_show_them(
    photoset: PhotoSet, doll: tuple[Run, tuple[Any, ...]]
) -> None:
    fit, weights, photos, shown, body, errors, lightings, shadows = doll[1]
    rng = np.random.default_rng(3)
    cameras = {photo.label: photo.camera for photo in photos}
    turned = {
        label: rng.multivariate_normal(np.zeros(6), own.covariance)
        for own in errors.poses_about(body.centre, cameras)
        for label in own.photos
    }

    def elsewhere(photo: Photo) -> Photo:
        scene = pose_motion(turned[photo.label])(SeenBody(photo.camera, body), 1)
        return replace(photo, camera=scene.camera)

    moved = replace(photoset, photos=tuple(elsewhere(photo) for photo in photoset.photos))
    again: Sequence[Seen] = fitted(moved)[1][3]
    weighed = list(calibration.weighed_points(fit, weights, photos, shown, body, lightings, shadows))
    expected, found = [], []
    for k, (one, own, other) in enumerate(zip(weighed, shown, again, strict=True)):
        mine = fit.rows.photo == k
        kd, ks, elements = fit.rows.kd[mine], fit.rows.ks[mine], light_elements(lightings[one.lighting])

        def left(seen: Seen, kd: np.ndarray, ks: np.ndarray, elements: Any = elements) -> np.ndarray:
            d, s = transfers_of(elements, seen.pixels, fit.brdf, shadows)
            return seen.radiance - kd * seen.points.at_points(d) - ks * seen.points.at_points(s)

        _, before, after = np.intersect1d(own.points.points, other.points.points, return_indices=True)
        keep = np.zeros(len(other.points), bool)
        keep[after] = True
        some = Seen.of(other.lighting, other.points.where(keep), other.pixels)
        change = left(some, kd[before], ks[before]) - left(own, kd, ks)[before]
        # Where the camera is elsewhere, a pixel shows what the fit doesn't expect there: the opposite of its change.
        at = own.points.samples[np.arange(len(own.points)), own.points.weights.argmax(axis=1)]
        predicted = -one.moved(pose_motion(turned[one.label]))[np.unique(at, return_inverse=True)[1]]
        expected.append(change.ravel())
        found.append(predicted[before].ravel())
    true, by_slopes = np.concatenate(expected), np.concatenate(found)
    # Noise doesn't change; highlights are as narrow as pixels, and slopes across these are too steep.
    assert np.corrcoef(true, by_slopes)[0, 1] > 0.9
    assert 0.8 < (true @ by_slopes) / (by_slopes @ by_slopes) < 1.05
    # Without the texture's gradient nearly nothing is explained.
    even = [-replace(one, texture=None).moved(pose_motion(turned[one.label])).ravel() for one in weighed]
    assert np.std(np.concatenate(even)) < 0.9 * np.std(by_slopes)
