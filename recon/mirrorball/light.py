"""Lighting read off photographs of a mirror (chrome) ball: one view of it, or several merged.

A single view lacks a cone behind the ball and the directions about the camera; a second one, from about 90
degrees away, shows both, and how far lamps are. The mirror's reflectance is a number that the user gives: at 1 all
light is too dark by it (chrome reflects about 0.55 to 0.6, polished steel 0.6, silvered glass 0.9).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from capture.arrays import frozen_array
from capture.lighting import Lighting
from recon.mirrorball.merge import Agreement, map_agreement, merge_sources
from recon.mirrorball.triangulate import common_ball
from recon.mirrorball.view import BallSource, BallView
from recon.mirrorball.viewmap import blend, filled, share, view_map

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Mean level, in steps of the file's numbers, below which an integer photograph shows darkness, not light.
_FEWEST_STEPS = 3.0
# Factor between the photographs of a bracket that is worth a word.
_NOTABLE_FACTOR = 1.1


@dataclass(frozen=True, eq=False)
class BallLighting:
    """What a mirror ball shows of the light around it.

    name : of the photograph or the lighting, for messages and results.
    radiance_map : (H, 2H, 3) float32 lat-long radiance in the world frame (`capture.lighting`), without the
        sources; filled from neighbours where nothing was seen.
    coverage : (H, 2H) bool, the map's pixels that were seen.
    uncovered_share : share of the sphere of directions that was not seen, the masked camera included.
    clipped_share : share of the sphere of directions, sources apart, where every view is saturated: the
        map is a lower bound there.
    too_dark : all but the sources is within a few steps of the files' black, so that the map is unreliable.
    sources : brightest first.
    agreement : of each of several views with the others. warnings : in plain words.
    centre : (3,) metres, of the ball in the world, where several views place it; near sources count from there.
    """

    name: str
    radiance_map: NDArray[np.float32]
    coverage: Mask
    uncovered_share: float
    clipped_share: float
    too_dark: bool
    sources: tuple[BallSource, ...]
    agreement: tuple[Agreement, ...]
    warnings: tuple[str, ...]
    centre: Floats | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "radiance_map", frozen_array(self.radiance_map, np.float32))
        object.__setattr__(self, "coverage", frozen_array(self.coverage, np.bool_))


def ball_lighting(views: Sequence[BallView], name: str, height: int = 64) -> BallLighting:
    """Lighting from views of a mirror ball at one place, all in the same world and unit of radiance.

    height : rows of the lat-long map, >= 2. In the map, each view counts with the inverse variance of its error
    of place (`recon.mirrorball.viewmap`); sources that several views show are combined by inverse variance.
    """
    if height < 2:
        raise ValueError(f"{name}: a lat-long map of {height} rows is asked for; it must have at least 2")
    ball = common_ball(views)
    sources, hidden, warnings = merge_sources(views, ball)
    guessed = (_guess_warning(view) for view in views if view.guessed)
    warnings = (*guessed, *map(_bracket_warning, filter(_is_off, views)), *warnings)
    maps = [view_map(view, height, discs) for view, discs in zip(views, hidden, strict=True)]
    merged = blend(maps)
    radiance_map, seen = filled(merged)
    agreement: tuple[Agreement, ...] = ()
    if len(views) > 1:
        agreement, disagreements = map_agreement([view.name for view in views], maps)
        warnings += disagreements
    return BallLighting(
        name=name,
        radiance_map=radiance_map,
        coverage=seen,
        uncovered_share=share(1 - merged.covered),
        clipped_share=share(merged.saturated),
        too_dark=all(_too_dark(view) for view in views),
        sources=sources,
        agreement=agreement,
        warnings=warnings,
        centre=None if ball is None else ball.centre,
    )


def lighting_of_ball(
    ball: BallLighting, recover: tuple[str, ...] | None, name: str | None = None
) -> Lighting:
    """The lighting that a ball shows, with what of it is left to be recovered.

    recover : any of "irradiance" and "ambient"; None for what the photograph calls for: nothing if no source
        is clipped, else its irradiance, and the ambient as well if all the rest is too dark to be known.
        With "ambient", a uniform radiance that is fitted stands in for the map.
    name : of the lighting; the photograph's where none is given.
    """
    if recover is None:
        recover = ()
        if any(source.clipped for source in ball.sources):
            recover = ("irradiance", "ambient") if ball.too_dark else ("irradiance",)
    closeness, closeness_std = (
        np.array([getattr(source, name) for source in ball.sources])
        for name in ("closeness", "closeness_std")
    )
    near = ball.centre is not None and bool(closeness.any())
    return Lighting(
        name=ball.name if name is None else name,
        radiance_map=None if "ambient" in recover else ball.radiance_map,
        directions=np.array([source.direction for source in ball.sources]),
        irradiances=np.array([source.irradiance for source in ball.sources]),
        direction_std_deg=np.array([source.direction_std_deg for source in ball.sources]),
        recover_irradiance="irradiance" in recover,
        recover_ambient="ambient" in recover,
        origin=f"mirror ball {ball.name}",
        warnings=ball.warnings,
        closeness=closeness if near else None,
        closeness_std=closeness_std if near else None,
        centre=np.zeros(3) if ball.centre is None else ball.centre,
    )


def _guess_warning(view: BallView) -> str:
    x, y = view.camera.project(view.sphere.centre[None])[0]
    return (
        f"{view.name}: nothing says where the ball is; the clearest round outline was taken for its, at column"
        f" {x:.0f}, row {y:.0f}, with a radius of {view.radius_px:.0f} pixels. Where that is something else,"
        " give a mask, or the ball's centre and radius (ball)"
    )


def _is_off(view: BallView) -> bool:
    return any(max(factor, 1 / factor) > _NOTABLE_FACTOR for factor in view.bracket_factors)


def _bracket_warning(view: BallView) -> str:
    factors = ", ".join(f"{factor:.2f}" for factor in view.bracket_factors)
    return (
        f"{view.name}: with its exposures divided out, each photograph of the bracket is {factors} times as bright as"
        " the one before, and should be once; check the exposures and what the files hold: cameras' JPEGs follow a"
        " curve of their own, which a recovered response undoes"
    )


def _too_dark(view: BallView) -> bool:
    rest = view.pixels.usable & ~view.in_source
    step = np.sqrt(12 * view.pixels.variance[rest].mean())
    return bool(view.without_sources[rest].mean() < _FEWEST_STEPS * step)
