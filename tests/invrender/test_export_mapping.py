"""Which numbers of other renderers' materials a fitted BRDF has."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad

from capture.lighting import latlong_directions
from invrender.brdf.form import Angles
from invrender.brdf.lobes import BECKMANN, GGX_FORM, PLASTICS
from invrender.brdf.microfacet import Microfacet
from invrender.output.export.directions import direction_pairs
from invrender.output.export.gltf_target import GLTF
from invrender.output.export.lights import panorama
from invrender.output.export.mapping import map_brdf
from invrender.output.export.materialx_target import STANDARD_SURFACE, OpenPbr, StandardSurface
from invrender.output.export.mitsuba_target import MITSUBA, MitsubaBlend
from invrender.output.export.rough_interface import passed_and_kept
from invrender.output.export.target import Numbers
from recon.mesh.tessellated import tessellated
from recon.mesh.trianglemesh import is_watertight, volume
from synthetic.materials.fresnel import fresnel_dielectric
from synthetic.materials.rh01 import RH01_MATERIALS, radiometric

KD, KS = np.array([0.1, 0.12, 0.15]), np.array([0.03, 0.02, 0.025])
CENTRE, RADIUS = np.array([0.001, 0.0, -0.001]), 0.02


@pytest.mark.parametrize("width", [0.03, 0.1, 0.4])
def test_directions_integrate_matte_reflection_and_facets(width: float) -> None:
    pairs = direction_pairs(width)
    # A matte white reflects all of uniform light; the horizon cuts through the rule's panels, which costs up to 0.6%.
    assert_allclose(pairs.per_view(pairs.angles.cos_i[:, None] / np.pi), 1, atol=7e-3)
    # Facets seen head-on, each at its angle: D cos theta_h integrates to 1, most of it above the horizon.
    front = pairs.views.argmax()
    lobe = (
        GGX_FORM.density(pairs.angles.theta_h, width)
        * np.cos(pairs.angles.theta_h)
        / (4 * pairs.angles.cos_d)
    )
    assert pairs.per_view(lobe[:, None])[front, 0] == pytest.approx(1, abs=1.5 * width**2 + 2e-3)
    assert np.degrees(np.arccos(pairs.views.min())) == pytest.approx(81, abs=0.5)


def test_what_mitsuba_has_is_found_in_its_own_numbers() -> None:
    for target, form in zip(MITSUBA[:2], (BECKMANN, GGX_FORM), strict=True):
        mapping = map_brdf(Microfacet(KD, KS, 1.5, 0.15, form), MITSUBA)
        # What is left is shadowing, correlated with us: next to nothing but at grazing light.
        assert mapping.target is target
        assert mapping.relative_rms < 0.008
        numbers = mapping.numbers
        assert numbers.alpha == pytest.approx(0.15, abs=1e-3)
        assert numbers.fresnel == pytest.approx(1.5, abs=0.02)
        assert_allclose(numbers.base, np.pi * KD, rtol=2e-3)
        # F(1.5, 0) is 0.04.
        assert_allclose(numbers.specular, KS / 0.04, rtol=0.03)


def test_a_plastic_is_mitsubas_roughplastic() -> None:
    brdf = Microfacet(np.array([0.1, 0.07, 0.05]), np.full(3, 0.04), 1.5, 0.1, PLASTICS[BECKMANN])
    mapping = map_brdf(brdf, MITSUBA)
    assert mapping.target.model == "Mitsuba roughplastic (beckmann)"
    # Its interface is as rough as the lobe, ours smooth.
    assert mapping.relative_rms < 0.005
    assert_allclose([mapping.numbers.alpha, mapping.numbers.fresnel], [0.1, 1.5], rtol=0.005)
    # Without such a base it is the blend that is nearest, and by far not as near.
    assert map_brdf(brdf, MITSUBA[:2]).relative_rms > 5 * mapping.relative_rms


def test_a_nearly_smooth_interface_passes_what_a_smooth_one_does() -> None:
    cos = np.array([0.2, 0.5, 1.0])
    passed, kept = passed_and_kept(BECKMANN, 0.01, 1.5, cos)
    # Between the table's cosines Fresnel's equations bend.
    assert_allclose(passed, 1 - fresnel_dielectric(1.5, cos), rtol=3e-3)
    # By reversibility as much of diffuse light comes out as went in, spread over mu^2 as many directions.
    comes_in = quad(lambda cos: 2 * cos * (1 - fresnel_dielectric(1.5, cos)), 0, 1)[0]
    # Mitsuba's mean over 64 cosines counts both ends whole: 1 part in 64 of what is kept at the steepest, 0.55.
    assert_allclose(kept, 1 - comes_in / 1.5**2, atol=0.01)


def test_a_lobe_without_fresnel_is_gltfs_with_a_high_index() -> None:
    mapping = map_brdf(Microfacet(KD, KS, None, 0.2, GGX_FORM), [GLTF])
    assert mapping.relative_rms < 0.02
    assert_allclose(mapping.numbers.fresnel * mapping.numbers.specular, KS, rtol=0.05)
    # What the lobe takes from the base is made up for.
    assert_allclose(mapping.numbers.base, np.pi * KD / (1 - KS.max()), rtol=0.02)


def test_a_metal_is_gltfs_lobe_over_black() -> None:
    gold = np.array([0.95, 0.7, 0.4])
    numbers = map_brdf(Microfacet(np.zeros(3), gold, None, 0.2, GGX_FORM), [GLTF]).numbers
    # Schlick's factor rises to white, ours is flat: a trace of blue below makes up for it.
    assert_allclose(numbers.fresnel * numbers.specular, gold, atol=0.03)
    assert numbers.base.max() < 0.04


def test_rh01s_lobe_is_mapped_as_well_as_the_page_says() -> None:
    material = radiometric(RH01_MATERIALS["teflon"])
    brdf = Microfacet(material.kd, material.ks, material.mu, material.sigma)
    for targets, rms, front in (
        ([GLTF], 0.090, 0.027),
        (MITSUBA, 0.069, 0.004),
        ([STANDARD_SURFACE], 0.095, 0.024),
    ):
        mapping = map_brdf(brdf, targets)
        assert mapping.relative_rms == pytest.approx(rms, abs=0.003)
        assert mapping.view_rms[mapping.view_deg.argmin()] == pytest.approx(front, abs=0.002)
        # No target lets facets hide nothing of each other: the difference grows towards grazing views.
        assert mapping.view_rms.argmax() == mapping.view_deg.argmax()
        assert mapping.worst.view_deg > 80
        assert mapping.worst.theirs < mapping.worst.ours


def test_formulas_at_normal_incidence_are_what_the_specifications_say() -> None:
    along = Angles(*(np.array([value]) for value in (0.0, 1.0, 1.0, 1.0)))
    alpha, factor, f0, base = 0.3, 0.7, np.array([0.04, 0.1, 0.2]), np.array([0.5, 0.4, 0.3])
    # D = 1 / (pi alpha^2), no shadowing, V = 1/4; the base gets what the strongest channel leaves.
    lobe = 1 / (4 * np.pi * alpha**2)
    numbers = Numbers(alpha, factor, base, f0)
    expected = factor * f0 * lobe + base / np.pi * (1 - factor * 0.2)
    assert_allclose(GLTF.reflected(along, numbers)[0], expected, rtol=1e-12)
    numbers = Numbers(alpha, 1.5, base, f0)
    for target in (MitsubaBlend("beckmann", BECKMANN), MitsubaBlend("ggx", GGX_FORM)):
        assert_allclose(target.reflected(along, numbers)[0], 0.04 * f0 * lobe + base / np.pi, rtol=1e-12)


def test_white_standard_surface_keeps_all_light() -> None:
    pairs = direction_pairs(0.2)
    white = Numbers(0.2, 1.5, np.ones(3), np.ones(3))
    # The layer reflects E of uniform light and the base the rest; the rule as above.
    surface = StandardSurface()
    assert_allclose(pairs.per_view(surface.reflected(pairs.angles, white)), 1, atol=7e-3)
    single = GGX_FORM.shape(pairs.angles, 0.2)[:, None]
    lobe = surface.lobe(pairs.angles, Numbers(0.2, 1e6, np.ones(3), np.ones(3)))
    # Of a perfect mirror the light that bounces between facets is made up for, too.
    assert_allclose(pairs.per_view(lobe), 1, atol=7e-3)
    assert (pairs.per_view(single) < 0.999).all()


def test_open_pbr_tints_the_layer_and_not_what_it_leaves() -> None:
    pairs = direction_pairs(0.2)
    white = Numbers(0.2, 1.5, np.ones(3), np.ones(3))
    surface, tint, base = OpenPbr(), np.array([0.2, 0.5, 1.0]), np.array([0.7, 0.4, 0.1])
    reflected = pairs.per_view(surface.lobe(pairs.angles, white))
    expected = tint * reflected + base * (1 - reflected)
    found = pairs.per_view(surface.reflected(pairs.angles, Numbers(0.2, 1.5, base, tint)))
    # The rule's own error, as above.
    assert_allclose(found, expected, atol=7e-3)
    matte = pairs.per_view(surface.reflected(pairs.angles, surface.matte(base)))
    assert_allclose(matte, np.broadcast_to(base, matte.shape), atol=7e-3)


def test_the_sphere_of_triangles_is_one() -> None:
    mesh = tessellated(CENTRE, RADIUS)
    assert is_watertight(mesh)
    assert volume(mesh) == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=2e-3)
    assert_allclose(mesh.vertices, CENTRE + RADIUS * mesh.normals, atol=1e-12)
    assert mesh.uv is not None
    up, left = mesh.normals[:, 2] > 1 - 1e-9, np.isclose(mesh.uv, [0.25, 0.5]).all(axis=1)
    assert_allclose(mesh.uv[up, 1], 1)
    assert_allclose(mesh.normals[left], [[0, 1, 0]], atol=1e-12)


def test_panoramas_are_seen_from_inside() -> None:
    directions = latlong_directions(16).astype(np.float32)
    seen = panorama(directions)
    # In the middle +X, a quarter to the left +Y, above +Z; texels are 11 degrees wide.
    for row, column, axis in ((8, 16, 0), (8, 8, 1), (0, 5, 2)):
        assert seen[row, column] @ np.eye(3)[axis] > 0.98
