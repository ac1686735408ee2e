"""Factorization under wholly unknown light, for the six spheres of RH01's Fig. 11: python -m benchmarks.blind.

Photographs by brute-force integration, 1% noise, an area light and a source, none of them told. First the table, truth
beside estimate, whole ladder and seconds beside it; then errors over 200 draws of the noise in their own standard
deviations, whose root mean square should be 1, and how many of the 95% intervals hold the truth.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from capture.arc.gantry import Arc
from capture.camera import Camera
from capture.radiance import RadianceImage
from invrender.solve.blind import BlindSolution, factorize_blind
from recon.bodies import SphereBody
from recon.harmonics import evaluate_harmonics, sphere_directions
from recon.lightfield import LightField
from recon.sampling import NO_SOURCES, sample_body
from recon.sphere import Sphere
from synthetic.lights.arealight import AreaLight
from synthetic.lights.sources import DirectionalSource
from synthetic.materials.microfacet import Microfacet
from synthetic.materials.rh01 import RH01_MATERIALS, radiometric
from synthetic.render.lobes import reflected_radiance

Floats = NDArray[np.float64]

_AREA = AreaLight(np.array([-0.26, 0.72, 0.64]), np.array([1.5, 1.6, 1.8]), width_rad=0.35)
_SOURCE = DirectionalSource(np.array([0.85, -0.31, 0.42]), np.array([1.6, 1.5, 1.35]))
_SPHERE = Sphere(np.zeros(3), 0.02, np.zeros((4, 4)))
_RADIUS_PX, _SAMPLES = 90, 25000
_NOISE, _FLOOR = 0.01, 0.001


def main() -> None:
    """Print the table and the study of errors."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--draws", type=int, default=200)
    options.add_argument("--views", type=int, default=60)
    options.add_argument("--samples", type=int, default=_SAMPLES)
    chosen = options.parse_args()
    print(f"{'':10} {'Ks share':>20} {'mu':>16} {'sigma':>18} {'source':>8} {'first 9':>8} {'seconds':>14}")
    print(f"{'':10} {'truth':>9} {'found':>10} {'truth':>7} {'found':>8} {'truth':>7} {'found':>10}", end="")
    print(f" {'deg off':>8} {'off':>8} {'one':>7} {'ladder':>6}")
    for name, row in RH01_MATERIALS.items():
        material = radiometric(row)
        photos = _noisy(_photographs(material, chosen.views, chosen.samples), np.random.default_rng(0))
        _row(name, material, photos)
    material = radiometric(RH01_MATERIALS["teflon"])
    _study(material, _photographs(material, 30, 6000), chosen.draws)


def _row(name: str, material: Microfacet, photos: list[LightField]) -> None:
    seconds = []
    for ladder in (False, True):
        start = time.perf_counter()
        solution = factorize_blind(photos, ladder=ladder)
        seconds.append(time.perf_counter() - start)
    truth = material.ks / (material.kd + material.ks)
    mu = ["none" if value is None else f"{value:.3f}" for value in (material.mu, solution.mu)]
    sigma = "none" if solution.sigma is None else f"{solution.sigma:.5f}"
    off = "none"
    if len(solution.light.sources.directions) == 1:
        off = f"{np.degrees(np.arccos(min(1, solution.light.sources.directions[0] @ _SOURCE.direction))):.4f}"
    print(
        f"{name:10} {truth[1]:9.4f} {solution.brdf_share[1]:10.4f} {mu[0]:>7} {mu[1]:>8} {material.sigma:7.2f}"
        f" {sigma:>10} {off:>8} {_light_off(solution):8.4f} {seconds[0]:7.1f} {seconds[1]:6.1f}"
    )


def _light_off(solution: BlindSolution) -> float:
    """Largest error of the first nine coefficients over the one of degree 0."""
    # A fine spiral of equal solid angles integrates the area light, and the source is one product.
    grid = sphere_directions(50000)
    area = 4 * np.pi / len(grid) * evaluate_harmonics(grid, 2).T @ _AREA.radiance_from(grid)
    total = area + evaluate_harmonics(_SOURCE.direction[None], 2).T * _SOURCE.irradiance
    return float(np.abs(solution.light.normalised_coefficients[:9] - total / total[0]).max())


def _study(material: Microfacet, photos: list[LightField], draws: int) -> None:
    scores: dict[str, list[float]] = {}
    rng = np.random.default_rng(1)
    for _ in range(draws):
        solution = factorize_blind(_noisy(photos, rng), ladder=False)
        std = np.sqrt(np.diag(solution.covariance))
        truth = [*(material.ks / (material.kd + material.ks)), material.mu, material.sigma]
        found = [*solution.brdf_share, solution.mu, solution.sigma]
        for name, a, b, s in zip(solution.covariance_names, found, truth, std, strict=False):
            scores.setdefault(name, []).append((a - b) / s)
    print(f"\n{draws} draws, teflon, {sum(map(len, photos))} samples: errors in standard deviations")
    for name, values in scores.items():
        z = np.array(values)
        print(
            f"{name:10} RMS {np.sqrt((z**2).mean()):5.2f}  mean {z.mean():+5.2f}"
            f"  95% intervals hold {(np.abs(z) < 1.96).mean():.1%}"
        )


def _photographs(material: Microfacet, views: int, samples: int) -> list[LightField]:
    photos = []
    focal, side = _RADIUS_PX * 0.6 / _SPHERE.radius, int(2.2 * _RADIUS_PX)
    black = np.zeros((side, side, 3), np.float32)
    image = RadianceImage(black, black, np.zeros((side, side), bool))
    for index, angle in enumerate(np.linspace(0, np.radians(177), views)):
        pose = Arc(np.zeros(3), [0, 0, 1], 0.6, [1, 0, 0]).pose(angle)
        camera = Camera("PINHOLE", np.array([focal, focal, side / 2, side / 2]), side, side, pose)
        rng = np.random.default_rng(index)
        field = sample_body(SphereBody(_SPHERE), camera, image, None, NO_SOURCES, samples // views, rng)
        radiance = reflected_radiance(material, [_AREA], [_SOURCE], field.normals, field.views)
        photos.append(replace(field, radiance=field.mean_over_rays(radiance)))
    return photos


def _noisy(photos: list[LightField], rng: np.random.Generator) -> list[LightField]:
    noisy = []
    for photo in photos:
        deviation = np.hypot(_NOISE * photo.radiance, _FLOOR * photo.radiance.mean())
        noisy.append(
            replace(photo, radiance=photo.radiance + deviation * rng.standard_normal(deviation.shape))
        )
    return noisy


if __name__ == "__main__":
    main()
