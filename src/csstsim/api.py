"""csstsim in a notebook or a script: a campaign, its chips as arrays, and copies of it with something changed.

    import csstsim

    sim = csstsim.Simulation("campaign.yaml")      # or Simulation(): the campaign of `csstsim init`
    sim = sim.replace(window=(4000, 5000, 4000, 5000), layers={"cosmic_rays": None})
    frame = sim.chip("10100000004", 9)             # frame.image, frame.truth, frame.wcs, frame.header

A Simulation never changes, and what it makes depends on it alone: the same one gives the same bits, in any order, in a
loop and in several processes. Nothing is written but truth bricks and PSF sets, kept in `cache` under names of what
they were made for. Relative paths in a campaign file are taken from the folder Python runs in, as on the command line.
"""

import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from csstsim.campaign import OpenCampaign
from csstsim.catalog.own_table import plain_columns
from csstsim.config import Campaign, Observation, digest, load_campaign, load_observation
from csstsim.errors import InputError
from csstsim.io.paths import Paths
from csstsim.model import validate
from csstsim.optics.aim import exposure_of
from csstsim.release import release
from csstsim.shipped import ROOT

_TABLE = "csstsim.catalog.own_table:TableCatalog"


@dataclass(frozen=True, eq=False)
class Frame:
    """One chip of one exposure, as arrays; pixel (0, 0) of each is the first of the window.

    image: (ny, nx), DN (uint16) of `Simulation.chip`, electrons (float32) of `Simulation.light`.
    truth: astropy Table, a row an object (docs: Products); xImage, yImage count from 1 on the whole chip, and
    `truth["xImage"] - 1 - window.x0` is the column of `image`. wcs: astropy WCS of `image`, field distortion included:
    apparent directions [deg]. header: astropy Header, what the Level-0 file says in its two HDUs; None of `light`.
    raw: the window as read, with prescan and overscan, (rows, columns) DN, or None of `light`. orders: astropy Table of
    the truth of a spectroscopic chip, order by order, or None. window: x0, x1, y0, y1 [pixel] on the chip.
    """

    image: np.ndarray
    truth: Any
    wcs: Any
    window: Any
    header: Any = None
    raw: np.ndarray | None = None
    orders: Any = None
    readout: Any = None  # detector.channels.ReadoutFrame of `raw`

    @cached_property
    def electrons(self):
        """(ny, nx) float32, electrons: the channels' bias taken off, their gain undone; nothing else is corrected.

        Raises ValueError for a frame without bias and gain in its header (layers left out, or of `light`).
        """
        result = np.empty(self.image.shape, np.float32)
        for block in self.readout.blocks if self.readout else ():
            names = f"DETBIA{block.channel:02d}", f"GAIN{block.channel:02d}"
            if any(self.header.get(name) is None for name in names):
                raise ValueError("the header has no bias and gain of each channel: its layers left them out")
            bias, gain = (self.header[name] for name in names)
            result[block.image] = (self.image[block.image] - np.float32(bias)) * np.float32(gain)
        if not self.readout:
            raise ValueError("electrons already: `image` of Simulation.light")
        return result


