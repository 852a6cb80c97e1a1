"""The setting of a benchmark: one chip of the shipped camera, its PSF set, an exposure, and the noise of a pixel."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from csstsim.base.errors import InputError
from csstsim.base.shipped import SHIPPED
from csstsim.catalog.selection.select import Noise
from csstsim.instrument.camera import load_camera
from csstsim.instrument.pointing import Pointing
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.optics.gratings.dispersion import Disperser
from csstsim.optics.psf.psf_file import PsfSet
from csstsim.optics.psf.psf_set import PsfSampling, make_psf
from csstsim.optics.scatter.scattered_light import scattered_light
from csstsim.render.psf_mixture import Mixer
from csstsim.render.psf_table import read_tables, write_tables

if TYPE_CHECKING:
    from csstsim.base.types import PathLike
    from csstsim.instrument.camera import Camera
    from csstsim.instrument.chip import Chip
    from csstsim.instrument.filter import Filter
    from csstsim.optics.scatter.scattered_light import Scattered
    from csstsim.render.psf_table import PsfTable

EXPTIME = 150.0  # s
GRID = 10  # nodes along a side, a campaign's default
POINTING = Pointing("SCIE", 60.0, -40.0, -113.4333, "2027-06-26T20:35:58", EXPTIME, (6778.0, 0.0, 0.0), (0.0, 7.0, 3.0))


@dataclass(frozen=True, eq=False)
class Setting:
    """The inputs that are common to all methods."""

    camera: Camera
    chip: Chip
    filter: Filter
    psf: PsfSet
    table: PsfTable  # of the same set, for photons
    mixer: Mixer  # of the same set, for stamps
    scattered: Scattered  # its halo is in the PSF set
    wcs: ChipWCS
    exptime: float
    variance: float  # of a pixel without the object [electron^2]: sky, dark current, read noise
    disperser: Disperser | None = None  # of a spectroscopic chip


def disperser_of(setting: Setting) -> Disperser:
    """Return the Disperser of the Setting of a spectroscopic chip."""
    assert setting.disperser is not None
    return setting.disperser


def make_setting(folder: PathLike, band: str) -> Setting:
    """Return the Setting of the filter `band`. Its PSF set is made in `folder`, or reused if it is there.

    The set's file name has the camera's digest, so the set of another camera is never used. Raises InputError.
    """
    camera = load_camera(SHIPPED / "instrument")
    chips = {chip.filter: chip for chip in reversed(camera.chips.values())}
    if band not in chips:
        raise InputError("unknown filter", key="--filter", value=band, allowed=", ".join(chips))
    chip = chips[band]
    filter_ = camera.filters[band]
    disperser = Disperser(camera.gratings[chip.id], filter_, camera.telescope) if chip.kind == "slitless" else None
    scattered = scattered_light(camera, filter_)
    path = Path(folder) / f"psf_{band}_{camera.digest}.h5"
    if not path.exists():
        make_psf(path, chip, filter_, camera.psf, PsfSampling(GRID), camera_digest=camera.digest, scattered=scattered)
    psf = PsfSet(path, chip=chip.id, camera_digest=camera.digest)
    tables = path.with_suffix(".tables.h5")
    if not tables.exists():
        write_tables(tables, psf)
    noise = Noise(filter_.sky, camera.detector.dark, camera.detector.read_noise)
    return Setting(
        camera=camera,
        chip=chip,
        filter=filter_,
        psf=psf,
        table=read_tables(tables, psf),
        mixer=Mixer(psf),
        scattered=scattered,
        wcs=ChipWCS(chip, POINTING),
        exptime=EXPTIME,
        variance=noise.variance(EXPTIME),
        disperser=disperser,
    )
