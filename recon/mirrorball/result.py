"""What `lightfactor mirrorball` writes and prints."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from capture.files.documents import file_hash, software, write_json
from capture.files.imagefile import write_exr
from capture.terminal import console
from recon.mirrorball.figure import ViewPanel, ball_figure
from recon.mirrorball.light import BallLighting, lighting_of_ball
from recon.mirrorball.view import BallSource, BallView
from recon.sphere.circle import Disk

if TYPE_CHECKING:
    from recon.mirrorball.register import Turn

Floats = NDArray[np.float64]

OWN_FILES = ("lighting.json", "lighting.toml", "mirrorball.png", "*.exr")
_FRAME = "x right, y up, z towards the camera"
_MERGED = "lighting"
# Share of all directions that may be saturated, sources apart, before it is worth a word.
_NOTABLE_CLIPPING = 0.001


@dataclass(frozen=True)
class BallShot:
    """One view as files: a photograph or a bracket, and where the ball is in it."""

    photos: tuple[Path, ...]
    mask: Path | None
    disk: Disk | None
    background: Path | None

    @property
    def files(self) -> tuple[Path, ...]:
        """All files that it is read from."""
        return (*self.photos, *(path for path in (self.mask, self.background) if path is not None))


@dataclass(frozen=True, eq=False)
class Reading:
    """All that one run found: each view as a lighting of its own, and the views merged, if they are of one light.

    turns : how each view was turned to the first, where that was estimated.
    """

    shots: tuple[BallShot, ...]
    views: tuple[BallView, ...]
    singles: tuple[BallLighting, ...]
    merged: BallLighting | None
    panels: tuple[ViewPanel, ...]
    turns: tuple[Turn, ...] | None

    @property
    def lightings(self) -> tuple[BallLighting, ...]:
        """The lightings as a photo set would use them."""
        return self.singles if self.merged is None else (self.merged,)

    @property
    def stems(self) -> tuple[str, ...]:
        """The names of the lightings' maps."""
        own = tuple(shot.photos[0].stem for shot in self.shots)
        return own if self.merged is None else (_MERGED,)

    @property
    def upright(self) -> bool:
        """Whether the world is the first camera's, drawn upright."""
        first = self.views[0].camera.world_to_camera[:3, :3]
        return bool(np.allclose(first, np.diag([1, -1, -1]), atol=1e-9))

    @property
    def frame(self) -> str:
        """The world's axes, in words."""
        if self.merged is None:
            return _FRAME
        return f"{_FRAME} of {self.views[0].name}" if self.upright else "that of the poses"


def write(folder: Path, reading: Reading, given: Iterable[Path]) -> None:
    """Write the maps, lighting.json, lighting.toml and the figure. given : files that options named, as inputs."""
    for shot, ball in zip(reading.shots, reading.singles, strict=True):
        write_exr(folder / f"{shot.photos[0].stem}.exr", ball.radiance_map)
    if reading.merged is not None:
        write_exr(folder / f"{_MERGED}.exr", reading.merged.radiance_map)
    inputs = sorted({*(path for shot in reading.shots for path in shot.files), *given})
    write_json(folder / "lighting.json", _document(reading, inputs))
    (folder / "lighting.toml").write_text(_snippet(reading), encoding="utf-8")
    figure = ball_figure(reading.panels, reading.singles, reading.merged, reading.frame, reading.upright)
    figure.savefig(folder / "mirrorball.png")


def _document(reading: Reading, inputs: Sequence[Path]) -> dict[str, Any]:
    brightest = _brightest((*reading.singles, *reading.lightings))
    entries = []
    for index, (shot, view, ball) in enumerate(
        zip(reading.shots, reading.views, reading.singles, strict=True)
    ):
        camera = view.camera
        entry = {
            "photo": str(shot.photos[0]),
            "bracket": [str(path) for path in shot.photos],
            "map": f"{shot.photos[0].stem}.exr",
            **_found(ball, brightest),
            "ball_centre_px": camera.project(view.sphere.centre[None])[0].tolist(),
            "ball_radius_px": view.radius_px,
            "outline_rms_px": view.sphere.residual_px[0],
            "camera": {"model": camera.model, "params": camera.params.tolist()},
            "world_to_camera": camera.world_to_camera.tolist(),
            "bracket_factors": list(view.bracket_factors),
        }
        if reading.turns is not None:
            entry["rotation_std_deg"] = reading.turns[index].std_deg
        entries.append(entry)
    document: dict[str, Any] = {
        "format": 1,
        "frame": reading.frame,
        "unit": "irradiance in the photographs' relative radiance times steradians",
        "photos": entries,
    }
    if reading.merged is not None:
        agreement = [
            {"photo": each.name, "correlation": each.correlation, "factor": each.factor}
            for each in reading.merged.agreement
        ]
        document["merged"] = {
            "map": f"{_MERGED}.exr",
            **_found(reading.merged, brightest),
            "agreement": agreement,
            "warnings": list(reading.merged.warnings),
        }
    return {**document, "inputs": {str(path): file_hash(path) for path in inputs}, "software": software()}


def _found(ball: BallLighting, brightest: float) -> dict[str, Any]:
    return {
        "sources": [_source(source, brightest, ball.centre) for source in ball.sources],
        "uncovered_share": ball.uncovered_share,
        "clipped_share": ball.clipped_share,
    }


