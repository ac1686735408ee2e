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

POINTS, PHOTOS = 30, 5


def solved_points(specular: bool, ks_varies: bool, dark: Sequence[int] = ()) -> SolvedPoints:
    """Some points in photographs whose transfers are at random, solved for; Kd of those that are `dark` is zero."""
    rng = np.random.default_rng(2)
    rows, at = POINTS * PHOTOS, np.repeat(np.arange(POINTS), PHOTOS)
    d, s = rng.uniform(0.2, 1, (2, rows, 3))
    kd, ks = rng.uniform(0.2, 0.4, (2, POINTS, 3))
    kd[list(dark)] = -0.1
    stack = TexelObservations(
        form=RH01_FORM,
        size=POINTS,
        points=np.arange(POINTS),
        starts=np.arange(0, rows, PHOTOS),
        at=at,
        photo=np.tile(np.arange(PHOTOS), POINTS),
        tiles=np.zeros(rows, int),
        columns=np.repeat(d.T.reshape(-1, 1), 2, axis=1).astype(np.float32),
        radiance=kd[at] * d + specular * ks[at] * s + 0.01 * rng.standard_normal((rows, 3)),
        weight=rng.uniform(5000, 10000, (rows, 3)),
        trust=np.ones((rows, 3)),
        share=np.ones((rows, 1)),
    )
    model = TexturedModel("any", specular, specular, ks_varies=ks_varies)
    return SolvedPoints.by(model, stack, d, s)


@pytest.mark.parametrize(
    ("specular", "ks_varies"), [(False, False), (True, False), (True, True)], ids=["matte", "even", "varies"]
)
def test_rows_move_means_as_solving_anew_does(specular: bool, ks_varies: bool) -> None:
    here, rng = solved_points(specular, ks_varies), np.random.default_rng(3)
    stack, weights = here.stack, rng.uniform(0, 1, POINTS)

    def means(radiance: np.ndarray) -> np.ndarray:
        values = SolvedPoints.by(here.model, replace(stack, radiance=radiance), here.d, here.s).values
        return np.average(np.concatenate([values.kd, values.ks], axis=1), axis=0, weights=weights)

    found = influence_of(PointInfluence.of(here), np.zeros((len(stack.at), 3, 0)), [])
    assert found.sure.all()
    change = 1e-3 * rng.standard_normal(stack.radiance.shape)
    expected = means(stack.radiance + change) - means(stack.radiance)
    moved = np.einsum("rcn,rc->n", found.of_means(weights), change)
    # The problems are linear; columns and influence are single precision.
    assert_allclose(moved, expected, rtol=1e-4, atol=1e-10)
    assert specular == bool(np.abs(expected[3:]).min() > 0)


@pytest.mark.parametrize("ks_varies", [False, True])
def test_bars_go_by_the_equations_that_the_search_goes_by(ks_varies: bool) -> None:
    here = solved_points(specular=True, ks_varies=ks_varies, dark=(3, 4, 20))
    assert (here.values.kd[[3, 4, 20]] == 0).all()
    changes = list(np.random.default_rng(4).standard_normal((2, *here.stack.radiance.shape)))
    matrix, _ = here.shared_equations(changes)
    left = [PointInfluence.of(here).left_of(change) for change in changes]
    found = [[(here.stack.weight * one * other).sum() for other in left] for one in left]
    # Another route to the same sums; columns are single precision.
    assert_allclose(found, matrix, rtol=1e-6)


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
    expected, found, even = [], [], []
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
        sample = np.unique(own.points.nearest, return_inverse=True)[1][before]
        motion = pose_motion(turned[one.label])
        expected.append(change.ravel())
        found.append(-one.moved(motion)[sample].ravel())
        even.append(-replace(one, texture=None).moved(motion)[sample].ravel())
    true, by_slopes, by_shading = (np.concatenate(parts) for parts in (expected, found, even))
    # Noise doesn't change; highlights are as narrow as pixels, and slopes across these are too steep.
    assert np.corrcoef(true, by_slopes)[0, 1] > 0.9
    assert 0.8 < (true @ by_slopes) / (by_slopes @ by_slopes) < 1.05
    # Much of what is seen is the texture's gradient.
    assert np.corrcoef(true, by_shading)[0, 1] < 0.8
    assert np.std(by_shading) < 0.9 * np.std(by_slopes)
