"""Built-in scenes made small: few pixels, a light summed over few directions."""

from __future__ import annotations

import re
from collections.abc import Mapping

_INTEGRATION = "\n[render]\ndirections = 256\nper_side = 2\n"


def small_scene(scene: str, values: Mapping[str, str]) -> str:
    """The text of a scene file with other values of its keys, wherever these stand."""
    for key, value in values.items():
        scene = re.sub(rf"^{key} = .*$", f"{key} = {value}", scene, flags=re.MULTILINE)
    return scene + _INTEGRATION
