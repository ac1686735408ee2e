"""The photographs that methods are raced on: a sphere by brute force, whole, with some that no fit sees."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.atlas.stage import SPHERE, Stage, lit, truths
from capture.camera import Camera
from capture.parallel import parallel_map
from capture.radiance import RadianceImage
from invrender.plan.photographs import unexposed
from recon.mesh.bodies import SphereBody
from recon.sampling.draw import NO_SOURCES, sample_body
from recon.sampling.lightfield import LightField, off_terminators

Floats = NDArray[np.float64]

# Photographs held out, between the others' places, and their samples.
_HELD_OUT, _JUDGED = 3, 1500


@dataclass(frozen=True, eq=False)
class SpherePhotos:
    """Photographs, where they were taken, and others that no fit sees.

    seen : all usable pixels of each photograph, none of them at the rim, without noise. images : with noise, black
    elsewhere. held_out : samples from `unseen_cameras`, without noise.
    """

    stage: Stage
    cameras: tuple[Camera, ...]
    seen: tuple[LightField, ...]
    images: tuple[RadianceImage, ...]
    unseen_cameras: tuple[Camera, ...]
    held_out: tuple[LightField, ...]

    def with_noise(self, seed: int) -> SpherePhotos:
        """The same with other noise."""
        rng = np.random.default_rng(seed)
        images = []
        for camera, field in zip(self.cameras, self.seen, strict=True):
            image = np.zeros((camera.height, camera.width, 3), np.float32)
            image[field.rows, field.columns] = self.stage.noise.applied(
                field.radiance, np.ones(len(field)), rng
            )
            images.append(RadianceImage(image, np.zeros_like(image), np.zeros(image.shape[:2], bool)))
        return replace(self, images=tuple(images))

    def samples(self, budget: int | None, sources: Floats = NO_SOURCES) -> list[LightField]:
        """Samples as `process` draws them, about `budget` of all photographs; all pixels for None."""
        each = None if budget is None else max(budget // len(self.cameras), 1)

        def drawn(index: int) -> LightField:
            rng = np.random.default_rng(index)
            camera, image = self.cameras[index], self.images[index]
            field = sample_body(SphereBody(SPHERE), camera, image, None, sources, each, rng)
            return off_terminators(field, sources)

        return list(parallel_map(drawn, range(len(self.cameras))))

    @property
    def truth(self) -> dict[str, float | None]:
        """The Ks share, mu and sigma."""
        return truths(self.stage.material)


def sphere_photos(stage: Stage, seed: int) -> SpherePhotos:
    """Photograph a stage, all pixels of it: its `samples` don't matter here."""
    cameras = stage.cameras
    between = replace(stage, views=2 * len(cameras)).cameras[1::2]
    unseen = between[:: max(len(between) // _HELD_OUT, 1)][:_HELD_OUT]
    return SpherePhotos(
        stage,
        tuple(cameras),
        tuple(_seen(stage, camera, None) for camera in cameras),
        (),
        tuple(unseen),
        tuple(_seen(stage, camera, _JUDGED) for camera in unseen),
    ).with_noise(seed)


def _seen(stage: Stage, camera: Camera, budget: int | None) -> LightField:
    rng = np.random.default_rng(0)
    field = sample_body(SphereBody(SPHERE), camera, unexposed(camera), None, NO_SOURCES, budget, rng)
    return lit(stage, field, field.normals, field.views)
