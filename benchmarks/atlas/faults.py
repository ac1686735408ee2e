"""What photographs are like: noise, poses that are off, outliers, highlights that saturate. Errors grow smoothly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks.atlas.stage import Finding, Stage, expected, fitted, lit
from benchmarks.atlas.sweep import Boundary
from recon.sampling.lightfield import LightField
from synthetic.faults import with_outliers

Floats = NDArray[np.float64]


def noise_draw(relative: float, number: int) -> dict[str, Finding]:
    stage = Stage(relative=relative)
    return fitted(stage, stage.drawn(number))


def noise_theory(relative: float) -> dict[str, Finding]:
    return expected(Stage(relative=relative))


def pose_draw(std_deg: float, number: int) -> dict[str, Finding]:
    """Each camera is turned about the sphere by a random angle that the fit isn't told; std_deg about each axis."""
    stage, rng = Stage(), np.random.default_rng(number)
    photos = []
    for field in stage.fields():
        turn = Rotation.from_rotvec(np.radians(std_deg) * rng.standard_normal(3)).as_matrix()
        photos.append(lit(stage, field, field.normals @ turn.T, field.views @ turn.T))
    return fitted(stage, stage.noisy(photos, rng))


def outliers_draw(share: float, number: int) -> dict[str, Finding]:
    """A share of the samples is nonsense, half of it in specks."""
    stage, rng = Stage(), np.random.default_rng(number)
    return fitted(stage, [_spoilt(photo, share, rng) for photo in stage.noisy(stage.photographs(), rng)])


def _spoilt(photo: LightField, share: float, rng: np.random.Generator) -> LightField:
    image = np.zeros((photo.rows.max() + 1, photo.columns.max() + 1, 3))
    image[photo.rows, photo.columns] = photo.radiance
    seen = np.zeros(image.shape[:2])
    seen[photo.rows, photo.columns] = 1
    spoilt, _ = with_outliers(image, seen, share, rng)
    return replace(photo, radiance=spoilt[photo.rows, photo.columns])


def saturation_draw(share: float, number: int) -> dict[str, Finding]:
    """The brightest samples are saturated, and left out as recon does."""
    stage = Stage()
    photos = stage.drawn(number)
    level = saturation_level([photo.radiance for photo in photos], share)
    return fitted(stage, [photo.where(photo.radiance.max(axis=1) < level) for photo in photos])


def saturation_theory(share: float) -> dict[str, Finding]:
    stage = Stage()
    level = saturation_level([photo.radiance for photo in stage.photographs()], share)
    return expected(stage, lambda _, radiance: radiance.max(axis=1) < level)


def saturation_level(radiances: Sequence[Floats], share: float) -> float:
    """The radiance beyond which a share of the samples has some channel."""
    return float(np.quantile(np.concatenate([seen.max(axis=1) for seen in radiances]), 1 - share)) + 1e-12


def faultless_theory(_: float) -> dict[str, Finding]:
    return expected(Stage())


NOISE = Boundary(
    "noise",
    "Noise, unknown light",
    "noise, relative to each pixel's radiance",
    (0.001, 0.003, 0.01, 0.03, 0.1),
    (2, 4),
    noise_draw,
    noise_theory,
    "Errors grow in proportion, until what noise hides is said to be open.",
    log=True,
)
POSE = Boundary(
    "pose",
    "Poses that are off, unknown light",
    "error of the cameras about each axis [degrees], standard deviation",
    (0.03, 0.1, 0.3, 1.0),
    (0, 3),
    pose_draw,
    faultless_theory,
    "Theory's bars are those of noise alone; the fit must widen its own by what residuals show.",
    log=True,
)
OUTLIERS = Boundary(
    "outliers",
    "Outliers, unknown light",
    "share of the samples that is nonsense",
    (0.0, 0.01, 0.03, 0.06, 0.1),
    (0, 1),
    outliers_draw,
    faultless_theory,
    "Theory's bars are those of a set without them.",
)
SATURATION = Boundary(
    "saturation",
    "Saturated highlights, unknown light",
    "share of the samples that saturates",
    (0.0, 0.02, 0.05, 0.1, 0.2),
    (0, 3),
    saturation_draw,
    saturation_theory,
    "What saturates is left out: the highlight's middle, then most of it.",
)
