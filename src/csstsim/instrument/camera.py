"""The camera: every data file of an instrument folder (config/instrument/README.md), read and checked as one object."""

from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.help_page import explained
from csstsim.instrument.chip import Chip, Detector
from csstsim.instrument.cosmic_rays import load_cosmic_rays
from csstsim.instrument.defects import load_defects
from csstsim.instrument.filter import GRID, Filter, sample_curve
from csstsim.instrument.grating import load_gratings
from csstsim.instrument.load import build, folder_digest, read_data, read_sections
from csstsim.instrument.orbit import Orbit
from csstsim.instrument.pointing import parse_utc
from csstsim.instrument.telescope import Telescope
from csstsim.instrument.traps import load_traps

KINDS = ("imaging", "slitless")
CHIPS_MAX = 99  # two digits in the names of files


@dataclass(frozen=True, eq=False)
class Camera:
    """The Survey Camera as its data files describe it; `digest` names their content."""

    chips: dict[int, Chip]
    filters: dict[str, Filter]
    telescope: Telescope
    orbit: Orbit
    detector: Detector
    keywords: list[dict[str, Any]]  # level-0 header entries of level0_keywords.yaml; empty without the file
    psf: dict[str, Any]  # psf.yaml; empty without the file
    scatter: dict[str, Any]  # scatter.yaml; empty without the file
    ghosts: dict[str, Any]  # ghosts.yaml; empty without the file
    sky: dict[str, Any]  # sky.yaml; empty without the file
    leds: dict[str, Any]  # leds.yaml and `mosaic`, its columns and rows; empty without the file
    folder: Path
    digest: str

    @cached_property
    def bands(self):
        """{name in lower case, as in columns' names: Filter} of the imaging filters, in the order of filters.yaml."""
        return {name.lower(): filter_ for name, filter_ in self.filters.items() if filter_.kind == "imaging"}

    @property
    def imaging_chips(self):
        """Chips behind the imaging filters, by number."""
        return [chip for chip in self.chips.values() if chip.kind == "imaging"]

    @property
    def slitless_chips(self):
        """Chips behind the gratings, by number."""
        return [chip for chip in self.chips.values() if chip.kind == "slitless"]

    @cached_property
    def gratings(self):
        """{chip id: instrument.grating.Gratings} of the slitless chips. Raises InputError."""
        file = self.folder / "gratings.yaml"
        if not file.exists():
            raise InputError("the instrument folder has no gratings", file=file)
        chips = {chip.id: chip for chip in self.slitless_chips}
        return load_gratings(self.folder / "gratings", read_data(file), chips, self.filters, self.telescope)


@explained("instrument")
def load_camera(folder):
    """Read an instrument folder (config/instrument/README.md). Raises InputError naming file, key and value."""
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError("no such instrument folder", file=folder)
    detector = _detector(folder / "detector.yaml")
    filters = _filters(folder / "filters.yaml")
    telescope, orbit = load_telescope(folder / "telescope.yaml")
    keywords = folder / "level0_keywords.yaml"
    optional = {name: folder / f"{name}.yaml" for name in ("psf", "scatter", "ghosts", "sky", "leds")}
    chips = _chips(folder / "chips.yaml", filters, detector, telescope)
    more = {name: read_data(path) if path.exists() else {} for name, path in optional.items()}
    if more["leds"]:
        more["leds"] |= {"mosaic": tuple(max(getattr(c, of) for c in chips.values()) for of in ("column", "row"))}
    return Camera(
        chips=chips,
        filters=filters,
        telescope=telescope,
        orbit=orbit,
        detector=detector,
        keywords=_only_list(keywords) if keywords.exists() else [],
        **more,
        folder=folder,
        digest=folder_digest(folder),
    )


