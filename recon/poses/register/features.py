"""Features of photographs and their matches, in a COLMAP database.

SIFT with affine shape and domain-size pooling (Dong & Soatto 2015, "Domain-size pooling in local descriptors") bears
the wide steps between photographs of a gantry.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capture.camera import Camera
from capture.progress import Track
from capture.tasks.stage import stage_results

# Up to so many photographs every pair is matched; of more, each with so many partners that look most alike.
_ALL_PAIRS, _PARTNERS = 80, 40
# Features of each photograph, the largest ones, by which partners are chosen, and the ratio test's limit on cosines.
_LARGEST, _RATIO = 150, 0.8
# Photographs further on in the manifest that are partners anyhow.
_NEXT = 2
# Pixels along a photograph's longer side beyond which it is shrunk to look for features.
_MAX_SIDE = 2400


@dataclass(frozen=True)
class PhotoRecord:
    """A photograph in the database. name : its picture's file. lens : the number of its camera."""

    name: str
    lens: int


@dataclass(frozen=True, eq=False)
class Matches:
    """What was found in the photographs and between them.

    shapes : of each photograph the affine shapes (k, 2, 2) of its features, pixels.
    pairs : (m, 2) photographs whose matches agree with some motion; inliers : (m,) how many do; still : (m,) whether
        that may be a turn on the spot, or none at all.
    """

    shapes: tuple[NDArray[np.float64], ...]
    pairs: NDArray[np.int64]
    inliers: NDArray[np.int64]
    still: NDArray[np.bool_]

    @property
    def keypoints(self) -> NDArray[np.int64]:
        """How many features each photograph has, (c,)."""
        return np.array([len(shape) for shape in self.shapes], np.int64)


@contextmanager
def quiet_colmap() -> Iterator[None]:
    """Keep COLMAP from writing to the terminal."""
    import pycolmap

    level = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = 3
    try:
        yield
    finally:
        pycolmap.logging.minloglevel = level


def match_features(
    database: Path,
    folder: Path,
    shots: Sequence[PhotoRecord],
    lenses: Sequence[Camera],
    masked: bool,
    track: Track,
) -> Matches:
    """Find features in pictures and match them; `database` is made.

    folder : holds the pictures, and in masks/ what of each counts, if `masked`.
    The numbers of images in the database are the shots' places, counted from 1: equal input gives equal results.
    """
    import pycolmap

    with quiet_colmap():
        _write_shots(database, shots, lenses)
        pictures = [(folder / shot.name, mask_file(folder / shot.name) if masked else None) for shot in shots]
        found = stage_results("features", find_features, pictures, lambda files: str(files[0]))
        shapes: list[NDArray[np.float64]] = []
        with _opened(database) as opened:
            for number in track(range(1, len(shots) + 1), "Looking for features"):
                keypoints, descriptors = next(found)
                opened.write_keypoints(number, keypoints)
                kind = pycolmap.FeatureExtractorType.SIFT
                opened.write_descriptors(number, pycolmap.FeatureDescriptors(kind, descriptors))
                shapes.append(_shapes(keypoints))
            pairs = _pairs(opened, shapes)
        matching, verification = _matching_options()
        listed = folder / "pairs.txt"
        for first in track(range(1, len(shots)), "Matching features"):
            lines = [f"{shots[a].name} {shots[b].name}" for a, b in pairs if b == first]
            if lines:
                listed.write_text("\n".join(lines), encoding="utf-8")
                options = pycolmap.ImportedPairingOptions(match_list_path=listed)
                pycolmap.match_image_pairs(
                    database, matching, options, verification, device=pycolmap.Device.cpu
                )
        with _opened(database) as opened:
            numbers, inliers = opened.read_two_view_geometry_num_inliers()
            verified = [pycolmap.pair_id_to_image_pair(number) for number in numbers]
            still = [_without_parallax(opened.read_two_view_geometry(*pair).config) for pair in verified]
    return Matches(
        shapes=tuple(shapes),
        pairs=np.array(verified, np.int64).reshape(-1, 2) - 1,
        inliers=np.array(inliers, np.int64),
        still=np.array(still, bool),
    )


def mask_file(picture: Path) -> Path:
    """Where COLMAP looks for what of a picture counts."""
    return picture.parent / "masks" / f"{picture.name}.png"


def find_features(files: tuple[Path, Path | None]) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """COLMAP's keypoints (k, 6), places and affine shapes in pixels, and descriptors (k, 128) of one picture.

    files : the picture and, as of `mask_file`, what of it counts; None for all.
    """
    import pycolmap

    picture, mask = files
    reader = pycolmap.ImageReaderOptions()
    if mask is not None:
        reader.mask_path = mask.parent
    database = picture.with_suffix(".db")
    try:
        pycolmap.extract_features(
            database,
            picture.parent,
            image_names=[picture.name],
            reader_options=reader,
            extraction_options=_extraction_options(),
            device=pycolmap.Device.cpu,
        )
        with _opened(database) as opened:
            return opened.read_keypoints(1), opened.read_descriptors(1).data
    finally:
        database.unlink(missing_ok=True)


