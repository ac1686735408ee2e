"""Pixels of a photograph that are read some at a time, or around points alone, are those that are read at once."""

from __future__ import annotations

import re

import numpy as np
import pytest

from capture.decode import decode_photo
from capture.photo import Photo
from capture.photoset import load_photoset
from invrender.observation import samples
from invrender.observation.clock import Clock
from invrender.observation.geometry import find_geometry
from invrender.observation.samples import PhotoReader
from recon.sampling.draw import NO_SOURCES, sample_body
from recon.sampling.lightfield import LightField

from .faultysets import write_set


@pytest.fixture(scope="module")
def read(tmp_path_factory: pytest.TempPathFactory) -> tuple[PhotoReader, Photo, LightField]:
    """A reader, a photograph without a mask, and all its usable pixels at once."""
    folder = write_set(tmp_path_factory.mktemp("reader") / "set")
    manifest = folder / "photoset.toml"
    manifest.write_text(re.sub(r"(?m)^mask = .*\n", "", manifest.read_text()))
    photoset = load_photoset(folder)
    photo, found = photoset.photos[0], find_geometry(photoset).found
    image, rng = decode_photo(photoset.radiometry, photo), np.random.default_rng(0)
    whole = sample_body(found.body, photo.camera, image, None, NO_SOURCES, None, rng)
    return PhotoReader.of(photoset, found), photo, whole


def numbered(field: LightField, photo: Photo) -> list[int]:
    return (field.rows * photo.camera.width + field.columns).tolist()


def test_some_at_a_time_are_all(
    read: tuple[PhotoReader, Photo, LightField], monkeypatch: pytest.MonkeyPatch
) -> None:
    reader, photo, whole = read
    # The first rows around the sphere show nothing of it.
    monkeypatch.setattr(samples, "_AT_A_TIME", 2 * photo.camera.width)
    blocks = list(reader.pixels(photo, len(whole) * 10, NO_SOURCES, Clock()))
    assert len(blocks) > 5
    assert [number for block in blocks for number in numbered(block, photo)] == numbered(whole, photo)
    np.testing.assert_array_equal(np.concatenate([block.radiance for block in blocks]), whole.radiance)
    np.testing.assert_array_equal(np.concatenate([block.weight for block in blocks]), whole.weight)
    fewer = [
        number
        for block in reader.pixels(photo, 300, NO_SOURCES, Clock())
        for number in numbered(block, photo)
    ]
    assert len(set(fewer)) == len(fewer) == 300
    # Evenly over the sphere: the middle of 300 lies off that of all by a sixteenth of its radius at most, 3 deviations.
    rows, all_rows = (np.divmod(of, photo.camera.width)[0] for of in (fewer, numbered(whole, photo)))
    assert abs(np.mean(rows) - np.mean(all_rows)) < np.ptp(all_rows) / 2 / 16 * 1.5
    assert set(fewer) <= set(numbered(whole, photo))


def test_around_points_alone(read: tuple[PhotoReader, Photo, LightField]) -> None:
    reader, photo, whole = read
    usable = set(numbered(whole, photo))
    middle = int(np.median(whole.rows)), int(np.median(whole.columns))
    squares = np.array([middle, (middle[0], middle[1] + 1), (0, 0)])
    field, drawn = reader.pixels_around(photo, squares, 10, NO_SOURCES, np.random.default_rng(1), Clock())
    found = numbered(field, photo)
    assert found == sorted(set(found))
    assert set(found) <= usable
    width, first = photo.camera.width, middle[0] * photo.camera.width + middle[1]
    six = {first + down * width + along for down in (0, 1) for along in (0, 1, 2)}
    assert {number for number, random in zip(found, drawn, strict=True) if not random} <= six <= set(found)
    assert 10 <= drawn.sum() <= 80
