"""Memory and time of a large texture: python -m benchmarks.texture [SCALE].

A bumpy, painted doll of 200,000 faces in 20 photographs of 2 megapixels, 1% noise, three softboxes and a lamp; each
lit pixel is a sum over eight random directions of its own, whose noise is half of the radiance (RMS). SCALE (1)
multiplies lengths in pixels and the number of samples, and divides the facets' edges. What counts: peak memory, and
the texel solve's time over that of the visibility pass.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from capture.arc.gantry import look_at
from capture.camera import Camera
from capture.files.imagefile import read_exr_layers, read_pixels, write_exr
from capture.parallel import parallel_map
from invrender.process.pipeline import DEFAULT_SAMPLES
from recon.mesh.bodies import MeshBody, blended, body_pixels
from recon.mesh.tangents import tangents
from recon.mesh.trianglemesh import TriangleMesh, smooth_normals, write_mesh
from synthetic.lights.latlong import LatLongLight
from synthetic.materials.microfacet import MicrofacetMaterial
from synthetic.shapes.doll import doll_mesh

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int64]

_PHOTOS, _WIDTH, _HEIGHT, _FOCAL, _DISTANCE = 20, 1250, 1600, 7000.0, 0.6
# Metres: 200,000 faces; bumps so high and so wide.
_EDGE, _BUMP, _WAVE = 0.000494, 0.0008, 0.012
_LOBE = MicrofacetMaterial(np.zeros(3), np.full(3, 0.1), 1.5, 0.15)
_NOISE = 0.01
# Softboxes: where in the map's rows and columns, how wide (one standard deviation, pixels), and how bright.
_MAP, _DIRECTIONS = 128, 8
_BOXES = (((40, 40), 15.0, (3, 3.3, 3.6)), ((44, 128), 15.0, (3.6, 3.3, 3)), ((38, 202), 18.0, (2.4, 3, 3.6)))
_LAMP, _IRRADIANCE = np.array([0.75, -0.4330127, 0.5]), np.array([1.2, 1.1, 1.0])


def main(arguments: list[str]) -> None:
    """Print memory, times and how well the paint is found."""
    scale = float(arguments[0]) if arguments else 1.0
    with tempfile.TemporaryDirectory() as name:
        folder, out = Path(name) / "set", Path(name) / "result"
        folder.mkdir()
        faces, pixels = write_set(folder, scale)
        words = ["process", str(folder), "-o", str(out), "--samples", str(int(scale * DEFAULT_SAMPLES))]
        command = [sys.executable, "-m", "benchmarks.memory", *words]
        done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
        peak = float(done.stdout.splitlines()[-1])
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        print(f"{faces} faces, {_PHOTOS} photographs, {pixels} pixels on the object")
        print(f"peak memory {peak / 2**10:.2f} GB, processor {used.ru_utime + used.ru_stime:.0f} s")
        print(judged(out))


def judged(out: Path) -> str:
    """What a result folder says of times, and of the texture against the paint."""
    document = json.loads((out / "result.json").read_text(encoding="utf-8"))
    path, side = out / document["texture"]["kd"], document["texture"]["side"]
    found, known = read_pixels(path).astype(float), read_exr_layers(path)["A"] > 0
    at = (np.arange(4 * side) + 0.5) / (4 * side)
    truth = np.empty_like(found)
    for row in range(side):
        uv = np.stack(np.meshgrid(at, 1 - at[4 * row : 4 * row + 4]), axis=-1)
        truth[row] = paint(uv)[0].reshape(4, side, 4, 3).mean(axis=(0, 2))
    off = (found - truth)[known]
    peak = -20 * np.log10(np.sqrt(np.mean(off**2)) / truth.max())
    return (
        f"texture {side} x {side}, {known.mean():.1%} known, Kd off by {peak:.1f} dB below the peak\n"
        f"seconds: {json.dumps(document['timing_s'])}"
    )


def paint(uv: Floats) -> tuple[Floats, Floats]:
    """Kd and Ks (..., 3) at texture coordinates (..., 2)."""
    u, v = 2 * np.pi * uv[..., :1], 2 * np.pi * uv[..., 1:]
    phases = np.array([0.0, 0.7, 1.9])
    spots = np.tanh(8 * np.sin(12 * u + phases) * np.sin(10 * v + 2 * phases))
    rings = np.sin(3 * u - 5 * v + np.zeros(3))
    return 0.14 + 0.09 * spots + 0.02 * np.sin(150 * v + 40 * u), 0.04 + 0.02 * rings


def bumpy_doll(edge: float) -> TriangleMesh:
    """The doll with bumps that hide light from each other."""
    doll = doll_mesh(edge)
    height = _BUMP * np.sin(2 * np.pi * doll.vertices / _WAVE).prod(axis=1, keepdims=True)
    vertices = doll.vertices + height * doll.normals
    return TriangleMesh(vertices, doll.faces, smooth_normals(vertices, doll.faces), doll.uv)


def write_set(folder: Path, scale: float) -> tuple[int, int]:
    """Write the set; returns its mesh's faces and the pixels on the object, of all photographs."""
    mesh = bumpy_doll(_EDGE / scale)
    write_mesh(folder / "object.obj", mesh)
    light = LatLongLight(_softboxes())
    write_exr(folder / "lighting.exr", light.pixels.astype(np.float32))
    width, height = int(_WIDTH * scale), int(_HEIGHT * scale)
    focal = _FOCAL * scale
    params = [focal, focal, width / 2, height / 2]
    lines = [
        'format = 1\nname = "large texture"\n',
        f'[camera]\nmodel = "PINHOLE"\nparams = {params}\nwidth = {width}\nheight = {height}\n',
        '[object]\nshape = "mesh"\nmesh = "object.obj"\ntexture = true\n',
        '[[lighting]]\nname = "room"\nmap = "lighting.exr"\n',
        f"directional = [{{ direction = {_LAMP.tolist()}, irradiance = {_IRRADIANCE.tolist()} }}]\n",
    ]
    body, cameras = MeshBody(mesh), []
    for k in range(_PHOTOS):
        azimuth, elevation = 2 * np.pi * k / _PHOTOS, np.radians(18 * (k % 2))
        level = np.cos(elevation)
        towards = np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
        pose = look_at(_DISTANCE * towards, np.zeros(3), [0, 0, 1])
        cameras.append(Camera("PINHOLE", np.array(params), width, height, pose))
        lines.append(
            f'[[photo]]\nfile = "{k:03}.exr"\nmask = "{k:03}.png"\nworld_to_camera = {json.dumps(pose.tolist())}\n'
        )

    def write(k: int) -> int:
        rows, columns = body_pixels(body, cameras[k])
        picture = np.zeros((height, width, 3), np.float32)
        rng = np.random.default_rng(k)
        for part in np.array_split(np.arange(len(rows)), len(rows) // 50_000 + 1):
            seen = photographed(body, light, cameras[k], (rows[part], columns[part]), rng)
            picture[rows[part], columns[part]] = seen * (1 + _NOISE * rng.standard_normal(seen.shape))
        write_exr(folder / f"{k:03}.exr", picture)
        mask = np.zeros((height, width), np.uint8)
        mask[rows, columns] = 255
        cv2.imwrite(str(folder / f"{k:03}.png"), mask)
        return len(rows)

    pixels = sum(parallel_map(write, range(_PHOTOS)))
    (folder / "photoset.toml").write_text("".join(lines), encoding="utf-8")
    return len(mesh.faces), pixels


def photographed(
    body: MeshBody, light: LatLongLight, camera: Camera, pixels: tuple[Ints, Ints], rng: np.random.Generator
) -> Floats:
    """Radiance (n, 3) of pixels, rows and columns: paint over 2 x 2 parts of each, light at its middle."""
    mesh, (rows, columns) = body.mesh, pixels
    assert mesh.uv is not None
    centres = np.column_stack([columns, rows]) + 0.5
    kd, ks = np.zeros((2, len(rows), 3))
    for corner in np.array([(-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)]):
        found = body.hits(camera, np.asarray(centres + corner))
        assert found.faces is not None
        assert found.weights is not None
        uv = blended(mesh.uv, mesh.faces[found.faces], found.weights)
        for total, value in zip((kd, ks), paint(uv), strict=True):
            total += value / 4
    at = body.hits(camera, np.asarray(centres))
    frame = np.concatenate([tangents(at.normals), at.normals[:, None]], axis=1)
    wo = np.einsum("nij,nj->ni", frame, at.views)
    result = np.zeros((len(rows), 3))
    for directions, irradiance in _lights(light, len(rows), rng):
        wi = np.einsum("nij,nj->ni", frame, directions)
        lit = (wi[:, 2] > 0) & body.visible(at.positions, at.facets, directions)
        cos = np.where(lit, wi[:, 2], 0)[:, None]
        result += (kd + ks * _LOBE.lobe(wi, wo)) * cos * irradiance
    return result


def _lights(light: LatLongLight, count: int, rng: np.random.Generator) -> Iterator[tuple[Floats, Floats]]:
    """Directions (count, 3) and irradiance square to them (count, 3): the lamp, then some of the map's own density."""
    yield np.broadcast_to(_LAMP, (count, 3)), np.broadcast_to(_IRRADIANCE, (count, 3))
    for k in range(_DIRECTIONS):
        # Stratified along the one random number.
        u = rng.random((count, 2))
        u[:, 0] = (u[:, 0] + k) / _DIRECTIONS
        directions = np.asarray(light.sample(u), float)
        radiance = np.asarray(light.radiance_from(directions), float)
        yield directions, radiance / (_DIRECTIONS * light.density(directions)[:, None])


def _softboxes() -> Singles:
    rows, columns = np.mgrid[:_MAP, : 2 * _MAP]
    total = np.zeros((_MAP, 2 * _MAP, 3))
    for (row, column), width, value in _BOXES:
        square = ((rows - row) ** 2 + (columns - column) ** 2) / width**2
        total += np.exp(-square / 2)[..., None] * value
    return total.astype(np.float32)


if __name__ == "__main__":
    main(sys.argv[1:])
