"""Photo sets through polarising filters: each view parallel and crossed, of renderings with and without the lobe."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np

from capture.files.imagefile import read_pixels, write_exr
from capture.manifest import Polarisation
from synthetic.materials.material import Material
from synthetic.materials.texture import Textured
from synthetic.scenes.build import read_staging
from synthetic.sensing.noise import Noise
from synthetic.writer import write_photoset

_FILTERS: tuple[Polarisation, ...] = ("parallel", "cross")


def write_pairs(
    folder: Path,
    scene: Path,
    extinction: float,
    transmission: float = 0.4,
    noise: float = 0.01,
    seed: int = 0,
) -> Path:
    """The photographs of a scene file, each twice, in `folder`/pairs, with a share of noise.

    The base is half of what comes through an ideal filter, however it is turned. All of the lobe comes through a
    parallel one, `extinction` of that through a crossed one; all filters pass `transmission` of unpolarised light.
    """
    staging = replace(read_staging(scene), sensor=Noise(0, 0))
    matte = replace(staging, scene=replace(staging.scene, material=_without_lobe(staging.scene.material)))
    whole, base, out = folder / "whole", folder / "base", folder / "pairs"
    write_photoset(staging, whole)
    write_photoset(matte, base)
    out.mkdir()
    for file in whole.iterdir():
        if (
            file.is_file()
            and file.name != "truth.json"
            and not (file.suffix == ".exr" and file.stem.isdigit())
        ):
            shutil.copy(file, out)
    rng = np.random.default_rng(seed)
    head, *photos = (whole / "photoset.toml").read_text().split("[[photo]]\n")
    written = [head]
    for k, photo in enumerate(photos):
        name = f"{k:03d}.exr"
        below = read_pixels(base / name).astype(float)
        lobe = read_pixels(whole / name).astype(float) - below
        for polarisation in _FILTERS:
            passed = 1.0 if polarisation == "parallel" else extinction
            pixels = 2 * transmission * (below / 2 + passed * lobe)
            pixels *= 1 + noise * rng.standard_normal(pixels.shape)
            write_exr(out / f"{k:03d}-{polarisation}.exr", pixels.astype(np.float32))
            table = photo.replace(name, f"{k:03d}-{polarisation}.exr")
            written.append(f'[[photo]]\npolarisation = "{polarisation}"\n{table}')
    text = "".join(written)
    first = text.index("[[lighting]]")
    table = f"[polarisation]\ntransmission = {transmission}\n\n"
    (out / "photoset.toml").write_text(text[:first] + table + text[first:])
    return out


def _without_lobe(material: Material) -> Material:
    if isinstance(material, Textured):
        return replace(material, ks_map=np.zeros_like(material.ks_map))
    return replace(material, ks=np.zeros(3))
