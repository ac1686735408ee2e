"""References of known reflectance: absolute Kd and light where none was measured, witnesses where it was."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from capture.photoset import load_photoset
from invrender.brdf.microfacet import Microfacet
from invrender.estimate.reference_scale import ReferenceScale
from invrender.estimate.unknown_light import factorize_blind
from invrender.estimate.unknown_light.absolute_scale import absolute_blind
from invrender.process.pipeline import process
from invrender.result.document import result_document
from invrender.result.run import Run
from invrender.result.sentences import reference_in_words
from invrender.transport.predict import predict
from invrender.transport.transfer import light_elements
from recon.reference import Reference
from synthetic.scenes.build import read_staging
from synthetic.writer import write_photoset
from tests.invrender.faultysets import GLOSSY, MATTE, change_manifest, write_set
from tests.invrender.fewforms import few_forms_tried, no_causes_sought
from tests.invrender.referencesets import add_card, add_sphere, forget_light, forget_strength
from tests.invrender.test_unknown_texture import BALL, write_ball_set

Floats = NDArray[np.float64]

# Of a ball of one paint.
PAINT = 0.1
KD, KS = np.array([0.2, 0.16, 0.12]), np.full(3, 0.04)
# Beside the sphere, 12 mm wide.
BESIDE, FACING = (0.0, 0.0288, 0.0), (1.0, 0.3, 0.4)
LAMPS = 1.5 + 0.2 * (np.arange(8) % 3)


@pytest.fixture(scope="module")
def staged(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """A sphere under a lamp per photograph, with room beside it; by its material."""
    folder = tmp_path_factory.mktemp("staged")
    for name, material in (("glossy", GLOSSY), ("matte", MATTE)):
        write_set(folder / name, material, beside=44)
    return lambda name: folder / name


@pytest.fixture
def copied(staged: Callable[[str], Path], tmp_path: Path) -> Callable[..., Path]:
    def copy(name: str = "glossy") -> Path:
        return Path(shutil.copytree(staged(name), tmp_path / "set", dirs_exist_ok=True))

    return copy


def card(
    normal: Floats, white: float = 1.0, reflectance_std: float = 0.0, normal_std: float = 0.0
) -> Reference:
    """A card of nine even parts that a photograph "a" shows under the light "room"."""
    return Reference(
        "photoset.toml: [[reference]] 1",
        "the card in a",
        "a",
        "room",
        np.tile(normal, (9, 1)),
        None,
        np.full((9, 3), white),
        np.arange(9),
        reflectance_std,
        normal_std,
    )


def test_a_scale_is_the_light_over_what_shows_and_a_tilt_moves_it_by_its_tangent() -> None:
    tilt, std = np.radians(40), np.radians(2)
    normal = np.array([np.sin(tilt), 0.0, np.cos(tilt)])

    def falls(reference: Reference, normals: Floats) -> Floats:
        return 3.0 * np.clip(normals @ [0.0, 0.0, 1.0], 0, None)[:, None] * np.ones(3)

    scale = ReferenceScale.of([card(normal, 0.5, 0.02, std)], falls)
    assert_allclose(scale.factors, 3 * np.cos(tilt) / (np.pi * 0.5))
    # The irradiance goes as cos; a turn about the other axis moves it by the second order only.
    assert_allclose(scale.own_std, np.hypot(0.02, std * np.tan(tilt)), rtol=1e-3)
    # Two that agree: half of the variance; weights go by what each is off by itself.
    both = ReferenceScale.of([card(normal, 0.5, 0.02, std), card(normal, 0.5, 0.04)], falls)
    first = 0.02**2 + (std * np.tan(tilt)) ** 2
    assert_allclose(both.weights, np.array([1 / first, 1 / 0.04**2]) / (1 / first + 1 / 0.04**2), rtol=1e-3)
    assert_allclose(both.own_std, 1 / np.sqrt(1 / first + 1 / 0.04**2), rtol=1e-3)
    assert both.remarks == ()
    with pytest.raises(ValueError, match="next to no light falls on it"):
        ReferenceScale.of([card(np.array([1.0, 0.0, -0.01]))], falls)


@pytest.mark.sweep
def test_bars_of_products_are_how_far_draws_of_noise_scatter(bench) -> None:
    lighting = bench.known_lighting()
    rng = np.random.default_rng(3)
    elements, brdf = light_elements(lighting), Microfacet(KD, KS, 1.6, 0.2)
    photos = [bench.sphere_field(angle, sources=lighting.directions) for angle in (-40.0, 0.0, 40.0)]
    shown = [predict(brdf, elements, np.ones((len(elements), 3)), photo) for photo in photos]
    logs, stated, apart = [], [], []
    for _ in range(12):
        noisy = [
            replace(
                photo, radiance=own * (1 + 0.05 * rng.standard_normal(own.shape)), variance=(0.05 * own) ** 2
            )
            for photo, own in zip(photos, shown, strict=True)
        ]
        blind = factorize_blind(noisy, ["room"] * 3)
        found = absolute_blind(blind, [card(lighting.directions[0])])
        slopes = np.diag(-1 / (1 - blind.brdf_share))
        by = np.hstack([slopes, np.zeros((3, len(blind.covariance_names) - 3)), np.eye(3)])
        logs.append(np.log((1 - blind.brdf_share) * found.scale.factor))
        stated.append(np.diag(by @ found.covariance @ by.T))
        apart.append(np.log(1 - blind.brdf_share))
    scatter, shares = np.std(logs, axis=0, ddof=1), np.std(apart, axis=0, ddof=1)
    # 36 numbers tell a deviation to 12%; three channels' means are compared.
    assert 0.6 < scatter.mean() / np.sqrt(np.mean(stated)) < 1.3
    # Errors of light and of Kd cancel: neither is known as well alone.
    assert (scatter < 0.8 * shares).all()


def solved(folder: Path) -> Run:
    """What is found of a set by a few of its pixels, few forms being tried: references tell its scale however it is."""
    with few_forms_tried(), no_causes_sought():
        return process(load_photoset(folder), samples=2000)


def check_absolute(run: Run, ks: bool = True) -> None:
    """Kd, Ks and light lie within three of their bars, and the bars hold what the card may be off by."""
    solution = run.solution
    assert solution.gauge.startswith("absolute: the ")
    assert solution.is_absolute
    for name, truth in {"kd": KD, "albedo": np.pi * KD, **({"ks": KS} if ks else {})}.items():
        found = solution.quantities[name]
        assert found.value is not None
        assert found.std is not None
        assert (np.abs(found.value - truth) < 3 * found.std).all()
        # The reflectance is known to 1%, so that nothing is known better; tilt and noise add as much again.
        assert (found.std > 0.0099 * found.value).all()
        assert (found.std < 0.025 * found.value).all()
        assert found.shares["reference"] > 0.9
    lights = np.array([own.lighting.irradiances[0] for own in solution.lightings])
    stds = np.array([own.irradiance_std[0] for own in solution.lightings])
    assert (np.abs(lights - LAMPS[:, None]) < 3 * stds).all()
    assert (stds < 0.03 * lights).all()
    assert_allclose(solution.brdf.kd, solution.quantities["kd"].value)
    document = result_document(run, {own.lighting.name: "" for own in solution.lightings}, {})
    (reference,) = document["references"]
    assert reference["photo"] == "002.exr"
    assert_allclose(reference["predicted_over_shown"], 1)
    assert reference["std_relative_by"]["reflectance"] == [0.01] * 3


@pytest.mark.parametrize("kind", ["card", pytest.param("sphere", marks=pytest.mark.slow)])
def test_lamps_of_unknown_strength_are_told_by_a_reference(copied: Callable[..., Path], kind: str) -> None:
    folder = copied()
    if kind == "card":
        add_card(folder, 2, BESIDE, FACING)
    else:
        add_sphere(folder, 2, (0, 0.0288, -0.01), 0.006)
    check_absolute(solved(forget_strength(folder)))


@pytest.mark.slow
def test_pictures_stay_as_they_are_in_another_scale(copied: Callable[..., Path]) -> None:
    free = solved(forget_strength(copied()))
    folder = copied()
    shutil.rmtree(folder)
    fixed = solved(forget_strength(add_card(copied(), 2, BESIDE, FACING)))
    # Only the gauge differs: shares, and Kd times light.
    for name in ("kd_normalised", "mu", "sigma"):
        assert_allclose(
            fixed.solution.quantities[name].value, free.solution.quantities[name].value, rtol=1e-6
        )
        assert_allclose(fixed.solution.quantities[name].std, free.solution.quantities[name].std, rtol=1e-3)

    def sent(run: Run) -> Floats:
        return run.solution.brdf.kd * np.array(
            [own.lighting.irradiances[0] for own in run.solution.lightings]
        )

    assert_allclose(sent(fixed), sent(free), rtol=1e-6)
    assert "relative" in free.solution.gauge
    photo = fixed.photoset.photos[4]
    assert_allclose(fixed.predict(photo).predicted, free.predict(photo).predicted, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("material", ["glossy", pytest.param("matte", marks=pytest.mark.slow)])
def test_all_of_the_light_being_unknown_kd_is_absolute_by_a_card(
    copied: Callable[..., Path], material: str
) -> None:
    run = solved(forget_light(add_card(copied(material), 2, BESIDE, FACING)))
    check_absolute(run, ks=material == "glossy")
    assert "kd.r" in run.solution.covariance_names
    (score,) = run.references
    words = reference_in_words(score)
    assert words.startswith("The card in 002.exr says how bright the light is to 1.")
    assert "its reflectance 1.0%" in words


def test_cards_that_disagree_are_told_and_widen_the_bars(copied: Callable[..., Path]) -> None:
    folder = add_card(copied(), 2, BESIDE, FACING)
    # Half of its light is shaded.
    add_card(folder, 5, BESIDE, (1.0, 0.0, 0.7), reflectance=0.2)
    change_manifest(folder, r"reflectance = 0\.2", lambda _: "reflectance = 0.4")
    run = solved(forget_strength(folder))
    (remark,) = (text for text in run.warnings if text.startswith("The references differ"))
    assert re.search(r"by the card in 00[25].exr Kd would be [+-]\d+%", remark)
    kd = run.solution.quantities["kd"]
    std = kd.std if kd.std is not None else np.zeros(3)
    assert kd.value is None or (std > 0.2 * kd.value).all()
    assert run.solution.gauge.startswith("absolute: the mean of 2 references")


@pytest.mark.parametrize("scale", [pytest.param(1.0, marks=pytest.mark.slow), 0.8])
def test_where_light_is_given_a_card_is_its_witness(copied: Callable[..., Path], scale: float) -> None:
    folder = add_card(copied(), 2, BESIDE, FACING, reflectance=0.4 * scale)
    change_manifest(folder, r"reflectance = 0\.4|reflectance = 0\.32\d*", lambda _: "reflectance = 0.4")
    run = solved(folder)
    assert run.solution.gauge.startswith("absolute: the given lighting")
    said = [text for text in run.warnings if "other light falls than is given" in text]
    assert len(said) == (scale != 1)
    assert not said or "-20%, -20%, -20%" in said[0]
    # A card that shows 0.8 times what it should: the light would send 1 / 0.8.
    assert_allclose(run.references[0].over_shown, 1 / scale, rtol=0.02)


@pytest.mark.slow
def test_near_lamps_ask_where_the_card_is(tmp_path: Path) -> None:
    folder = write_set(tmp_path / "near", distance=0.15, beside=44)
    change_manifest(folder, r"directional = \[\{ direction = \[(.*?)\], irradiance = \[(.*?)\]", _near_lamp)
    # The object's side of the card is nearer to the lamps than its far side by a fifth of their distance.
    add_card(folder, 2, BESIDE, FACING)
    change_manifest(folder, r"near = .*", lambda found: found[0] + '\nrecover = ["irradiance"]')
    with pytest.raises(
        ValueError, match=r"\[\[reference\]\] 1 .*the lamps are near.*give the reference's position"
    ):
        solved(folder)
    change_manifest(folder, r"(?m)^normal = ", lambda found: f"position = {list(BESIDE)}\nnormal = ")
    kd = solved(folder).solution.quantities["kd"]
    assert kd.value is not None
    assert kd.std is not None
    assert (np.abs(kd.value - KD) < 3 * kd.std).all()
    assert (kd.std < 0.03 * kd.value).all()


def _near_lamp(found: re.Match[str]) -> str:
    # What is irradiance at the centre is intensity over the distance squared.
    direction, irradiance = (np.array([float(x) for x in part.split(",")]) for part in found.groups())
    return (
        f"near = [{{ position = {(0.15 * direction).tolist()}, intensity = {(0.15**2 * irradiance).tolist()}"
    )


def test_a_card_that_faces_away_from_all_light_is_refused_before_the_fit(
    copied: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = add_card(copied(), 0, BESIDE, FACING)
    # The lamp of the first photograph stands on the camera's side, 10 degrees up.
    change_manifest(folder, r"normal = \[.*\]", lambda _: "normal = [0.05, 0, -1]")
    monkeypatch.delattr("invrender.process.known_light.explain_set")
    with pytest.raises(ValueError, match=r"\[\[reference\]\] 1 .*next to no light falls on it"):
        solved(forget_strength(folder))


def test_a_card_in_a_light_that_no_fitted_photograph_is_under_is_refused(copied: Callable[..., Path]) -> None:
    folder = forget_light(add_card(copied(), 2, BESIDE, FACING))
    # Known, as light must be that only held-out photographs are under.
    change_manifest(folder, r'(name = "lamp 2"\n)unknown = true\ndark = true', _given_lamp)
    change_manifest(folder, r'(file = "002\.exr"\n)', lambda found: found[0] + "held_out = true\n")
    with pytest.raises(ValueError, match=r"\[\[reference\]\] 1 .*its light 'lamp 2' is on no photograph"):
        solved(folder)


def _given_lamp(found: re.Match[str]) -> str:
    return found[1] + "directional = [{ direction = [1, 0, 0], irradiance = [1, 1, 1] }]"


SOFT = """format = 1
name = "soft"
object = {{ shape = "sphere", radius = 0.02, stated = true }}
camera = {{ width = 112, height = 68, focal_px = 918 }}
sensor = {{ noise = 0.02 }}
seed = {seed}
[material]
{material}
[[lighting]]
name = "room"
area = [
    {{ azimuth_deg = 20, elevation_deg = 40, radiance = 4.0, width_deg = 25 }},
    {{ azimuth_deg = -80, elevation_deg = 10, radiance = [1.0, 1.2, 1.5], width_deg = 37 }},
    {{ azimuth_deg = 180, elevation_deg = 0, radiance = 1.0, width_deg = 60 }},
]
"""
VIEWS = ((0, 0), (45, 10), (90, -20), (135, 20), (180, 0), (-45, 30), (-90, -10), (-135, 0))


def soft_set(folder: Path, seed: int) -> Path:
    """A glossy sphere from all sides in soft light that its set doesn't give."""
    folder.mkdir()
    views = "".join(
        f'[[view]]\nazimuth_deg = {a}\nelevation_deg = {e}\nlighting = "room"\n' for a, e in VIEWS
    )
    (folder / "staged.toml").write_text(SOFT.format(seed=seed, material=GLOSSY) + views)
    write_photoset(read_staging(folder / "staged.toml"), folder)
    return folder


