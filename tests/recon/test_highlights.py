"""More samples where small highlights are, and what each of them then stands for."""

from __future__ import annotations

import numpy as np
import pytest

from capture.arc.gantry import look_at
from capture.camera import Camera
from capture.radiance import RadianceImage
from recon.mesh.bodies import SphereBody, body_coverage
from recon.sampling.budget import draw, spread, spread_with_highlights
from recon.sampling.candidates import Candidates
from recon.sampling.draw import NO_SOURCES, sample_body


def drawn_again(bright, normals, found: float, rng: np.random.Generator) -> Candidates:
    """A quarter of the pixels at random, and of the highlight's others such a share."""
    at_random = np.zeros(len(normals), bool)
    at_random[rng.choice(len(normals), len(normals) // 4, replace=False)] = True
    beside = bright & ~at_random & (rng.random(len(normals)) < found)
    index = np.flatnonzero(at_random | beside)
    return Candidates(index, index, at_random[index], bright[index], 0.25, found)


@pytest.mark.parametrize("found", [1.0, 0.4])
@pytest.mark.parametrize("how", ["beside the budget", "by information"])
def test_more_samples_of_highlights_leave_sums_unbiased(how: str, found: float) -> None:
    rng = np.random.default_rng(3)
    normals = rng.standard_normal((12000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    bright = np.arccos(normals[:, 2]) < 0.15
    expected, counted, samples = [], [], []
    for _ in range(100):
        expected.append(bright[spread(normals, 600, rng)].mean())
        looked_at = drawn_again(bright, normals, found, rng)
        own = normals[looked_at.rows]
        if how == "beside the budget":
            kept, stands_for = spread_with_highlights(own, looked_at, 600, rng)
        else:
            kept, stands_for = draw(own, np.where(looked_at.bright, 9.0, 1.0), 600, rng, looked_at.stands_for)
        samples.append(looked_at.bright[kept].sum())
        counted.append(stands_for[looked_at.bright[kept]].sum() / stands_for.sum())
    # Four times what an even draw has, and more.
    assert np.mean(samples) > 4 * 600 * np.mean(expected) * found
    # What it counts for is what an even draw would have of it: to the standard error of a hundred draws.
    error = np.hypot(np.std(expected), np.std(counted)) / np.sqrt(len(expected))
    assert abs(np.mean(counted) - np.mean(expected)) < 3 * error


@pytest.mark.parametrize("masked", [True, False])
def test_a_highlight_of_a_large_photograph_is_sampled_whatever_is_beside_the_body(ball, masked: bool) -> None:
    camera = Camera("PINHOLE", [1200.0, 1200, 320, 240], 640, 480, look_at([0, -2, 0], [0, 0, 0], [0, 0, 1]))
    body = SphereBody(ball([0, 0, 0], 0.3))
    y, x = np.mgrid[:480, :640]
    on_body = body_coverage(body, camera)
    spot = np.hypot(x - 350, y - 200) < 6
    radiance = (
        np.where(spot, 5.0, np.where(on_body, 1.0, 30.0))[..., None].repeat(3, axis=2).astype(np.float32)
    )
    image = RadianceImage(radiance, radiance**2, np.zeros((480, 640), bool))
    coverage = on_body.astype(np.float32) if masked else None
    rng = np.random.default_rng(0)
    field = sample_body(body, camera, image, coverage, NO_SOURCES, 200, rng, highlights=True)
    # Of 1600 pixels drawn at random of 100,000 hardly any would show it: a fifth of the budget does.
    assert spot[field.rows, field.columns].sum() >= 30
    assert on_body[field.rows, field.columns].all()
    # They stand for a thousandth of the body.
    share = field.shares[spot[field.rows, field.columns]].sum() / field.shares.sum()
    assert share < 0.005
