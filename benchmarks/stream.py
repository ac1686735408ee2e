"""Light-field samples of 60 photographs of 12 megapixels against decoding them: python -m benchmarks.stream [PHOTOS].

The set is a mesh of a sphere on a ring of cameras, so that one mask serves them all; the picture is a JPEG with the
detail of a photograph. Samples come with normals, visibility and weights. What counts: the ratio of the time to that
of decoding alone, in turns in one run, and the peak memory, which must not grow with the number of photographs.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
import trimesh

from benchmarks.decode import HEIGHT, WIDTH, photograph
from benchmarks.memory import peak_megabytes
from capture.arc.gantry import Arc
from capture.camera import Camera
from capture.decode import decode_photo
from capture.parallel import parallel_map
from capture.photoset import PhotoSet, load_photoset
from recon.mesh.bodies import Body, MeshBody, body_coverage
from recon.mesh.trianglemesh import TriangleMesh
from recon.sampling.find import find_body
from recon.sampling.stream import light_fields

_FOCAL, _DISTANCE, _RADIUS, _PER_PHOTO, _ROUNDS = 6000.0, 0.6, 0.1, 1000, 2
_SOURCE = np.array([[0.6, 0.0, 0.8]])


def main(arguments: list[str]) -> None:
    """Print the ratio of times and the peak memory."""
    count = int(arguments[0]) if arguments else 60
    budget = _PER_PHOTO * count
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _write_set(folder, count)
        photoset = load_photoset(folder)
        few = PhotoSet(**{**vars(photoset), "photos": photoset.photos[:4]})
        begin = time.perf_counter()
        body = find_body(photoset).body
        checked = time.perf_counter() - begin
        samples = _stream(few, body, budget)[1]
        after_few = peak_megabytes()
        times: dict[str, list[float]] = {"decode": [], "stream": []}
        # One photograph alone measures nothing.
        for _ in range(_ROUNDS if count > 1 else 1):
            times["decode"].append(_decode(photoset))
            seconds, samples = _stream(photoset, body, budget)
            times["stream"].append(seconds)
        after_all = peak_megabytes()
    bare, ours = min(times["decode"]), min(times["stream"])
    print(f"{count} photographs of {WIDTH * HEIGHT / 1e6:.0f} megapixels, {samples} samples")
    print(
        f"decoding {bare:.1f} s, samples {ours:.1f} s: {ours / bare:.2f}x; comparing mesh and masks {checked:.1f} s"
    )
    print(f"peak memory {after_few:.0f} MB after 4 photographs, {after_all:.0f} MB after all")


def _stream(photoset: PhotoSet, body: Body, budget: int) -> tuple[float, int]:
    begin = time.perf_counter()
    sources = {photo.lighting: _SOURCE for photo in photoset.photos}
    samples = sum(len(field) for field in light_fields(photoset, body, sources, budget))
    return time.perf_counter() - begin, samples


def _decode(photoset: PhotoSet) -> float:
    begin = time.perf_counter()
    for _ in parallel_map(
        lambda photo: float(decode_photo(photoset.radiometry, photo).radiance[0, 0, 0]), photoset.photos
    ):
        pass
    return time.perf_counter() - begin


def _write_set(folder: Path, count: int) -> None:
    ball = trimesh.creation.icosphere(subdivisions=6, radius=_RADIUS)
    ball.export(folder / "ball.ply")
    photograph(folder / "photo.jpg")
    arc = Arc(np.zeros(3), np.array([0.0, 0, 1]), _DISTANCE, np.array([1.0, 0, 0]))
    params = [_FOCAL, _FOCAL, WIDTH / 2, HEIGHT / 2]
    lines = [
        'format = 1\nname = "ring"\n[radiometry]\nencoding = "srgb"\n',
        f'[camera]\nmodel = "PINHOLE"\nparams = {params}\nwidth = {WIDTH}\nheight = {HEIGHT}\n',
        '[object]\nshape = "mesh"\nmesh = "ball.ply"\n',
    ]
    for k in range(count):
        pose = arc.pose(2 * np.pi * k / count)
        (folder / f"{k:03}.jpg").symlink_to("photo.jpg")
        lines.append(
            f'[[photo]]\nfile = "{k:03}.jpg"\nmask = "mask.png"\nworld_to_camera = {json.dumps(pose.tolist())}\n'
        )
    (folder / "photoset.toml").write_text("".join(lines), encoding="utf-8")
    body = MeshBody(TriangleMesh(ball.vertices, ball.faces, ball.vertices / _RADIUS))
    covered = body_coverage(body, Camera("PINHOLE", np.array(params), WIDTH, HEIGHT, arc.pose(0.0)))
    cv2.imwrite(str(folder / "mask.png"), covered.astype(np.uint8) * 255)


if __name__ == "__main__":
    main(sys.argv[1:])
