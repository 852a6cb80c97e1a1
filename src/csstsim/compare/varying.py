"""What differs between two runs of one campaign and means nothing, and what only says how a product was made.

Varying: dates, timings, checksums over them, the folder. Provenance: versions, commits, digests of recipes, the layers'
parameters. All else of a product is the same, bit by bit, in two runs of one campaign.
"""

import re

# FITS keywords. HDU 0 has a date, timings and a checksum over both; DATASUM says nothing that the pixels do not.
KEYWORDS = re.compile(r"DATE|CHECKSUM|DATASUM|CPU_\w+|WALL_\w+")
MADE_BY = re.compile(r"FITSSWV|SIM(VER|GIT)|(CAMP?|LAY|EXP|TRUT|PSF)HASH|HISTORY")
COLUMNS = ("ms",)  # CPU milliseconds of an object
# Keys of the records in JSON files, tables, frames (META) and of HDF5 attributes
KEYS = ("stages", "timing", "checksum")
MADE_FROM = (
    "recipe", "recipes", "csstsim", "camera", "camera_digest", "universe", "digest", "truth_hash", "psf_hash",
    "version", "provenance", "hats_builder", "CAMHASH",
)  # fmt: skip
SIZES = ("hats_estsize",)  # kB on the disk
# What lies beside the products: of the workflow, and what has hashes of files with dates in them
FOLDERS = ("logs", "benchmarks", ".snakemake")
FILES = ("campaign.json", "MANIFEST.sha256", "MANIFEST.tsv")
_PAGE = re.compile(
    r'(?s)<section id="times">.*?</section>|<a href="#times">[^<]*</a> ?|<tr>(?=<t[hd]>campaign file<).*?</tr>'
)
_PROVENANCE = re.compile(r'(?s)<section id="provenance">.*?</section>')


def varies(name):
    """Whether a FITS keyword, a column or a record's key of this name may differ between two runs of one campaign."""
    return bool(KEYWORDS.fullmatch(name)) or name in COLUMNS or name in KEYS or name in SIZES


def is_provenance(name):
    """Whether a FITS keyword or a record's key says how a product was made, not what it is."""
    return bool(MADE_BY.fullmatch(name)) or name in MADE_FROM


def steady_page(text):
    """Return (a report's HTML without run times and the campaign's folder, its section on provenance; "" if none)."""
    text = _PAGE.sub("", text)
    made = _PROVENANCE.search(text)
    return _PROVENANCE.sub("", text), made[0] if made else ""
