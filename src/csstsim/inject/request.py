"""What is injected: the objects and options of all frames, and their record in a frame's header."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from csstsim import __version__
from csstsim.base.digest import digest, file_digest
from csstsim.base.old_names import warn_old_name
from csstsim.base.plural import number_of
from csstsim.io.fits_writing import as_ascii

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from csstsim.base.types import PathLike
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.inject.rewritten import Record

    Log = Callable[[str], object]
    Injector = Callable[[Path, Path, Log], str]  # called with a frame, its copy and `log`; returns a summary

SAME_NOISE = "the frame has injected objects with this noise"
_REALISATION = re.compile(r"digest\s*\w+,\s*realisation\s*(\d+),\s*by")  # in the HISTORY that `record` writes


@dataclass(frozen=True)
class Request:
    """The objects to inject, and the options of `inject`, which are the same for all frames.

    Parameters
    ----------
    columns : dict
        {name: values (n,)} of the table.
    table : path
        The table's file, or a description of a table in memory.
    realisation : int
        Number of the noise; 0: the photons of a simulation of objects with the same ids.
    campaign : path or OpenCampaign, optional
        The campaign that made the frames. Default: as their headers state.
    instrument, cache : path, optional
        The camera's folder and the folder of PSF sets, without a campaign.
    psf : path, optional
        The PSF of frames of other telescopes: a model of PSFEx, or FITS stamps.
    zeropoint : float, optional
        AB magnitude of 1 electron/s in frames of other telescopes. Default: from their headers.
    light_curves : path, optional
        File of the light curves that the table names.
    """

    columns: dict[str, Any]
    table: PathLike
    realisation: int = 1
    campaign: PathLike | OpenCampaign | None = None
    instrument: PathLike | None = None
    cache: PathLike | None = None
    psf: PathLike | None = None
    zeropoint: float | None = None
    light_curves: PathLike | None = None

    @property
    def name(self) -> str:
        """The name of the table, for HISTORY."""
        return Path(self.table).name


def log_or_say(log: Log, options: dict[str, Any]) -> Log:
    """Return the function for lines of progress; `say`, its old name among the options, is deprecated."""
    if "say" not in options:
        return log
    warn_old_name("say is now called log", goes="0.3.0", stacklevel=2)
    return cast("Log", options.pop("say"))


def realisations(frame: Path) -> set[int]:
    """Return the realisations that were injected into a frame, by its HISTORY; none for an original frame."""
    from csstsim.io.fits import open_fits, raw_cards

    with open_fits(frame) as hdus:
        history = "".join(card[8:] for card in raw_cards(hdus[0], frame) if card.startswith("HISTORY "))
    return realisations_of(history)


def realisations_of(history: str) -> set[int]:
    """Return the realisations that a HISTORY states, its lines joined."""
    return {int(number) for number in _REALISATION.findall(history)}


def record(request: Request, count: int) -> Record:
    """Return the record of an injection for the header (rewritten.rewrite)."""
    content: list[Any] = [{name: np.asarray(values).tolist() for name, values in request.columns.items()}]
    if request.light_curves:
        content.append(file_digest(request.light_curves))
    code = digest(content)
    return {
        "cards": [
            ("INJCOUNT", count, "objects injected, the last time"),
            ("INJHASH", code, "digest of their table"),
            ("INJREAL", request.realisation, "realisation of their noise"),
        ],
        "history": [
            f"{number_of(count, 'object')} of {as_ascii(request.name)}, digest {code}, "
            f"realisation {request.realisation}, by csstsim {__version__}"
        ],
    }
