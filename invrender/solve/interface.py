"""What a diffuse base under a smooth interface, as of plastic or varnish, would make of the numbers.

Light that leaves such a base is reflected back in part by the interface, the more the more grazing [Wolff 1994,
"Diffuse-reflectance model for smooth dielectric surfaces"]: its radiance falls off with 1 - F(mu, theta_o), which over
a Lambertian base passes for another mu. No model of the ladder has it; where photographs ask for it, it is a doubt.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from invrender.model.columns import PhotoColumns
from invrender.model.fresnel import fresnel_reflectance
from invrender.solve.forms import Trial
from invrender.solve.models import Estimate
from invrender.solve.search import fit
from invrender.solve.statistics import total_statistics
from invrender.theory.refinement import interval_rule

Floats = NDArray[np.float64]

# Share of the cost that the interface must take away to be a doubt; rounds in which base and lobe come to one mu.
NOTABLE, ROUNDS = 1.02, 4
# That of most plastics and varnishes.
USUAL_MU = 1.5


@dataclass(frozen=True, eq=False)
class UnderInterface:
    """What numbers would be were the base under an interface. ks : (3,), None where it varies."""

    mu: float
    sigma: float
    ks: Floats | None

    def __str__(self) -> str:
        ks = "" if self.ks is None else f", Ks {self.ks.mean():.3g}"
        return f"mu {self.mu:.2f}, sigma {self.sigma:.3g}{ks}"


def under_interface(trial: Trial, plain: Estimate) -> Estimate | None:
    """The estimate of a model with a Fresnel factor, its base under an interface of that index; None if not better.

    trial : the share of the samples that it is fitted to. plain : the estimate with a Lambertian base there.
    """
    # A base that darkens towards grazing may have driven mu far off.
    starts = (plain, replace(plain, brdf=replace(plain.brdf, mu=USUAL_MU)))
    found = min((_agreed(trial, start) for start in starts), key=lambda estimate: estimate.cost)
    return found if NOTABLE * found.cost < plain.cost else None


def _agreed(trial: Trial, found: Estimate) -> Estimate:
    """The estimate in which base and lobe come to one mu, from one nearby."""
    for _ in range(ROUNDS):
        assert found.brdf.mu is not None
        photos = [_behind(photo, found.brdf.mu) for photo in trial.photos]
        weights = [w.weight for w in trial.weights]
        found = fit(found.model, total_statistics(photos, weights), found)
    return found


def _behind(photo: PhotoColumns, mu: float) -> PhotoColumns:
    """Columns with a base behind an interface, that sends as much in all."""
    share = passed(mu, photo.field.cos_exitant)
    columns = photo.columns.copy()
    columns[..., 0] *= share[None, :, None].astype(np.float32)
    return replace(photo, columns=columns)


def passed(mu: float, cos: Floats) -> Floats:
    """What an interface lets out at cosines of exitant angles: 1 - F over its mean, per projected solid angle."""
    nodes, weights = interval_rule(32, 0, 1)
    mean = 2 * (weights * nodes * (1 - fresnel_reflectance(mu, nodes))).sum()
    return np.asarray((1 - fresnel_reflectance(mu, cos)) / mean)
