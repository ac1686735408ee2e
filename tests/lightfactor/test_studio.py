"""The workbench's server: who may ask it, what it answers, and what is left when it is killed."""

from __future__ import annotations

import gzip
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from capture.photoset import load_photoset
from invrender.result.saved import RESULT_NAME
from lightfactor.studio.jobs import jobs
from lightfactor.studio.manifest import write_key
from lightfactor.studio.opened import key_of, open_path
from tests.invrender.faultysets import RADIUS, SIZE, change_manifest, write_set
from tests.invrender.livescenes import room

from .studios import TOKEN, Served, served

Command = Callable[..., tuple[int, str, str]]
PHOTO = key_of("000.exr")


def unpacked(data: bytes) -> dict:
    block = gzip.decompress(data)
    return json.loads(block[4 : 4 + int.from_bytes(block[:4], "little")])


def test_a_set_is_described_with_its_photographs_and_cameras(bench: Served) -> None:
    state = json.loads(bench.ask("GET", "/api/state")[2])
    assert (state["folder"], state["problem"]) == ("set", "")
    photos = state["set"]["photos"]
    assert [photo["label"] for photo in photos] == [f"{k:03d}.exr" for k in range(8)]
    assert photos[0]["id"] == PHOTO
    # All cameras stand at azimuth 0, 0.6 m away, and look at the sphere.
    for camera in state["set"]["cameras"]:
        np.testing.assert_allclose(camera["centre"], [0.6, 0, 0], atol=1e-9)
        np.testing.assert_allclose(camera["axes"][2], [-1, 0, 0], atol=1e-9)


def test_the_object_is_where_a_fit_looks_for_it(bench: Served) -> None:
    surface = unpacked(bench.ask("GET", "/api/surface")[2])
    assert surface["radius"] == pytest.approx(RADIUS)
    assert surface["centre"] == pytest.approx([0, 0, 0], abs=1e-9)
    status, _, data = bench.ask("GET", f"/api/photos/{PHOTO}/checks")
    assert status == 200
    block = gzip.decompress(data)
    start = 4 + int.from_bytes(block[:4], "little")
    arrays = json.loads(block[4:start])["arrays"]

    def array(name: str, kind: type) -> np.ndarray:
        values = np.frombuffer(
            block, kind, int(np.prod(arrays[name]["shape"])), start + arrays[name]["offset"]
        )
        return values.reshape(arrays[name]["shape"])

    covered, samples = array("covered", np.uint8), array("samples", np.float32)
    # The sphere's outline has a radius of 0.45 of the picture's side, wider by 1 / sqrt(1 - (0.02 / 0.6)^2).
    assert covered.sum() == pytest.approx(np.pi * (0.45 * SIZE) ** 2 * 1.0011, rel=0.01)
    columns, rows = samples[:, :2].T.astype(int)
    assert covered[rows, columns].all()
    assert ((samples[:, 2] > 0) & (samples[:, 2] <= 1)).all()
    # Of all but those that are seen at a grazing angle.
    assert 0.8 < len(samples) / covered.sum() < np.sin(np.radians(81)) ** 2


def test_photographs_have_thumbnails_that_are_made_once(bench: Served, ball: Path) -> None:
    status, headers, data = bench.ask("GET", f"/api/photos/{PHOTO}/thumbnail")
    assert (status, headers["content-type"]) == (200, "image/jpeg")
    assert cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR).shape == (68, 68, 3)
    (kept,) = (ball / ".studio" / "thumbnails").glob("*.jpg")
    made = kept.stat().st_mtime_ns
    assert bench.ask("GET", f"/api/photos/{PHOTO}/thumbnail")[2] == data
    assert kept.stat().st_mtime_ns == made
    facts = unpacked(bench.ask("GET", f"/api/photos/{PHOTO}")[2])
    assert facts["label"] == "000.exr"
    assert facts["saturated"] == 0
    assert sum(facts["histogram"]["counts"]["red"]) == 68 * 68


