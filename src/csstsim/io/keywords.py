"""The values of the Level-0 header, and the table that names and orders its keywords.

The table is config/instrument/level0_keywords.yaml (its head explains the entries). This module computes every quantity
that an entry can name. Quantities without a source in the simulation (telemetry) do not exist.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import csstsim
from csstsim.base.commit import git_commit
from csstsim.base.errors import InputError
from csstsim.base.release import release
from csstsim.base.units import DAY_S, EARTH_RADIUS_KM
from csstsim.detector.channels import ReadoutFrame
from csstsim.instrument.orbit import orbit_after
from csstsim.io.fits_writing import card, remark
from csstsim.io.sections import section_lists

if TYPE_CHECKING:
    from csstsim.base.types import PathLike
    from csstsim.instrument.chip import Detector
    from csstsim.instrument.pointing import Pointing
    from csstsim.simulation.state import State

STAGES = ("select", "render", "readout", "level0")
_FROM_LAYERS = (
    "gain", "bias", "read_noise", "one_gain", "one_read_noise", "clipped_high", "clipped_low", "prnu_rms",
    "cosmic_tracks", "cosmic_pixels", "cosmic_electrons", "hot_pixels", "dead_pixels", "bad_columns", "defects_level",
    "dark_electrons", "bfe_area", "cti_density", "cti_trapped", "cti_serial_trapped", "saturated", "bloom_lost",
    "nonlinearity_quadratic", "nonlinearity_cubic",
    "sky_rate", "sky_zodiacal", "sky_earth", "sky_sun", "sky_moon", "sky_planets", "sky_stars",
    "shutter_open_0", "shutter_open_1", "shutter_close_0", "shutter_close_1",
    "led_flag", "led_type", "led_time", "led_guessed",
    *(f"{name}_angle_{end}" for name in ("sun", "moon", "limb", "limb_sun") for end in ("start", "end")),
)  # a quantity is absent if its layer is  # fmt: skip
# The keyword of each part of a recipe (campaign.opened.OpenCampaign.recipe); readers check them.
RECIPE = {"campaign": "CAMPHASH", "camera": "CAMHASH", "layers": "LAYHASH", "exposure": "EXPHASH"}
_KEYS = {"hdu", "block", "keyword", "constant", "from", "repeat", "comment"}


def recorded_recipe(header: Mapping[str, Any]) -> dict[str, Any]:
    """Return the recipe stated in a primary header of Level-0 or a calibrated image; None for parts that it lacks."""
    recipe = {name: header.get(keyword) for name, keyword in RECIPE.items()}
    return recipe | {"csstsim": release(header["SIMVER"]) if "SIMVER" in header else None}


def header_cards(
    entries: Sequence[Any], values: Mapping[str, Any], hdu: int, file: PathLike = "level0_keywords.yaml"
) -> list[str]:
    """Return the cards of one HDU, in the table's order.

    entries: the table; values: {name: value}, None for a quantity that this exposure does not have (its keyword is
    omitted). Raises InputError with the entry's name if it is malformed or names an unknown quantity.
    """
    cards = []
    for number, entry in enumerate(entries):
        where = f"entry {number + 1}"
        if isinstance(entry, dict) and "keyword" in entry:
            where += f", {entry['keyword']}"
        _check(entry, values, file, where)
        if entry["hdu"] != hdu:
            continue
        if "block" in entry:
            rule = "=" * 69
            cards += [
                remark("COMMENT", f" {rule}"),
                remark("COMMENT", f" {entry['block']}"),
                remark("COMMENT", f" {rule}"),
            ]
            continue
        value = values[entry["from"]] if "from" in entry else entry["constant"]
        keyword = entry["keyword"]
        comment = entry.get("comment", "")
        if value is None:
            continue
        if keyword == "HISTORY":
            cards += [remark("HISTORY", f" {line}") for line in value]
            continue
        repeated = [(keyword, value)]
        if entry.get("repeat"):
            repeated = [(f"{keyword}{i + 1:02d}", v) for i, v in enumerate(value) if v is not None]
        try:
            cards += [card(name, v, comment) for name, v in repeated]
        except ValueError as exc:
            raise InputError(str(exc), file=file, key=where) from None
    return cards


def _check(entry: Any, values: Mapping[str, Any], file: PathLike, where: str) -> None:
    location = {"file": file, "key": where}
    if not isinstance(entry, dict) or not set(entry) <= _KEYS or entry.get("hdu") not in (0, 1):
        raise InputError(
            "not a header entry", value=entry, allowed=f"hdu 0 or 1, and {', '.join(sorted(_KEYS))}", **location
        )
    kinds = [name for name in ("block", "constant", "from") if name in entry]
    named = isinstance(entry.get("keyword", ""), str)
    if len(kinds) != 1 or ("keyword" in entry) == ("block" in entry) or not named:
        raise InputError("an entry is a block, or a keyword with either constant or from", value=entry, **location)
    if "from" in entry and not (isinstance(entry["from"], str) and entry["from"] in values):
        raise InputError("unknown quantity", value=entry["from"], allowed=", ".join(sorted(values)), **location)


def header_values(state: State, provenance: Mapping[str, Any], layout: str) -> dict[str, Any]:
    """Return {name: value} of everything a Level-0 header can state.

    `provenance` holds obsid, filename (without suffix), recipe ({name: digest}, see RECIPE), truth_hash, psf_hash,
    seed, campaign_name, ephemeris, planets, layers (list of {keyword: parameters}), camera ({changed number: value})
    and stages (list of [stage, wall s, cpu s]); a missing entry gives None.
    """
    values: dict[str, Any] = dict.fromkeys(_FROM_LAYERS) | state.header
    values |= _exposure(state.pointing) | _detector(state, layout) | _simulation(provenance)
    values["layers"] += [f"value {name} = {json.dumps(state.header[name])}" for name in state.header.get("own", ())]
    if values["bias"] is not None and values["gain"] is not None:
        values["bias_adu"] = [bias / gain for bias, gain in zip(values["bias"], values["gain"], strict=True)]
    return values | {"date": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%S}"}


def _exposure(pointing: Pointing) -> dict[str, Any]:
    start_state = pointing.sat_position, pointing.sat_velocity
    end_state = orbit_after(*start_state, pointing.exptime)
    ra = float(pointing.ra)
    dec = float(pointing.dec)
    pa = float(pointing.pa)
    values = {
        "type": pointing.type, "ra": ra, "dec": dec, "pa": pa, "target": _designation(ra, dec),
        "euler_1": ra, "euler_2": -dec, "euler_3": -pa, "shutter": pointing.type == "SCIE",
        "exptime": float(pointing.exptime), "survey": None if pointing.survey == "WIDE" else pointing.survey,
        "time_start": _iso(pointing.start), "time_end": _iso(pointing.end),
        "mjd_start": pointing.mjd, "mjd_end": pointing.mjd + pointing.exptime / DAY_S,
    }  # fmt: skip
    for end, (position, velocity) in (("start", start_state), ("end", end_state)):
        values[f"altitude_{end}"] = math.hypot(*position) - EARTH_RADIUS_KM
        for axis, x, v in zip("xyz", position, velocity, strict=True):
            values |= {f"position_{end}_{axis}": float(x), f"velocity_{end}_{axis}": float(v)}
    return values


def _iso(moment: datetime) -> str:
    return moment.replace(tzinfo=None).isoformat(timespec="milliseconds")


def _designation(ra: float, dec: float) -> str:
    """Return the IAU's designation of a position [deg], truncated to its digits: Jhhmmss.s+ddmmss."""
    tenths = int(ra % 360.0 * 2400.0 + 1e-6)  # of seconds of time
    arcsec = int(abs(dec) * 3600.0 + 1e-6)
    hour, tenths = divmod(tenths, 36000)
    degree, arcsec = divmod(arcsec, 3600)
    time = f"{hour:02d}{tenths // 600:02d}{tenths % 600 / 10:04.1f}"
    return f"J{time}{'-' if dec < 0 else '+'}{degree:02d}{arcsec // 60:02d}{arcsec % 60:02d}"


