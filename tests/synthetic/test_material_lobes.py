"""What every lobe keeps to: reciprocity, the horizon, its dtype, and samples as dense as it says."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import chi2

from synthetic.materials.energy import directional_albedo
from synthetic.materials.facets import BeckmannSlopes, GGXSlopes
from synthetic.materials.fresnel import fresnel_conductor, fresnel_dielectric
from synthetic.materials.lambertian import Lambertian
from synthetic.materials.material import Material
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.materials.mirror import Mirror
from synthetic.materials.phong import PhongMaterial
from synthetic.materials.rh01 import RH01_MATERIALS, exact, radiometric
from synthetic.materials.smith import SmithMaterial
from synthetic.materials.tabulated import Tabulated, bin_centres
from synthetic.vectors import mirrored

ZERO, ONE = np.zeros(3), np.ones(3)


def table_of_a_lobe(width: float) -> np.ndarray:
    """A table (30, 30, 24, 3) of something smooth that depends on all coordinates."""
    angles = bin_centres((30, 30, 24))
    bell = np.exp(-((angles.theta_h / width) ** 2)) * (1 + angles.theta_d**2)
    value = 0.1 + bell * (1 + 0.2 * np.sin(angles.phi_d) * angles.theta_h)
    return value[..., None] * np.array([1.0, 0.5, 0.2])


MATERIALS = {
    "printed": MicrofacetMaterial(ZERO, ONE, None, 0.3),
    "beckmann": SmithMaterial(ZERO, ONE, None, BeckmannSlopes(0.3, 0.3)),
    "ggx": SmithMaterial(ZERO, ONE, 1.5, GGXSlopes(0.25, 0.25)),
    "brushed": SmithMaterial(ZERO, ONE, 0.2 + 3.9j, GGXSlopes(0.15, 0.5)),
    "phong": PhongMaterial(ZERO, ONE, 20.0),
    "table": Tabulated(ZERO, ONE, table_of_a_lobe(0.3)),
    "matte": Lambertian(ONE / 4),
}
RECIPROCAL = [name for name in MATERIALS if name != "matte"]


def direction(theta: float, phi: float) -> np.ndarray:
    return np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])


def hemisphere(rng: np.random.Generator, count: int) -> np.ndarray:
    w = rng.normal(size=(count, 3))
    w[:, 2] = np.abs(w[:, 2])
    return w / np.linalg.norm(w, axis=1, keepdims=True)


@pytest.mark.parametrize("name", RECIPROCAL)
def test_light_and_viewer_can_be_exchanged(name: str, rng: np.random.Generator) -> None:
    wi, wo = hemisphere(rng, 2000), hemisphere(rng, 2000)
    lobe = MATERIALS[name].lobe(wi, wo)
    assert lobe.max() > 0.5
    # Rounding, at grazing angles; far out on a bell it counts for more.
    assert_allclose(lobe, MATERIALS[name].lobe(wo, wi), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", MATERIALS)
def test_lobe_is_zero_below_the_horizon_and_finite_above(name: str, rng: np.random.Generator) -> None:
    material = MATERIALS[name]
    w = np.concatenate([hemisphere(rng, 50), np.eye(3), [direction(np.pi / 2 - 1e-7, 1.0)]])
    everywhere = np.concatenate([w, -w, mirrored(w)])
    for dtype in (np.float64, np.float32):
        wi, wo = everywhere[:, None].astype(dtype), everywhere.astype(dtype)
        lobe = material.lobe(wi, wo)
        assert lobe.dtype == dtype
        assert np.isfinite(lobe).all()
        assert (lobe >= 0).all()
        below = (wi[..., 2] <= 0) | (wo[..., 2] <= 0)
        assert (lobe[below] == 0).all()
        density = material.density(wi, wo[wo[:, 2] > 0])
        assert density.dtype == dtype
        assert np.isfinite(density).all()
        u = rng.uniform(size=(50, 2)).astype(dtype)
        assert material.sample(w[:50].astype(dtype), u).dtype == dtype


@pytest.mark.parametrize("name", RECIPROCAL)
def test_single_precision_is_enough(name: str, rng: np.random.Generator) -> None:
    wi, wo = hemisphere(rng, 3000), hemisphere(rng, 3000)
    wi = np.concatenate([wi, mirrored(wo)])
    wo = np.concatenate([wo, wo])
    keep = np.minimum(wi[:, 2], wo[:, 2]) > 0.01
    wi, wo = wi[keep], wo[keep]
    double = MATERIALS[name].lobe(wi, wo)
    single = MATERIALS[name].lobe(wi.astype(np.float32), wo.astype(np.float32))
    # Directions round by 6e-8, which a cosine of 0.01 shows as 6e-6, and a lobe's slope as a few times more.
    assert_allclose(single, double, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("theta_deg", [0.0, 50.0, 80.0])
@pytest.mark.parametrize("name", MATERIALS)
def test_samples_are_as_dense_as_they_say(name: str, theta_deg: float, rng: np.random.Generator) -> None:
    material, count = MATERIALS[name], 40000
    wo = direction(np.radians(theta_deg), 0.4)
    # Cells of equal solid angle over the whole sphere, 20 x 20 points in each.
    rows, columns, inner = 48, 48, 20
    z = (np.arange(rows * inner) + 0.5) / (rows * inner) * 2 - 1
    phi = (np.arange(columns * inner) + 0.5) / (columns * inner) * 2 * np.pi - np.pi
    radius = np.sqrt(1 - z**2)[:, None]
    grid = np.stack(
        [radius * np.cos(phi), radius * np.sin(phi), np.broadcast_to(z[:, None], (len(z), len(phi)))], -1
    )
    density = material.density(grid, wo).reshape(rows, inner, columns, inner).mean(axis=(1, 3))
    expected = density * (4 * np.pi / rows / columns)
    assert_allclose(expected.sum(), 1.0, atol=4e-3)  # midpoints, of densities with edges

    w = material.sample(np.broadcast_to(wo, (count, 3)), rng.uniform(size=(count, 2)))
    assert_allclose(np.linalg.norm(w, axis=1), 1.0, rtol=1e-12)
    row = np.minimum(((w[:, 2] + 1) / 2 * rows).astype(int), rows - 1)
    column = np.minimum(((np.arctan2(w[:, 1], w[:, 0]) / np.pi + 1) / 2 * columns).astype(int), columns - 1)
    seen = np.bincount(row * columns + column, minlength=rows * columns)
    expected = expected.ravel() * count
    # Thin cells together.
    thin = expected < 10
    seen, expected = (
        np.append(seen[~thin], seen[thin].sum()),
        np.append(expected[~thin], expected[thin].sum()),
    )
    enough = expected > 1
    statistic = ((seen - expected)[enough] ** 2 / expected[enough]).sum()
    # One of a thousand seeds would fail; there are 21 runs, and the seed is fixed.
    assert chi2.sf(statistic, enough.sum() - 1) > 1e-3


@pytest.mark.parametrize("theta_deg", [0.0, 60.0, 85.0])
@pytest.mark.parametrize("name", RECIPROCAL)
def test_weighted_samples_give_the_albedo(name: str, theta_deg: float, rng: np.random.Generator) -> None:
    # Two routes to one integral: the material's own samples, and quadrature.
    material, count = MATERIALS[name], 40000
    wo = direction(np.radians(theta_deg), 0.0)
    wi = material.sample(np.broadcast_to(wo, (count, 3)), rng.uniform(size=(count, 2)))
    value = material.lobe(wi, wo)[:, 0] * np.maximum(wi[:, 2], 0) / material.density(wi, wo)
    error = value.std() / np.sqrt(count)
    expected = directional_albedo(material, np.cos(np.radians(theta_deg)))[0, 0]
    assert (
        abs(value.mean() - expected) < 4 * error + 1e-3 * expected
    )  # four standard errors, the quadrature's 1e-3
    assert error < 0.02 * expected


@pytest.mark.parametrize("roughness", [0.01, 0.2, 1.0])
@pytest.mark.parametrize("cos_o", [1.0, 0.5, 0.01])
def test_no_sample_outweighs_the_rest(roughness: float, cos_o: float, rng: np.random.Generator) -> None:
    # GGX's visible facets sample three lobes; the others' bells are at most 4 / e = 1.47 times its own.
    wo = np.array([np.sqrt(1 - cos_o**2), 0.0, cos_o])
    u = rng.uniform(size=(20000, 2))
    for facets, bound in (
        (GGXSlopes(roughness, roughness), 1.0),
        (BeckmannSlopes(roughness, roughness), 2.61),
    ):
        material = SmithMaterial(ZERO, ONE, None, facets)
        wi = material.sample(np.broadcast_to(wo, (len(u), 3)), u)
        weight = material.lobe(wi, wo)[:, 0] * wi[:, 2] / material.density(wi, wo)
        assert 0.3 < weight.max() < bound * (1 + 1e-9)
    printed = MicrofacetMaterial(ZERO, ONE, None, roughness)
    wi = printed.sample(np.broadcast_to(wo, (len(u), 3)), u)
    weight = printed.lobe(wi, wo)[:, 0] * wi[:, 2] / printed.density(wi, wo)
    shown = 1 + GGXSlopes(roughness, roughness).hidden(wo) / cos_o
    assert weight.max() < 1.5 * shown


def test_exact_form_is_the_printed_one_near_normal_incidence() -> None:
    # S and Beckmann differ by sigma^2, Fresnel and masking by less.
    for row in RH01_MATERIALS.values():
        for sigma in (0.02, 0.01):
            narrow = row._replace(sigma=sigma)
            wo = direction(0.1, 0.0)
            wi = direction(0.1 + sigma, np.pi + 0.05)
            printed, smith = (make(narrow, 0.1).lobe(wi, wo)[0] for make in (radiometric, exact))
            # Fresnel at 0.1 rad is that at 0 up to 1e-3; tan^2 - theta^2 over sigma^2 is about sigma^2.
            assert_allclose(smith, printed, rtol=2e-3)


def test_fresnel_of_smith_is_taken_between_facet_and_viewer() -> None:
    wi, wo = direction(0.3, 0.5), direction(1.2, 2.0)
    cos_d = np.cos(np.arccos(wi @ wo) / 2)
    facets = GGXSlopes(0.3, 0.3)
    without = SmithMaterial(ZERO, ONE, None, facets).lobe(wi, wo)
    ratio = SmithMaterial(ZERO, ONE, 1.5, facets).lobe(wi, wo) / without
    assert_allclose(ratio, [fresnel_dielectric(1.5, cos_d) / 0.04], rtol=1e-12)
    ratio = SmithMaterial(ZERO, ONE, 0.2 + 3.9j, facets).lobe(wi, wo) / without
    assert_allclose(
        ratio, [fresnel_conductor(0.2 + 3.9j, cos_d) / fresnel_conductor(0.2 + 3.9j, 1.0)], rtol=1e-12
    )


def test_fresnel_of_a_metal_at_its_limits() -> None:
    cos = np.linspace(0, 1, 50)
    # ((n - 1)^2 + k^2) / ((n + 1)^2 + k^2) at normal incidence, 1 at grazing, a dielectric without absorption.
    assert_allclose(fresnel_conductor(0.2 + 3.9j, 1.0), (0.64 + 15.21) / (1.44 + 15.21), rtol=1e-12)
    assert_allclose(fresnel_conductor(0.2 + 3.9j, 0.0), 1.0, rtol=1e-12)
    assert_allclose(fresnel_conductor(1.5 + 0j, cos), fresnel_dielectric(1.5, cos), rtol=1e-12)


def test_phong_peaks_at_the_mirrored_viewer_with_the_value_of_its_equation() -> None:
    wo = direction(0.8, 0.3)
    material = PhongMaterial(ZERO, np.array([0.2, 0.3, 0.4]), 30.0)
    wi = mirrored(wo)
    assert_allclose(material.evaluate([0, 0, 1], wi, wo), material.ks * 32 / (2 * np.pi), rtol=1e-12)
    across = np.array([-np.sin(0.3), np.cos(0.3), 0.0])
    beside = np.cos(0.2) * wi + np.sin(0.2) * across
    assert_allclose(material.lobe(beside, wo) / material.lobe(wi, wo), [np.cos(0.2) ** 30], rtol=1e-12)


def test_a_brushed_material_turns_with_its_tangent(rng: np.random.Generator) -> None:
    material = MATERIALS["brushed"]
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    wi, wo = hemisphere(rng, 100), hemisphere(rng, 100)
    x, _, z = turn.T
    there = material.evaluate(z, wi @ turn.T, wo @ turn.T, tangent=x)
    assert_allclose(there, np.broadcast_to(material.lobe(wi, wo), (100, 3)), rtol=1e-9)
    swapped = SmithMaterial(ZERO, ONE, 0.2 + 3.9j, GGXSlopes(0.5, 0.15)).lobe(
        wi[:, [1, 0, 2]], wo[:, [1, 0, 2]]
    )
    assert_allclose(swapped, material.lobe(wi, wo), rtol=1e-12)
    assert not material.is_isotropic
    assert MATERIALS["ggx"].is_isotropic


def test_a_mirror_sends_light_to_the_mirrored_direction(rng: np.random.Generator) -> None:
    mirror = Mirror(ZERO, ONE * 0.04, 1.5)
    wo = hemisphere(rng, 10)
    wi = mirror.sample(wo, rng.uniform(size=(10, 2)))
    assert_allclose(wi + wo, 2 * wo[:, 2:] * [[0, 0, 1]], atol=1e-15)
    assert mirror.is_mirror
    assert (mirror.lobe(wi, wo) == 0).all()


def test_a_smooth_surface_becomes_a_mirror() -> None:
    cos = np.cos(np.radians([0.0, 40.0, 70.0]))
    mirror = Mirror(ZERO, ONE * 0.04, 1.5)
    smooth = SmithMaterial(ZERO, ONE * 0.04, 1.5, BeckmannSlopes(0.003, 0.003))
    # Fresnel's curvature over the lobe: sigma^2 times a few.
    assert_allclose(directional_albedo(smooth, cos), directional_albedo(mirror, cos), rtol=2e-4)
    assert_allclose(directional_albedo(mirror, cos)[:, 0], fresnel_dielectric(1.5, cos), rtol=1e-12)


@pytest.mark.parametrize("mu", [0.9, 1.0, np.nan, 1.5 + 0j, -0.2 + 3j])
def test_impossible_indices_are_refused(mu: complex) -> None:
    with pytest.raises(ValueError, match="mu is"):
        SmithMaterial(ZERO, ONE, mu, GGXSlopes(0.1, 0.1))


def test_impossible_exponents_are_refused() -> None:
    with pytest.raises(ValueError, match=r"exponent is -1\.0"):
        PhongMaterial(ZERO, ONE, -1.0)


def test_weights_are_the_same_everywhere() -> None:
    material: Material = Lambertian(np.array([0.1, 0.2, 0.3]))
    kd, ks = material.weights(np.zeros((5, 2)))
    assert kd.shape == ks.shape == (5, 3)
    assert (kd == [0.1, 0.2, 0.3]).all()
    assert (ks == 0).all()