def likely_pairs(descriptors: Sequence[NDArray[np.uint8]]) -> list[tuple[int, int]]:
    """Pairs (a, b), a < b, of photographs worth matching, of very many.

    descriptors : of each photograph those (k, 128) of its largest features. Each photograph gets the partners with
    which most of these match (Wu 2013, "Towards linear-time incremental structure from motion", section 3), and its
    neighbours in the list.
    """
    count = len(descriptors)
    filled = np.zeros((count, _LARGEST, 128), np.float32)
    for place, own in enumerate(descriptors):
        units = own.astype(np.float32)
        filled[place, : len(own)] = units / np.maximum(np.linalg.norm(units, axis=1, keepdims=True), 1e-9)
    everything = filled.reshape(-1, 128).T
    pairs = {(a, b) for a in range(count) for b in range(a + 1, min(a + 1 + _NEXT, count))}
    for place in range(count):
        alike = (filled[place] @ everything).reshape(_LARGEST, count, _LARGEST)
        second, first = np.arccos(np.clip(np.partition(alike, -2, axis=2)[:, :, -2:], -1, 1)).transpose(
            2, 0, 1
        )
        votes = (first < _RATIO * second).sum(axis=0)
        votes[place] = -1
        for other in np.argsort(-votes, kind="stable")[:_PARTNERS]:
            pairs.add((min(place, int(other)), max(place, int(other))))
    return sorted(pairs)


def feature_sizes(shapes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sizes (k,) in pixels of features of affine shapes (k, 2, 2)."""
    return np.sqrt(np.abs(np.linalg.det(shapes)))


def _pairs(database: Any, shapes: Sequence[NDArray[np.float64]]) -> list[tuple[int, int]]:
    """Pairs (a, b), a < b, of photographs to be matched."""
    count = len(shapes)
    if count <= _ALL_PAIRS:
        return [(a, b) for b in range(count) for a in range(b)]
    largest = [np.argsort(-feature_sizes(own), kind="stable")[:_LARGEST] for own in shapes]
    return likely_pairs(
        [np.asarray(database.read_descriptors(n + 1).data)[places] for n, places in enumerate(largest)]
    )


def _write_shots(path: Path, shots: Sequence[PhotoRecord], lenses: Sequence[Camera]) -> None:
    """Cameras and images under numbers of our choosing; left to COLMAP they would depend on its threads' race."""
    import pycolmap

    with _opened(path) as database:
        rigs = []
        for number, lens in enumerate(lenses, start=1):
            camera = pycolmap.Camera(
                model=lens.model, width=lens.width, height=lens.height, params=lens.params.tolist()
            )
            camera.camera_id, camera.has_prior_focal_length = number, True
            database.write_camera(camera, use_camera_id=True)
            rig = pycolmap.Rig()
            rig.add_ref_sensor(pycolmap.sensor_t(pycolmap.SensorType.CAMERA, number))
            rigs.append(database.write_rig(rig))
        for number, shot in enumerate(shots, start=1):
            image = pycolmap.Image(name=shot.name, camera_id=shot.lens + 1)
            image.image_id = number
            database.write_image(image, use_image_id=True)
            frame = pycolmap.Frame()
            frame.rig_id = rigs[shot.lens]
            frame.add_data_id(image.data_id)
            database.write_frame(frame)


def _extraction_options() -> Any:
    import pycolmap

    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu = False
    # Pictures share the cores.
    options.num_threads = 1
    options.max_image_size = _MAX_SIDE
    options.sift.estimate_affine_shape = True
    options.sift.domain_size_pooling = True
    # Half of COLMAP's: plaster and matte coatings show faint texture, and false matches are sifted out later.
    options.sift.peak_threshold = 0.003
    return options


def _matching_options() -> tuple[Any, Any]:
    import pycolmap

    matching = pycolmap.FeatureMatchingOptions()
    matching.use_gpu = False
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = 0
    return matching, verification


def _without_parallax(config: int) -> bool:
    import pycolmap

    kinds = pycolmap.TwoViewGeometryConfiguration
    return kinds(config) in (kinds.PANORAMIC, kinds.PLANAR_OR_PANORAMIC, kinds.WATERMARK)


def _shapes(keypoints: NDArray[np.float32]) -> NDArray[np.float64]:
    """Affine shapes (k, 2, 2) of COLMAP's keypoints (k, 6): place and shape."""
    return np.asarray(keypoints, float)[:, 2:].reshape(-1, 2, 2)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    import pycolmap

    database = pycolmap.Database.open(path)
    try:
        yield database
    finally:
        database.close()
