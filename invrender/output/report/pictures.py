"""Pictures of the report as data URLs: photographs, differences and figures."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence

import cv2
import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from capture.srgb import linear_to_srgb
from invrender.brdf.richer import SHARES_BEYOND, facet_density
from invrender.brdf.smith import Smith
from invrender.estimate.evidence import Candidate
from invrender.estimate.quantities import FittedLighting, PhotoScore
from invrender.estimate.textured.textures import FittedTextures
from invrender.result.document import lighting_map
from recon.sampling.lightfield import LightField

Floats = NDArray[np.float64]

# Pixels along the longer side: three pictures abreast on a wide screen, twice as fine for sharp displays.
_PICTURE_PX = 640
_INK, _ACCENT, _SOFT = "#24292f", "#0b6bcb", "#b9c4d0"
# Lightings of nothing but sources that have a panel each.
_FEW_PLAIN = 4
# Widths of the widest lobe up to which distributions of normals are drawn.
_WIDTHS = 6.0
# Of texels that the photographs leave open, 8 bits: neither black, which is an albedo, nor of a colour scale.
_UNKNOWN = 200


def tone_mapped(radiance: NDArray[np.floating], white: float) -> NDArray[np.uint8]:
    """Linear RGB to 8-bit sRGB, `white` shown as white."""
    linear = np.clip(np.asarray(radiance, float) / max(white, 1e-30), 0, 1)
    return np.round(linear_to_srgb(linear) * 255).astype(np.uint8)


def white_level(radiance: NDArray[np.floating]) -> float:
    """A white that lets only the brightest half percent clip."""
    return float(np.percentile(np.asarray(radiance).max(axis=-1), 99.5))


def difference_picture(difference: Floats, limit: float, inside: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Signed difference (h, w) in colours, blue below and red above zero, saturating at +-limit; grey outside."""
    colours = matplotlib.colormaps["RdBu_r"](np.clip(difference / max(limit, 1e-30) / 2 + 0.5, 0, 1))[..., :3]
    colours[~inside] = 0.93
    return np.round(colours * 255).astype(np.uint8)


def shrunk(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A picture (h, w, 3) no wider or higher than a page shows it."""
    scale = _PICTURE_PX / max(picture.shape[:2])
    if scale >= 1:
        return picture
    return np.asarray(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)


def image_url(picture: NDArray[np.uint8], jpeg: bool = False) -> str:
    """An RGB picture (h, w, 3) as a data URL."""
    extension, kind = (".jpg", "jpeg") if jpeg else (".png", "png")
    _, data = cv2.imencode(extension, picture[:, :, ::-1])
    return f"data:image/{kind};base64,{base64.b64encode(data.tobytes()).decode()}"


def figure_url(figure: Figure) -> str:
    """A figure as a data URL of its SVG, so that it is sharp at any size."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg", bbox_inches="tight", metadata={"Date": None})
    return f"data:image/svg+xml;base64,{base64.b64encode(buffer.getvalue()).decode()}"


def residual_figure(fields: Mapping[str, LightField], residuals: Mapping[str, Floats]) -> Figure:
    """Relative residual against exitant angle: mean (bias) and RMS per bin of four degrees.

    fields : samples of each photograph. residuals : (n, 3), of the same.
    """
    angle = np.degrees(np.arccos(np.clip(np.concatenate([f.cos_exitant for f in fields.values()]), 0, 1)))
    radiance = np.concatenate([field.radiance.mean(axis=1) for field in fields.values()])
    residual = np.concatenate([residuals[label].mean(axis=1) for label in fields])
    edges = np.arange(0, 92, 4)
    cell = np.digitize(angle, edges) - 1
    count = np.bincount(cell, minlength=len(edges))
    used = np.flatnonzero(count >= 20)

    def per_bin(values: Floats) -> Floats:
        return np.bincount(cell, values, minlength=len(edges))[used] / count[used]

    mean = per_bin(radiance)
    centre = edges[used] + 2
    figure = Figure(figsize=(6.4, 3.4))
    axes = figure.add_subplot()
    axes.axhline(0, color=_SOFT, lw=1)
    axes.plot(centre, 100 * np.sqrt(per_bin(residual**2)) / mean, "o-", color=_ACCENT, ms=4, label="RMS")
    axes.plot(centre, 100 * per_bin(residual) / mean, "s--", color="#c2410c", ms=4, label="mean (bias)")
    axes.set_xlabel("exitant angle, camera to normal (degrees)")
    axes.set_ylabel("residual, mean of channels\n(% of mean radiance)")
    axes.set_xlim(0, 90)
    axes.legend(frameon=False)
    _plain(axes)
    return figure


