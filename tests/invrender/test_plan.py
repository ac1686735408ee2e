"""Plans against what solving photographs finds, and against what theory says."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from capture.photoset import load_photoset
from invrender.estimate.jacobian import pack
from invrender.estimate.search import LADDER, fit
from invrender.estimate.statistics import by_lighting, photo_statistics
from invrender.estimate.uncertainty import uncertainty_of
from invrender.plan.advice import advise
from invrender.plan.experiment import PlannedLight, angles_deg
from invrender.plan.from_scene import experiment_of
from invrender.plan.information import Marginal, Posterior, Tally, photograph_tally
from invrender.plan.planning import Plan, make_plan
from invrender.plan.prospect import Expected, worth_improving
from invrender.process.pipeline import process
from synthetic.scenes.build import read_staging
from synthetic.writer import write_photoset

from .planscenes import BRDF, GANTRY, LAMP, SKY, SOFT, TEFLON, columns_of, scene

QUICK = "[render]\ndirections = 256\nper_side = 2\n"


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Plan]:
    """Plan of a scene file's text."""
    folder = tmp_path_factory.mktemp("scenes")

    def plan(text: str, degree: int = 10, samples: int = 4000) -> Plan:
        path = folder / "bench.toml"
        path.write_text(text)
        return make_plan(experiment_of(read_staging(path)), degree, samples)

    return plan


