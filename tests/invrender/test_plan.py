"""Plans against what solving photographs finds, against finite differences, and against what theory says."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import block_diag

from capture.lighting import Lighting, latlong_directions
from invrender.brdf.microfacet import Microfacet
from invrender.estimate.jacobian import pack
from invrender.estimate.search import LADDER, fit
from invrender.estimate.statistics import by_lighting, photo_statistics
from invrender.estimate.uncertainty import uncertainty_of
from invrender.estimate.unknown_light.projection import arrow_of
from invrender.plan.advice import advise
from invrender.plan.experiment import Experiment, PlannedLight, angles_deg
from invrender.plan.from_scene import experiment_of
from invrender.plan.information import Marginal, Posterior, Tally, photograph_tally
from invrender.plan.light_prospect import UnknownLight
from invrender.plan.planning import Plan, make_plan
from invrender.plan.prospect import Expected
from invrender.plan.shown import PlannedObject
from invrender.plan.unknowns import unknowns_of
from invrender.process.pipeline import process
from invrender.transport.predict import predict
from invrender.transport.transfer import light_elements
from recon.harmonics.basis import evaluate_harmonics
from recon.mesh.bodies import SphereBody
from recon.mesh.tangents import tangents
from recon.sphere.sphere import Sphere
from synthetic.materials.rh01 import RH01_MATERIALS, radiometric
from synthetic.scenes.build import read_staging
from synthetic.scenes.builtin import scene_path

TEFLON = radiometric(RH01_MATERIALS["teflon"])
BRDF = Microfacet(TEFLON.kd, TEFLON.ks, TEFLON.mu, TEFLON.sigma)
MATTE = Microfacet(TEFLON.kd, np.zeros(3), None, None)
BALL = SphereBody(Sphere(np.zeros(3), 0.02, np.zeros((4, 4))))
LAMP = "directional = [{ azimuth_deg = 0, elevation_deg = 4, irradiance = 2.0 }]"
SOFT = "area = [{ azimuth_deg = 110, elevation_deg = 60, radiance = 1.0, width_deg = 60 }]"
SKY = "area = [{ azimuth_deg = 110, elevation_deg = 40, radiance = 1.5, width_deg = 20 }]"


def scene(light: str, views: str, material: str = 'name = "teflon"', more: str = "") -> str:
    """A sphere of 30 px: a fit takes all of its pixels, however many photographs there are."""
    return f"""format = 1
