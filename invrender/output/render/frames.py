"""The frames of a picture or a turntable: where the camera stands in each, and how far the light has turned."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from capture.camera import Camera
from invrender.output.render.view import View

# What goes round, counter-clockwise seen from above; the other two rest.
TURNS = ("view", "light", "object")


@dataclass(frozen=True, eq=False)
class TurntableFrame:
    """Where a picture is taken from, in the axes in which the object rests, and how far the light has turned in these.

    camera : its pose. light_turn : degrees about +Z, counter-clockwise seen from above.
    """

    camera: Camera
    light_turn: float = 0.0


def view_frames(
    view: View, camera: Callable[[View], Camera], count: int, turn: str, light_turn: float
) -> list[TurntableFrame]:
    """Frames evenly all around, beginning with a view. camera : that of a view. light_turn : degrees, in the first."""
    angles = [360 * k / count for k in range(count)]
    match turn:
        case "view":
            return [TurntableFrame(camera(view.turned(angle)), light_turn) for angle in angles]
        case "light":
            return light_frames(camera(view), count, light_turn)
        case _:
            # An object that turns one way sees camera and light turn the other way.
            return [TurntableFrame(camera(view.turned(-angle)), light_turn - angle) for angle in angles]


def light_frames(camera: Camera, count: int, light_turn: float) -> list[TurntableFrame]:
    """Frames of a camera that rests, the light going all around."""
    return [TurntableFrame(camera, light_turn + 360 * k / count) for k in range(count)]
