"""The paths of all products of a campaign, for the command line and the workflow. Their names: base.stage_records.

    truth/dataset/Norder=8/Dir=D/Npix=P.parquet  truth/hats.properties  psf/chip_08.h5 chip_08_tables.h5
    chips/{obsid}_{chip}/select.parquet render.fits drawn.parquet orders.parquet readout.fits
    level0/{obsid}/{stem}.fits {stem}.truth.parquet {stem}.cat {stem}.orders.parquet {stem}.cosmic.fits
    masters/chip_08.fits  calibrated/{obsid}_{chip}.fits  measure/{obsid}_{chip}.parquet {obsid}_{chip}.residual.fits
    spectra/{obsid}_{chip}.parquet
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
from csstsim.base.stage_records import PRODUCTS, STAGE_OF, STAGES
from csstsim.io.level0_names import FORMS, NEWEST

if TYPE_CHECKING:
    from typing import Any

    from csstsim.base.types import PathLike
    from csstsim.campaign.job import Job

# Suffixes of the files that accompany a Level-0 file and have its name
TRUTH = ".truth.parquet"
CAT = ".cat"
ORDERS = ".orders.parquet"
COSMIC = ".cosmic.fits"
RENDER_PRODUCTS = tuple(product.name for product in STAGES["render"].products)  # file names; campaigns may keep them


def existing_product(path: Path, command: str) -> Path:
    """Return the path of a product. Raises InputError with the command that makes it if it is missing."""
    if not path.is_file():
        raise InputError(f"not made yet; `csstsim {command}` makes it, snakemake the whole campaign", file=path)
    return path


class Paths:
    """The products of one campaign below its output folder, and its intermediates below `scratch` if given.

    names: the form of the names of Level-0 files, a key of io.level0_names.FORMS.
    """

    def __init__(self, output: PathLike, scratch: PathLike | None = None, names: str = NEWEST) -> None:
        self.output = Path(output)
        self._form = FORMS[names]
        self.chips = Path(scratch or output) / "chips"

    def pattern(self, name: str) -> str:
        """Return the path of a product (base.stage_records.PRODUCTS) with its placeholders in braces."""
        path = PRODUCTS[name].path
        return f"{self.chips}{path.removeprefix('chips')}" if path.startswith("chips/") else f"{self.output}/{path}"

    def find(self, name: str, **words: object) -> Path:
        """Return the path of a product; words: values of the placeholders in its record."""
        folder = self.chips.parent if PRODUCTS[name].path.startswith("chips/") else self.output
        return folder / PRODUCTS[name].path.format(**words)

    def of(self, name: str, one: Job | int | str | None) -> Path:
        """Return the path of a product of one job, chip (number), exposure (obsid) or brick; None: of the campaign."""
        return self.find(name, **self._words(STAGE_OF[name].unit, one))

    def _words(self, unit: str, one: Any) -> dict[str, object]:
        if unit == "job":
            return {"obsid": one.obsid, "chip": f"{one.chip.id:02d}", "stem": self.stem(one)}
        if unit == "chip":
            return {"chip": f"{one:02d}"}
        if unit == "exposure":
            return {"obsid": one}
        return {"pix": one, "dir": one // 10000 * 10000} if unit == "brick" else {}

    def stem(self, job: Job) -> str:
        """Return the name of a Level-0 file without its ending; job: campaign.job.Job."""
        return self._form.stem(job)

    def truth(self, pix: int) -> Path:
        """A brick of the embedded truth, HATS parquet; pix: NSIDE 256, nested."""
        return self.of("truth", pix)

    @property
    def truth_catalogue(self) -> Path:
        """The folder of the truth bricks, and of the metadata of all of them."""
        return self.output / "truth"

    def merge(self, pix: int) -> Path:
        """A merged brick's table of sources, HATS parquet; pix: NSIDE 256, nested."""
        return self.of("merge", pix)

    @property
    def merge_catalogue(self) -> Path:
        """The folder of the merged bricks, and of the metadata of all of them."""
        return self.output / "merge"

    def psf(self, chip_id: int) -> Path:
        """A chip's PSF set, HDF5."""
        return self.of("psf", chip_id)

    def psf_tables(self, chip_id: int) -> Path:
        """The tables from which photons are sampled, made from the PSF set, HDF5."""
        return self.of("psf_tables", chip_id)

    def stage(self, obsid: str, chip_id: int, name: str) -> Path:
        """Intermediate of a chip: 'select.parquet', 'render.fits', 'drawn.parquet', ..."""
        return self.find(name, obsid=obsid, chip=f"{chip_id:02d}")

    def level0(self, job: Job) -> Path:
        """A chip's Level-0 FITS file; job: campaign.job.Job."""
        return self.of("level0", job)

    def level0_truth(self, job: Job) -> Path:
        """The truth table of a Level-0 file, parquet."""
        return self.of("level0_truth", job)

    def level0_cat(self, job: Job) -> Path:
        """The same table as text (io.cat), if the campaign's `truth` requests it."""
        return self.of("level0_cat", job)

    def level0_catalogue(self, job: Job) -> Path:
        """The path at which programs of the campaign's form of names expect the text; with C9 that of `level0_cat`."""
        return self.output / "level0" / job.obsid / f"{self._form.catalogue(self.stem(job), job.chip.filter)}.cat"

    def level0_orders(self, job: Job) -> Path:
        """The truth of dispersed light, order by order (io.orders), of a spectroscopic chip's science exposure."""
        return self.of("level0_orders", job)

    def level0_cosmic(self, job: Job) -> Path:
        """The image of the cosmic rays alone, if cosmic_rays saves it (io.frames, plane `cosmic`)."""
        return self.level0(job).with_suffix(COSMIC)

    def masters(self, chip_id: int) -> Path:
        """A chip's master bias, dark and flat, FITS."""
        return self.of("masters", chip_id)

    def calibrated(self, obsid: str, chip_id: int) -> Path:
        """A calibrated frame (SCI, ERR, DQ), FITS."""
        return self.find("calibrated", obsid=obsid, chip=f"{chip_id:02d}")

    def measure(self, obsid: str, chip_id: int) -> Path:
        """The table of the sources measured on an imaging frame, parquet."""
        return self.find("measure", obsid=obsid, chip=f"{chip_id:02d}")

    def residual(self, obsid: str, chip_id: int) -> Path:
        """The image of an imaging frame without its sources, FITS, with measurement.joint."""
        return self.find("residual", obsid=obsid, chip=f"{chip_id:02d}")

    def spectra(self, obsid: str, chip_id: int) -> Path:
        """The table of extracted spectra of a slitless frame, parquet."""
        return self.find("spectra", obsid=obsid, chip=f"{chip_id:02d}")

    def lines(self, obsid: str, chip_id: int) -> Path:
        """The table of the emission lines in them, parquet."""
        return self.find("lines", obsid=obsid, chip=f"{chip_id:02d}")

    def validate(self, pix: int) -> Path:
        """A brick's validation, JSON; pix: NSIDE 256, nested."""
        return self.of("validate", pix)

    def look(self, obsid: str, chip_id: int) -> Path:
        """A picture of a Level-0 file, PNG."""
        return self.output / "look" / f"{obsid}_{chip_id:02d}.png"

    @property
    def report(self) -> Path:
        """The campaign's report, HTML."""
        return self.find("report")

    @property
    def variants_page(self) -> Path:
        """The comparison of a campaign's variants, HTML."""
        return self.find("variants_page")
