"""Polarising filters: the lamp behind one, and the camera's turned along it (parallel) or across it (cross).

What the base sends has lost its polarisation, so that a filter passes the same share of it however it is turned. What
the lobe sends is mirrored at the surface and keeps it: a parallel filter passes all of that, a crossed one next to
nothing [Nayar, Fang & Boult 1997, "Separation of Reflection Components Using Color and Polarization", section 3].
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from capture.manifest import Manifest, Polarisation, PolarisationTable

# What crossed filters pass of the lobe before photographs tell: sheets of a studio pass about as much.
_START = 0.02


@dataclass(frozen=True)
class Extinction:
    """What crossed filters pass of the lobe, as a share of what parallel ones do.

    value : 0 to 1; where it isn't known yet, a first guess. std : its standard deviation. origin : "free" where
    photographs are to tell it, and have not or can't; "unused" where none that is fitted was crossed.
    """

    value: float
    std: float
    origin: Literal["given", "found", "free", "unused"]

    @property
    def is_free(self) -> bool:
        """Whether photographs are to tell it."""
        return self.origin in ("free", "found")


@dataclass(frozen=True)
class Polariser:
    """The filter before the camera, as one photograph has it.

    transmission : the share of unpolarised light that it passes, up to a half where it is ideal. extinction : as of
    `Extinction`.
    """

    polarisation: Polarisation
    transmission: float
    extinction: float

    @property
    def lobe_share(self) -> float:
        """What the filter passes of the lobe's light over what it passes of the base's: 2 if it is parallel."""
        return 2.0 * (self.extinction if self.polarisation == "cross" else 1.0)


def read_extinction(manifest_path: Path, manifest: Manifest) -> Extinction | None:
    """The extinction of a set's filters, None where no photograph was taken through one.

    ValueError where filters are said of some photographs only, or where the photographs can't tell what isn't given.
    """
    said = [photo.polarisation for photo in manifest.photo]
    table, std = manifest.polarisation, manifest.uncertainty.extinction
    if not any(said):
        if table is not None or std is not None:
            what = "[polarisation]" if table is not None else "[uncertainty] extinction"
            raise ValueError(
                f"{manifest_path}: {what} is of filters, but no [[photo]] has polarisation = 'cross' or 'parallel':"
                " say which each is, or remove it"
            )
        return None
    if None in said:
        without = manifest.photo[said.index(None)].file
        raise ValueError(
            f"{manifest_path}: polarisation is said of {len(said) - said.count(None)} of {len(said)} photographs, but"
            f' not of "{without}": say it of all, or of none'
        )
    given = None if table is None else table.extinction
    if given is not None:
        return Extinction(given, std or 0.0, "given")
    if std is not None:
        raise ValueError(
            f"{manifest_path}: [uncertainty] extinction is the deviation of a number that isn't given: write"
            " [polarisation] extinction, or remove it"
        )
    fitted = {photo.polarisation for photo in manifest.photo if not photo.held_out}
    if fitted == {"cross"}:
        raise ValueError(
            f"{manifest_path}: all photographs that are fitted are crossed: these show no more than a trace of"
            " highlights, and can't tell how much of them; add parallel ones, or write [polarisation] extinction"
        )
    return Extinction(_START, 0.0, "free" if "cross" in fitted else "unused")


def polariser_of(
    polarisation: Polarisation | None, table: PolarisationTable | None, extinction: Extinction | None
) -> Polariser | None:
    """The filter of one photograph, None without."""
    if polarisation is None or extinction is None:
        return None
    return Polariser(polarisation, (table or PolarisationTable()).transmission, extinction.value)