class Simulation:
    """A campaign that is open, and what may be changed of it.

    campaign: file of a campaign; None: that of `csstsim init`, r, g and i of a small field. cache: folder of truth
    bricks and PSF sets [default: $CSSTSIM_CACHE, or csstsim in the user's cache folder]; share it as you like.
    Raises InputError for any fault in the campaign's files.
    """

    def __init__(self, campaign=None, cache=None):
        starter = ROOT / "config" / "starter" / "campaign.yaml"
        self._file = Path(campaign or starter)
        config = load_campaign(self._file)
        if campaign is None:
            shipped = {"survey_table": ROOT / "survey_tables" / "demo.csv", "observations": {}}
            config = validate(Campaign, config.model_dump() | shipped, self._file)
        folder = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        self._cache = Path(cache or os.environ.get("CSSTSIM_CACHE") or Path(folder) / "csstsim")
        self._open(config, {}, None)

    def _open(self, config, layers, pointings):
        self._layers, self._pointings = layers, pointings
        self._run = OpenCampaign(self._file, copied=True, config=config, layers=layers, pointings=pointings)
        self._run.paths = _Kept(self._cache, self._run)

    def replace(self, *, layers=None, catalog=None, **keys):
        """Return a Simulation like this one, but for what is named.

        keys: those of a campaign file (docs: Configuration), whole, as there or as Python has them: `seed=2`,
        `fidelity="noise_free"`, `psf={"grid": 10}`, `select={"types": ["SCIE"], "chips": [9]}`; `window` also as
        (x0, x1, y0, y1). layers: {keyword: changed parameters, or None to leave the layer out} of science exposures.
        catalog: an astropy Table (columns: csstsim.catalog.own_table), a CatalogBase class of yours, or the mapping of
        a campaign file. Raises InputError for an unknown key or layer, or a value that cannot be used.
        """
        config = self._run.config.model_dump()
        if isinstance(keys.get("window"), tuple | list) and len(keys["window"]) == 4:
            keys["window"] = dict(zip(("x0", "x1", "y0", "y1"), keys["window"], strict=True))
        if "window" in keys and "select" not in keys:  # pixels are named: no circle on the sky chooses them
            keys["select"] = config["select"] | ({"region": None} if keys["window"] != "region" else {})
        if catalog is not None:
            keys["catalog"] = _catalog(catalog, config["catalog"])
        pointings = None if "survey_table" in keys else self._pointings
        return self._with(config | keys, self._changed(layers) if layers else self._layers, pointings)

    def _with(self, config, layers, pointings):
        made = object.__new__(Simulation)
        made._file, made._cache = self._file, self._cache
        made._open(validate(Campaign, config, self._file), layers, pointings)
        return made

    def aim(self, ra, dec, chip=9, *, size=1000, pa=0.0, time="2027-11-20T01:20:00", exptime=150.0):
        """Return a Simulation of one exposure that has a place on the middle of one chip, and the pixels around it.

        ra, dec [deg, ICRS]; chip 1 to 30 (its filter is the image's); size: side of the window [pixel], None for the
        whole chip; pa: position angle [deg]; time: ISO UTC; exptime [s]. The exposure's obsid is 10100000001.
        Raises InputError for values that cannot be used.
        """
        camera = self._run.camera
        if chip not in camera.chips:
            raise InputError("no such chip", key="chip", value=chip, allowed=f"1 to {max(camera.chips)}")
        pointing = exposure_of(
            camera, camera.chips[chip], ra, dec, obsid="10100000001", pa=pa, time=time, exptime=exptime
        )
        detector, window = camera.chips[chip].detector, None
        if size is not None:
            spans = {axis: (n - size) // 2 for axis, n in (("x", detector.nx), ("y", detector.ny))}
            window = {f"{axis}{i}": start + i * size for axis, start in spans.items() for i in (0, 1)}
        changes = {"select": {"types": ["SCIE"], "chips": [chip]}, "window": window}
        return self._with(self._run.config.model_dump() | changes, self._layers, [pointing])

    def _changed(self, changes):
        """Return {"SCIE": list of layers} with parameters changed and layers left out."""
        file = self._run.config.observation_file("SCIE")
        entries = self._layers.get("SCIE") or load_observation(file).layers
        given, kept = {name.lower(): param for name, param in changes.items()}, []
        for entry in entries:
            [(keyword, param)] = entry.items()
            change = given.pop(keyword.lower(), {})
            if change is not None:
                kept.append({keyword: (param or {}) | change})
        if given:
            known = ", ".join(keyword for entry in entries for keyword in entry)
            raise InputError("not a layer of the list", file=file, key="layers", value=min(given), allowed=known)
        return self._layers | {"SCIE": validate(Observation, {"layers": kept}, file).layers}

    @property
    def config(self):
        """The campaign as csstsim.config.Campaign: every key, frozen."""
        return self._run.config

    @property
    def layers(self):
        """The layers of science exposures with all their parameters: a list of {keyword: {name: value}}, in order."""
        return self._run.steps["SCIE"].describe() if "SCIE" in self._run.steps else []

    @cached_property
    def exposures(self):
        """astropy Table of what the campaign selects: obsid, type, ra, dec, pa [deg], time, exptime [s], chips."""
        from astropy.table import Table

        rows = {}
        for job in self._run.jobs:
            rows.setdefault(job.pointing.obsid, (job.pointing, []))[1].append(job.chip.id)
        names = "obsid", "type", "ra", "dec", "pa", "time", "exptime", "chips"
        values = [
            (p.obsid, p.type, p.ra, p.dec, p.pa, f"{p.start:%Y-%m-%dT%H:%M:%S}", p.exptime, tuple(chips))
            for p, chips in rows.values()
        ]
        dtype = [str, str, float, float, float, str, float, object]
        return Table(
            rows=values, names=names, dtype=dtype, units={"ra": "deg", "dec": "deg", "pa": "deg", "exptime": "s"}
        )

    def chip(self, obsid, chip):
        """Return the Frame of one chip (1 to 30) in one exposure, read out: DN, all layers.

        Raises InputError for an exposure or chip that the campaign does not select.
        """
        from astropy.io.fits import Header

        from csstsim.detector.channels import ReadoutFrame
        from csstsim.in_memory import simulate
        from csstsim.io.level0_cards import level0_cards

        job = self._job(obsid, chip)
        state, provenance = simulate(self._run, job, say=_quiet)
        readout = ReadoutFrame.of(state.chip.detector, state.window)
        cards = level0_cards(state, self._run.camera.keywords, provenance, state.header.get("layout", "channels"))
        header = Header.fromstring("".join(text for part in cards for text in part))
        return self._frame(job, state, readout.active(state.image), header=header, raw=state.image, readout=readout)

    def light(self, obsid, chip):
        """Return the Frame of the light alone, before the detector: electrons of objects and sky.

        Bright objects and the sky are expectations, faint ones counted electrons, Poisson by birth; with
        `fidelity="noise_free"` all of it is expectation. Raises InputError as `chip`.
        """
        from csstsim.in_memory import light

        job = self._job(obsid, chip)
        state = light(self._run, job, say=_quiet)
        image = state.image if state.counted is None else state.image + state.counted.astype(np.float32)
        return self._frame(job, state, image)

    def _job(self, obsid, chip):
        return self._run.job(str(obsid), int(chip))

    def _frame(self, job, state, image, **parts):
        from csstsim.io.orders import orders_table
        from csstsim.io.truth import truth_table

        truth = _table(truth_table(state.truth, job))
        orders = None if state.orders is None else _table(orders_table(state.orders))
        return Frame(image=image, truth=truth, wcs=_wcs(job), window=job.window, orders=orders, **parts)


class _Kept(Paths):
    """Truth bricks and PSF sets in the cache, each under a name of what it was made for."""

    def __init__(self, cache, run):
        super().__init__(cache / "products")
        self._cache, self._run = cache, run

    @cached_property
    def _truth(self):
        key = self._run.universe_key()
        made_for = [release(), key["seed"], key["universe"].digest, key["camera"].digest, key["lensing"].model_dump()]
        return Paths(self._cache / digest(made_for))

    @cached_property
    def _psf(self):
        config = self._run.config.psf.model_dump(mode="json", exclude={"interpolation", "beta", "neighbours"})
        return Paths(self._cache / digest([release(), config, self._run.camera.digest]))

    def truth(self, pix):
        return self._truth.truth(pix)

    def psf(self, chip_id):
        return self._psf.psf(chip_id)

    def psf_tables(self, chip_id):
        return self._psf.psf_tables(chip_id)


def _catalog(given, before):
    """Return the campaign's `catalog` for a table, a class or a mapping; mag_limit and shapes stay as they were."""
    if isinstance(given, dict):
        return given
    kept = {name: before[name] for name in ("mag_limit", "shapes")}
    if isinstance(given, type):
        return kept | {"kind": f"{given.__module__}:{given.__qualname__}", "options": {}}
    if not hasattr(given, "colnames"):
        allowed = "an astropy Table, a CatalogBase class, a mapping"
        raise InputError("cannot be used", key="catalog", value=type(given).__name__, allowed=allowed)
    columns = {name: values.tolist() for name, values in plain_columns(given).items()}
    return kept | {"kind": _TABLE, "options": {"columns": columns}}


def _table(table):
    from astropy.table import Table

    return Table({name: table[name] for name in table.names})


def _wcs(job):
    """Return the astropy WCS of a job's window: TAN-SIP where the field is distorted, else linear."""
    from astropy.wcs import WCS

    from csstsim.optics.sip import sip_header

    header = sip_header(job.wcs) if job.wcs.distortion else job.wcs.header()
    header |= {"CRPIX1": header["CRPIX1"] - job.window.x0, "CRPIX2": header["CRPIX2"] - job.window.y0}
    return WCS(header)


def _quiet(text):
    """Say nothing."""
