"""A flat field from photographs of an even surface, and the numbers of its flatfield.json."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from capture.sensor.flatfield import FlatField, FlatFieldMap, RadialFlatField
from capture.sensor.flatmap import fit_map
from capture.sensor.flattiles import FlatTiles, flat_tiles, read_flat
from capture.sensor.radialfit import RadialFit, fit_radial, flat_field_of

if TYPE_CHECKING:
    from capture.decode import Encoding

_TURN = "turn the camera by 90 or 180 degrees about its axis between several photographs of the surface"
# What a smooth lens and light leave unexplained, RMS relative; more is texture or a shadow.
_MOST_MISFIT = 0.03


@dataclass(frozen=True, eq=False)
class FlatFieldRecovery:
    """What flat-field photographs determine.

    flat_field : radial, or a map. radial : the polynomial, in both cases. fit : the chosen candidate; candidates : all.
    """

    photos: tuple[Path, ...]
    tiles: FlatTiles
    flat_field: FlatField
    radial: RadialFlatField
    fit: RadialFit
    candidates: tuple[RadialFit, ...]

    @property
    def warnings(self) -> list[str]:
        """What the photographs leave undetermined, in plain words."""
        mean, std = self.fit.gradients.mean(axis=0), np.sqrt(np.diag(self.fit.light_covariance)[:2])
        if self.fit.turned or (len(self.photos) > 1 and (np.abs(mean) < 3 * std).all()):
            return []
        alone = "One photograph" if len(self.photos) == 1 else "A camera that is never turned"
        return [f"{alone} hardly separates a gradient of the light from a shifted lens: {_TURN}"]

    @property
    def undetermined(self) -> list[dict[str, str]]:
        """What the photographs leave open, with reason and remedy; the illumination holds whatever it is."""
        if self.fit.centre_known:
            return []
        reason = "vignetting is too weak, or the light too uneven, to separate a shifted lens from the light's gradient"
        return [{"parameter": "centre", "reason": reason, "remedy": _TURN}]


def recover_flat_field(
    photos: Sequence[Path], encoding: Encoding = "linear", *, as_map: bool = False
) -> FlatFieldRecovery:
    """The relative illumination over the image from photographs of an evenly lit, even surface.

    photos : of one size; best several, the camera turned about its axis in between. encoding : of integer files.
    as_map : pixel by pixel instead of a radial polynomial.
    ValueError names the photograph that is saturated, dark, textured, of another size, or darker than 5% somewhere.
    """
    tiles = flat_tiles(_read(photos, encoding))
    fit, candidates = fit_radial(tiles)
    _check_flat(photos, fit)
    radial = flat_field_of(fit, tiles)
    flat_field: FlatField = radial
    if as_map:
        flat_field = fit_map(
            (image for _, image in _read(photos, encoding)), radial, fit.light, fit.light_covariance
        )
    else:
        try:
            radial.gain(radial.width, radial.height)
        except ValueError as error:
            raise ValueError(f"{photos[0]}: {error}") from error
    return FlatFieldRecovery(tuple(photos), tiles, flat_field, radial, fit, tuple(candidates))


def flat_field_document(recovery: FlatFieldRecovery, map_name: str) -> dict[str, Any]:
    """The numbers of a flatfield.json. map_name : the EXR beside it, where it is a map."""
    flat_field, radial, model = recovery.flat_field, recovery.radial, recovery.fit.model
    return {
        "format": 1,
        "kind": "map" if isinstance(flat_field, FlatFieldMap) else "radial",
        "width": radial.width,
        "height": radial.height,
        "unit": "illumination relative to the centre (radial: 1 + a1 r^2 + a2 r^4 + ..., r in half diagonals)"
        " or to its maximum (map)",
        "radial": {
            "centre": radial.centre.tolist(),
            "centre_std": np.sqrt(np.diag(radial.covariance)[:2]).tolist(),
            "coefficients": radial.coefficients.tolist(),
            "coefficients_std": np.sqrt(np.diag(radial.covariance)[2:])
            .reshape(radial.coefficients.shape)
            .tolist(),
            "covariance": radial.covariance.tolist(),
            "structured_rms_relative": radial.structured.tolist(),
        },
        "map": {
            "file": map_name,
            "relative_std": flat_field.relative_std.tolist(),
        }
        if isinstance(flat_field, FlatFieldMap)
        else None,
        "model": {
            "order": model.order,
            "free_centre": model.free_centre,
            "per_channel": model.per_channel,
            "gradient": model.gradient,
        },
        "photos": [
            {"file": path.name, "gradient": light[:2].tolist(), "saddle": light[2:].tolist()}
            for path, light in zip(recovery.photos, recovery.fit.light, strict=True)
        ],
        "undetermined": recovery.undetermined,
        "warnings": recovery.warnings,
    }


def _read(photos: Iterable[Path], encoding: Encoding) -> Iterator[Any]:
    return ((path, read_flat(path, encoding)) for path in photos)


def _check_flat(photos: Sequence[Path], fit: RadialFit) -> None:
    left = 1.4826 * np.median(np.abs(fit.residual), axis=(1, 2))
    worst = int(np.argmax(left))
    if left[worst] > _MOST_MISFIT:
        raise ValueError(
            f"{photos[worst]}: brightness departs from a smooth lens and light by {left[worst]:.0%}; photograph an"
            " even surface without texture or shadows, out of focus"
        )
