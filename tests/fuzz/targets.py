"""The readers under test: which file each is given, and how that file is damaged."""

from collections.abc import Callable
from typing import NamedTuple

from fuzz import seeds
from fuzz.spoil import spoiled_bytes, spoiled_fits, spoiled_text


class Target(NamedTuple):
    """A file and its reader: `make(folder)` writes sound files and returns the one to spoil.

    `spoil` makes the strategy of hostile bytes of the sound bytes; `reader`: of fuzz.readers; `weight`: share of the
    examples.
    """

    make: Callable
    spoil: Callable
    reader: str
    weight: float = 1.0


INSTRUMENT = (
    "detector", "chips", "filters", "telescope", "cosmic_rays", "defects", "cti", "gratings", "brighter_fatter", "psf",
    "scatter", "ghosts", "sky", "leds", "distortion", "level0_keywords",
)  # fmt: skip
UNIVERSE = "cosmology", "dust", "galaxies", "lensing", "occupation", "quasars", "stars", "structure"
COMPARED = {
    "Level-0 FITS": (seeds.level0(), spoiled_fits),
    "frame FITS": (seeds.frame, spoiled_fits),
    "PSF set HDF5": (seeds.psf, spoiled_bytes),
    "truth parquet": (seeds.truth, spoiled_bytes),
    "validation JSON": (seeds.validation, spoiled_text),
}
TARGETS = {
    "campaign YAML": Target(seeds.shipped("campaign.yaml"), spoiled_text, "campaign", 2),
    "observation YAML": Target(seeds.shipped("observations", "science.yaml"), spoiled_text, "observation", 2),
    "survey table CSV": Target(seeds.survey_table, spoiled_text, "survey_table", 2),
    "scored CSV": Target(seeds.scored("found.csv"), spoiled_text, "scored_catalogue"),
    "scored .cat": Target(seeds.scored_text, spoiled_text, "scored_catalogue"),
    "scored FITS": Target(seeds.scored("found.fits"), spoiled_fits, "scored_catalogue", 0.5),
    "scored parquet": Target(seeds.scored("found.parquet"), spoiled_bytes, "scored_catalogue", 0.5),
    "frames of a pack": Target(seeds.frames_of_a_pack, spoiled_text, "truth_of_a_pack"),
    "pointing list ECSV": Target(seeds.pointing_list("list.ecsv"), spoiled_text, "pointing_list", 2),
    "pointing list FITS": Target(seeds.pointing_list("list.fits"), spoiled_fits, "pointing_list", 0.5),
    "pointing list mapping": Target(seeds.pointing_mapping, spoiled_text, "pointing_mapping", 0.5),
    "instrument aXe .conf": Target(seeds.in_instrument("gratings", "GI1.conf"), spoiled_bytes, "instrument", 0.5),
    "instrument sensitivity": Target(seeds.in_instrument("gratings", "GI_p1.fits"), spoiled_fits, "instrument", 0.5),
    "instrument distortion FITS": Target(seeds.in_instrument("distortion.fits"), spoiled_fits, "instrument", 0.5),
    "instrument maps.yaml": Target(seeds.lab_maps("prnu", "bad_pixels"), spoiled_text, "instrument", 0.4),
    "instrument laboratory map FITS": Target(seeds.lab_maps("prnu"), spoiled_fits, "instrument", 0.4),
    "universe star spectra": Target(seeds.in_universe("star_spectra.fits"), spoiled_fits, "star_spectra", 0.3),
    "universe galaxy spectra": Target(seeds.in_universe("galaxy_spectra.fits"), spoiled_fits, "galaxy_spectra", 0.3),
    "dust map FITS": Target(seeds.dust, spoiled_fits, "dust_map"),
    "Cycle-9 stars HDF5": Target(seeds.c9_stars, spoiled_bytes, "c9_stars"),
    "Cycle-9 galaxies HDF5": Target(seeds.c9_galaxies, spoiled_bytes, "c9_galaxies"),
    "Cycle-9 spectra HDF5": Target(seeds.c9_spectra, spoiled_bytes, "c9_spectra"),
    "scene parquet": Target(seeds.objects, spoiled_bytes, "scene"),
    "table of objects CSV": Target(seeds.own_table(".csv"), spoiled_text, "own_table"),
    "light curves CSV": Target(seeds.light_curves, spoiled_text, "light_curves"),
    "table of objects ECSV": Target(seeds.own_table(".ecsv"), spoiled_bytes, "own_table"),
    "table of objects FITS": Target(seeds.own_table(".fits"), spoiled_fits, "own_table"),
    "image of a galaxy FITS": Target(seeds.picture_fits, spoiled_fits, "galaxy_image"),
    "image of a galaxy HDF5": Target(seeds.picture_hdf5, spoiled_bytes, "galaxy_image"),
    "spectrum of an object CSV": Target(seeds.spectrum, spoiled_text, "spectrum"),
    "PSF set HDF5": Target(seeds.psf, spoiled_bytes, "psf"),
    "PSF tables HDF5": Target(seeds.psf_tables, spoiled_bytes, "psf_tables"),
    "PSF library HDF5": Target(seeds.psf_library, spoiled_bytes, "psf_library", 0.5),
    "Level-0 FITS": Target(seeds.level0(), spoiled_fits, "level0", 2),
    "Level-0 FITS, compressed": Target(seeds.level0(compress=True), spoiled_fits, "level0", 2),
    "frame FITS": Target(seeds.frame, spoiled_fits, "frame", 2),
    "picture of a frame": Target(seeds.frame, spoiled_fits, "picture", 0.3),
    "picture of Level-0": Target(seeds.level0(), spoiled_fits, "picture", 0.3),
    "picture of an image": Target(seeds.image, spoiled_fits, "picture", 0.3),
    "table parquet": Target(seeds.objects, spoiled_bytes, "table"),
    "truth parquet": Target(seeds.truth, spoiled_bytes, "truth"),
    "frame to recreate": Target(seeds.level0(), spoiled_fits, "recreated", 0.3),
    "image to inject into": Target(seeds.foreign, spoiled_fits, "foreign", 0.3),
    "stamps of a PSF": Target(seeds.stamps, spoiled_fits, "stamps", 0.3),
    "truth as text": Target(seeds.cat, spoiled_text, "cat"),
    "orders parquet": Target(seeds.orders, spoiled_bytes, "orders"),
    "brick parquet": Target(seeds.objects, spoiled_bytes, "brick"),
    "validation JSON": Target(seeds.validation, spoiled_text, "validation"),
    "log of a job": Target(seeds.job_log, spoiled_bytes, "job_log", 0.5),
}
for name in INSTRUMENT:
    made = seeds.in_instrument(f"{name}.yaml")
    TARGETS[f"instrument {name}.yaml"] = Target(made, spoiled_text, "instrument", 0.4)
for name in UNIVERSE:
    TARGETS[f"universe {name}.yaml"] = Target(seeds.in_universe(f"{name}.yaml"), spoiled_text, "universe", 0.05)
for name, (make, spoil) in COMPARED.items():
    TARGETS[f"compared {name}"] = Target(seeds.beside_a_sound_one(make), spoil, "compared", 0.5)
