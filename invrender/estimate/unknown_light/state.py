"""The nonlinear unknowns: what of the BRDF and of the sources radiance is not linear in."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from invrender.brdf.form import LobeForm
from invrender.brdf.fresnel import MU_RANGE
from invrender.brdf.lobes import RH01_FORM
from invrender.brdf.microfacet import SIGMA_RANGE, Microfacet
from invrender.brdf.richer import NUMBER_RANGE
from recon.mesh.tangents import tangents

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Where a search for the refractive index begins.
FIRST_MU = 1.5
# Largest steps: of a share, of log(mu - 1), log sigma and log spread, of a source, radians, and of others.
_STEPS = {
    "share": 0.2,
    "mu": 0.5,
    "sigma": 0.5,
    "coat": 0.3,
    "haze": 0.2,
    "spread": 0.5,
    "source": 0.1,
    "closeness": 0.1,
}
_SHARES = (1e-3, 1 - 1e-3)
# Radii of the object over a near lamp's distance from its centre: no lamp is inside, and none that is near is far away.
CLOSENESS_RANGE = (1e-4, 0.9)


@dataclass(frozen=True, eq=False)
class BlindState:
    """A BRDF up to its scale, and where the sources are.

    specular_share : (3,) Ks / (Kd + Ks), RGB. mu : None without Fresnel factor. sigma : radians; None where all is
    diffuse, and `specular_share` zero. directions : (k, 3) unit, towards the sources. form : of the lobe. owners :
    (k,), the number of the lighting that each source belongs to. closeness : (k,), radii of the object over each
    source's distance from its centre, 0 of one far away; None where all are far away.
    """

    specular_share: Floats
    mu: float | None
    sigma: float | None
    directions: Floats
    form: LobeForm = RH01_FORM
    owners: Ints = field(default_factory=lambda: np.zeros(0, int))
    closeness: Floats | None = None

    @property
    def brdf(self) -> Microfacet:
        """The BRDF in the gauge Kd + Ks = 1."""
        return Microfacet(1 - self.specular_share, self.specular_share, self.mu, self.sigma, self.form)

    @property
    def roughness(self) -> float:
        """sigma of a state that has a lobe."""
        if self.sigma is None:
            raise ValueError("the state has no sigma, for all is diffuse; ask for its diffuse part alone")
        return self.sigma

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the nonlinear parameters, in the order of steps and covariances.

        mu stands for log(mu - 1), sigma and the form's spread for their logs; a source's two are turns, radians, along
        its `tangents`. Of near sources their closeness follows.
        """
        names = [] if self.sigma is None else ["share r", "share g", "share b"]
        names += [] if self.mu is None else ["mu"]
        names += [] if self.sigma is None else ["sigma", *self.form.numbers]
        turned = (f"source {k + 1} {way}" for k in range(len(self.directions)) for way in "ab")
        return (*names, *turned, *(f"closeness {k + 1}" for k in self.near))

    @property
    def near(self) -> list[int]:
        """Which sources are near."""
        return [] if self.closeness is None else np.flatnonzero(self.closeness).tolist()

    @property
    def numbers_of_sources(self) -> int:
        """How many of `names`, the last ones, are the sources'."""
        return 2 * len(self.directions) + len(self.near)

    @property
    def sources(self) -> Floats:
        """Rows (k, 3), or (k, 4) where some are near: unit directions, and closeness."""
        if self.closeness is None:
            return self.directions
        return np.column_stack([self.directions, self.closeness])

    def own(self, channel: int, lighting: int) -> list[int]:
        """Indices into `names` of what a channel depends on: its specular share, the sources, and what all share."""
        skip = {"share r", "share g", "share b"} - {f"share {'rgb'[channel]}"}
        others = np.flatnonzero(self.owners != lighting)
        skip |= {f"source {k + 1} {way}" for k in others for way in "ab"}
        skip |= {f"closeness {k + 1}" for k in others}
        return [k for k, name in enumerate(self.names) if name not in skip]

    def scales(self) -> Floats:
        """Derivatives of the shares, mu, sigma (radians), the form's numbers and turns by the parameters of `names`."""
        spread = self.form.numbers.get("spread", 0.0)
        by_name = {"mu": (self.mu or 1) - 1, "sigma": self.sigma or 0.0, "spread": spread}
        return np.array([by_name.get(name, 1.0) for name in self.names])

    def moved(self, step: Floats) -> BlindState:
        """The state after a step, cut to what a linear model can be trusted with and to the parameters' ranges."""
        limits = np.array([_STEPS[name.split()[0]] for name in self.names])
        by_name = dict(zip(self.names, np.clip(step, -limits, limits).tolist(), strict=True))
        form = self.form
        if self.sigma is None:
            specular_share, sigma = self.specular_share, None
        else:
            specular_share = np.clip(self.specular_share + [by_name[f"share {c}"] for c in "rgb"], *_SHARES)
            sigma = float(np.clip(self.sigma * np.exp(by_name["sigma"]), *SIGMA_RANGE))
            form = form.with_numbers({name: self._number(name, by_name[name]) for name in form.numbers})
        mu = None if self.mu is None else float(np.clip(1 + (self.mu - 1) * np.exp(by_name["mu"]), *MU_RANGE))
        turned = [
            turn(direction, by_name[f"source {k + 1} a"], by_name[f"source {k + 1} b"])
            for k, direction in enumerate(self.directions)
        ]
        directions = np.array(turned).reshape(-1, 3)
        closeness = self.closeness
        if closeness is not None:
            nearer = [by_name.get(f"closeness {k + 1}", 0.0) for k in range(len(closeness))]
            closeness = np.where(closeness > 0, np.clip(closeness + nearer, *CLOSENESS_RANGE), 0)
        return replace(
            self,
            specular_share=specular_share,
            mu=mu,
            sigma=sigma,
            directions=directions,
            form=form,
            closeness=closeness,
        )

    def _number(self, name: str, step: float) -> float:
        """A number of the form after a step."""
        value = self.form.numbers[name]
        return float(np.clip(value * np.exp(step) if name == "spread" else value + step, *NUMBER_RANGE[name]))

    def stuck(self, gradient: Floats) -> NDArray[np.bool_]:
        """Which parameters are at an end of their range that they would leave, (t,)."""
        ends = {"mu": (self.mu, MU_RANGE), "sigma": (self.sigma, SIGMA_RANGE)}
        ends |= {name: (value, NUMBER_RANGE[name]) for name, value in self.form.numbers.items()}
        ends |= {f"share {c}": (float(self.specular_share[k]), _SHARES) for k, c in enumerate("rgb")}
        for k in self.near:
            ends[f"closeness {k + 1}"] = (float(self.sources[k, 3]), CLOSENESS_RANGE)
        found = []
        for name, slope in zip(self.names, gradient, strict=True):
            value, (low, high) = ends.get(name, (None, (0.0, 0.0)))
            found.append(
                value is not None and ((value <= low and slope < 0) or (value >= high and slope > 0))
            )
        return np.array(found, bool)

    def under(self, lighting: int) -> BlindState:
        """The same with no sources but those of one lighting."""
        return self.without_source(np.flatnonzero(self.owners != lighting))

    def with_form(self, form: LobeForm) -> BlindState:
        """The same with a lobe of another form, which may have no Fresnel factor, or an interface that needs one.

        What numbers both forms have stay as they are.
        """
        form = form.with_numbers(
            {name: self.form.numbers[name] for name in form.numbers if name in self.form.numbers}
        )
        # Without an interface an index is another number: far off, it leads to the far end of its range.
        mu = FIRST_MU if form.interface and not self.form.interface else self.mu
        return replace(self, form=form, mu=mu if form.has_fresnel else None)

    def without_fresnel(self) -> BlindState:
        """The same without Fresnel factor, and so without interface."""
        return replace(self, form=self.form.lobe if self.form.interface else self.form, mu=None)

    def without_lobe(self) -> BlindState:
        """The same sources on a diffuse body."""
        return BlindState(np.zeros(3), None, None, np.zeros((0, 3))).with_sources_of(self)

    def with_sources_of(self, other: BlindState, lighting: int | None = None) -> BlindState:
        """The same with another's sources in place of its own, all or those of one lighting."""
        if lighting is None:
            return replace(self, directions=other.directions, owners=other.owners, closeness=other.closeness)
        result = self.without_source(np.flatnonzero(self.owners == lighting))
        for source in other.under(lighting).sources:
            result = result.with_source(source, lighting)
        return result

    def with_source(self, source: Floats, lighting: int = 0) -> BlindState:
        """The same with one more source; source : a direction (3,), or with its closeness (4,)."""
        near = source[3] if len(source) > 3 else 0.0
        before = np.zeros(len(self.directions)) if self.closeness is None else self.closeness
        return replace(
            self,
            directions=np.vstack([self.directions, source[:3]]),
            owners=np.append(self.owners, lighting),
            closeness=np.append(before, near) if near or self.near else None,
        )

    def without_source(self, index: int | Ints) -> BlindState:
        """The same without one of its sources, or several."""
        closeness = None if self.closeness is None else np.delete(self.closeness, index)
        return replace(
            self,
            directions=np.delete(self.directions, index, axis=0),
            owners=np.delete(self.owners, index),
            closeness=closeness if closeness is not None and closeness.any() else None,
        )

    def with_closeness(self, closeness: Floats) -> BlindState:
        """The same with sources so near, (k,)."""
        return replace(self, closeness=closeness if closeness.any() else None)


def turns(directions: Floats, angle: float) -> Floats:
    """Directions (k, 3) turned by an angle, radians, along each of their tangents: (k, 2, 3)."""
    moved = directions[:, None] + angle * tangents(directions)
    return np.asarray(moved / np.linalg.norm(moved, axis=-1, keepdims=True))


def turn(direction: Floats, a: float, b: float) -> Floats:
    """A direction turned by small angles, radians, along its tangents."""
    moved = direction + np.array([a, b]) @ tangents(direction)
    return np.asarray(moved / np.linalg.norm(moved))