@pytest.mark.slow
def test_in_soft_unknown_light_the_card_tells_as_well_as_it_claims(tmp_path: Path) -> None:
    folder = add_card(soft_set(tmp_path / "soft", 0), 0, BESIDE, (0.6, 0.0, -1.0), reflectance=0.4)
    # All that is uncertain now are the card's noise and the light by the fit.
    change_manifest(folder, r"reflectance_std = 0\.01", lambda _: "reflectance_std = 0.0")
    solution = solved(forget_light(folder)).solution
    kd = solution.quantities["kd"]
    assert kd.value is not None
    assert kd.std is not None
    assert (np.abs(kd.value - KD) < 3 * kd.std).all()
    assert (kd.std < 0.01 * kd.value).all()
    # The light's mean, by pixels of the map that the scene was lit by, is absolute, too.
    harmonics = solution.lightings[0].harmonics
    assert harmonics is not None
    assert (np.abs(harmonics.coefficients[0] - [3.727, 3.881, 4.110]) < 3 * harmonics.std[0]).all()


@pytest.mark.sweep
def test_bars_of_absolute_kd_cover_over_draws(tmp_path: Path) -> None:
    off = []
    for seed in range(12):
        folder = soft_set(tmp_path / f"soft{seed}", seed)
        add_card(
            folder, 0, BESIDE, np.random.default_rng(seed).uniform([0.5, -0.7, -0.7], [1, 0.7, 0.7]).tolist()
        )
        change_manifest(folder, r"reflectance_std = 0\.01", lambda _: "reflectance_std = 0.0")
        kd = process(load_photoset(forget_light(folder))).solution.quantities["kd"]
        assert kd.value is not None
        off.append((kd.value - KD) / kd.std)
    # Neighbouring pixels count as a quarter of them; here they are independent, so that bars are up to twice too wide.
    assert np.abs(off).max() < 3
    assert 0.3 < np.sqrt(np.mean(np.square(off))) < 1.3


