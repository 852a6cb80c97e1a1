"""Names of values that differ between any two runs, and of values that describe only how a product was made.

Everything else in a product is the same, bit by bit, in two runs of one campaign.
"""

import re

from csstsim.delivery.manifest import FILES
from csstsim.delivery.verify import WORKFLOW_FILES

# FITS keywords, all in HDU 0: a date, timings, and checksums of pixels that are compared themselves
KEYWORDS = re.compile(r"DATE|CHECKSUM|DATASUM|(CPU|WALL)_\w+")
COLUMNS = {"ms"}  # CPU milliseconds of an object
# Keys of records (JSON files, metadata of tables, META of frames, HDF5 attributes); hats_estsize is the size of files
KEYS = {"stages", "timing", "checksum", "hats_estsize"}
# ... and of RO-Crate metadata: dates, hashes of files with dates in them
KEYS |= {"datePublished", "startTime", "endTime", "sha256", "contentSize"}
# Files that are not products: those of the workflow, and hashes of files with dates in them
NOT_PRODUCTS = {*WORKFLOW_FILES, *FILES}
_PAGE = re.compile(  # sizes of files may differ by their timings
    r'(?s)<section id="(times|products)">.*?</section>|<a href="#times">[^<]*</a> ?|'
    r"<tr><th>(campaign file|report written|host)</th>.*?</tr>"
)

# How a product was made: versions, commits, digests, the layers' parameters
PROVENANCE_KEYWORDS = re.compile(r"FITSSWV|SIMVER|SIMGIT|(CAMP|CAM|LAY|EXP|TRUT|PSF)HASH|HISTORY")
PROVENANCE_KEYS = {
    "recipe", "recipes", "csstsim", "camera", "camera_digest", "universe", "digest", "truth_hash", "psf_hash",
    "version", "provenance", "hats_builder",
}  # fmt: skip
_PROVENANCE_SECTION = re.compile(r'(?s)<section id="provenance">.*?</section>')


def varies(name: str) -> bool:
    """Whether a FITS keyword, a column or a key of this name may differ between two runs of one campaign."""
    return name in COLUMNS or name in KEYS or bool(KEYWORDS.fullmatch(name))


def is_provenance(name: str) -> bool:
    """Whether a FITS keyword or a key of this name describes how a product was made, not its content."""
    return name in PROVENANCE_KEYS or bool(PROVENANCE_KEYWORDS.fullmatch(name))


def steady_page(text: str) -> tuple[str, str]:
    """Return (HTML of a report without run times, campaign folder and provenance; its section on provenance)."""
    text = _PAGE.sub("", text)
    provenance = _PROVENANCE_SECTION.search(text)
    return _PROVENANCE_SECTION.sub("", text), provenance[0] if provenance else ""
