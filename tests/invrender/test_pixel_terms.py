"""What a predicted pixel is made of adds up to the picture, and each part comes from where its name says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.testing import assert_allclose

from capture.files.imagefile import write_exr
from invrender.output.render.view import View
from recon.mesh.trianglemesh import TriangleMesh

from .livescenes import gloss, room, studio_of
from .renders import write_result


def corner() -> TriangleMesh:
    """Two square plates at right angles, 40 mm wide: each sends light to the other."""
    steps = np.linspace(0, 0.04, 9)
    vertices, faces, normals = [], [], []
    for across, outward in (((1, 0, 0), (0, 0, 1)), ((0, 0, 1), (1, 0, 0))):
        start = len(vertices)
        for u in steps:
            for v in steps:
                vertices.append(u * np.array(across) + v * np.array([0.0, 1, 0]))
                normals.append(outward)
        for i in range(8):
            for j in range(8):
                a, b, c, d = (start + 9 * (i + k) + j + m for k, m in ((0, 0), (1, 0), (1, 1), (0, 1)))
                turned = outward == (0, 0, 1)
                faces += [(a, b, c), (a, c, d)] if turned else [(a, c, b), (a, d, c)]
    return TriangleMesh(np.array(vertices), np.array(faces), np.array(normals, float))


def test_parts_add_up_to_the_picture(tmp_path: Path):
    studio, _ = studio_of(gloss(tmp_path / "result"))
    camera = studio.camera(View(30.0, 20.0, None), studio.optics((24, 24)))
    picture = studio.take(camera, percent=0)
    strong = replace(
        studio,
        material=replace(studio.material, brdf=replace(studio.material.brdf, ks=2 * studio.material.brdf.ks)),
    )
    brightest = np.unravel_index(picture.radiance.sum(axis=2).argmax(), (24, 24))
    rim = np.argwhere((picture.coverage > 0) & (picture.coverage < 1))[0]
    for row, column in (brightest, (12, 12), (15, 6), rim):
        base, lobe, bounced = studio.terms(camera, int(row), int(column))
        # Pictures sum up maps in single precision.
        assert_allclose(base + lobe, picture.radiance[row, column], rtol=1e-4)
        assert (base > 0).all()
        assert not bounced.any()
        again = strong.terms(camera, int(row), int(column))
        assert_allclose(again[0], base)
        assert_allclose(again[1], 2 * lobe)
    assert not np.any(studio.terms(camera, 0, 0))


def test_what_parts_of_a_mesh_send_each_other_is_told_apart(tmp_path: Path):
    write_result(tmp_path / "result", "half-angle microfacet", 1.5, 0.15, interreflection={"taken_off": True})
    write_exr(tmp_path / "result" / "lighting.exr", room())
    studio, _ = studio_of(tmp_path / "result", corner())
    camera = studio.camera(View(45.0, 45.0, None), studio.optics((40, 40)))
    picture = studio.take(camera, percent=0)
    rows, columns = np.nonzero(picture.coverage == 1)
    some = slice(None, None, len(rows) // 12)
    shares = []
    for row, column in zip(rows[some], columns[some], strict=True):
        terms = studio.terms(camera, int(row), int(column))
        assert_allclose(sum(terms), picture.radiance[row, column], rtol=1e-4)
        shares.append(terms[2].sum() / sum(terms).sum())
    # From a plate of albedo about one half at right angles: some percent, and more near the edge that both share.
    assert min(shares) >= 0
    assert 0.02 < max(shares) < 0.5
