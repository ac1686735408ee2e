"""What a lamp's light becomes at a pixel: a base of its own albedo under a lobe that all pixels share.

    B / E = Kd (t(theta_i) t(theta_o) cos theta_i + a + b E_b) + Ks F W cos theta_i

Lobes are those of `brdf`, bases those of `transport.diffuse_base`. a is what of the lamp's own light comes back from
the room, E_b what comes by way of the rest of the object (`bounces`), both over the lamp's irradiance. Shadows aren't
in the model: robust weights count them for less.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from capture.lighting import cosines
from invrender.brdf.form import Angles, LobeForm
from invrender.photometric_stereo.stack import PixelStack, PixelSurface, tangents
from invrender.transport.diffuse_base import base_share

Floats = NDArray[np.float64]
# By how much directions (radians) and the model's numbers are changed for derivatives.
_CHANGE = 1e-5
# What the refractive index is taken for: lamps beside the camera don't determine it, and most coatings have this one.
ASSUMED_MU = 1.5


@dataclass(frozen=True, eq=False)
class SharedReflection:
    """What all pixels share.

    form : of the lobe; None of a Lambertian surface. sigma : its width, radians. ks : (3,). ambient, bounce : a and b,
    0 or more.
    """

    form: LobeForm | None
    sigma: float
    ks: Floats
    ambient: float = 0.0
    bounce: float = 0.0

    @property
    def numbers(self) -> dict[str, float]:
        """What a fit seeks beside Ks, by name."""
        own = {} if self.form is None else {"sigma": self.sigma, **self.form.numbers}
        return {"ambient": self.ambient, "bounce": self.bounce, **own}

    def with_numbers(self, numbers: Mapping[str, float]) -> SharedReflection:
        """The same with other numbers, named as in `numbers`."""
        form = self.form
        if form is not None and form.numbers:
            form = form.with_numbers({name: numbers[name] for name in form.numbers})
        return SharedReflection(
            form, numbers.get("sigma", self.sigma), self.ks, numbers["ambient"], numbers["bounce"]
        )

    def shaded(self, normals: Floats, stack: PixelStack) -> tuple[Floats, Floats]:
        """What pixels reflect per unit of Kd and of Ks, (p, j) each."""
        if self.form is None:
            lamps = stack.lamps if len(stack.lamps) > 1 else stack.lamps[0]
            base = np.maximum(cosines(normals, lamps), 0)
            return base + self._around(stack), np.zeros_like(base)
        angles = Angles.between(normals[:, None], stack.lamps, stack.views[:, None])
        cos_i = np.maximum(angles.cos_i, 0)
        base = base_share(self.form, ASSUMED_MU, cos_i, np.maximum(angles.cos_o, 0)) * cos_i
        angles = replace(angles, cos_o=np.broadcast_to(angles.cos_o, cos_i.shape))
        return base + self._around(stack), self.form.reflected(angles, ASSUMED_MU, self.sigma)

    def _around(self, stack: PixelStack) -> Floats | float:
        """What arrives from elsewhere than the lamp, over its irradiance."""
        return self.ambient if stack.bounced is None else self.ambient + self.bounce * stack.bounced

    def predicted(self, surface: PixelSurface, stack: PixelStack) -> Floats:
        """Radiance over the lamp's irradiance (p, j, 3), 1/sr."""
        return self._mixed(surface, *self.shaded(surface.normals, stack))

    def _mixed(self, surface: PixelSurface, base: Floats, gloss: Floats) -> Floats:
        return np.asarray(surface.kd[:, None] * base[..., None] + self.ks * gloss[..., None])


@dataclass(frozen=True, eq=False)
class LinearisedShading:
    """The model about a state, and its derivatives.

    predicted : (p, j, 3). turns : (p, j, 3, 2), by turns of the normal along `tangents`, radians. base : (p, j), by Kd
    of the channel. shared : (p, j, 3, n + 3), by the shared numbers and Ks; None where nobody asks.
    """

    predicted: Floats
    turns: Floats
    base: Floats
    shared: Floats | None


def linearised(
    reflection: SharedReflection,
    surface: PixelSurface,
    stack: PixelStack,
    turning: bool = True,
    with_shared: bool = False,
) -> LinearisedShading:
    """The model about what all pixels share and what each has.

    turning : False of normals that are held, whose derivatives are 0. with_shared : whether to take the derivatives by
    what all pixels share.
    """
    base, gloss = reflection.shaded(surface.normals, stack)

    def derivative(changed: tuple[Floats, Floats]) -> Floats:
        of_base, of_gloss = (
            (after - before) / _CHANGE for after, before in zip(changed, (base, gloss), strict=True)
        )
        return reflection._mixed(surface, of_base, of_gloss)

    turns = np.zeros((*stack.reflected.shape, 2))
    for k, along in enumerate(tangents(surface.normals) if turning else ()):
        turns[..., k] = derivative(reflection.shaded(surface.normals + _CHANGE * along, stack))
    shared = None
    if with_shared:
        numbers = reflection.numbers
        columns = [
            derivative(
                reflection.with_numbers({**numbers, name: value + _CHANGE}).shaded(surface.normals, stack)
            )
            for name, value in numbers.items()
        ]
        columns += [gloss[..., None] * channel for channel in np.eye(3)]
        shared = np.stack(columns, axis=-1)
    return LinearisedShading(reflection._mixed(surface, base, gloss), turns, base, shared)
