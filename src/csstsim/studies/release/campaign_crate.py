"""`csstsim release crate`: the RO-Crate metadata of a campaign's output folder, from its manifest, recipes and logs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from csstsim.base.errors import InputError
from csstsim.base.plural import number_of
from csstsim.delivery.manifest import CRATE_FOLDER, HASHES, SIZES, file_hash, read_manifest
from csstsim.studies.release.crate import Crate, CrateFile, licence_of, write_crate
from csstsim.studies.release.made_with import inputs, tables_version, write_made_with
from csstsim.studies.release.run_record import run_record

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from csstsim.campaign.opened import OpenCampaign

FOLDERS = {
    "level0": "Level-0 images and spectroscopic frames, with the truth of each",
    "truth": "the true sky, by bricks",
    "psf": "PSF sets, a file for each chip",
    "measure": "detections of each image",
    "spectra": "extracted spectra",
    "merge": "the merged catalogue, by bricks",
    "validate": "the validation of each brick",
    "report": "the report",
    "calibrated": "calibrated images",
    "masters": "master calibration frames",
    "look": "pictures",
    "chips": "light of chips",
    CRATE_FOLDER: "what the products were made with",
}


def campaign_crate(
    run: OpenCampaign, log: Callable[[str], object], authors: Iterable[str] = (), licence: str = "CC-BY-4.0"
) -> None:
    """Write ro-crate-metadata.json, and the files in workflow/ that it describes, into a campaign's output folder.

    run: campaign.opened.OpenCampaign; authors: names; licence: SPDX name or address. Raises InputError without a
    manifest, or if its sizes are not those of the files.
    """
    licence_of(licence)
    root = run.paths.output
    if not (root / HASHES).is_file():
        raise InputError(f"no manifest yet: `csstsim verify {run.file} --manifest` writes it", file=root / HASHES)
    hashes = read_manifest(root / HASHES)
    files: dict[str, CrateFile] = {}
    for line in (root / SIZES).read_text(encoding="ascii").splitlines()[1:]:
        name, size, kind = (*line.split("\t"), "", "")[:3]  # also of a damaged line
        if name not in hashes or not (root / name).is_file() or str((root / name).stat().st_size) != size:
            raise InputError(f"not as listed in {SIZES}; `csstsim verify` reports the differences", file=root / name)
        files[name] = CrateFile(kind, int(size), hashes[name])
    for name, kind in (*write_made_with(run, root).items(), (HASHES, "hashes"), (SIZES, "sizes and kinds")):
        files[name] = CrateFile(kind, (root / name).stat().st_size, file_hash(root / name))
    crate = Crate(
        name=run.config.name,
        files=files,
        folders=FOLDERS,
        run=run_record(root),
        inputs=tuple(inputs(run)),
        description=f"{number_of(len(run.jobs), 'Level-0 file')} of a simulation of the CSST Survey Camera by csstsim, "
        "with their truth and what was measured on them",
        version=tables_version(),
        authors=tuple(authors),
        licence=licence,
    )
    log(f"{write_crate(root, crate)}: {number_of(len(files), 'file')}")