name = "bench"
[object]
shape = "sphere"
[material]
{material}
[[lighting]]
name = "lab"
{light}
[camera]
width = 80
height = 60
focal_px = 900
{views}
{more}
"""


GANTRY = "[gantry]\nphotos = 7\nstep_deg = 25\n"


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


def columns_of(brdf: Microfacet, light: PlannedLight, fields, degree: int = 3):
    unknowns = unknowns_of(brdf, [light], degree, None)
    return unknowns, list(PlannedObject(BALL, [light], unknowns, degree).shown(0, fields))


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


def test_a_plan_states_what_process_then_reports(tmp_path: Path, few_forms: None):
    from capture.photoset import load_photoset
    from synthetic.writer import write_photoset

    path = tmp_path / "noisy.toml"
    # So noisy that what process adds for its quadratures hardly counts.
    path.write_text(
        scene(
            f"{SKY}\n{LAMP}",
            "[gantry]\nphotos = 4\nstep_deg = 40\n",
            more="[sensor]\nnoise = 0.05\n[render]\ndirections = 256\nper_side = 2\n",
        )
    )
    staging = read_staging(path)
    write_photoset(staging, tmp_path / "set")
    plan = make_plan(experiment_of(staging))
    few = make_plan(experiment_of(staging), samples=400)
    result = process(load_photoset(tmp_path / "set")).result
    # `process` keeps a pixel away from the masks' border: a fifteenth of a disc of 30 px.
    assert plan.fit_samples == pytest.approx(sum(photo.samples for photo in result.photos), rel=0.1)
    # However few of them are looked at: on a grid of a tenth of the pixels the outline is met by chance.
    assert few.fit_samples == pytest.approx(plan.fit_samples, rel=0.1)
    for name in ("kd", "ks", "sigma", "mu"):
        expected, found = named(plan.expected, name), result.quantities[name]
        # The largest of three answers is stated, 10% more than noise implies on average. Three channels that turn out
        # to have one Ks tell it by up to the root of three better than a plan for a coloured one says.
        ratio = found.std / expected.std
        assert ((ratio > (0.5 if name == "ks" else 0.85)) & (ratio < 1.3)).all(), (name, ratio)
        assert expected.quantity.status == found.status


# --- derivatives, by other routes


def shifted(brdf: Microfacet, name: str, step: float) -> Microfacet:
    return replace(brdf, **{name: getattr(brdf, name) + step})


@pytest.mark.parametrize("brdf", [BRDF, MATTE], ids=["glossy", "matte"])
def test_columns_are_the_slopes_of_predicted_radiance(bench, brdf):
    lighting = bench.known_lighting()
    field = bench.sphere_field(70.0, samples=200, sources=lighting.directions)
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
    posterior = Posterior([Marginal(u, t, asked) for u, t in zip(unknowns.lights, tallies, strict=True)])
    patches = np.array(list(patch_scores.values()))

    def check(spread, rows: np.ndarray) -> None:
        assert_allclose(spread.std**2, np.diag(rows @ covariance @ rows.T), rtol=1e-9)
        pulls = [((rows @ covariance @ scores.T) ** 2).sum(axis=1) for scores in (tile_scores, patches)]
        assert_allclose(spread.fragility**2, np.maximum(*pulls), rtol=1e-9)

    of_shared, none = rng.normal(size=(3, t)), np.zeros((4, 3 * p))
    check(posterior.of_shared(of_shared), np.hstack([np.zeros((3, 6 * p)), of_shared]))
    check(posterior.of_lighting(0), np.hstack([asked[:, : 3 * p], none, asked[:, 3 * p :]]))
    check(posterior.of_lighting(1), np.hstack([none, asked]))
    # The gauge holds the first light's total, sources among it, to a part in ten thousand: its degree 0.
    for k, held in ((0, True), (1, False)):
        per_total = np.sqrt(4 * np.pi) / lights[k].total[:, None]
        total = UnknownLight.of(lights[k], unknowns, k).rows[:3] * per_total
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


# --- what theory says


@pytest.mark.slow
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
        (light,) = planned(text, degree=16, samples=1500).lights
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


# --- bad input


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"degree": -1}, "degree is -1"),
        ({"samples": 0}, "samples is 0"),
    ],
)
def test_numbers_out_of_range_are_named(change: dict[str, int], words: str):
    experiment = experiment_of(read_staging(scene_path("fail-no-grazing")))
    with pytest.raises(ValueError, match=words):
        make_plan(experiment, **change)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            f'name = "teflon"\n[[lighting]]\nname = "lab"\n{LAMP}',
            f'model = "mirror"\nkd = 0.1\nks = 0.5\n[[lighting]]\nname = "lab"\n{SKY}',
            "has no roughness and index",
        ),
        (
            'name = "teflon"',
            'model = "anisotropic"\nkd = 0.1\nks = 0.1\nalpha_x = 0.1\nalpha_y = 0.2',
            "two roughnesses",
        ),
        ('name = "teflon"', 'model = "lambertian"\nkd = 0.0', "reflects nothing"),
        ("photos = 7", "photos = 2\nheld_out = [0, 1]", "held out"),
        ("azimuth_deg = 0, elevation_deg = 4", "azimuth_deg = 180, elevation_deg = 0", "no light reaches"),
        ("focal_px = 900", "focal_px = 60", r"shows \d+ usable pixels"),
    ],
)
def test_what_cannot_be_planned_is_refused_in_a_sentence(tmp_path: Path, old: str, new: str, words: str):
    path = tmp_path / "bench.toml"
    text = scene(LAMP, "[gantry]\nphotos = 7\nstep_deg = 1\n")
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(ValueError, match=words):
        make_plan(experiment_of(read_staging(path)))


def test_other_materials_are_planned_as_their_like_and_it_is_said(tmp_path: Path):
    def brdf_and_notes(material: str) -> tuple[Microfacet, str]:
        path = tmp_path / "bench.toml"
        path.write_text(scene(LAMP, GANTRY, material))
        experiment: Experiment = experiment_of(read_staging(path))
        return experiment.brdf, " ".join(experiment.notes)

    brdf, notes = brdf_and_notes('model = "ggx"\nkd = 0.1\nks = 0.05\nalpha = 0.2\nmu = 1.5')
    assert (brdf.sigma, brdf.mu) == (0.2, 1.5)
    assert "GGX of alpha 0.2" in notes
    brdf, notes = brdf_and_notes('model = "smith"\nkd = 0.1\nks = 0.05\nsigma = 0.2')
    assert (brdf.sigma, brdf.mu) == (0.2, None)
    brdf, notes = brdf_and_notes('model = "plastic"\nkd = 0.1\nks = 0.05\nalpha = 0.2\nmu = 1.5')
    assert "GGX of alpha 0.2" in notes
    assert "the base under an interface is planned as a Lambertian one" in notes
    assert (brdf.mu, brdf.sigma) == (1.5, 0.2)
    brdf, notes = brdf_and_notes('model = "phong"\nkd = 0.1\nks = 0.1\nexponent = 50')
    assert "Phong" in notes
    # Head-on both lobes are as high: ks (s + 2) / 2 pi, and Ks / (4 pi sigma^2).
    assert brdf.sigma is not None
    assert_allclose(brdf.ks / (4 * np.pi * brdf.sigma**2), 0.1 * 52 / (2 * np.pi))
    # And fall to half at the same half angle, to a percent.
    half = np.arccos(0.5 ** (1 / 50)) / 2
    assert np.exp(-((half / brdf.sigma) ** 2)) == pytest.approx(0.5, rel=0.01)
