"""Masks that the workbench's page sends: where they are kept, and what stays as it was."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from capture.decode import photo_mask
from capture.photoset import load_photoset
from lightfactor.studio.manifest import write_key
from lightfactor.studio.opened import key_of
from tests.invrender.faultysets import SIZE, change_manifest, write_set

from .studios import Served, served

FIRST = f"/api/photos/{key_of('000.exr')}/mask"
NO_MASK = r'mask = "000_mask.png"\n'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A set of eight photographs with masks, to be changed."""
    return write_set(tmp_path / "set")


@pytest.fixture
def bench(folder: Path) -> Iterator[Served]:
    with served(folder) as found:
        yield found


def drawn(width: int = SIZE, height: int = SIZE) -> np.ndarray:
    """A mask (h, w) with an edge of partial cover."""
    pixels = np.zeros((height, width), np.uint8)
    pixels[10:30, 20:50] = 255
    pixels[30, 20:50] = 100
    return pixels


def sent(pixels: np.ndarray) -> bytes:
    """A PNG of a mask as browsers write it, in colours with an alpha channel."""
    colours = np.dstack([pixels] * 3 + [np.full_like(pixels, 255)])
    return cv2.imencode(".png", colours)[1].tobytes()


def kept(folder: Path, number: int = 0) -> np.ndarray:
    mask = photo_mask(load_photoset(folder).photos[number])
    assert mask is not None
    return mask


