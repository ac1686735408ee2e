"""A base under a smooth interface: its albedo, reciprocity, directions drawn for it, and Mitsuba's plastic."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from synthetic.materials.facets import GGXSlopes
from synthetic.materials.material import sample_cosine
from synthetic.materials.plastic import Plastic
from synthetic.materials.smith import SmithMaterial
from synthetic.render.lattice import lattice

BASE = np.array([0.2, 0.1, 0.05])
MATTE = Plastic(SmithMaterial(BASE, np.zeros(3), 1.5, GGXSlopes(0.3, 0.3)))
GLOSSY = Plastic(SmithMaterial(BASE, np.full(3, 0.04), 1.5, GGXSlopes(0.3, 0.3)))


def directions(rng: np.random.Generator, count: int) -> np.ndarray:
    return sample_cosine(rng.uniform(0.02, 1, (count, 2)))


def test_under_light_from_all_sides_the_base_reflects_pi_base() -> None:
    # Light and viewer by the cosine both: the mean over pairs is the BRDF's, and pi times it the albedo.
    pairs = np.random.default_rng(0).permuted(np.tile(lattice(1 << 14)[:, None], (1, 2, 1)), axis=0)
    light, view = sample_cosine(pairs[:, 0]), sample_cosine(pairs[:, 1])
    # Of values that differ by a fifth, 16,000 leave 1.5e-3.
    assert_allclose(MATTE.lobe(light, view).mean(axis=0), BASE, rtol=5e-3)


def test_light_and_viewer_may_change_places(rng: np.random.Generator) -> None:
    light, view = directions(rng, 50), directions(rng, 50)
    assert_allclose(GLOSSY.lobe(light, view), GLOSSY.lobe(view, light), rtol=1e-12)


def test_directions_are_drawn_as_densely_as_is_told() -> None:
    view = np.array([0.6, 0.0, 0.8])
    drawn = GLOSSY.sample(np.broadcast_to(view, (1 << 14, 3)), lattice(1 << 14))
    weight = np.maximum(drawn[:, 2:], 0) / GLOSSY.density(drawn, view)[:, None]
    even = sample_cosine(lattice(1 << 16))
    # By cosine alone, of whose draws the lobe's few weigh most: 1e-3.
    expected = np.pi * GLOSSY.lobe(even, view).mean(axis=0)
    assert_allclose((GLOSSY.lobe(drawn, view) * weight).mean(axis=0), expected, rtol=5e-3)


def test_an_interface_without_a_real_index_is_refused() -> None:
    with pytest.raises(
        ValueError, match="mu is None; the interface of a plastic has a real refractive index"
    ):
        Plastic(SmithMaterial(BASE, np.zeros(3), None, GGXSlopes(0.3, 0.3)))


def test_the_base_is_that_of_mitsubas_plastic(rng: np.random.Generator) -> None:
    mi = pytest.importorskip("mitsuba", reason="needs the extra `reference`")
    mi.set_variant("scalar_rgb")
    theirs = mi.load_dict({"type": "plastic", "int_ior": 1.5, "ext_ior": 1.0, "diffuse_reflectance": 0.5})
    light, view = directions(rng, 40), directions(rng, 40)
    shown = np.empty(40)
    for k in range(40):
        hit = mi.SurfaceInteraction3f()
        hit.wi = mi.Vector3f(view[k])
        # Off the mirrored direction, where smooth gloss is, the base is all that there is.
        shown[k] = theirs.eval(mi.BSDFContext(), hit, mi.Vector3f(light[k]))[0] / light[k, 2]
    ratio = shown / MATTE.lobe(light, view)[:, 0]
    # Single precision; what bounces below the interface is a factor.
    assert_allclose(ratio, ratio.mean(), rtol=1e-4)