def _detector(path):
    moved = path.with_name("brighter_fatter.yaml")
    effects = {
        "cosmic_rays": load_cosmic_rays(path.with_name("cosmic_rays.yaml")),
        "defects": load_defects(path.with_name("defects.yaml")),
        "traps": load_traps(path.with_name("cti.yaml")),
        "brighter_fatter": read_data(moved) if moved.exists() else {},
    }
    detector = build(Detector, read_sections(path), path, **effects)
    for axis in ("x", "y"):
        n, channels, size = (getattr(detector, name) for name in (f"n{axis}", f"channels_{axis}", f"channel_n{axis}"))
        if min(n, channels, size) < 1 or channels * size != n:
            rule = f"channels_{axis} * channel_n{axis} = {channels * size}"
            raise InputError("does not fit the channels", file=path, key=f"n{axis}", value=n, allowed=rule)
    if detector.channels_x % 2:
        raise InputError("half the columns read out to each side", file=path, key="channels_x", allowed="even numbers")
    if detector.channels_y != 2:
        raise InputError("half the rows read out to each side", file=path, key="channels_y", allowed="2")
    _positive(detector, ("gain", "adc_max", "pixel_um", "full_well"), path)
    signed = {"nonlinearity_quadratic", "nonlinearity_cubic", *effects}
    _positive(detector, (f.name for f in fields(Detector) if f.name not in signed), path, or_zero=True)
    for name, most in (
        ("bloom_row_share", 1), ("nonlinearity_spread", 1), ("gain_spread", 0.5), ("adc_max", 65535), ("channels_x", 13)
    ):  # fmt: skip
        if getattr(detector, name) > most:
            raise InputError("out of range", file=path, key=name, value=getattr(detector, name), allowed=f"0..{most}")
    return detector


def load_telescope(path):
    """Read telescope.yaml: (Telescope, Orbit). Raises InputError."""
    data = read_data(path)
    telescope = build(Telescope, data.get("telescope"), path, "telescope")
    if telescope.parity not in (1, -1):
        raise InputError("unknown parity", file=path, key="telescope.parity", value=telescope.parity, allowed="1, -1")
    _positive(telescope, ("diameter_m", "focal_length_m", "pixel_scale", "shutter_span_mm"), path)
    _positive(telescope, ("shutter_time",), path, or_zero=True)
    orbit = build(Orbit, data.get("orbit"), path, "orbit")
    try:
        parse_utc(orbit.epoch)
    except ValueError:
        raise InputError("not an ISO UTC time", file=path, key="orbit.epoch", value=orbit.epoch) from None
    _positive(orbit, ("altitude_km",), path)
    return telescope, orbit


def _positive(record, names, path, or_zero=False):
    for name in names:
        value = getattr(record, name)
        if not (value > 0 or (or_zero and value == 0)):
            allowed = "0 or more" if or_zero else "more than 0"
            raise InputError("out of range", file=path, key=name, value=value, allowed=allowed)


def _filters(path):
    filters = {}
    for name, entry in read_data(path).items():
        entry = dict(entry) if isinstance(entry, dict) else {}
        key = f"{name}.nodes"
        try:
            nodes = np.asarray(entry.pop("nodes", ()), dtype=float)
        except (TypeError, ValueError):
            nodes = np.empty(0)
        if nodes.ndim != 2 or nodes.shape[1] != 2 or len(nodes) < 2 or not np.isfinite(nodes).all():
            raise InputError("must be a list of (angstrom, throughput) pairs", file=path, key=key)
        if (np.diff(nodes[:, 0]) <= 0).any() or nodes[0, 0] < GRID[0] or nodes[-1, 0] > GRID[-1]:
            raise InputError("wavelengths must rise, within 2000-11000 A", file=path, key=key)
        if (nodes[:, 1] < 0).any() or (nodes[:, 1] > 1).any() or not (nodes[:, 1] > 0).any():
            raise InputError("throughput must lie in 0..1 and not be zero everywhere", file=path, key=key)
        kind = entry.get("kind")
        if kind not in KINDS:
            raise InputError("unknown kind", file=path, key=f"{name}.kind", value=kind, allowed=", ".join(KINDS))
        curve = {"wavelength": GRID, "throughput": sample_curve(nodes)}
        filters[name] = build(Filter, entry, path, name, name=name, **curve)
    return filters


def _chips(path, filters, detector, telescope):
    chips = {}
    for i, row in enumerate(_only_list(path)):
        key = f"chips[{i}]"
        name = row.get("filter") if isinstance(row, dict) else None
        if not isinstance(name, str) or name not in filters:
            raise InputError("unknown filter", file=path, key=f"{key}.filter", value=name, allowed=", ".join(filters))
        chip = build(Chip, row, path, key, kind=filters[name].kind, detector=detector, telescope=telescope)
        if chip.id in chips or not 1 <= chip.id <= CHIPS_MAX:
            raise InputError(f"chip ids are distinct, 1..{CHIPS_MAX}", file=path, key=f"{key}.id", value=chip.id)
        chips[chip.id] = chip
    return dict(sorted(chips.items()))


def _only_list(path):
    """Return the one list that the file's sections hold."""
    lists = [value for value in read_data(path).values() if isinstance(value, list)]
    if len(lists) != 1:
        raise InputError(f"the file must hold one list, not {len(lists)}", file=path)
    return lists[0]
