"""Poses that another program found, as they are handed on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera

Floats = NDArray[np.float64]

# Pixels by which two cameras may place the same direction differently and still be one.
_SAME_PX = 0.5


@dataclass(frozen=True, eq=False)
class ImportedPose:
    """name : of the photograph, as the other program writes it. world_to_camera : (4, 4), OpenCV's axes.

    camera : with which the pose was found, if the file states it and it is one of ours.
    """

    name: str
    world_to_camera: Floats
    camera: Camera | None


def camera_difference(own: Camera, other: Camera) -> float:
    """How far apart two cameras see the same directions, pixels of the first (RMS over its picture).

    A camera of a shrunk or enlarged picture counts as the same; infinite where the pictures' shapes differ.
    """
    factor = own.width / other.width
    if abs(own.height / other.height / factor - 1) > 2 / min(other.width, other.height):
        return np.inf
    x, y = (np.linspace(0, size, 9) for size in (own.width, own.height))
    pixels = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    _, directions = own.posed(np.eye(4)).rays(pixels)
    seen = other.posed(np.eye(4)).project(directions) * factor
    off = np.linalg.norm(seen - pixels, axis=1)
    off = off[np.isfinite(off)]
    return float(np.sqrt((off**2).mean())) if len(off) else np.inf


def camera_warning(
    own: Sequence[Camera], other: Sequence[Camera | None], labels: Sequence[str]
) -> str | None:
    """A sentence if the manifest's cameras aren't those with which poses were found; None if they are."""
    pairs = [(camera_difference(a, b), n) for n, (a, b) in enumerate(zip(own, other, strict=True)) if b]
    if not pairs or max(pairs)[0] <= _SAME_PX:
        return None
    off, worst = max(pairs)
    camera = other[worst]
    assert camera is not None
    params = ", ".join(f"{value:.6g}" for value in camera.params)
    return (
        f"{labels[worst]}: the imported poses were found with another camera than the manifest's ({off:.1f} px apart,"
        f' RMS over the picture): model = "{camera.model}", params = [{params}], width = {camera.width}, height ='
        f" {camera.height}; put that one into the manifest, or let `lightfactor register` find the poses with yours"
    )


def same_camera(own: Camera, other: Camera | None) -> bool:
    """Whether the picture's points mean the same to both."""
    return other is not None and own.width == other.width and camera_difference(own, other) <= _SAME_PX