@pytest.fixture
def few_directions(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half as many further views and lamps: fast, and good enough for what they are to show."""
    monkeypatch.setattr("invrender.plan.advice._DIRECTIONS", 30)


def named(expected: tuple[Expected, ...], name: str) -> Expected:
    return next(one for one in expected if one.name == name)


def statuses(expected: tuple[Expected, ...]) -> dict[str, str]:
    return {one.name: one.quantity.status for one in expected}


# --- against the solver


def test_expected_deviations_are_the_scatter_of_estimates_and_what_the_solver_states(bench, rng):
    photos = bench.photograph(TEFLON, np.linspace(0, 180, 10))
    fields = [photo.field for photo in photos]
    unknowns, seen = columns_of(BRDF, PlannedLight(bench.known_lighting(), known=True), fields)
    weights = [1 / ((0.01 * one.radiance) ** 2 + (0.001 * one.radiance.mean()) ** 2) for one in seen]
    told = Tally.none(0, len(unknowns.std))
    for field, one, weight in zip(fields, seen, weights, strict=True):
        told += photograph_tally(unknowns, 0, field, one, weight)
    posterior = Posterior([Marginal(unknowns.lights[0], told, np.zeros((0, len(unknowns.std))))])
    spread = posterior.of_shared(np.diag(unknowns.std))
    expected, fragility = spread.std, spread.fragility

    def estimated(noisy):
        statistics = by_lighting(photo_statistics(p, w) for p, w in zip(noisy, weights, strict=True))
        found = fit(LADDER[-1], statistics, start)
        return found, pack(found, {"light": ("known",)})

    start = None
    start, parameters = estimated(photos)
    draws = [estimated(bench.with_noise(photos, rng))[1].vector for _ in range(120)]
    ratio = np.std(draws, axis=0, ddof=1) / expected
    # A scatter over 120 draws is known to 6.5%: each of eight within two and a half deviations, the mean within one.
    assert (np.abs(ratio - 1) < 0.16).all(), ratio
    assert abs(ratio.mean() - 1) < 0.06
    stated = uncertainty_of(lambda v: v, parameters, start, bench.with_noise(photos, rng), weights)
    # It has tabulated the transfers, and differs in where it takes the derivatives: the fit's own place.
    assert_allclose(fragility, stated.fragility, rtol=0.02)


def test_a_plan_states_what_process_then_reports(tmp_path: Path, few_forms: None, no_causes: None):
    path = tmp_path / "noisy.toml"
    # So noisy that what process adds for its quadratures hardly counts.
    path.write_text(
        scene(
            f"{SKY}\n{LAMP}",
            "[gantry]\nphotos = 4\nstep_deg = 40\n",
            more="[sensor]\nnoise = 0.05\n" + QUICK,
        )
    )
    staging = read_staging(path)
    write_photoset(staging, tmp_path / "set")
    plan = make_plan(experiment_of(staging))
    few = make_plan(experiment_of(staging), samples=400)
    result = process(load_photoset(tmp_path / "set"))
    # `process` keeps a pixel away from the masks' border: a fifteenth of a disc of 30 px.
    assert plan.fit_samples == pytest.approx(sum(photo.samples for photo in result.scores), rel=0.1)
    # However few of them are looked at: on a grid of a tenth of the pixels the outline is met by chance.
    assert few.fit_samples == pytest.approx(plan.fit_samples, rel=0.1)
    for name in ("kd", "ks", "sigma", "mu"):
        expected, found = named(plan.expected, name), result.solution.quantities[name]
        # The largest of three answers is stated, 10% more than noise implies on average. Three channels that turn out
        # to have one Ks tell it by up to the root of three better than a plan for a coloured one says.
        ratio = found.std / expected.std
        assert ((ratio > (0.5 if name == "ks" else 0.85)) & (ratio < 1.3)).all(), (name, ratio)
        assert expected.quantity.status == found.status


@pytest.mark.sweep
def test_a_plan_counts_what_a_scene_states_of_calibration_as_process_does(tmp_path: Path, few_forms: None):
    path = tmp_path / "stated.toml"
    paint = "kd = [0.2, 0.15, 0.1]\nks = [0.05, 0.06, 0.07]\nmu = 1.5\nsigma = 0.15"
    text = scene(LAMP, GANTRY, material=paint, more=QUICK)
    path.write_text(text)
    # Nothing is off: errors that are leave misfit, by which a fit weighs its pixels otherwise than planned.
    write_photoset(read_staging(path), tmp_path / "set")
    stated = "[uncertainty]\nrotation_deg = 0.1\nfocal_length = 0.001\ndirection_deg = 0.1\n"
    manifest = tmp_path / "set" / "photoset.toml"
    manifest.write_text(manifest.read_text() + stated)
    path.write_text(text + stated)
    plan = make_plan(experiment_of(read_staging(path)), samples=40_000)
    result = process(load_photoset(tmp_path / "set"))
    compared = 0
    for name in ("kd", "ks", "sigma", "mu"):
        expected, found = named(plan.expected, name), result.solution.quantities[name]
        assert sum(expected.shares.values()) == pytest.approx(1)
        for cause in ("poses", "light_directions"):
            if expected.shares[cause] > 0.15:
                reported = np.mean(found.std**2) * found.shares[cause]
                # By the same slopes: at the truth, from samples of its own.
                assert np.mean(expected.causes[cause]) == pytest.approx(reported, rel=0.5), (name, cause)
                compared += 1
    assert compared >= 4
    # Half the error counts as plan says.
    path.write_text(text + stated.replace("rotation_deg = 0.1", "rotation_deg = 0.05"))
    better = make_plan(experiment_of(read_staging(path)), samples=40_000)
    for name in ("kd", "sigma", "mu"):
        # But for the poses' second order, which falls faster.
        improved = named(plan.expected, name).improved("poses")
        assert_allclose(named(better.expected, name).std, improved, rtol=0.05)
    # Every photograph twice, from where it was taken, leaves what calibration does as it is.
    twice, once = named(plan.repeated, "kd"), named(plan.expected, "kd")
    assert_allclose(twice.causes["poses"], once.causes["poses"], rtol=1e-3)
    cause, gain = worth_improving(plan.expected)[0]
    assert gain == max(float(np.max(one.std / one.improved(cause))) for one in plan.expected) > 1


@pytest.mark.sweep
def test_in_unknown_light_a_plan_counts_calibration_as_process_does(tmp_path: Path, few_forms: None):
    path = tmp_path / "stated.toml"
    paint = "kd = [0.2, 0.15, 0.1]\nks = [0.05, 0.06, 0.07]\nmu = 1.5\nsigma = 0.15"
    stated = "[uncertainty]\nrotation_deg = 0.5\n"
    text = scene(f'{LAMP}\ngiven = "nothing"', GANTRY, material=paint, more=QUICK)
    path.write_text(text)
    write_photoset(read_staging(path), tmp_path / "set")
    manifest = tmp_path / "set" / "photoset.toml"
    manifest.write_text(manifest.read_text() + stated)
    path.write_text(text + stated)
    plan = make_plan(experiment_of(read_staging(path)), 0, 40_000)
    result = process(load_photoset(tmp_path / "set"))
    for name in ("ks_normalised", "sigma", "mu"):
        expected, found = named(plan.expected, name), result.solution.quantities[name]
        assert expected.shares["poses"] > 0.9
        reported = np.mean(found.std**2) * found.shares["poses"]
        # By the same slopes: at the truth, from samples of its own.
        assert np.mean(expected.causes["poses"]) == pytest.approx(reported, rel=0.5), name
    # The lamp's direction follows seven poses, each half a degree off about either axis across it.
    direction = named(plan.expected, "lab/source 1 direction")
    assert direction.std == pytest.approx(np.radians(0.5) * np.sqrt(2 / 7), rel=0.3)
    assert direction.shares["poses"] > 0.99


# --- what theory says


@pytest.mark.sweep
def test_soft_light_leaves_sigma_open_and_the_lamp_that_is_advised_settles_it(planned, few_directions):
    text = scene(SOFT, "[gantry]\nphotos = 2\nstep_deg = 60\n")
    plan = planned(text, samples=20_000)
    assert statuses(plan.expected)["sigma"] == "undetermined"
    assert "99% of the light's varying power" in named(plan.expected, "sigma").quantity.reason
    advice = advise(plan)
    assert advice.target.name == "sigma"
    # No other view makes the light sharper, nor does a lamp whose highlight nobody sees.
    assert {statuses(one.expected)["sigma"] for one in advice.view.tried} == {"undetermined"}
    assert {statuses(one.expected)["sigma"] for one in advice.lamp.tried} == {"undetermined", "determined"}
    best = advice.lamp.best
    assert best.named("sigma").quantity.status == "determined"
    assert (
        plan.experiment.direction(best.place.view) @ best.place.direction > -0.95
    )  # its highlight is in view
    # Planned with it in the scene, it keeps what it promises.
    azimuth, elevation = angles_deg(best.place.direction)
    level = ", ".join(f"{value:.6f}" for value in best.irradiance)
    lamp = f"{{ azimuth_deg = {azimuth:.4f}, elevation_deg = {elevation:.4f}, irradiance = [{level}] }}"
    beside = f'[[lighting]]\nname = "both"\n{SOFT}\ndirectional = [{lamp}]\n'
    seen_from = f'[[view]]\nlighting = "both"\nazimuth_deg = {60 * int(best.place.view.name)}\n'
    again = planned(text + beside + seen_from, samples=20_000)
    for one in again.expected:
        # 2000 samples speak for all 2700, and some 100 see the highlight, each time others.
        assert_allclose(one.std, best.named(one.name).std, rtol=0.1, err_msg=one.name)


def test_without_grazing_highlights_mu_is_open_and_the_view_that_is_advised_sees_one(planned, few_directions):
    text = scene(LAMP, "[gantry]\nstart_deg = -6\nstep_deg = 3\nphotos = 5\n")
    plan = planned(text, samples=20_000)
    assert {name for name, status in statuses(plan.expected).items() if status == "undetermined"} == {"mu"}
    assert "grazing" in named(plan.expected, "mu").quantity.remedy
    advice = advise(plan)
    assert advice.target.name == "mu"
    best = advice.view.best
    assert best.named("mu").quantity.status == "determined"
    source = plan.experiment.lights[0].lighting.directions[0]
    # The highlight's facet lies half way between source and camera: seen at 60 degrees from its normal and more.
    assert np.degrees(np.arccos(source @ best.place.direction)) / 2 > 60
    azimuth, elevation = angles_deg(best.place.direction)
    more = f"[[view]]\nazimuth_deg = {azimuth:.6f}\nelevation_deg = {elevation:.6f}\n"
    again = planned(text + more, samples=20_000)
    for one in again.expected:
        assert_allclose(one.std, best.named(one.name).std, rtol=0.1, err_msg=one.name)
    # Twice the same photographs are no substitute.
    assert statuses(plan.repeated)["mu"] == "undetermined"


def test_a_matte_object_hides_light_above_degree_two(planned):
    plan = planned(scene(f'{SKY}\ngiven = "nothing"', GANTRY, 'model = "lambertian"\nkd = 0.2'), degree=6)
    (light,) = plan.lights
    assert light.highest == 2
    # Odd degrees above 1 don't come through at all [RH01, eq. 16], whatever the noise.
    assert_allclose(light.shares[[3, 5]], 0, atol=1e-6)
    assert light.effective_rank < 9 + 9 + 13 + 0.01
    # Its colour is one with the light's.
    assert set(statuses(plan.expected)) == {"lab/degrees 0 to 2"}


def test_the_rougher_the_object_the_less_it_shows_of_high_degrees(planned):
    def doubts(sigma: float) -> tuple[np.ndarray, int]:
        material = f'model = "microfacet"\nkd = 0.02\nks = 0.15\nsigma = {sigma}\nmu = 1.5'
        text = scene(f'{SKY}\ngiven = "nothing"', GANTRY, material, "[sensor]\nnoise = 0.1\n")
        (light,) = planned(text, degree=16, samples=1000).lights
        assert light.reached == pytest.approx(1, abs=0.03)
        return np.sqrt(1 - light.shares), light.highest

    (smooth, to_smooth), (rough, to_rough) = doubts(0.1), doubts(0.7)
    # A lobe of sigma passes exp(-(sigma l)^2) [RH01, eq. 20], of degree 8 half, or e^-31, but for what its cut at the
    # horizon lets through.
    assert to_smooth == 16
    assert 2 <= to_rough <= 8
    assert smooth[8] < 5 * smooth[2]
    assert rough[8] > 20 * rough[2]


def test_uniform_light_determines_nothing_of_the_parts_until_a_lamp_is_added(planned):
    even = "area = [{ azimuth_deg = 0, elevation_deg = 90, radiance = 1.0, width_deg = 100000 }]"
    assert set(statuses(planned(scene(even, GANTRY)).expected).values()) == {"undetermined"}
    with_lamp = planned(scene(f"{even}\n{LAMP}", GANTRY))
    assert set(statuses(with_lamp.expected).values()) == {"determined"}


def test_two_lightings_of_unknown_total_share_one_gauge(planned):
    other = f'[[lighting]]\nname = "other"\n{LAMP}\ngiven = "nothing"\n'
    more = f'{other}[[view]]\nazimuth_deg = 100\nlighting = "other"\n'
    plan = planned(scene(f'{SKY}\n{LAMP}\ngiven = "nothing"', GANTRY, more=more), degree=4)
    found = statuses(plan.expected)
    assert {"lab/source 1 irradiance", "other/source 1 direction", "ks_normalised"} <= found.keys()
    assert "kd" not in found
    # The photographs under both tell how strong one is beside the other.
    assert named(plan.expected, "other/source 1 irradiance").relative < 0.05
    known = more.replace('given = "nothing"\n[[view]]', "[[view]]")
    absolute = planned(scene(f'{SKY}\n{LAMP}\ngiven = "nothing"', GANTRY, more=known), degree=4)
    assert named(absolute.expected, "kd").relative < 0.01


def test_meshes_show_and_hide_as_their_photographs_do(tmp_path: Path):
    """Radiance that is planned with, against photographs by brute force: shadows, mirrored rays, transfer vectors."""
    from synthetic.render.photograph import photographs

    path = tmp_path / "cat.toml"
    lights = f"{SKY}\ndirectional = [{{ azimuth_deg = -120, elevation_deg = 40, irradiance = 2.0 }}]"
    glossy = 'model = "microfacet"\nkd = 0.05\nks = 0.1\nsigma = 0.3'
    text = scene(lights, "[[view]]\nazimuth_deg = -35\nelevation_deg = 20\n", glossy)
    text = text.replace('shape = "sphere"', 'shape = "cat"\nedge = 0.002\natlas = false')
    text = text.replace("focal_px = 900", "focal_px = 450") + "[render]\ndirections = 256\nper_side = 2\n"
    path.write_text(text)
    staging = read_staging(path)
    plan = make_plan(experiment_of(staging), samples=1500)
    ((truth, _),) = photographs(staging.scene, None)
    field = plan.draws[0].field
    (seen,) = plan.bench.shown(0, [plan.draws[0]])
    level = np.sqrt(np.mean(seen.radiance**2))
    error = np.sqrt(np.mean((seen.radiance - truth[field.rows, field.columns]) ** 2, axis=1)) / level
    turned_to_the_lamp = (
        field.mean_over_rays(field.normals) @ plan.experiment.lights[0].lighting.directions[0] > 0.1
    )
    hidden = turned_to_the_lamp & ~np.isin(
        np.arange(len(field)), field.ray_sample[field.sources_visible[:, 0]]
    )
    assert hidden.mean() > 0.02
    # 0.5% and 0.3%: transfer vectors come from few rays, and of the sky's highlights one ray decides.
    assert np.sqrt(np.mean(error**2)) < 0.01
    assert np.sqrt(np.mean(error[hidden] ** 2)) < 0.01
