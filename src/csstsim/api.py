"""csstsim in a notebook or a script: a campaign, its chips as arrays, and copies of it with something changed.

    import csstsim

    sim = csstsim.Simulation("campaign.yaml")      # or Simulation(): the campaign of `csstsim init`
    sim = sim.replace(window=(4000, 5000, 4000, 5000), layers={"cosmic_rays": None})
    frame = sim.chip("10100000004", 9)             # frame.image, frame.truth, frame.wcs, frame.header

A Simulation never changes and can be pickled. Its results depend on it alone: the same Simulation gives the same bits,
in any order, in a loop and in several processes. Only truth bricks and PSF sets are written, to `cache`; their names
contain a digest of what decides them. Relative paths in a campaign file start at the folder of that file; those given
to `replace` start at the folder Python runs in, but for psf.library and a catalogue's files. The logger `csstsim` lists
the files that are made, and the objects that are not rendered.
"""

from __future__ import annotations

import copy
import logging
import math
import operator
import warnings
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.astropy_values import direction, number, utc_text
from csstsim.base.errors import InputError
from csstsim.base.files.yaml_file import read_yaml
from csstsim.base.plural import number_of
from csstsim.base.shipped import ROOT
from csstsim.campaign.aiming import chips_for, next_obsid, next_start
from csstsim.campaign.cache_paths import CachePaths, cache_folder
from csstsim.campaign.config import load_campaign, make_campaign
from csstsim.campaign.notes import pointing_note
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.survey_table import OBSID, OBSID_ALLOWED
from csstsim.catalog.base import CatalogBase
from csstsim.catalog.object_table import object_table, plain_columns, read_table
from csstsim.catalog.open import TABLE_KIND
from csstsim.instrument.camera import load_camera
from csstsim.optics.geometry.pointing_for import aim_point, centred_exposure
from csstsim.simulation.frame import Frame, frame_of
from csstsim.simulation.observation import changed_layers

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from datetime import datetime
    from typing import Any, TypeAlias

    from astropy.coordinates import SkyCoord
    from astropy.table import Table
    from astropy.time import Time
    from astropy.units import Quantity

    from csstsim.base.types import IntArray, PathLike
    from csstsim.campaign.config import Campaign
    from csstsim.campaign.job import Job
    from csstsim.instrument.camera import Camera
    from csstsim.instrument.chip import Chip
    from csstsim.instrument.filter import Filter
    from csstsim.instrument.pointing import Pointing

    Layers: TypeAlias = dict[str, Sequence[Mapping[str, dict[str, Any] | None]]]  # {exposure type: Observation.layers}

__all__ = ["Frame", "Simulation"]


MAX_EXPOSURES = 1000  # exposures of one `aim`
_AIMED: dict[tuple[int, str], datetime] = {}  # (seed, obsid): start; what this process has aimed


