"""References in photographs: their pixels, white by them, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from capture.chart.chart import read_chart
from capture.decode import decode_photo
from capture.files.imagefile import write_exr
from capture.photoset import PhotoSet, load_photoset
from capture.reference import SeenReference, mean_of_parts, see_references

Floats = NDArray[np.float64]

HEAD = """format = 1
name = "card"
[camera]
model = "SIMPLE_PINHOLE"
params = [80.0, 40.0, 30.0]
width = 80
height = 60
[radiometry]
white_balance = {balance}
[[lighting]]
name = "room"
unknown = true
[[photo]]
file = "000.exr"
world_to_camera = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.5], [0.0, 0.0, 0.0, 1.0]]
[[reference]]
"""
CARD = 'photo = "000.exr"\nregion = [[10, 12], [40, 12], [40, 42], [10, 42]]\nnormal = [0, 0, -1]\nreflectance = 0.4\n'
SHOWN = np.array([0.3, 0.2, 0.1])


def seen_in(photoset: PhotoSet) -> SeenReference:
    """The only reference of a set."""
    (seen,) = see_references(photoset.manifest, photoset.references, photoset.photos, photoset.radiometry)
    return seen


@pytest.fixture
def written(tmp_path: Path) -> Callable[..., Path]:
    """A photograph of a card, 10 to 40 across and 12 to 42 down, with a bright frame around."""
    pixels = np.full((60, 80, 3), 0.02, np.float32)
    pixels[10:44, 8:42] = 0.9
    pixels[12:42, 10:40] = SHOWN

    def write(
        table: str = CARD, balance: str = '"none"', change: Callable[[Floats], None] | None = None
    ) -> Path:
        own = pixels.copy()
        if change is not None:
            change(own)
        write_exr(tmp_path / "000.exr", own)
        (tmp_path / "photoset.toml").write_text(HEAD.format(balance=balance) + table)
        return tmp_path

    return write


def test_a_card_is_read_without_its_frame(written: Callable[..., Path]) -> None:
    photoset = load_photoset(written())
    seen = seen_in(photoset)
    # Without the border no pixel shows the frame; single precision.
    assert_allclose(seen.white, np.tile(SHOWN / 0.4, (28 * 28, 1)), rtol=1e-6)
    assert sorted(set(seen.parts.tolist())) == list(range(9))
    # A reflectance per channel.
    coloured = load_photoset(written(CARD.replace("0.4", "[0.6, 0.4, 0.2]")))
    seen = seen_in(coloured)
    assert_allclose(mean_of_parts(seen.white, seen.parts), 0.5, rtol=1e-6)


def test_white_balance_makes_the_reference_its_own_colour(written: Callable[..., Path]) -> None:
    photoset = load_photoset(written(CARD.replace("0.4", "[0.4, 0.4, 0.5]"), '"reference"'))
    photo = decode_photo(photoset.radiometry, photoset.photos[0])
    # Its green stays.
    assert_allclose(photo.radiance[20, 20], 0.2 * np.array([1, 1, 1.25]), rtol=1e-6)


def test_a_real_chart_gives_white_and_how_unevenly_it_is_lit(data_dir: Path, tmp_path: Path) -> None:
    file = data_dir / "raw" / "CRW_0101.CRW"
    head = (
        HEAD.format(balance='"reference"').replace("000.exr", str(file)).replace("width = 80", "width = 2312")
    )
    table = f'photo = "{file}"\nchart = "MCC24-2005"\nnormal = [0, 0, -1]'
    (tmp_path / "photoset.toml").write_text(head.replace("height = 60", "height = 1720") + table)
    photoset = load_photoset(tmp_path)
    seen = seen_in(photoset)
    # Four grey patches reflect 15% or more; each is grey to 2% once the mean is.
    names = [read_chart("MCC24-2005").names[k] for k in read_chart("MCC24-2005").greys]
    assert names[:4] == ["white", "neutral 8", "neutral 6.5", "neutral 5"]
    patches = np.array([seen.white[seen.parts == k].mean(axis=0) for k in range(4)])
    assert len(np.unique(seen.parts)) == 4
    assert_allclose(patches / patches.mean(axis=1, keepdims=True), 1, atol=0.025)
    # The chart's own fit says that light varies by 26% over it.
    assert 0.15 < np.ptp(patches.mean(axis=1)) / patches.mean() < 0.3


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (CARD.replace('"000.exr"', '"001.exr"'), '"001.exr" is no \\[\\[photo\\]\\] of the set'),
        (CARD.replace("region", "regoin"), "regoin"),
        (CARD.replace("reflectance = 0.4", ""), "lacks the key 'reflectance'"),
        (CARD.replace("reflectance = 0.4", "reflectance = 18"), "above 0 and at most 1"),
        (CARD.replace("normal = [0, 0, -1]", ""), "lacks the way that the card faces"),
        (CARD + "size = [0.1, 0.1]", "normal and size both"),
        (CARD + "centre = [0, 0, 0]\nradius = 0.1", "region and centre: give one of"),
        (CARD.replace("normal = [0, 0, -1]", "normal = [0, 0, 0]"), "normal is \\[0, 0, 0\\]"),
        ('photo = "000.exr"\nchart = "MCC24"\nreflectance = 0.2', "a chart has its own"),
        ('photo = "000.exr"\ncentre = [0, 0, 0]\nreflectance = 0.2', "needs centre and radius"),
    ],
)
def test_a_bad_table_is_named(written: Callable[..., Path], table: str, message: str) -> None:
    with pytest.raises(ValueError, match=r"photoset.toml.*reference.*" + message):
        load_photoset(written(table))


@pytest.mark.parametrize(
    ("table", "change", "message"),
    [
        (
            CARD.replace("[40, 42]", "[90, 42]"),
            None,
            "corner at \\[90.0, 42.0\\], outside the picture of 80x60",
        ),
        (CARD.replace("40", "13").replace("42", "15"), None, "it has 1 pixels, 50 are needed"),
        (CARD, lambda pixels: pixels.__imul__(0), "it is black"),
        ('photo = "000.exr"\nchart = "MCC24"', None, "no MCC24 chart is found"),
        (
            'photo = "000.exr"\ncentre = [2, 0, 0]\nradius = 0.1\nreflectance = 0.2',
            None,
            "isn't in the picture",
        ),
        (
            'photo = "000.exr"\ncentre = [0.2, 0, 0]\nradius = 0.1\nreflectance = 0.2',
            None,
            "beyond the picture",
        ),
    ],
)
def test_a_reference_that_shows_nothing_usable_is_refused(
    written: Callable[..., Path], table: str, change: Callable[[Floats], None] | None, message: str
) -> None:
    photoset = load_photoset(written(table, change=change))
    with pytest.raises(ValueError, match=r'\[\[reference\]\] 1 \(photo "000.exr"\): .*' + message):
        seen_in(photoset)


def test_white_balance_by_a_reference_needs_one(written: Callable[..., Path]) -> None:
    folder = written(balance='"reference"')
    path = folder / "photoset.toml"
    path.write_text(path.read_text().replace("[[reference]]\n" + CARD, ""))
    with pytest.raises(ValueError, match="white_balance = 'reference', but there is no"):
        load_photoset(folder)


def test_a_saturated_card_is_refused(written: Callable[..., Path]) -> None:
    folder = written(CARD.replace(".exr", ".png"))
    path = folder / "photoset.toml"
    path.write_text(path.read_text().replace(".exr", ".png"))
    pixels = np.full((60, 80, 3), 40, np.uint8)
    pixels[12:42, 20:40] = 255
    cv2.imwrite(str(folder / "000.png"), pixels)
    photoset = load_photoset(folder)
    with pytest.raises(ValueError, match="of its pixels are saturated: expose less"):
        seen_in(photoset)
