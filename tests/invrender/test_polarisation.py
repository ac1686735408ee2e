"""Photographs through polarising filters: base and lobe in their shares, the extinction with its bar, refusals."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from capture.photoset import load_photoset
from capture.polarisation import Extinction, Polariser
from invrender.brdf.lobes import GGX_FORM
from invrender.brdf.microfacet import Microfacet
from invrender.estimate.unknown_light.lighting_design import LightingDesign
from invrender.estimate.unknown_light.rows import rows_of
from invrender.estimate.unknown_light.state import BlindState
from invrender.process.pipeline import process
from invrender.result.document import result_document
from invrender.result.sentences import filters_in_words
from invrender.transport.columns import photo_columns
from invrender.transport.predict import predict, predict_columns
from invrender.transport.transfer import light_elements
from tests.invrender.faultysets import change_manifest, write_scene
from tests.invrender.polarisedsets import write_pairs
from tests.invrender.test_textures import LAMP_LIT

Floats = NDArray[np.float64]

EXTINCTION = 0.013
CROSSED = Polariser("cross", 0.5, EXTINCTION)
PARALLEL = Polariser("parallel", 0.5, EXTINCTION)


@pytest.fixture(scope="module")
def pairs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pairs")
    return write_pairs(folder, glossy_scene(folder), EXTINCTION)


def glossy_scene(folder: Path) -> Path:
    """The scene of a glossy sphere under a lamp per photograph."""
    return write_scene(folder / "scene")


def test_all_routes_to_radiance_show_base_and_lobe_in_the_filters_shares(bench) -> None:
    lighting = bench.known_lighting()
    elements = light_elements(lighting)
    strengths = np.ones((len(elements), 3))
    field = bench.sphere_field(20.0, sources=lighting.directions)
    kd, ks = np.array([0.2, 0.16, 0.12]), np.full(3, 0.04)
    share = ks / (kd + ks)
    state = BlindState(share, 1.6, 0.12, lighting.directions, owners=np.zeros(1, int))
    light = np.full((26, 3), 0.5)

    def routes(polariser: Polariser | None, kd: Floats, ks: Floats) -> list[Floats]:
        seen = field.through(polariser)
        own = Microfacet(kd, ks, 1.6, 0.12)
        blind = rows_of(LightingDesign.of([seen], 4), state, 4)
        columns = photo_columns("light", elements, seen)
        base, lobe = blind.parts(light)
        return [
            predict(own, elements, strengths, seen),
            predict_columns(columns, own, strengths),
            (1 - share) * base * kd.any() + share * lobe * ks.any(),
        ]

    base, lobe = routes(None, kd, 0 * ks), routes(None, 0 * kd, ks)
    for polariser, passed in ((CROSSED, 2 * EXTINCTION), (PARALLEL, 2.0)):
        for below, above, shown in zip(base, lobe, routes(polariser, kd, ks), strict=True):
            assert above.max() > 0.01
            # Columns and rows are single precision.
            assert_allclose(shown, below + passed * above, rtol=2e-5, atol=1e-6)


def test_the_extinction_is_found_with_its_bar_and_the_brdf_beside_it(pairs: Path, few_forms) -> None:
    run = process(load_photoset(pairs), 3000, causes=False)
    found, quantities = run.photoset.extinction, run.solution.quantities
    assert found is not None
    assert found.origin == "found"
    # Noise of 1% at lobes that a crossed filter makes a hundredth of.
    assert 5e-5 < found.std < 5e-4
    assert abs(found.value - EXTINCTION) < 3 * found.std
    for name, truth in (("kd", [0.2, 0.16, 0.12]), ("ks", [0.04] * 3), ("sigma", [0.12]), ("mu", [1.6])):
        quantity = quantities[name]
        assert quantity.value is not None
        assert quantity.std is not None
        # Two of twelve numbers may be beyond two deviations; none beyond four.
        assert (np.abs(quantity.value - truth) < 4 * quantity.std).all(), name
    assert quantities["kd"].shares["extinction"] > 0
    # A crossed photograph is predicted as one, down to the noise of 1%.
    crossed = next(photo for photo in run.photoset.photos if "cross" in photo.name)
    assert run.predict(crossed).error.rms < 0.012
    assert f"crossed ones pass {100 * found.value:.2f}" in filters_in_words(found)
    document = result_document(run, {light.lighting.name: "" for light in run.solution.lightings}, {})
    assert document["polarisation"] == {
        "extinction": found.value,
        "extinction_std": found.std,
        "origin": "found",
    }


@pytest.mark.sweep
def test_bars_of_the_extinction_hold_it(tmp_path: Path, few_forms) -> None:
    scene, scores = glossy_scene(tmp_path), []
    for seed in range(8):
        run = process(
            load_photoset(write_pairs(tmp_path / str(seed), scene, 0.02, noise=0.02, seed=seed)),
            2000,
            causes=False,
        )
        assert run.photoset.extinction is not None
        scores.append((run.photoset.extinction.value - 0.02) / run.photoset.extinction.std)
    # Chi-squared of eight is within 1.3 and 21 in 99 of 100 cases.
    assert 1.3 < np.sum(np.square(scores)) < 21


@pytest.mark.sweep
def test_the_extinction_is_found_in_unknown_light(pairs: Path, tmp_path: Path, few_forms) -> None:
    folder = Path(shutil.copytree(pairs, tmp_path / "set"))
    change_manifest(folder, "directional = .*", lambda _: "unknown = true")
    run = process(load_photoset(folder), 6000, causes=False)
    found, share = run.photoset.extinction, run.solution.quantities["ks"]
    assert found is not None
    assert abs(found.value - EXTINCTION) < 3 * found.std
    assert share.value is not None
    assert share.std is not None
    assert (np.abs(share.value - [1 / 6, 0.2, 0.25]) < 4 * share.std).all()


@pytest.mark.slow
def test_a_painted_surface_tells_the_extinction_too(
    tmp_path: Path, few_forms, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("invrender.process.extinction", "invrender.estimate.textured.fit"):
        monkeypatch.setattr(f"{module}.OTHER_FORMS", (GGX_FORM,))
    (tmp_path / "doll.toml").write_text(LAMP_LIT.replace("photos = 6", "photos = 4"))
    folder = write_pairs(tmp_path, tmp_path / "doll.toml", EXTINCTION)
    run = process(load_photoset(folder), 2000)
    found = run.photoset.extinction
    assert found is not None
    assert abs(found.value - EXTINCTION) < 3 * found.std < 3e-3
    # Of six photographs without filters mu's deviation is 0.18.
    for name, truth, most in (("mu", 2.2, 0.04), ("sigma", 0.12, 0.002)):
        quantity = run.solution.quantities[name]
        assert quantity.value is not None
        assert quantity.std is not None
        assert abs(quantity.value[0] - truth) < 4 * quantity.std[0] < 4 * most
    change_manifest(folder, "directional = .*", lambda _: "unknown = true")
    with pytest.raises(ValueError, match="isn't found with texture = true in unknown light"):
        process(load_photoset(folder), 3000)


def test_a_given_extinction_is_taken_and_its_deviation_widens_bars(
    pairs: Path, tmp_path: Path, few_forms
) -> None:
    folder = Path(shutil.copytree(pairs, tmp_path / "set"))
    change_manifest(
        folder,
        r"transmission = 0.4\n",
        lambda _: "transmission = 0.4\nextinction = 0.018\n\n[uncertainty]\nextinction = 0.005\n",
    )
    photoset = load_photoset(folder)
    run = process(photoset, 1500, causes=False)
    assert run.photoset.extinction == photoset.extinction == Extinction(0.018, 0.005, "given")
    kd = run.solution.quantities["kd"]
    assert kd.value is not None
    assert kd.std is not None
    # One deviation off, of which the bar knows; what that leaves counts as misfit beside it.
    assert kd.shares["extinction"] > 0.1
    assert (np.abs(kd.value - [0.2, 0.16, 0.12]) < 2.5 * kd.std).all()


def _only_crossed(folder: Path) -> None:
    path = folder / "photoset.toml"
    head, *photos = path.read_text().split("[[photo]]\n")
    path.write_text("[[photo]]\n".join([head, *(photo for photo in photos if "cross" in photo)]))


def _edited(pattern: str, replacement: str) -> Callable[[Path], object]:
    return lambda folder: change_manifest(folder, pattern, lambda _: replacement)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (
            _edited('polarisation = "cross"\nfile = "003', 'file = "003'),
            r'15 of 16 photographs, but not of "003-cross',
        ),
        (
            _edited('polarisation = "(cross|parallel)"\n', ""),
            r"\[polarisation\] is of filters, but no \[\[photo\]\]",
        ),
        (_only_crossed, r"all photographs that are fitted are crossed.*add parallel ones"),
        (_edited('"cross"', '"crossed"'), r"polarisation"),
        (_edited("transmission = 0.4", "transmission = 0.7"), r"transmission"),
        (_edited("transmission = 0.4", "extinction = 1.0"), r"extinction"),
        (
            _edited(r"\[polarisation\]\n", "[uncertainty]\nextinction = 0.01\n[polarisation]\n"),
            r"deviation of a number",
        ),
    ],
)
def test_what_is_wrong_with_filters_is_said(
    pairs: Path, tmp_path: Path, damage: Callable[[Path], object], message: str
) -> None:
    folder = Path(shutil.copytree(pairs, tmp_path / "set"))
    damage(folder)
    with pytest.raises(ValueError, match=f"photoset.toml.*{message}"):
        load_photoset(folder)


@pytest.mark.parametrize(
    "command", [("brdf",), ("light", "--brdf", "truth.json"), ("factor",), ("process", "--published")]
)
def test_who_does_not_know_filters_refuses_them(
    pairs: Path, tmp_path: Path, command: tuple[str, ...], lightfactor: Callable[..., tuple[int, str, str]]
) -> None:
    truth = {"truth.json": pairs.parent / "whole" / "truth.json"}
    options = [truth.get(option, option) for option in command[1:]]
    code, _, err = lightfactor(command[0], pairs, "-o", tmp_path / "out", *options)
    assert code != 0
    assert re.search("polarising filters.*only `lightfactor process`", " ".join(err.split()))


@pytest.mark.slow
def test_filters_that_hardly_cross_are_named(tmp_path: Path, few_forms) -> None:
    run = process(load_photoset(write_pairs(tmp_path, glossy_scene(tmp_path), 0.4)), 2000, causes=False)
    assert any("Crossed filters pass 40% of the highlights" in warning for warning in run.warnings)
