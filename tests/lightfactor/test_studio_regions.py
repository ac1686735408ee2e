"""Source regions that the workbench's page sends: what the manifest keeps, and the maps that they are marked on."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from gzip import decompress
from pathlib import Path
from struct import unpack

import numpy as np
import pytest

from capture.photoset import load_photoset
from capture.source_region import source_regions
from lightfactor.studio.manifest import write_key
from lightfactor.studio.opened import key_of
from tests.invrender.faultysets import write_set
from tests.invrender.test_psm import SET, every_third

from .studios import Served, served

ONE = {"direction": [0.6, 0.0, 0.8], "radiusDeg": 20}


def kept(bench: Served, light: str, *regions: object) -> tuple[int, dict[str, str]]:
    path = f"/api/lightings/{key_of(light)}/source-regions"
    status, _, answer = bench.ask("POST", path, body=json.dumps({"regions": regions}).encode())
    return status, json.loads(answer)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small set that says nothing of its light but one of its lamps' directions; tests leave it as it is."""
    path = write_set(tmp_path_factory.mktemp("ball") / "set") / "photoset.toml"
    text = re.sub(
        r'(name = "lamp [1-7]"\n)directional = .*\n', r"\1unknown = true # dark\n", path.read_text()
    )
    path.write_text(text)
    return path.parent


@pytest.fixture(scope="module")
def bench(folder: Path) -> Iterator[Served]:
    with served(folder) as found:
        yield found


def test_regions_are_kept_where_fits_read_them(bench: Served, folder: Path) -> None:
    manifest = folder / "photoset.toml"
    before = manifest.read_text()
    other = {"direction": [0.0, -1.0, 0.0], "radiusDeg": 7.55}
    assert kept(bench, "lamp 3", ONE, other) == (200, {})
    (name, region), *rest = source_regions(load_photoset(folder).lightings).items()
    assert (name, rest) == ("lamp 3", [])
    np.testing.assert_allclose(region.directions, [[0.6, 0, 0.8], [0, -1, 0]], atol=1e-4)
    np.testing.assert_allclose(np.degrees(region.radii), [20, 7.55], atol=0.06)  # kept to a tenth
    told = json.loads(bench.ask("GET", "/api/state")[2])["set"]["lightings"]
    assert [len(each["regions"]) for each in told] == [0, 0, 0, 2, 0, 0, 0, 0]
    assert [each["takesRegions"] for each in told] == [False] + [True] * 7
    assert kept(bench, "lamp 3") == (200, {})
    assert manifest.read_text() == before


@pytest.mark.parametrize(
    ("light", "region", "said"),
    [
        ("lamp 0", ONE, "light 'lamp 0' is given: no lamps are looked for in it"),
        ("lamp 1", ONE | {"direction": [0, 0, 2]}, "has length 2"),
        ("lamp 1", ONE | {"direction": [0, 1]}, "it must be three finite numbers"),
        ("lamp 1", ONE | {"radiusDeg": 0}, "it must be above 0"),
        ("lamp 1", {"direction": [0, 0, 1]}, "lacks 'radiusDeg'"),
        ("lamp 9", ONE, "the set has none of this id"),
    ],
)
def test_what_is_no_region_is_refused(
    bench: Served, folder: Path, light: str, region: object, said: str
) -> None:
    before = (folder / "photoset.toml").read_bytes()
    status, answer = kept(bench, light, region)
    assert status in (400, 404)
    assert said in answer["error"]
    assert (folder / "photoset.toml").read_bytes() == before


def test_a_set_that_says_nothing_of_its_light_has_a_lighting_written(tmp_path: Path) -> None:
    manifest = tmp_path / "photoset.toml"
    text = 'format = 1\nname = "a"\n[[photo]]\nfile = "a.png"\n\n\n'
    manifest.write_text(text)
    regions = [{"direction": [0.0, 0.0, 1.0], "radius_deg": 20.0}]
    write_key(manifest, "lighting", 0, "source_regions", regions)
    written = manifest.read_text()
    assert written.startswith(text.rstrip() + "\n")
    assert "source_regions = [{ direction = [0.0, 0.0, 1.0], radius_deg = 20.0 }]\n" in written
    assert 'name = "lighting"\nunknown = true\n' in written
    # With a remark behind it, it is still found.
    manifest.write_text(written.replace("}]\n", "}] # the window\n"))
    write_key(manifest, "lighting", 0, "source_regions", None)
    assert "source_regions" not in manifest.read_text()


def test_a_real_mirror_ball_shows_its_lamp_unless_it_lies_outside_the_region(
    data_dir: Path, tmp_path: Path
) -> None:
    manifest = tmp_path / "photoset.toml"
    manifest.write_text(every_third((SET / "photoset.toml").read_text()))
    name = load_photoset(tmp_path).lightings[0].name

    def seen() -> tuple[np.ndarray, np.ndarray]:
        """The map, and the lamps."""
        status, _, body = bench.ask("GET", f"/api/lightings/{key_of(name)}/map")
        assert status == 200
        block = decompress(body)
        (length,) = unpack("<I", block[:4])
        header = json.loads(block[4 : 4 + length])["arrays"]
        rest = block[4 + length :]
        return tuple(
            np.frombuffer(rest, np.float32, int(np.prod(of["shape"])), of["offset"]).reshape(of["shape"])
            for of in (header["radiance"], header["lamps"])
        )

    with served(tmp_path) as bench:
        radiance, (lamp,) = seen()
        assert radiance.shape == (64, 128, 3)
        towards = lamp.astype(float) / np.linalg.norm(lamp.astype(float))
        for direction, count in ((towards, 1), (-towards, 0)):
            assert kept(bench, name, {"direction": direction.tolist(), "radiusDeg": 30})[0] == 200
            assert len(seen()[1]) == count