def photo_error_figure(scores: Sequence[PhotoScore]) -> Figure:
    """Relative RMS of each photograph: fitted, cross-validated, held out."""
    figure = Figure(figsize=(6.4, 3.4), layout="constrained")
    axes = figure.add_subplot()
    place = np.arange(1, len(scores) + 1)
    fitted = np.array([not s.held_out for s in scores])
    rms = 100 * np.array([s.rms for s in scores])
    unseen = np.array([np.nan if s.cross_validated is None else 100 * s.cross_validated for s in scores])
    axes.bar(place[fitted], rms[fitted], color=_SOFT, label="fitted")
    if not fitted.all():
        axes.bar(place[~fitted], rms[~fitted], color="#c2410c", label="held out")
    axes.plot(place, unseen, "o", color=_ACCENT, ms=4, label="when left out of the fit")
    axes.set_xlabel("photograph, in the manifest's order")
    axes.set_ylabel("RMS residual (% of RMS radiance)")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_ylim(0, 1.35 * float(np.nanmax(np.append(rms, unseen))))
    axes.legend(frameon=False, loc="upper right", ncols=3, fontsize=9)
    _plain(axes)
    return figure


def lighting_figure(entries: Sequence[FittedLighting]) -> Figure:
    """The lightings as lat-long maps with their directional sources, one panel each (at most twelve).

    More than four that are nothing but sources share one panel, a dot for each source.
    """
    plain = [entry.lighting.radiance_map is None and entry.ambient is None for entry in entries]
    crowd = sum(plain) > _FEW_PLAIN
    together = [entry for entry, alone in zip(entries, plain, strict=True) if alone and crowd]
    shown = [entry for entry, alone in zip(entries, plain, strict=True) if not (alone and crowd)][:12]
    panels = len(shown) + bool(together)
    across = min(panels, 4)
    down = -(-panels // across)
    figure = Figure(figsize=(max(3.1 * across, 6.4), 1.95 * down + 0.5) if across > 1 else (6.4, 3.4))
    maps = [lighting_map(entry) for entry in shown]
    white = max([float(np.percentile(radiance.max(axis=-1), 99)) for radiance in maps] + [1e-12])
    for k in range(panels):
        axes = figure.add_subplot(down, across, k + 1)
        if k < len(shown):
            axes.imshow(tone_mapped(maps[k], white), extent=(0, 360, 180, 0), aspect="auto")
            azimuth, polar = _angles(shown[k].lighting.directions)
            axes.plot(azimuth, polar, "*", color="#f5b301", mec="black", mew=0.6, ms=11)
            axes.set_title(shown[k].lighting.name, fontsize=9, color=_INK)
        else:
            strength = np.concatenate([entry.lighting.irradiances.mean(axis=1) for entry in together])
            azimuth, polar = _angles(np.concatenate([entry.lighting.directions for entry in together]))
            dots = axes.scatter(azimuth, polar, 26, strength, edgecolors="black", linewidths=0.5)
            figure.colorbar(dots, ax=axes).set_label("irradiance, mean of channels", fontsize=8)
            axes.set_title(f"sources of {len(together)} lightings", fontsize=9, color=_INK)
        axes.set_xlim(0, 360)
        axes.set_ylim(180, 0)
        axes.set_xticks([0, 90, 180, 270, 360])
        axes.set_yticks([0, 90, 180])
        axes.tick_params(labelsize=7)
        if k // across == down - 1 or k + across >= panels:
            axes.set_xlabel("azimuth from +X (degrees)", fontsize=8)
        if k % across == 0:
            axes.set_ylabel("polar angle\nfrom +Z (degrees)", fontsize=8)
    figure.tight_layout()
    return figure


def _angles(directions: Floats) -> tuple[Floats, Floats]:
    """Azimuth and polar angle (k,) of directions (k, 3), degrees."""
    x, y, z = directions.T
    return np.degrees(np.arctan2(y, x)) % 360, np.degrees(np.arccos(np.clip(z, -1, 1)))


def normals_figure(candidates: Sequence[Candidate], chosen: int) -> Figure | None:
    """Distributions of normals without a formula beside the best with one; None where no such table was tried."""
    facets = [
        (k, brdf)
        for k, brdf in enumerate(candidate.estimate.brdf for candidate in candidates)
        if brdf.sigma is not None and isinstance(brdf.form.lobe, Smith)
    ]
    tables = [pair for pair in facets if SHARES_BEYOND[0] in pair[1].form.numbers]
    formulas = [pair for pair in facets if pair not in tables]
    if not tables or not formulas:
        return None
    shown = {min(group, key=lambda pair: candidates[pair[0]].error)[0] for group in (tables, formulas)}
    shown |= {k for k, _ in facets if k == chosen}
    widest = max(brdf.sigma or 0.0 for k, brdf in facets if k in shown)
    theta = np.linspace(0, min(_WIDTHS * widest, np.pi / 2), 300)
    figure = Figure(figsize=(6, 3.2), layout="constrained")
    axes = figure.add_subplot()
    highest = 0.0
    for k, brdf in facets:
        if k in shown:
            density = facet_density(brdf.form, theta, brdf.sigma or 0.0)
            highest = max(highest, float(density.max()))
            dashed = SHARES_BEYOND[0] in brdf.form.numbers
            label = f"{brdf.form.name}, {candidates[k].error:.2%}{' (chosen)' if k == chosen else ''}"
            axes.plot(np.degrees(theta), density, "--" if dashed else "-", label=label)
    axes.set(
        yscale="log",
        ylim=(highest * 1e-4, highest * 2),
        xlabel="half angle (degrees)",
        ylabel="distribution of normals D (1/sr)",
    )
    axes.legend(fontsize="small", title="form, error on unseen photographs", title_fontsize="small")
    _plain(axes)
    return figure


def texture_figure(textures: FittedTextures) -> Figure:
    """Maps of Kd, and of Ks where it varies, beside their standard deviations; grey where they aren't known."""
    rows = [("$K_d$", textures.kd, textures.kd_std)]
    if textures.ks_varies:
        rows.append(("$K_s$", textures.ks, textures.ks_std))
    unknown = textures.layout.image(textures.known.astype(float)) == 0
    figure = Figure(figsize=(8.6, 3.9 * len(rows)))
    panels = figure.subplots(len(rows), 2, squeeze=False)
    for (name, values, std), (picture_axes, doubt) in zip(rows, panels, strict=True):
        picture = tone_mapped(textures.layout.image(values), white_level(values[textures.known]))
        picture[unknown] = _UNKNOWN
        picture_axes.set_title(name, fontsize=10, color=_INK)
        # Of the surface's mean: where the albedo is black, a share of its own value would say nothing.
        mean = float(values[textures.known].mean())
        share = 100 * textures.layout.image(std.mean(axis=1)) / max(mean, 1e-30)
        most = float(np.percentile(share[~unknown], 98))
        colours = matplotlib.colormaps["viridis"](np.clip(share / max(most, 1e-30), 0, 1))[..., :3]
        codes = np.round(255 * colours).astype(np.uint8)
        codes[unknown] = _UNKNOWN
        doubt.set_title(f"standard deviation (% of the mean {name})", fontsize=10, color=_INK)
        scale = matplotlib.cm.ScalarMappable(matplotlib.colors.Normalize(0, most), "viridis")
        figure.colorbar(scale, ax=doubt, fraction=0.046, extend="max").ax.tick_params(labelsize=8)
        for axes, shown in ((picture_axes, picture), (doubt, codes)):
            axes.imshow(shrunk(shown), extent=(0, 1, 0, 1), interpolation="none")
            axes.set(xlabel="u", ylabel="v", xticks=[0, 0.5, 1], yticks=[0, 0.5, 1])
            axes.tick_params(labelsize=8)
    figure.tight_layout()
    return figure


def _plain(axes: matplotlib.axes.Axes) -> None:
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.grid(axis="y", color="#eaeef2", lw=0.8)
    axes.set_axisbelow(True)