class Simulation:
    """An opened campaign, and copies of it with something changed.

    Parameters
    ----------
    campaign : str or Path, optional
        Path of a campaign file. None: the campaign of `csstsim init`, a small field in r, g and i.
    cache : str or Path, optional
        Folder of truth bricks and PSF sets, which several Simulations may share. The default is $CSSTSIM_CACHE, or
        `csstsim` in the user's cache folder.

    Raises
    ------
    InputError
        For any fault in the campaign's files.

    Examples
    --------
    >>> import csstsim
    >>> sim = csstsim.Simulation().replace(seed=2, fidelity="noise_free")
    >>> sim.config.seed
    2
    """

    def __init__(self, campaign: str | Path | None = None, cache: PathLike | None = None) -> None:
        if not isinstance(campaign, str | Path | None):
            raise InputError("not a campaign", key="campaign", value=type(campaign).__name__, allowed="a file's path")
        starter = ROOT / "config" / "starter" / "campaign.yaml"
        # What errors name, and where relative paths begin, also after the process has gone to another folder
        self._file = Path(campaign).absolute() if campaign else Path("csstsim.Simulation")
        if campaign is None:
            shipped = {"survey_table": ROOT / "survey_tables" / "demo.csv", "observations": {}}
            config = make_campaign(read_yaml(starter) | shipped, self._file)
        else:
            config = load_campaign(self._file)
        self._cache = cache_folder(cache)
        self._open(config, {}, None)

    def __repr__(self) -> str:
        jobs = f"{number_of(len(self._run.jobs), 'chip')} of {number_of(len(self._run.exposures), 'exposure')}"
        return f"<Simulation: {self._config.name}, {jobs}, fidelity {self._config.fidelity}, seed {self._config.seed}>"

    def __getstate__(self) -> tuple[Path, Path, Campaign, Layers, dict[str, Pointing] | None]:
        return self._file, self._cache, self._config, self._layers, self._pointings

    def __setstate__(self, state: tuple[Path, Path, Campaign, Layers, dict[str, Pointing] | None]) -> None:
        self._file, self._cache, config, layers, pointings = state
        self._open(config, layers, pointings)

    def _open(self, config: Campaign, layers: Layers, pointings: dict[str, Pointing] | None) -> None:
        # as given: a copy is made of these
        self._config = config
        self._layers = layers
        self._pointings = pointings
        self._run = OpenCampaign(self._file, copied=True, config=config, layers=layers, pointings=pointings)
        self._run.paths = CachePaths(self._cache, self._run)

    def replace(
        self,
        *,
        layers: Mapping[str, dict[str, Any] | None] | None = None,
        catalog: Table | str | Path | type[CatalogBase] | dict[str, Any] | None = None,
        **keys: Any,
    ) -> Simulation:
        """Return a copy of this Simulation with the given changes.

        Parameters
        ----------
        layers : mapping, optional
            {keyword: {parameter: value}, or None to omit the layer}, for science exposures. They are added to earlier
            changes; new `observations` reset them.
        catalog : Table, str, Path, type or dict, optional
            An astropy Table or the path of a table's file (columns: csstsim.catalog.own_table), a CatalogBase class, or
            the mapping of a campaign file. All objects of a table are rendered, whatever `mag_limit` is.
        **keys : object
            Keys of a campaign file (docs: Configuration). Each value replaces the previous one completely. Its form is
            that of the file or of Python: `seed=2`, `fidelity="noise_free"`, `psf={"grid": 10}`, `select={"types":
            ["SCIE"], "chips": [9]}`. `window` may also be (x0, x1, y0, y1) [pixel].

        Returns
        -------
        Simulation
            The changed copy.

        Raises
        ------
        InputError
            For an unknown key or a value that cannot be used.
        """
        config = self._config.model_dump()
        if isinstance(keys.get("window"), tuple | list | np.ndarray):
            keys["window"] = _window(keys["window"])
        if "window" in keys and "select" not in keys:  # pixels are named: no circle on the sky chooses them
            keys["select"] = config["select"] | ({"region": None} if keys["window"] != "region" else {})
        keys = _from_here(copy.deepcopy(keys))
        pointings = None if "survey_table" in keys else self._pointings
        kept_layers = {} if "observations" in keys else self._layers
        given = keys.get("instrument")
        instrument = config["instrument"]
        if isinstance(given, dict) and "folder" not in given and instrument:  # numbers of this camera
            instrument = instrument if isinstance(instrument, dict) else {"folder": instrument}
            keys["instrument"] = {**instrument, **given}
        bands = (load_camera(keys["instrument"]) if "instrument" in keys else self._run.camera).bands
        if catalog is not None:
            keys["catalog"] = _catalog(catalog, config["catalog"], bands)
        return self._with(config | keys, kept_layers, pointings, layers)

    def _with(
        self,
        config: dict[str, Any],
        layers: Layers,
        pointings: dict[str, Pointing] | None,
        changes: Mapping[str, dict[str, Any] | None] | None = None,
    ) -> Simulation:
        made = object.__new__(Simulation)
        made._file = self._file
        made._cache = self._cache
        campaign = make_campaign(config, self._file)
        if changes is not None:
            file = campaign.observation_file("SCIE")
            layers = layers | {"SCIE": changed_layers(changes, layers.get("SCIE"), file)}
        made._open(campaign, layers, pointings)
        return made

    def aim(
        self,
        ra: float | Quantity | SkyCoord,
        dec: float | Quantity | None = None,
        chip: int | None = None,
        *,
        filter: str | None = None,
        size: int | None = 1000,
        pa: float | Quantity = 0.0,
        time: str | Time = "2027-11-20T01:20:00",
        exptime: float | Quantity = 150.0,
        obsid: str | int = "10100000001",
        exposures: int = 1,
    ) -> Simulation:
        """Return a Simulation of exposures with a position at the middle of one chip, and of the pixels around it.

        Behind gratings, the zeroth and the first order lie around the middle of the wider grating. A window that cuts
        them gives a warning. Noise, cosmic rays and photons differ by obsid; sky and detector are the same in all
        exposures. If an obsid was used before at another time, there is a warning: both frames have the same noise.
        Another warning says that the Sun is too near or the Earth in the way: choose another time.

        Parameters
        ----------
        ra, dec : float or Quantity
            Position [deg, ICRS]. A SkyCoord in place of both is taken as the direction is; its motion is not applied.
        chip : int, optional
            Number of the chip; its filter is the image's. Without chip and filter it is 9, an r chip.
        filter : str, optional
            Name of a filter instead of a chip: its chip nearest to the middle of the focal plane.
        size : int or None
            Side of the window [pixel]; None for the whole chip.
        pa : float or Quantity
            Position angle [deg].
        time : str or Time
            Start of the first exposure, UTC in ISO 8601.
        exptime : float or Quantity
            Exposure time [s].
        obsid : str or int
            Observation id of the first exposure, 9 to 14 digits.
        exposures : int
            Number of exposures. Each begins a minute after the end of the one before, has the next obsid, and is
            pointed separately.

        Returns
        -------
        Simulation
            A copy with these exposures.

        Raises
        ------
        InputError
            For values that cannot be used, for both a chip and a filter, and for a position so close to a pole (up to
            half a degree) that no pointing at this position angle puts it on the chip.
        """
        camera = self._run.camera
        science = self._run.steps.get("SCIE")
        target = _aimed_chip(camera, chip, filter)
        ra, dec = direction(ra, dec)
        pa = number(pa, "deg", "pa")
        exptime = number(exptime, "s", "exptime")
        time = utc_text(time)
        obsid = str(obsid)
        count = _integer(exposures, "exposures")
        if not OBSID.fullmatch(obsid):
            raise InputError("not an observation id", key="obsid", value=obsid, allowed=OBSID_ALLOWED)
        if not 1 <= count <= MAX_EXPOSURES:
            raise InputError("no number of exposures", key="exposures", value=count, allowed=f"1 to {MAX_EXPOSURES}")
        pointings = {}
        for _ in range(count):
            if not OBSID.fullmatch(obsid):
                raise InputError("no observation id is left", key="obsid", value=obsid, allowed=OBSID_ALLOWED)
            pointing = centred_exposure(
                camera,
                target,
                ra,
                dec,
                pa=pa,
                time=time,
                exptime=exptime,
                distorted=science is None or science.field_dist,
                **self._config.astrometry.model_dump(),
            )
            pointings[obsid] = pointing
            obsid = next_obsid(obsid)
            time = next_start(pointing)
        _warn_of_one_noise(self._config.seed, pointings)
        if note := pointing_note(pointings, camera.telescope):
            warnings.warn(f"{note}; try time=", stacklevel=2)
        window = None if size is None else _window_about(camera, target, size)
        changes = {"select": {"types": ["SCIE"], "chips": [target.id]}, "window": window}
        return self._with(self._config.model_dump() | changes, self._layers, pointings)

    @property
    def config(self) -> Campaign:
        """A copy of the campaign with every key, as csstsim.campaign.config.Campaign."""
        return self._config.model_copy(deep=True)

    @property
    def layers(self) -> list[dict[str, dict[str, Any]]]:
        """The layers of science exposures with all their parameters: a list of {keyword: {name: value}}, in order."""
        return self._run.steps["SCIE"].describe() if "SCIE" in self._run.steps else []

    @cached_property
    def exposures(self) -> Table:
        """astropy Table, one row a selected exposure: obsid, type, ra, dec, pa [deg], time, exptime [s], chips."""
        from astropy.table import Table

        rows: dict[str, tuple[Pointing, list[int]]] = {}
        for job in self._run.jobs:
            rows.setdefault(job.obsid, (job.pointing, []))[1].append(job.chip.id)
        names = "obsid", "type", "ra", "dec", "pa", "time", "exptime"
        values = [
            (obsid, p.type, p.ra, p.dec, p.pa, p.start.replace(tzinfo=None).isoformat(), p.exptime)
            for obsid, (p, _) in rows.items()
        ]
        table = Table(rows=values, names=names, units={"ra": "deg", "dec": "deg", "pa": "deg", "exptime": "s"})
        table["ra"].format = table["dec"].format = ".9g"
        table["chips"] = np.empty(len(values), object)
        for row, (_, chips) in enumerate(rows.values()):
            table["chips"][row] = tuple(chips)
        return table

    def chip(self, obsid: str | int, chip: int) -> Frame:
        """Return the Frame of one chip in one exposure, read out through all layers.

        Parameters
        ----------
        obsid : str or int
            Observation id of the exposure.
        chip : int
            Number of the chip.

        Returns
        -------
        Frame
            Its `image` has shape (ny, nx), uint16 [DN].

        Raises
        ------
        InputError
            For an exposure or chip that the campaign does not select.
        """
        from astropy.io.fits import Header

        from csstsim.detector.channels import ReadoutFrame
        from csstsim.io.level0_writing import level0_cards
        from csstsim.stages.chip import simulate

        job = self._job(obsid, chip)
        with job.named():
            state, provenance = simulate(self._run, job, log=_log)
        readout = ReadoutFrame.of(state.chip.detector, state.window)
        cards = level0_cards(state, self._run.camera.keywords, provenance, state.header.get("layout", "channels"))
        header = Header.fromstring("".join(text for part in cards for text in part))
        return frame_of(job, state, readout.active(state.image), header=header, raw=state.image, readout=readout)

    def light(self, obsid: str | int, chip: int) -> Frame:
        """Return the Frame of one chip in one exposure before the detector: electrons of objects and sky.

        Bright objects and the sky are expected electrons; faint objects are counted electrons, with Poisson noise. With
        `fidelity="noise_free"` all electrons are expected electrons.

        Parameters
        ----------
        obsid : str or int
            Observation id of the exposure.
        chip : int
            Number of the chip.

        Returns
        -------
        Frame
            Its `image` has shape (ny, nx), float32 [electron]; `header` and `raw` are None.

        Raises
        ------
        InputError
            For an exposure or chip that the campaign does not select.
        """
        from csstsim.stages.chip import light

        job = self._job(obsid, chip)
        with job.named():
            state = light(self._run, job, log=_log)
        image = state.image if state.counted is None else state.image + state.counted.astype(np.float32)
        return frame_of(job, state, image)

    def inject(
        self,
        frame: Frame,
        table: Table | dict[str, Any] | str | Path,
        *,
        realisation: int = 1,
        light_curves: PathLike | None = None,
    ) -> Frame:
        """Return a copy of a Frame with the objects of a table added (docs: Injection); `frame` itself does not change.

        In a frame of `chip`, the electrons of the objects pass through the detector; `raw`, `image` and `header`
        change.

        Parameters
        ----------
        frame : Frame
            A frame of `chip` or `light` of this Simulation.
        table : Table, mapping, str or Path
            Astropy Table, {name: (n,) values}, or the path of a table's file; columns: csstsim.catalog.own_table.
        realisation : int
            Number of the objects' noise, at least 0. 0 gives the photons that a simulation of the same ids has. A
            frame of `chip` takes each number once.
        light_curves : str or Path, optional
            File of the curves that the table's column light_curve names.

        Returns
        -------
        Frame
            The copy. Its `truth` is that of the injected objects.

        Raises
        ------
        InputError
            For a table that cannot be used, for a frame of another Simulation, and for objects of the same realisation
            in its header.
        """
        from csstsim.inject.memory import into_frame

        number = _integer(realisation, "realisation")
        if number < 0:
            raise InputError("no number of a realisation", key="realisation", value=number, allowed="0 and above")
        return into_frame(self._run, frame, table, number, _log, light_curves)

    def _job(self, obsid: str | int, chip: int) -> Job:
        return self._run.job(str(obsid), _integer(chip, "chip"))


