"""Albedos against closed forms, and materials that reflect more than they receive."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from synthetic.materials.energy import bihemispherical_albedo, check_energy, directional_albedo
from synthetic.materials.facets import BeckmannSlopes, GGXSlopes
from synthetic.materials.lambertian import Lambertian
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.materials.mirror import Mirror
from synthetic.materials.phong import PhongMaterial
from synthetic.materials.rh01 import RH01_MATERIALS, exact, radiometric
from synthetic.materials.smith import SmithMaterial
from synthetic.materials.texture import Textured

ZERO, ONE = np.zeros(3), np.ones(3)
COSINES = np.cos(np.radians([0.0, 1.0, 30.0, 60.0, 80.0, 89.9]))
QUADRATURE = 1e-3  # what it claims to be good to, of the albedo


def test_a_lobe_that_is_constant_has_the_albedo_of_a_matte_surface() -> None:
    # Phong with exponent 0 is 1 / pi, but goes through the quadrature.
    colour = np.array([0.2, 0.5, 0.9])
    matte = np.broadcast_to(colour, (6, 3))
    assert_allclose(directional_albedo(PhongMaterial(ZERO, colour, 0.0), COSINES), matte, rtol=QUADRATURE)
    assert_allclose(directional_albedo(Lambertian(colour / np.pi), COSINES), matte, rtol=1e-12)
    assert_allclose(bihemispherical_albedo(PhongMaterial(ZERO, colour, 0.0)), colour, rtol=QUADRATURE)


@pytest.mark.parametrize("exponent", [1.0, 7.5, 3000.0])
def test_phong_reflects_all_at_normal_incidence(exponent: float) -> None:
    assert_allclose(directional_albedo(PhongMaterial(ZERO, ONE, exponent), 1.0), np.ones((1, 3)), rtol=1e-6)


def test_rh01_facets_at_normal_exitance_by_a_single_integral() -> None:
    # At the normal, dwi = 4 cos_h dwh, so the albedo is the integral of S cos_h over the cap theta_h < pi/4.
    sigma = 0.2
    node, weight = np.polynomial.legendre.leggauss(100)
    theta = (node + 1) * np.pi / 8
    bell = np.exp(-((theta / sigma) ** 2)) / (np.pi * sigma**2)
    expected = (bell * np.cos(theta) * np.sin(theta) * 2 * np.pi) @ weight * np.pi / 8
    assert_allclose(
        directional_albedo(MicrofacetMaterial(ZERO, ONE, None, sigma), 1.0)[0], ONE * expected, rtol=1e-6
    )


@pytest.mark.parametrize("kind", [BeckmannSlopes, GGXSlopes])
@pytest.mark.parametrize("width", [0.003, 0.05, 0.3, 1.0, 3.0])
def test_facets_reflect_no_more_than_they_receive(kind: type[GGXSlopes], width: float) -> None:
    albedo = directional_albedo(SmithMaterial(ZERO, ONE, None, kind(width, width)), COSINES)
    assert (albedo < 1 + QUADRATURE).all()
    # One bounce loses what other facets catch: nothing of it when smooth and seen from above.
    lost = 1 - albedo[0, 0]
    assert lost < 4 * width**2
    if width < 1:
        check_energy(SmithMaterial(ZERO, ONE, None, kind(width, 2 * width)))


def test_brushed_facets_reflect_as_they_do_when_turned() -> None:
    along, across = (SmithMaterial(ZERO, ONE, None, GGXSlopes(a, b)) for a, b in ((0.1, 0.4), (0.4, 0.1)))
    cos = COSINES[2:]
    turned = directional_albedo(across, cos, azimuth=np.pi / 2)
    assert_allclose(directional_albedo(along, cos), turned, rtol=1e-9)
    assert not np.allclose(turned, directional_albedo(across, cos), rtol=0.01)
    assert_allclose(bihemispherical_albedo(along), bihemispherical_albedo(across), rtol=1e-9)


@pytest.mark.parametrize("name", RH01_MATERIALS)
def test_the_measured_spheres_are_possible(name: str) -> None:
    check_energy(radiometric(RH01_MATERIALS[name]))
    check_energy(exact(RH01_MATERIALS[name]))


def test_of_a_textured_material_the_maps_count() -> None:
    # Not the material that lends its lobe.
    kd_map = np.array([[[0.31, 0.1, 0.1], [0.1, 0.1, 0.1]]])
    check_energy(Textured(PhongMaterial(ONE, ONE, 9.0), kd_map, np.zeros((1, 1, 3))))


def test_printed_form_is_judged_by_its_mean() -> None:
    # It grows without bound towards grazing, and would be refused there.
    material = MicrofacetMaterial(ZERO, ONE * 0.9, None, 0.1)
    assert directional_albedo(material, np.cos(np.radians(89.5))).min() > 2
    check_energy(material)


@pytest.mark.parametrize(
    ("material", "message"),
    [
        (Lambertian(np.array([0.1, 0.39, 0.2])), r"1\.23 of .*\(green, at"),
        (
            PhongMaterial(np.array([0.0, 0.0, 0.2]), ONE * 0.5, 20.0),
            r"1\.13 of .*\(blue, at 0 degrees exitance\)",
        ),
        # 0.1 / F(1.5, 0) = 2.5 at grazing.
        (Mirror(ZERO, ONE * 0.1, 1.5), r"2\.\d\d of .*\(red, at 90 degrees exitance\): lower kd or ks"),
        (SmithMaterial(ZERO, ONE * 0.1, 1.5, GGXSlopes(0.05, 0.2)), r"at 90 degrees"),
        (
            MicrofacetMaterial(np.array([0.1, 0.1, 0.3]), ONE * 0.2, None, 0.1),
            r"1\.14 of .*\(blue, of the light from all",
        ),
        (
            Textured(
                PhongMaterial(ONE, ONE, 9.0), np.full((1, 1, 3), 0.1), np.array([[[0.1] * 3, [0.8] * 3]])
            ),
            r"1\.11",
        ),
    ],
)
def test_materials_that_reflect_too_much_are_refused(material: SmithMaterial, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        check_energy(material)