def test_a_broken_photograph_is_said_and_the_rest_works(tmp_path: Path) -> None:
    folder = write_set(tmp_path / "set")
    whole = (folder / "002.exr").read_bytes()
    (folder / "002.exr").write_bytes(whole[: len(whole) // 2])
    with served(folder) as bench:
        status, _, body = bench.ask("GET", f"/api/photos/{key_of('002.exr')}/thumbnail")
        assert status == 400
        assert "002.exr" in json.loads(body)["error"]
        assert bench.ask("GET", f"/api/photos/{PHOTO}/thumbnail")[0] == 200
        change_manifest(folder, r"radius = [\d.]+", lambda _: "radius = -1")
        state = json.loads(bench.ask("GET", "/api/state")[2])
        assert state["set"] is None
        assert "radius" in state["problem"]
        assert "radius" in json.loads(bench.ask("POST", "/api/fits", body=b"{}")[2])["error"]


MANIFEST = """format = 1
name = "two"   # as its author wrote it

[[photo]]
file = "a.png"
world_to_camera = [
    [1, 0, 0, 0],
    [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1],
]
held_out = true

[[photo]]
# The best one.
file = "b.png"
"""


def test_a_photograph_is_held_out_and_all_else_stays_as_it_was_written(tmp_path: Path) -> None:
    manifest = tmp_path / "photoset.toml"
    manifest.write_text(MANIFEST)
    write_key(manifest, "photo", 1, "held_out", True)
    assert manifest.read_text() == MANIFEST.replace("# The best", "held_out = true\n# The best")
    write_key(manifest, "photo", 1, "held_out", None)
    assert manifest.read_text() == MANIFEST
    write_key(manifest, "photo", 0, "held_out", None)
    assert manifest.read_text() == MANIFEST.replace("held_out = true\n", "")
    manifest.write_text('photo = [{ file = "a.png" }]\n')
    with pytest.raises(ValueError, match="by hand"):
        write_key(manifest, "photo", 0, "held_out", True)
    assert manifest.read_text() == 'photo = [{ file = "a.png" }]\n'


SAID = {"mesh": "", "unit": "mm", "encoding": "srgb", "light": "dark", "focal": None}


def test_a_folder_of_photographs_gets_a_manifest_and_no_second_one(tmp_path: Path) -> None:
    folder = tmp_path / 'my "ball"'
    folder.mkdir()
    picture = np.random.default_rng(0).integers(0, 200, (40, 60, 3), np.uint8)
    mask = np.zeros((40, 60), np.uint8)
    mask[10:30, 20:40] = 255
    for name, pixels in (("b.jpg", picture), ("a.png", picture), ("a_mask.png", mask)):
        cv2.imwrite(str(folder / name), pixels)
    (folder / "notes.txt").write_text("nothing")
    with served(folder) as bench:
        state = json.loads(bench.ask("GET", "/api/state")[2])
        assert state["starter"] == {"photos": ["a.png", "b.jpg"], "meshes": []}
        assert state["set"] is None
        for wrong in (
            {"mesh": "../x.ply"},
            {"light": "bright"},
            {"focal": -1},
            {"encoding": "x"},
            {"unit": "ft"},
        ):
            assert bench.ask("POST", "/api/manifest", body=json.dumps(SAID | wrong).encode())[0] == 400
            assert not (folder / "photoset.toml").exists()
        assert bench.ask("POST", "/api/manifest", body=json.dumps(SAID).encode())[0] == 200
        written = (folder / "photoset.toml").read_bytes()
        state = json.loads(bench.ask("GET", "/api/state")[2])
        assert state["starter"] is None
        assert [(photo["label"], photo["hasMask"]) for photo in state["set"]["photos"]] == [
            ("a.png", True),
            ("b.jpg", False),
        ]
        # Nobody knows the poses yet, and that is what is said.
        assert "lightfactor register" in state["problem"]
        assert bench.ask("GET", f"/api/photos/{key_of('b.jpg')}/thumbnail")[0] == 200
        assert (
            "already"
            in json.loads(bench.ask("POST", "/api/manifest", body=json.dumps(SAID).encode())[2])["error"]
        )
        assert (folder / "photoset.toml").read_bytes() == written
    photoset = load_photoset(folder, find_poses=True)
    assert photoset.name == 'my "ball"'
    assert photoset.lightings[0].dark
    assert photoset.photos[0].camera.focal_px == 72  # 1.2 of 60 pixels, a guess that the file calls one


def test_requests_that_make_no_sense_are_answered_with_a_sentence(bench: Served) -> None:
    for body, said in ((b"[1", "no JSON"), (b"[1]", "no JSON object"), (b'{"samples": 3}', "1000")):
        status, _, answer = bench.ask("POST", "/api/fits", body=body)
        assert status == 400
        assert said in json.loads(answer)["error"]
    for body, said in ((b"{}", "lacks 'heldOut'"), (b'{"heldOut": 1}', "true or false")):
        assert said in json.loads(bench.ask("POST", f"/api/photos/{PHOTO}/held-out", body=body)[2])["error"]
    assert "no mesh" in json.loads(bench.ask("GET", "/api/picks")[2])["error"]
    for name in ("room.png", "../room.hdr", ".room.hdr", "a/b.exr", ""):
        status, _, answer = bench.ask("POST", f"/api/lights?name={name}", body=b"x")
        assert status == 400
        assert "map of light" in json.loads(answer)["error"]
    assert bench.ask("POST", "/api/lights?name=room.hdr", body=b"no picture")[0] == 400


def state_when(bench: Served, fit: str, wanted: tuple[str, ...]) -> dict:
    """The last line of a fit's progress."""
    status, _, body = bench.ask("GET", f"/api/fits/{fit}/progress")
    assert status == 200
    lines = [json.loads(line) for line in body.splitlines()]
    assert lines[-1]["state"] in wanted
    return lines[-1]


@pytest.mark.slow
def test_a_fit_goes_on_when_its_server_is_killed_and_ends_when_it_is_stopped(ball: Path) -> None:
    command = [sys.executable, "-c", "from lightfactor.cli import main; main()"]
    server = subprocess.Popen(
        [*command, "studio", str(ball), "--no-browser"], stdout=subprocess.PIPE, text=True
    )
    assert server.stdout is not None
    port, token = re.search(r"127\.0\.0\.1:(\d+)/#(\S+)", server.stdout.readline()).groups()  # type: ignore[union-attr]
    bench, right = Served(int(port)), {"X-Lightfactor-Token": token}
    for _ in range(200):
        try:
            status, _, body = bench.ask("POST", "/api/fits", right, b'{"samples": 2000}')
            break
        except ConnectionRefusedError:
            time.sleep(0.1)
    assert status == 200, body
    started = json.loads(body)
    assert started["name"] == "fit-1"
    # Not two at a time.
    assert "running" in json.loads(bench.ask("POST", "/api/fits", right, b"{}")[2])["error"]
    server.send_signal(signal.SIGKILL)
    server.communicate()
    (job,) = jobs(open_path(ball))
    assert job.state() == "running"
    with served(ball) as again:
        last = state_when(again, started["id"], ("done",))
        assert last["hasResult"]
        assert "Results:" in last["said"]
        result = json.loads(again.ask("GET", f"/api/results/{started['id']}")[2])
        assert result["name"] == "fit-1"
        assert {line["status"] for line in result["numbers"]} <= {"determined", "weak"}
        assert len(result["photos"]) == 8
        # Models were told of as they were tried.
        lines = (ball / ".studio" / "jobs" / "fit-1" / "progress").read_text().splitlines()
        told = {json.loads(line).get("outcome") for line in lines}
        assert {f"{model['name']}: {model['unseen']:.2%}" for model in result["models"][:2]} <= told
        seen = unpacked(again.ask("GET", f"/api/results/{started['id']}/photos/{PHOTO}")[2])
        assert set(seen["arrays"]) == {"radiance", "std", "predicted", "counted", "normals"}
        # A second one is stopped: nothing of it is left.
        second = json.loads(again.ask("POST", "/api/fits", body=b"{}")[2])
        for _ in range(300):
            if (ball / ".studio" / "jobs" / "fit-2" / "progress").is_file():
                break
            time.sleep(0.1)
        assert again.ask("POST", f"/api/fits/{second['id']}/cancel", body=b"{}")[0] == 200
        assert state_when(again, second["id"], ("stopped",))["hasResult"] is False
        names = {path.name for path in ball.iterdir() if path.is_dir()}
        assert names == {"fit-1", ".studio", "truth"}
    assert (ball / "fit-1" / RESULT_NAME).is_file()
    assert not os.path.exists(ball / "fit-2")


def test_what_can_not_be_opened_is_said(lightfactor: Command, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for path, said in ((tmp_path / "nothing", "does not exist"), (tmp_path / "empty", "photoset.toml")):
        code, _, err = lightfactor("studio", path, "--no-browser")
        assert code == 1
        assert said in err


def test_a_port_in_use_is_said(lightfactor: Command, bench: Served, ball: Path) -> None:
    code, _, err = lightfactor("studio", ball, "--no-browser", "--port", bench.port)
    assert code == 1
    assert f"--port {bench.port}" in err
    assert TOKEN not in err


def test_maps_of_light_are_kept_with_the_set(tmp_path: Path) -> None:
    folder = write_set(tmp_path / "set")
    encoded = cv2.imencode(".hdr", np.ascontiguousarray(room(32)[..., ::-1]))[1].tobytes()
    with served(folder) as bench:
        assert bench.ask("POST", "/api/lights?name=room.hdr", body=encoded)[0] == 200
    assert (folder / ".studio" / "lights" / "room.hdr").read_bytes() == encoded
