"""The README of a pack, for readers who do not know csstsim."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING

from csstsim import __version__
from csstsim.studies.release.crate import licence_of
from csstsim.studies.release.score.quantities import ABOUT

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import Any

TEMPLATE = Path(__file__).with_name("templates") / "README.md"
PARAMS = (
    "NUMBER",
    "ALPHA_J2000",
    "DELTA_J2000",
    "MAG_AUTO",
    "MAGERR_AUTO",
    "FLUX_RADIUS",
    "A_WORLD",
    "B_WORLD",
    "THETA_J2000",
    "FLAGS",
)
FIT = (
    "With `MAG_PSF` among the columns and `-PSF_NAME {}` it also\nfits the PSF, which is right for points. "
    "Where the fit fails, as for most of the faintest sources, `MAG_PSF` is 99.\n"
)
TRUTH = """# The truth of $name

Keep this folder apart from the other one: it has what those who make catalogues must not see.

| file | what |
|---|---|
| `objects.parquet` | the true objects on the images, each once |
| `frames.json` | the frames and their corners |
| `frames/*.parquet` | the truth of each frame, and of the orders of spectra; `workflow/tables.json` has the columns |
| `workflow/` | the campaign with its seed, the workflow, digests of the recipes |

A catalogue is scored by

    $score

Columns of `objects.parquet` (B: a band):

| column | what |
|---|---|
$columns
"""


def readme(name: str, frames: Sequence[Mapping[str, Any]], licence: str) -> str:
    """Return the text of the public README. frames: the rows of frames.csv."""
    images = [row for row in frames if row["kind"] == "imaging"]
    example = next((row for row in images if row["filter"] == "r"), images[0])
    numbers = Counter((row["kind"], row["filter"]) for row in frames)
    words = {"imaging": "images", "slitless": "spectroscopic frames"}
    frame_counts = "; ".join(
        f"{words[kind]} in " + ", ".join(f"{band} ({n})" for (k, band), n in numbers.items() if k == kind)
        for kind in words
        if any(k == kind for k, _ in numbers)
    )
    bands = [band.lower() for kind, band in numbers if kind == "imaging"]
    width = f" -SEEING_FWHM {example['psf_fwhm_px'] * 0.074:.2f}" if example["psf_fwhm_px"] else ""
    command = (
        f"source-extractor 'calibrated/{example['name']}.fits[1]' -CATALOG_NAME first.cat -CATALOG_TYPE ASCII_HEAD \\\n"
        f"        -PARAMETERS_NAME first.param -FILTER N -DETECT_MINAREA 4 -DETECT_THRESH 2 \\\n"
        f"        -WEIGHT_TYPE MAP_RMS -WEIGHT_IMAGE 'calibrated/{example['name']}.fits[2]' \\\n"
        f"        -MAG_ZEROPOINT {example['zero_point_mag']} -PIXEL_SCALE 0.074{width}"
    )
    address, title = licence_of(licence)
    text = Template(TEMPLATE.read_text(encoding="utf-8")).substitute(
        name=name,
        frames=frame_counts,
        columns="\n".join(f"    {name}" for name in PARAMS),
        command=command,
        quantities="\n".join(f"| {key} | {text} |" for key, text in ABOUT.items()),
        licence=f"{title} ({address})",
        version=__version__,
        score=score_command(example["filter"].lower()),
        bands=" or ".join(filter(None, (", ".join(bands[:-1]), bands[-1]))),
        one=example["filter"].lower(),
        fit=FIT.format(example["psf"]) if example["psf"] else "",
        width=" and the width of the PSF are those" if example["psf"] else " is that",
    )
    missing: tuple[str, ...] = ("| `psf/", "**PSF**") if not any(row["psf"] for row in images) else ()
    missing += ("| `gratings/", "**Spectroscopic frames**") if len(images) == len(frames) else ()
    return _without(text, missing)


def _without(text: str, starts: Sequence[str]) -> str:
    """Return the text without the lines, and for a start with `*` the paragraphs, that begin as one of `starts`."""
    of_paragraphs = tuple(start for start in starts if start.startswith("*"))
    paragraphs = [paragraph for paragraph in text.split("\n\n") if not paragraph.startswith(of_paragraphs)]
    lines = "\n\n".join(paragraphs).split("\n")
    return "\n".join(line for line in lines if not line.startswith(tuple(starts)))


def truth_readme(name: str, columns: Mapping[str, str], band: str) -> str:
    """Return the text of the README of the truth. columns: {column: meaning}."""
    listed = "\n".join(f"| `{column}` | {text} |" for column, text in columns.items())
    return Template(TRUTH).substitute(name=name, score=score_command(band), columns=listed)


def score_command(band: str) -> str:
    """Return the command that scores source-extractor's catalogue of the README."""
    return (
        "csstsim release score first.cat --truth truth --output score --map ra=ALPHA_J2000 --map dec=DELTA_J2000 \\\n"
        f"        --map mag_{band}=MAG_AUTO --map a=A_WORLD --map b=B_WORLD --map pa=THETA_J2000"
    )
