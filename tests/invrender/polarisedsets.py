"""Photo sets through polarising filters: each view parallel and crossed, of renderings with and without the lobe."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np

from capture.files.imagefile import read_pixels, write_exr
from capture.manifest import Polarisation
from tests.invrender.faultysets import GLOSSY, write_set

_FILTERS: tuple[Polarisation, ...] = ("parallel", "cross")


def write_pairs(
    folder: Path, extinction: float, transmission: float = 0.4, noise: float = 0.01, seed: int = 0
) -> Path:
    """The sphere of `faultysets` under one lamp per pair of photographs.

    The base is half of what comes through an ideal filter, however it is turned. All of the lobe comes through a
    parallel one, `extinction` of that through a crossed one; all filters pass `transmission` of unpolarised light.
    """
    matte = GLOSSY.replace("ks = 0.04", "ks = 0.0")
    whole, base = write_set(folder / "whole", GLOSSY, noise=0), write_set(folder / "base", matte, noise=0)
    rng, out = np.random.default_rng(seed), folder / "pairs"
    out.mkdir()
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
    for mask in whole.glob("*_mask.png"):
        shutil.copy(mask, out)
    text = "".join(written)
    first = text.index("[[lighting]]")
    table = f"[polarisation]\ntransmission = {transmission}\n\n"
    (out / "photoset.toml").write_text(text[:first] + table + text[first:])
    return out