def _from_here(keys: dict[str, Any]) -> dict[str, Any]:
    """Return changed keys with absolute paths: the process may go to another folder."""

    def absolute(value: Any) -> Any:
        return Path(value).absolute() if isinstance(value, str | Path) and str(value) else value

    for name in {"survey_table", "universe", "instrument", "output"}.intersection(keys):
        keys[name] = absolute(keys[name])
    for name, inner in (("instrument", ("folder",)), ("observations", tuple(keys.get("observations") or ()))):
        if isinstance(keys.get(name), dict):
            keys[name] |= {key: absolute(keys[name][key]) for key in inner if key in keys[name]}
    return keys


def _aimed_chip(camera: Camera, chip: int | None, filter: str | None) -> Chip:
    """Return the Chip that `aim` is given by its number or by its filter. Raises InputError."""
    if filter is None:
        return chips_for(camera, () if chip is None else (_integer(chip, "chip"),), prefix="")[0]
    if chip is not None:
        raise InputError("a chip and a filter are given", key="filter", value=filter, allowed="one of them")
    if not isinstance(filter, str):
        raise InputError("must be a name", key="filter", value=filter, allowed=", ".join(camera.filters))
    return chips_for(camera, filters=(filter,), prefix="")[0]


def _window_about(camera: Camera, chip: Chip, size: int) -> dict[str, int]:
    """Return the window of `size` px about the middle of a target's flux after `aim`. Raises InputError."""
    nx = chip.detector.nx
    ny = chip.detector.ny
    size = _integer(size, "size")
    largest = min(nx, ny)
    if not 1 <= size <= largest:
        raise InputError("no window of a chip", key="size", value=size, allowed=f"1 to {largest}, or None")
    aim = aim_point(camera, chip)
    pairs = zip(aim.middle, (nx, ny), strict=True)
    x0, y0 = (min(max(math.floor(at + 0.5 - size / 2), 0), n - size) for at, n in pairs)
    if chip.kind == "slitless":
        span = camera.gratings[chip.id].span(*aim.target)
        if span.right - span.left > size:
            width = span.right - span.left
            message = f"a window of {size} px cuts the zeroth or the first order: they span {width:.0f} px"
            warnings.warn(f"{message}; give a larger `size`", stacklevel=3)
    return {"x0": x0, "x1": x0 + size, "y0": y0, "y1": y0 + size}


