"""The paths of all products of a campaign, for the command line and the workflow.

    truth/dataset/Norder=8/Dir=D/Npix=P.parquet  truth/hats.properties  psf/chip_08.h5 chip_08_tables.h5
    chips/{obsid}_{chip}/select.parquet render.fits drawn.parquet orders.parquet readout.fits
    level0/{obsid}/{stem}.fits {stem}.truth.parquet {stem}.cat {stem}.orders.parquet {stem}.cosmic.fits
    masters/chip_08.fits  calibrated/{obsid}_{chip}.fits  measure/{obsid}_{chip}.parquet  spectra/{obsid}_{chip}.parquet
    merge/dataset/Norder=8/Dir=D/Npix=P.parquet  merge/hats.properties  validate/{P}.json
    report/index.html verdict.json variants.html  look/{obsid}_{chip}.png

chips/ has the files passed between a chip's stages; it may be elsewhere (`scratch`), on a node's own disk.
The names of Level-0 files have the form that the campaign chooses (io.level0_names). Bricks use the HATS directory
layout (nested HEALPix order 8, NSIDE 256); bricks.hats makes catalogues of them.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from csstsim.base.errors import InputError
from csstsim.io.level0_names import FORMS, NEWEST

if TYPE_CHECKING:
    from csstsim.base.types import PathLike
    from csstsim.campaign.job import Job

# Suffixes of the files that accompany a Level-0 file under its name.
TRUTH = ".truth.parquet"
CAT = ".cat"
ORDERS = ".orders.parquet"
COSMIC = ".cosmic.fits"
LIGHT = "render.fits", "drawn.parquet", "orders.parquet"  # what render makes for a chip; may be kept


def made(path: Path, command: str) -> Path:
    """Return the path of a product. If it is missing, raises InputError with the command that makes it."""
    if not path.is_file():
        raise InputError(f"not made yet; `csstsim {command}` makes it, snakemake the whole campaign", file=path)
    return path


class Paths:
    """The products of one campaign under its output folder, its intermediates under `scratch` if that is given.

    names: the form of the names of Level-0 files, of io.level0_names.FORMS.
    """

    def __init__(self, output: PathLike, scratch: PathLike | None = None, names: str = NEWEST) -> None:
        self.output = Path(output)
        self._form = FORMS[names]
        self.chips = Path(scratch or output) / "chips"

    def _hats(self, kind: str, pix: int, form: str = "{}") -> Path:
        return self.output / kind / "Norder=8" / f"Dir={pix // 10000 * 10000}" / f"Npix={form.format(pix)}.parquet"

    def truth(self, pix: int) -> Path:
        """Bricks of the embedded truth, HATS parquet; pix: NSIDE 256, nested."""
        return self._hats("truth/dataset", pix)

    @property
    def truth_catalogue(self) -> Path:
        """The folder of the truth bricks and of the files about all of them."""
        return self.output / "truth"

    def merge(self, pix: int) -> Path:
        """A merged brick's table of sources, HATS parquet; pix: NSIDE 256, nested."""
        return self._hats("merge/dataset", pix)

    @property
    def merge_catalogue(self) -> Path:
        """The folder of the merged bricks and of the files about all of them."""
        return self.output / "merge"

    def psf(self, chip_id: int) -> Path:
        """A chip's PSF set, HDF5."""
        return self.output / "psf" / f"chip_{chip_id:02d}.h5"

    def psf_tables(self, chip_id: int) -> Path:
        """The tables from which photons are drawn, made from the PSF set, HDF5."""
        return self.output / "psf" / f"chip_{chip_id:02d}_tables.h5"

    def stage(self, obsid: str, chip_id: int, name: str) -> Path:
        """Intermediate of a chip: 'select.parquet', 'render.fits', 'drawn.parquet', ..."""
        return self.chips / f"{obsid}_{chip_id:02d}" / name

    def level0(self, job: Job) -> Path:
        """A chip's Level-0 FITS file; job: campaign.job.Job."""
        return self.output / "level0" / job.obsid / f"{self._form.stem(job)}.fits"

    def level0_truth(self, job: Job) -> Path:
        """The table of drawn objects beside the Level-0 file, parquet."""
        return self.level0(job).with_suffix(TRUTH)

    def level0_cat(self, job: Job) -> Path:
        """The same table as text (io.cat), if the campaign's `truth` asks for it."""
        return self.level0(job).with_suffix(CAT)

    def level0_catalogue(self, job: Job) -> Path:
        """Where programs that read the campaign's form of names look for the text: of C9 `level0_cat` itself."""
        return self.output / "level0" / job.obsid / f"{self._form.catalogue(self._form.stem(job), job.chip.filter)}.cat"

    def level0_orders(self, job: Job) -> Path:
        """The truth of dispersed light, order by order (io.orders), of a spectroscopic chip's science exposure."""
        return self.level0(job).with_suffix(ORDERS)

    def level0_cosmic(self, job: Job) -> Path:
        """The electrons of cosmic rays alone, if cosmic_rays saves them (io.frames, plane `cosmic`)."""
        return self.level0(job).with_suffix(COSMIC)

    def masters(self, chip_id: int) -> Path:
        """A chip's master bias, dark and flat, FITS."""
        return self.output / "masters" / f"chip_{chip_id:02d}.fits"

    def calibrated(self, obsid: str, chip_id: int) -> Path:
        """A calibrated frame (SCI, ERR, DQ), FITS."""
        return self.output / "calibrated" / f"{obsid}_{chip_id:02d}.fits"

    def measure(self, obsid: str, chip_id: int) -> Path:
        """The table of what was measured on an imaging frame, parquet."""
        return self.output / "measure" / f"{obsid}_{chip_id:02d}.parquet"

    def spectra(self, obsid: str, chip_id: int) -> Path:
        """The table of extracted spectra of a slitless frame, parquet."""
        return self.output / "spectra" / f"{obsid}_{chip_id:02d}.parquet"

    def lines(self, obsid: str, chip_id: int) -> Path:
        """The table of the emission lines in them, parquet."""
        return self.output / "spectra" / f"{obsid}_{chip_id:02d}_lines.parquet"

    def validate(self, pix: int) -> Path:
        """A brick's validation, JSON; pix: NSIDE 256, nested."""
        return self.output / "validate" / f"{pix}.json"

    def look(self, obsid: str, chip_id: int) -> Path:
        """A picture of a Level-0 file, PNG."""
        return self.output / "look" / f"{obsid}_{chip_id:02d}.png"

    @property
    def report(self) -> Path:
        """The campaign's report, HTML."""
        return self.output / "report" / "index.html"

    @property
    def variants_page(self) -> Path:
        """The comparison of a campaign's variants, HTML."""
        return self.output / "report" / "variants.html"