def files_of(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def refused(bench: Served, body: bytes, path: str = FIRST) -> str:
    """What the answer says is wrong."""
    status, _, answer = bench.ask("POST", path, body=body)
    assert status == 400
    return json.loads(answer)["error"]


def test_a_mask_takes_the_place_of_the_one_before_which_is_kept(bench: Served, folder: Path) -> None:
    before = files_of(folder)
    assert json.loads(bench.ask("POST", FIRST, body=sent(drawn()))[2]) == {"name": "000_mask.png"}
    np.testing.assert_allclose(kept(folder), drawn() / 255, atol=1e-6)
    assert cv2.imread(str(folder / "000_mask.png"), cv2.IMREAD_UNCHANGED).shape == (SIZE, SIZE)
    copy = folder / ".studio" / "masks" / "000_mask-1.png"
    assert copy.read_bytes() == before[folder / "000_mask.png"]
    # Nothing else has changed, and each former one is kept.
    second = (folder / "000_mask.png").read_bytes()
    assert {path for path, data in files_of(folder).items() if before.get(path) != data} == {
        folder / "000_mask.png",
        copy,
    }
    assert bench.ask("POST", FIRST, body=sent(255 - drawn()))[0] == 200
    assert copy.with_name("000_mask-2.png").read_bytes() == second
    assert copy.read_bytes() == before[folder / "000_mask.png"]


def test_the_page_gets_the_mask_that_is_there_in_grey_levels(bench: Served, folder: Path) -> None:
    status, headers, data = bench.ask("GET", FIRST)
    assert (status, headers["content-type"]) == (200, "image/png")
    found = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_allclose(found / 255, kept(folder), atol=0.5 / 255)
    change_manifest(folder, NO_MASK, lambda _: "")
    status, _, data = bench.ask("GET", FIRST)
    assert (status, json.loads(data)) == (400, {"error": "000.exr: has no mask yet"})


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_a_first_mask_is_named_in_the_manifest_and_all_else_stays(
    bench: Served, folder: Path, newline: str
) -> None:
    (folder / "000_mask.png").unlink()
    change_manifest(folder, NO_MASK, lambda _: "")
    manifest = folder / "photoset.toml"
    manifest.write_bytes(manifest.read_text().replace("\n", newline).encode())
    before = manifest.read_bytes()
    assert bench.ask("POST", FIRST, body=sent(drawn()))[0] == 200
    line, header = f'mask = "000_mask.png"{newline}'.encode(), f"[[photo]]{newline}".encode()
    assert manifest.read_bytes() == before.replace(header, header + line, 1)
    np.testing.assert_allclose(kept(folder), drawn() / 255, atol=1e-6)


def test_what_is_no_mask_of_the_photograph_is_refused_and_changes_nothing(
    bench: Served, folder: Path
) -> None:
    before = files_of(folder)
    whole = sent(drawn())
    for body, said in (
        (b"", "000.exr: no mask was sent"),
        (b"a mask" * (1 << 19), "is no PNG"),  # large ones get through
        (cv2.imencode(".jpg", drawn())[1].tobytes(), "is no PNG"),
        (whole[:20], "damaged or cut off"),
        (whole[: len(whole) // 2], "damaged or cut off"),
        (sent(drawn(60, 68)), "is 60x68 pixels, but the photograph is 68x68"),
        (sent(np.zeros_like(drawn())), "is empty; draw where the object is"),
    ):
        assert said in refused(bench, body)
    assert bench.ask("POST", "/api/photos/x/mask", body=whole)[0] == 404
    assert bench.ask("POST", FIRST, {"Content-Length": str(65 << 20)})[0] == 413
    # A manifest that can't be changed: no new file is left without a name.
    text = (folder / "photoset.toml").read_text()
    (folder / "photoset.toml").write_text(
        text.replace("[[photo]]", "[['photo']]", 1).replace("000_mask", "001_mask")
    )
    changed = files_of(folder)
    assert "write mask there by hand" in refused(bench, whole)
    assert files_of(folder) == changed
    (folder / "photoset.toml").write_text(text)
    assert files_of(folder) == before


@pytest.mark.parametrize(
    ("photo", "mask", "own"),
    [
        ("000.exr", "001_mask.png", "000-2_mask.png"),  # another photograph's, too
        ("000.exr", "../elsewhere_mask.png", "000-2_mask.png"),
        ("000.exr", "cover.tif", "000-2_mask.png"),  # what is no PNG
        ("cut-out.png", "cut-out.png", "cut-out_mask.png"),  # the photograph itself
        ("000.exr", "ball_mask.png", "000-2_mask.png"),  # a mirror ball's, too
    ],
)
def test_only_a_mask_of_the_photograph_alone_is_written_over(
    bench: Served, folder: Path, photo: str, mask: str, own: str
) -> None:
    # A file may be someone's though the manifest names it no more, as 000_mask.png here.
    for name in ("../elsewhere_mask.png", "ball_mask.png"):
        shutil.copy(folder / "000_mask.png", folder / name)
    cv2.imwrite(str(folder / "cover.tif"), drawn())
    cv2.imwrite(str(folder / "cut-out.png"), np.dstack([drawn()] * 4))
    change_manifest(folder, r'file = "000.exr"', lambda _: f'file = "{photo}"')
    change_manifest(folder, r'mask = "000_mask.png"', lambda _: f'mask = "{mask}"   # by hand')
    manifest = folder / "photoset.toml"
    ball = '[[lighting]]\nname = "ball"\nmirror_ball = { photo = "ball.exr", mask = "ball_mask.png" }\n'
    manifest.write_text(manifest.read_text() + ball)
    before, text = files_of(folder.parent), manifest.read_text()
    assert bench.ask("POST", f"/api/photos/{key_of(photo)}/mask", body=sent(drawn()))[0] == 200
    after = files_of(folder.parent)
    assert load_photoset(folder).photos[0].mask == folder / own
    np.testing.assert_allclose(kept(folder), drawn() / 255, atol=1e-6)
    assert {path for path, data in before.items() if after[path] != data} == {manifest}
    assert set(after) - set(before) == {folder / own}
    assert manifest.read_text() == text.replace(f'mask = "{mask}"   # by hand', f'mask = "{own}"   # by hand')


def test_photographs_outside_of_the_set_get_their_masks_into_it(bench: Served, folder: Path) -> None:
    (folder / "000.exr").rename(folder.parent / "raw.exr")
    change_manifest(folder, r'mask = "000_mask.png"\n', lambda _: "")
    change_manifest(folder, r'file = "000.exr"', lambda _: 'file = "../raw.exr"')
    assert bench.ask("POST", f"/api/photos/{key_of('raw.exr')}/mask", body=sent(drawn()))[0] == 200
    assert load_photoset(folder).photos[0].mask == folder / "raw_mask.png"
    # In a folder of the set they lie beside them.
    (folder / 'day é "1"').mkdir()
    (folder / "001.exr").rename(folder / 'day é "1"' / "001.exr")
    change_manifest(folder, r'file = "001.exr"\n', lambda _: "file = 'day é \"1\"/001.exr'\n")
    change_manifest(folder, r'mask = "001_mask.png"\n', lambda _: "")
    assert bench.ask("POST", f"/api/photos/{key_of('001.exr')}/mask", body=sent(drawn()))[0] == 200
    assert load_photoset(folder).photos[1].mask == folder / 'day é "1"' / "001_mask.png"


def test_a_key_is_written_where_it_stands(tmp_path: Path) -> None:
    manifest = tmp_path / "photoset.toml"
    text = (
        "[[photo]]\nfile = 'a.png' # one\nmask = 'a.png' # two\n\n"
        "[[photo]]\nfile = 'b.png'\n[photo.camera]\nwidth = 3\n"
    )
    manifest.write_text(text)
    write_key(manifest, "photo", 0, "mask", 'x \\ ".png')
    assert manifest.read_text() == text.replace("mask = 'a.png'", 'mask = "x \\\\ \\".png"')
    write_key(manifest, "photo", 1, "mask", "é.png")
    assert "[[photo]]\nmask = \"é.png\"\nfile = 'b.png'\n[photo.camera]" in manifest.read_text()
    odd = text.replace("mask =", '"mask" =')
    manifest.write_text(odd)
    with pytest.raises(ValueError, match="mask of photograph 1 is written in a way"):
        write_key(manifest, "photo", 0, "mask", "c.png")
    assert manifest.read_text() == odd