def _detector(state: State, layout: str) -> dict[str, Any]:
    detector = state.chip.detector
    window = state.window
    readout = ReadoutFrame.of(detector, window).of_file(layout)
    lists = section_lists(readout, layout)
    return {
        "data_section": lists["DATASEC"], "trim_section": lists["TRIMSEC"], "bias_section": lists["BIASSEC"],
        "chip_section": lists["DETSEC"],
        "chip_label": state.chip.label, "filter": state.chip.filter, "layout": layout,
        "extensions": 1 if state.mask is None else 2,
        "temperature": detector.temperature, "readout_time": detector.readout_time, "adc_max": detector.adc_max,
        "readout_speed": _readout_speed(detector),
        "pixel_scale": state.telescope.pixel_scale, "pixel_um": detector.pixel_um,
        "detector_size": f"[1:{detector.nx},1:{detector.ny}]", "channels": detector.channels_x * detector.channels_y,
        "prescan": readout.prescan, "overscan": readout.overscan, "parallel_overscan": readout.parallel_overscan,
        "window_x_first": window.x0 + 1, "window_x_last": window.x1,
        "window_y_first": window.y0 + 1, "window_y_last": window.y1,
        "bias_adu": None, "field_dist": state.wcs.distortion is not None,
    }  # fmt: skip


def _readout_speed(detector: Detector) -> float:
    """Return the mean rate [MHz] at which a channel's pixels are read, prescan and overscans included."""
    columns = detector.channel_nx + detector.prescan + detector.overscan
    return columns * (detector.channel_ny + detector.parallel_overscan) / detector.readout_time / 1e6


def _simulation(provenance: Mapping[str, Any]) -> dict[str, Any]:
    values = {"version": csstsim.__version__, "commit": git_commit(), "software": f"csstsim {csstsim.__version__}"}
    recipe = provenance.get("recipe", {})
    values |= {f"{name}_hash": recipe.get(name) for name in RECIPE}
    for name in ("obsid", "filename", "campaign_name", "seed", "truth_hash", "psf_hash", "ephemeris", "planets"):
        values[name] = provenance.get(name)
    for stage in STAGES:
        values |= {f"wall_{stage}": None, f"cpu_{stage}": None}
    for stage, wall, cpu in provenance.get("stages", ()):
        values |= {f"wall_{stage}": round(wall, 3), f"cpu_{stage}": round(cpu, 3)}
    layers = [item for entry in provenance.get("layers", ()) for item in entry.items()]
    history = [f"layer {name} {json.dumps(param, sort_keys=True)}" for name, param in layers]
    changes = [f"camera {name} = {value}" for name, value in provenance.get("camera", {}).items()]
    return values | {"layers": history + changes}
