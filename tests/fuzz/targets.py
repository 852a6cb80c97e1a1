"""The readers under test: which file each is given, and how that file is damaged."""

from collections.abc import Callable
from dataclasses import dataclass

from fuzz import seeds
from fuzz.spoil import spoiled_bytes, spoiled_fits, spoiled_text


@dataclass(frozen=True)
class Target:
    """One reader and a file it reads: `make(folder)` writes sound ones and returns the file to spoil.

    `spoil` makes the strategy of hostile bytes of the sound bytes; `weight` is its share of the examples.
    """

    make: Callable
    spoil: Callable
    function: str
    weight: float = 1.0


def _read(name):
    return f"fuzz.readers:{name}"


def _instrument(*names):
    return {
        f"instrument {name}.yaml": Target(seeds.in_instrument(f"{name}.yaml"), spoiled_text, _read("instrument"), 0.4)
        for name in names
    }


TARGETS = {
    "campaign YAML": Target(seeds.shipped("campaign.yaml"), spoiled_text, _read("campaign"), 2),
    "observation YAML": Target(seeds.shipped("observations", "science.yaml"), spoiled_text, _read("observation"), 2),
    "survey table CSV": Target(seeds.survey_table, spoiled_text, _read("survey_table"), 2),
    **_instrument(
        "detector",
        "chips",
        "filters",
        "telescope",
        "cosmic_rays",
        "defects",
        "cti",
        "gratings",
        "brighter_fatter",
        "psf",
        "scatter",
        "ghosts",
        "sky",
        "leds",
        "distortion",
        "level0_keywords",
    ),
    "instrument aXe .conf": Target(
        seeds.in_instrument("gratings", "GI1.conf"), spoiled_bytes, _read("instrument"), 0.5
    ),
    "instrument sensitivity FITS": Target(
        seeds.in_instrument("gratings", "GI_p1.fits"), spoiled_fits, _read("instrument"), 0.5
    ),
    "instrument distortion FITS": Target(
        seeds.in_instrument("distortion.fits"), spoiled_fits, _read("instrument"), 0.5
    ),
    **{
        f"universe {name}": Target(seeds.in_universe(name), spoiled_text, _read("universe"), 0.05)
        for name in ("cosmology.yaml", "dust.yaml", "galaxies.yaml", "lensing.yaml", "quasars.yaml", "stars.yaml")
    },
    "universe star spectra FITS": Target(
        seeds.in_universe("star_spectra.fits"), spoiled_fits, _read("star_spectra"), 0.3
    ),
    "universe galaxy spectra FITS": Target(
        seeds.in_universe("galaxy_spectra.fits"), spoiled_fits, _read("galaxy_spectra"), 0.3
    ),
    "dust map FITS": Target(seeds.dust, spoiled_fits, _read("dust_map")),
    "Cycle-9 stars HDF5": Target(seeds.c9_stars, spoiled_bytes, _read("c9_stars")),
    "Cycle-9 galaxies HDF5": Target(seeds.c9_galaxies, spoiled_bytes, _read("c9_galaxies")),
    "Cycle-9 spectra HDF5": Target(seeds.c9_spectra, spoiled_bytes, _read("c9_spectra")),
    "scene parquet": Target(seeds.objects, spoiled_bytes, _read("scene")),
    "table of objects CSV": Target(seeds.own_table(".csv"), spoiled_text, _read("own_table")),
    "table of objects ECSV": Target(seeds.own_table(".ecsv"), spoiled_bytes, _read("own_table")),
    "table of objects FITS": Target(seeds.own_table(".fits"), spoiled_fits, _read("own_table")),
    "PSF set HDF5": Target(seeds.psf, spoiled_bytes, _read("psf")),
    "PSF tables HDF5": Target(seeds.psf_tables, spoiled_bytes, _read("psf_tables")),
    "PSF library HDF5": Target(seeds.psf_library, spoiled_bytes, _read("psf_library"), 0.5),
    "Level-0 FITS": Target(seeds.level0(), spoiled_fits, _read("level0"), 2),
    "Level-0 FITS, compressed": Target(seeds.level0(compress=True), spoiled_fits, _read("level0"), 2),
    "frame FITS": Target(seeds.frame, spoiled_fits, _read("frame"), 2),
    "picture of a frame": Target(seeds.frame, spoiled_fits, _read("picture"), 0.3),
    "picture of Level-0": Target(seeds.level0(), spoiled_fits, _read("picture"), 0.3),
    "picture of an image": Target(seeds.image, spoiled_fits, _read("picture"), 0.3),
    "table parquet": Target(seeds.objects, spoiled_bytes, _read("table")),
    "truth parquet": Target(seeds.truth, spoiled_bytes, _read("truth")),
    "frame to recreate": Target(seeds.level0(), spoiled_fits, _read("recreated"), 0.3),
    "truth as text": Target(seeds.cat, spoiled_text, _read("cat")),
    "orders parquet": Target(seeds.orders, spoiled_bytes, _read("orders")),
    "brick parquet": Target(seeds.objects, spoiled_bytes, _read("brick")),
    **{
        f"compared {name}": Target(seeds.beside_a_sound_one(make), spoil, _read("compared"), 0.5)
        for name, make, spoil in (
            ("Level-0 FITS", seeds.level0(), spoiled_fits),
            ("frame FITS", seeds.frame, spoiled_fits),
            ("PSF set HDF5", seeds.psf, spoiled_bytes),
            ("truth parquet", seeds.truth, spoiled_bytes),
            ("validation JSON", seeds.validation, spoiled_text),
        )
    },
    "validation JSON": Target(seeds.validation, spoiled_text, _read("validation")),
    "log of a job": Target(seeds.job_log, spoiled_bytes, _read("job_log"), 0.5),
}