@pytest.mark.slow
def test_paint_in_unknown_light_is_absolute_by_a_card(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Forms of the lobe are told apart elsewhere; here each costs seconds.
    monkeypatch.setattr("invrender.estimate.textured.fit.OTHER_FORMS", ())
    scene = BALL.replace("width = 56", "width = 100")
    folder = write_ball_set(tmp_path, scene, np.full((4, 4, 3), PAINT))
    camera = load_photoset(folder).photos[1].camera.camera_to_world
    add_card(folder, 1, 0.042 * camera[:3, 0], -camera[:3, 2], (0.014, 0.014))
    with few_forms_tried():
        run = process(load_photoset(forget_light(folder)), samples=1000)
    assert run.textures is not None
    assert run.solution.is_absolute
    truth = PAINT * np.ones(3)
    known = run.textures.known
    off = (run.textures.kd[known] - truth) / truth
    # 2% of noise per texel; the scale is what is judged.
    assert np.abs(np.median(off, axis=0)).max() < 0.02
    share = np.median(run.textures.kd_std[known] / truth, axis=0)
    assert ((share > 0.01) & (share < 0.06)).all()
    lamp = run.solution.lightings[0]
    assert (np.abs(lamp.lighting.irradiances[0] - [1.2, 1.1, 1.0]) < 3 * lamp.irradiance_std[0]).all()
    assert (lamp.irradiance_std < 0.05).all()
