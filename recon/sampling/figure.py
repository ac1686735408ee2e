"""What the samples of a photograph know, as pictures to check a set by."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from capture.camera import Camera
from capture.figures import short_name
from capture.radiance import RadianceImage
from capture.srgb import linear_to_srgb
from recon.mesh.bodies import Body, body_window, sees
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# Pixels along the longer side of the part of the photograph that is drawn.
_SIDE = 360
_EMPTY = "lightsteelblue"


@dataclass(frozen=True, eq=False)
class PhotoPanel:
    """One photograph for the figure. sky : per vertex of a mesh, the share of the sky that it sees, or None."""

    label: str
    camera: Camera
    image: RadianceImage
    field: LightField
    sources: Floats
    sky: NDArray[np.floating] | None


def samples_figure(panel: PhotoPanel, body: Body, faces: NDArray[np.int64] | None) -> Figure:
    """Photograph, samples by weight, normals, sky, mirrored rays and the first source's shadow.

    faces : (f, 3) of the mesh; None for a sphere.
    """
    window = body_window(body, panel.camera)
    stride = max(-(-max(window[2] - window[0], window[3] - window[1]) // _SIDE), 1)
    rows, columns = (np.arange(window[k], window[k + 2], stride) for k in (0, 1))
    y, x = np.meshgrid(rows, columns, indexing="ij")
    pixels: Floats = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64) + 0.5
    pictures = _pictures(panel, body, faces, pixels, y.shape)
    radiance = np.clip(panel.image.radiance[y, x], 0, None)
    shown = linear_to_srgb(np.minimum(radiance / max(float(np.quantile(radiance, 0.99)), 1e-12), 1))
    tall = np.clip(y.shape[0] / y.shape[1], 0.4, 1.5)
    figure = Figure(figsize=(13, 2 * (0.9 + 3.2 * tall)), layout="constrained")
    axes = figure.subplots(2, 3).ravel()
    extent = (columns[0], columns[-1] + stride, rows[-1] + stride, rows[0])
    axes[0].imshow(shown, extent=extent)
    axes[0].set_title(short_name(panel.label))
    axes[1].imshow(0.4 * shown, extent=extent)
    dots = axes[1].scatter(
        panel.field.columns + 0.5,
        panel.field.rows + 0.5,
        c=panel.field.weight,
        s=2,
        vmin=0,
        vmax=1,
        cmap="viridis",
    )
    figure.colorbar(dots, ax=axes[1], label="weight", shrink=0.8)
    axes[1].set_title(f"{len(panel.field)} samples")
    for axis, (title, picture) in zip(axes[2:], pictures, strict=False):
        drawn = axis.imshow(picture, extent=extent, vmin=0, vmax=1, cmap="gray", interpolation="nearest")
        if picture.ndim == 2:
            figure.colorbar(drawn, ax=axis, shrink=0.8)
        axis.set_title(title)
        axis.set_facecolor(_EMPTY)
    for axis in axes[2 + len(pictures) :]:
        axis.set_axis_off()
    for axis in axes[: 2 + len(pictures)]:
        axis.set_xlabel("column (px)")
        axis.set_ylabel("row (px)")
    return figure


def _pictures(
    panel: PhotoPanel, body: Body, faces: NDArray[np.int64] | None, pixels: Floats, shape: tuple[int, ...]
) -> list[tuple[str, NDArray[Any]]]:
    """Titles and pictures (h, w) or (h, w, 4); what the body doesn't cover is left empty."""
    hits = body.hits(panel.camera, pixels)
    # Where nothing is hit the lens may have no ray at all.
    views = np.where(hits.hit[:, None], hits.views, [0.0, 0.0, 1.0])

    def drawn(values: NDArray[Any]) -> NDArray[Any]:
        if values.ndim == 1:
            return np.where(hits.hit, values, np.nan).reshape(shape)
        return np.column_stack([values, hits.hit]).reshape(*shape, 4)  # opacity last

    mirrored = 2 * (hits.normals * views).sum(axis=1)[:, None] * hits.normals - views
    pictures = [("normals: x, y, z as red, green, blue", drawn((hits.normals + 1) / 2))]
    if panel.sky is not None and faces is not None and hits.faces is not None:
        assert hits.weights is not None
        sky = (panel.sky[faces[hits.faces]] * hits.weights).sum(axis=1)
        pictures.append(("share of the sky that is seen, by cosine", drawn(sky)))
    free = body.visible(hits.positions, hits.facets, mirrored).astype(float)
    pictures.append(("mirrored ray: 1 free, 0 meets the object", drawn(free)))
    if len(panel.sources):
        lit = sees(body, hits.positions, hits.facets, panel.sources[0]).astype(float)
        pictures.append(("first source: 1 seen, 0 hidden", drawn(lit)))
    return pictures