def _warn_of_one_noise(seed: int, pointings: Mapping[str, Pointing]) -> None:
    """Warn where an obsid was aimed before, with this seed, at another time."""
    for obsid, pointing in pointings.items():
        before = _AIMED.setdefault((seed, obsid), pointing.start)
        if before != pointing.start:
            message = f"obsid {obsid} was aimed before, at {before:%Y-%m-%dT%H:%M:%S}: one obsid has one noise"
            warnings.warn(f"{message}; give another `obsid`, or ask for more `exposures`", stacklevel=3)


def _catalog(
    given: Table | str | Path | type[CatalogBase] | dict[str, Any],
    before: Mapping[str, Any],
    bands: Mapping[str, Filter],
) -> dict[str, Any]:
    """Return the campaign's `catalog` for a table, its file, a class or a mapping; shapes stay as they were."""
    if isinstance(given, dict):
        return copy.deepcopy(given)
    shapes = {"shapes": before["shapes"]}
    if isinstance(given, type):
        kind = f"{given.__module__}:{given.__qualname__}"
        if not issubclass(given, CatalogBase) or "." in given.__qualname__:
            allowed = "a class of a module, not of a function or class, derived from CatalogBase"
            raise InputError("cannot be used", key="catalog", value=kind, allowed=allowed)
        return shapes | {"mag_limit": before["mag_limit"], "kind": kind, "options": {}}
    if isinstance(given, str | Path):
        path = Path(given).resolve()
        object_table(read_table(path), bands, path)  # refused now, not with the first chip
        return shapes | {"kind": TABLE_KIND, "options": {"file": str(path)}}
    if not hasattr(given, "colnames"):
        allowed = "an astropy Table, a path to a table's file, a CatalogBase class, a mapping with kind and options"
        raise InputError("cannot be used", key="catalog", value=type(given).__name__, allowed=allowed)
    columns = plain_columns(given)
    object_table(columns, bands, "catalog")  # refused now, not with the first chip
    return shapes | {
        "kind": TABLE_KIND,
        "options": {"columns": {name: values.tolist() for name, values in columns.items()}},
    }


def _window(given: Sequence[int] | IntArray) -> dict[str, int]:
    """Return the mapping of (x0, x1, y0, y1)."""
    if len(given) != 4:
        raise InputError("must be four numbers", key="window", value=tuple(given), allowed="(x0, x1, y0, y1)")
    return {
        name: _integer(value, f"window.{name}") for name, value in zip(("x0", "x1", "y0", "y1"), given, strict=True)
    }


def _integer(value: Any, name: str) -> int:
    """Return a whole number as int. Raises InputError for anything else."""
    try:
        if isinstance(value, bool | np.bool_):
            raise TypeError
        return operator.index(value)
    except TypeError:
        raise InputError("must be a whole number", key=name, value=value) from None


def _log(text: object) -> None:
    """Log what a command would print, with a warning for objects that are not rendered."""
    logging.getLogger("csstsim").log(logging.WARNING if "not rendered" in str(text) else logging.INFO, text)