def _source(source: BallSource, brightest: float, centre: Floats | None) -> dict[str, Any]:
    position = distance_std = None
    if source.closeness and centre is not None:
        position = (centre + source.direction / source.closeness).tolist()
        distance_std = source.closeness_std / source.closeness**2
    return {
        "direction": source.direction.tolist(),
        "direction_std_deg": source.direction_std_deg,
        "position": position,
        "distance_std": distance_std,
        "angular_radius_deg": source.angular_radius_deg,
        "irradiance": source.irradiance.tolist(),
        "irradiance_std": source.irradiance_std.tolist(),
        "relative_irradiance": float(source.irradiance.mean()) / brightest,
        "clipped": source.clipped,
        "photos": list(source.views),
    }


def _snippet(reading: Reading) -> str:
    """The lightings as tables of a photoset.toml."""
    lines = [
        "# Light read off mirror balls: paste these tables into a photoset.toml.",
        f"# World: {reading.frame}; if the photo set's is another, turn directions, positions and maps.",
        "# Maps are named relative to the photoset.toml: copy them beside it, or write their path.",
    ]
    for stem, ball in zip(reading.stems, reading.lightings, strict=True):
        lighting = lighting_of_ball(ball, None)
        # JSON's quoting of a string is TOML's as well.
        lines += ["", "[[lighting]]", f"name = {json.dumps(stem)}"]
        if lighting.recovers:
            lines.append("# A highlight is clipped, so that its brightness is recovered in the fit.")
            lines.append(f"recover = {json.dumps(list(lighting.recovers))}")
        if lighting.radiance_map is not None:
            if ball.clipped_share > _NOTABLE_CLIPPING:
                lines.append(f"# Caution: {_clipping(ball)}.")
            lines.append(f"map = {json.dumps(stem + '.exr')}")
        recovered = lighting.recover_irradiance
        distant, near = [], []
        for source, place in zip(ball.sources, lighting.places, strict=True):
            if place is None:
                known = "" if recovered else f", irradiance = {_vector(source.irradiance, 5)}"
                distant.append(f"    {{ direction = {_vector(source.direction, 6)}{known} }},")
            else:
                known = "" if recovered else f", intensity = {_vector(place[1], 5)}"
                near.append(f"    {{ position = {_vector(place[0], 6)}{known} }},")
        for key, rows in (("directional", distant), ("near", near)):
            lines += [f"{key} = [", *rows, "]"] if rows else []
    return "\n".join(lines) + "\n"


def _vector(values: NDArray[np.float64], digits: int) -> str:
    return "[" + ", ".join(f"{value:.{digits}g}" for value in values) + "]"


def report(reading: Reading, output: Path) -> None:
    """Print the sources and what is wrong, and where results went."""
    from rich.markup import escape
    from rich.table import Table

    brightest = _brightest(reading.lightings)
    table = Table(box=None, header_style="bold")
    table.add_column("view" if reading.merged is None else "lighting")
    table.add_column("source direction", justify="right")
    for heading in ("± deg", "distance (m)", "irradiance", "clipped"):
        table.add_column(heading, justify="right")
    for ball in reading.lightings:
        if not ball.sources:
            table.add_row(escape(ball.name), "none: all light is in the map", "", "", "", "")
        for number, source in enumerate(ball.sources):
            table.add_row(
                escape(ball.name) if number == 0 else "",
                " ".join(f"{value:7.4f}" for value in source.direction),
                f"{source.direction_std_deg:.2f}",
                _distance(source),
                _irradiance(source, brightest),
                "yes" if source.clipped else "no",
            )
    console.print(table)
    console.print(f"Directions: {escape(reading.frame)}. Irradiance: relative to the brightest source.")
    if any(source.clipped for ball in reading.lightings for source in ball.sources):
        console.print(
            "A clipped source's irradiance is a lower bound. To measure it, add a shorter exposure (--bracket),"
            " or have it recovered from the object's photographs, as lighting.toml does."
        )
    for ball in reading.lightings:
        console.print(f"{escape(ball.name)}: {ball.uncovered_share:.1%} of all directions not seen.")
        if ball.clipped_share > _NOTABLE_CLIPPING:
            console.print(f"{escape(ball.name)}: {_clipping(ball)}; add a shorter exposure (--bracket).")
        for agreement in ball.agreement:
            if agreement.factor is not None:
                alike = "" if agreement.correlation is None else f"correlation {agreement.correlation:.2f}, "
                console.print(
                    f"{escape(agreement.name)} against the other views: {alike}{agreement.factor:.2f} times as bright."
                )
        for warning in ball.warnings:
            console.print(f"[bold]Warning:[/bold] {escape(warning)}")
    for turn, view in zip(reading.turns or (), reading.views, strict=False):
        console.print(
            f"{escape(view.name)}: turned by {turn.angle_deg:.1f} ± {turn.std_deg:.1f} degrees to the first."
        )
    console.print(f"Wrote {escape(str(output))}/: a map (.exr) per view, {', '.join(OWN_FILES[:3])}")


def _distance(source: BallSource) -> str:
    """Of a near source, from the ball's centre, with its standard deviation."""
    if not source.closeness:
        return "far"
    return f"{1 / source.closeness:.3g} ± {source.closeness_std / source.closeness**2:.1g}"


def _irradiance(source: BallSource, brightest: float) -> str:
    mean = source.irradiance.mean() / brightest
    if source.clipped:
        return f"≥ {mean:.3f}"
    # What makes a channel doubtful, outline and background, makes all of them so.
    return f"{mean:.3f} ± {source.irradiance_std.mean() / brightest:.3f}"


def _clipping(ball: BallLighting) -> str:
    return f"the map is saturated over {ball.clipped_share:.1%} of all directions and too dark there"


def _brightest(balls: Sequence[BallLighting]) -> float:
    """The largest mean irradiance of any source; 1 where there is none."""
    return max((float(source.irradiance.mean()) for ball in balls for source in ball.sources), default=1.0)
