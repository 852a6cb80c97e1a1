"""Makers of small sound files: each writes a file, with the others it needs, into a folder and returns its path."""

import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import h5py
import healpy
import numpy as np
from astropy.io import fits
from astropy.table import Table
from catalog.test_c9 import write_basis, write_galaxies, write_stars
from fuzz import readers
from support.csst import BANDS
from support.lab_maps import map_path, name_maps, response, write_map
from support.mini import mini_camera
from support.readout_state import flat_state, plain_layers, run

from csstsim.base.shipped import SHIPPED

EXPOSURE = {
    "OBSID": "10100000001", "DETECTOR": "09", "EXPTIME": 150.0, "READX0": 1, "READX1": 20, "READY0": 1, "READY1": 10,
    "CTYPE1": "RA---TAN", "CTYPE2": "DEC--TAN", "CRPIX1": 1.0, "CRPIX2": 1.0, "CRVAL1": 60.0, "CRVAL2": -40.0,
    "CD1_1": 1e-5, "CD1_2": 0.0, "CD2_1": 0.0, "CD2_2": 1e-5, "POSKIND": "APPARENT",
}  # fmt: skip
META = {
    "recipe": {"camera": "c", "exposure": "e"}, "stage": "render", "unit": "electron",
    "header": {"stages": [["render", 1, 2]]}, "exposure": EXPOSURE,
}  # fmt: skip
PLACES = np.array([60.0, 60.02, 60.01]), np.array([-40.0, -40.01, -39.99])  # ra, dec


def shipped(*parts):
    """Return a maker that copies one shipped file."""
    return lambda folder: shutil.copy(SHIPPED.joinpath(*parts), folder)


def in_instrument(*parts):
    """Return a maker of a small camera's folder that names one of its files."""
    return lambda folder: mini_camera(folder).joinpath(*parts)


def lab_maps(*kinds):
    """Return a maker of a small camera whose chip 9 has maps; of maps.yaml, or of the map if there is but one kind."""

    def make(folder):
        instrument, values = mini_camera(folder), {"prnu": response((64, 256)), "bad_pixels": np.zeros((64, 256), "u1")}
        name_maps(instrument, *kinds, **{kind: {"chips": [9]} for kind in kinds})
        for kind in kinds:
            write_map(map_path(instrument, kind, 9), values[kind])
        return instrument / "maps.yaml" if len(kinds) > 1 else map_path(instrument, kinds[0], 9)

    return make


def in_universe(name):
    return lambda folder: shutil.copytree(SHIPPED / "universe", folder / "universe") / name


def survey_table(folder):
    rows = (SHIPPED.parent / "survey_tables" / "demo.csv").read_text().splitlines()
    path = folder / "table.csv"
    path.write_text("\n".join(rows[:12]) + "\n")
    return path


def scored(name):
    """Return a maker of a catalogue as `csstsim release score` takes it."""

    def make(folder):
        columns = {"ra": PLACES[0], "dec": PLACES[1], "mag_r": [20.0, 21.0, 99.0], "e1": [0.1, 0.0, -0.2]}
        Table(columns | {"e2": np.zeros(3), "z": [0.5, 1.0, 2.0]}).write(folder / name)
        return folder / name

    return make


def scored_text(folder):
    """A catalogue as source-extractor writes it."""
    heads = ("ra", "dec", "mag_r")
    lines = [f"# {k:3d} {name}  something [deg]" for k, name in enumerate(heads, start=1)]
    path = folder / "found.cat"
    path.write_text("\n".join([*lines, " 60.0 -40.0 20.5", " 60.01 -40.0 21.5"]) + "\n")
    return path


def frames_of_a_pack(folder):
    frame = {"file": "a.fits", "filter": "r", "kind": "imaging", "corners": [[0, 0], [1, 0], [1, 1], [0, 1]]}
    path = folder / "frames.json"
    path.write_text(json.dumps({"name": "pack", "frames": [frame]}))
    return path


def pointing_list(name):
    """Return a maker of a list of pointings, ECSV or FITS by its suffix, with units and a state."""

    def make(folder):
        """Write the list into the folder; return its file."""
        table = Table.read(survey_table(folder), format="ascii.csv", comment="#", converters={"obsid": str})
        for column, value, unit in (("ra", 60.0, "deg"), ("sat_x", 2596.6, "km"), ("sat_y", 4497.4, "km"),
                                    ("sat_z", -4357.5, "km"), ("sat_vx", -6.6, "km/s"), ("sat_vy", 3.8, "km/s"),
                                    ("sat_vz", 0.0, "km/s")):  # fmt: skip
            table[column] = np.full(len(table), value)
            table[column].unit = unit
        table.write(folder / name)
        return folder / name

    return make


def pointing_mapping(folder):
    return shutil.copy(SHIPPED.parent / "survey_tables" / "lists" / "csst.yaml", folder)


def dust(folder):
    path, ebv = folder / "dust.fits", np.linspace(0.01, 1, healpy.nside2npix(4)).astype("f4")
    healpy.write_map(path, ebv, coord="G", column_names=["EBV"], dtype="f4")
    return path


def psf(folder):
    from csstsim.optics.psf.psf_set import PsfSampling, make_psf
    from csstsim.optics.scatter.scattered_light import scattered_light

    camera, path = readers.camera(), folder / "psf.h5"
    chip = camera.chips[readers.PSF_CHIP]
    filter_ = camera.filters[chip.filter]
    make_psf(
        path, chip, filter_, camera.psf, PsfSampling(2, cells=32), camera_digest=camera.digest,
        provenance={"seed": 1}, scattered=scattered_light(camera, filter_),
    )  # fmt: skip
    return path


def psf_tables(folder):
    from csstsim.optics.psf.psf_file import PsfSet
    from csstsim.render.psf_table import write_tables

    write_tables(folder / "psf_tables.h5", PsfSet(psf(folder)))
    return folder / "psf_tables.h5"


def psf_library(folder):
    chip = readers.camera().chips[readers.LIBRARY_CHIP]
    y, x = np.mgrid[:256, :256] - 127.5
    image = np.exp(-(x**2 + y**2) / 50).astype("f4")
    path = folder / f"psfCube_{chip.id}.h5"
    with h5py.File(path, "w") as file:
        for i in range(4):
            for j in range(4):
                group = file.create_group(f"w_{i}/psf_{j}")
                group.create_dataset("psfMat", data=image, compression="gzip")
                group["x"], group["y"] = 9000.0 * (j % 2), 9000.0 * (j // 2)
    return path


def level0(compress=False):
    def make(folder):
        from csstsim.instrument.camera import load_camera
        from csstsim.io.level0_writing import write_level0

        camera = load_camera(mini_camera(folder))
        state = flat_state(camera, 300.0, window=(0, 256, 0, 64))
        state.mask = np.zeros(state.image.shape, np.uint8)
        state = run(state, plain_layers())
        state.header["compress"] = compress
        provenance = {
            "recipe": {}, "seed": 1, "campaign_name": "x", "layers": [], "stages": [], "ephemeris": "builtin",
            "planets": False,
        }  # fmt: skip
        write_level0(folder / "level0.fits", state, camera.keywords, provenance, "channels")
        return folder / "level0.fits"

    return make


def frame(folder, meta=META):
    from csstsim.io.frames import save_frame

    planes = {"image": np.arange(200, dtype="f4").reshape(10, 20), "counted": np.ones((10, 20), "i4")}
    save_frame(folder / "frame.fits", planes, meta)
    return folder / "frame.fits"


def image(folder):
    header = fits.Header(
        {"CTYPE1": "RA---TAN", "CTYPE2": "DEC--TAN", "CRVAL1": 60.0, "CRVAL2": -40.0, "CD1_1": 1e-5, "CD2_2": 1e-5}
    )
    fits.PrimaryHDU(np.arange(600.0, dtype="f4").reshape(20, 30), header).writeto(folder / "image.fits")
    return folder / "image.fits"


def foreign(folder):
    """An image of another telescope, for `csstsim inject`."""
    from inject.others.test_foreign import write_image

    return write_image(folder)


def stamps(folder):
    """A cube of PSF stamps with their places."""
    cube = np.ones((2, 5, 5), np.float32)
    places = fits.BinTableHDU.from_columns([fits.Column(n, "E", array=[1.0, 9.0]) for n in ("X", "Y")])
    path = folder / "stamps.fits"
    fits.HDUList([fits.PrimaryHDU(cube, fits.Header({"PSFSAMP": 1.0})), places]).writeto(path)
    return path


def objects(folder):
    from csstsim.catalog.table import ObjectTable
    from csstsim.catalog.truth_bricks import SED_COLUMNS

    columns = {"id": np.arange(5), "ra": np.full(5, 60.0), "dec": np.full(5, -40.0), "name": np.array([*"abcde"])}
    table = ObjectTable.complete(
        columns | {name: np.ones(5, "f4") for name in SED_COLUMNS}, BANDS, {"product": "truth brick", "seed": 3}
    )
    table.write(folder / "objects.parquet")
    return folder / "objects.parquet"


def truth(folder):
    from csstsim.catalog.table import ObjectTable
    from csstsim.io.truth import truth_table

    drawn = ObjectTable.complete({"id": [1, 2], "ra": [10.0, 11.0], "dec": [1.0, 2.0]}, BANDS)
    drawn = drawn.with_columns(x=np.array([3.0, 4.0]), y=np.array([5.0, 6.0]), mag=np.array([20.0, 21.0]))
    chip = SimpleNamespace(id=9, filter="r")
    truth_table(drawn, chip).write(folder / "truth.parquet", {"recipe": {"camera": "c"}})
    return folder / "truth.parquet"


def cat(folder):
    from csstsim.io.cat import write_cat
    from csstsim.io.truth import CAT_COLUMNS, read_truth

    table = read_truth(truth(folder))
    write_cat(folder / "truth.cat", type(table)({name: table[ours] for name, ours in CAT_COLUMNS.items()}))
    return folder / "truth.cat"


def orders(folder):
    from csstsim.catalog.table import ObjectTable
    from csstsim.io.orders import write_orders

    gratings = readers.camera().gratings[1]
    columns = {name: np.ones(3) for name in ("x", "y", "p", "q", "r", "s", "electrons", "drawn")} | {
        "id": np.arange(3), "row": np.arange(3), "order": np.ones(3, "i1"), "cut": np.zeros(3, bool),
        "grating": np.full(3, gratings.pieces[0][0].name),
    }  # fmt: skip
    write_orders(folder / "orders.parquet", ObjectTable(columns), {"recipe": {"camera": "c"}})
    return folder / "orders.parquet"


def beside_a_sound_one(make):
    """Return a maker of what `make` writes, and of a sound file beside it that differs in nothing."""

    def both(folder):
        path = Path(make(folder))
        shutil.copy(path, path.with_name(f"sound{path.suffix}"))
        return path

    return both


def validation(folder):
    from csstsim.measure.bricks.validation.result_file import write_result

    gates = [{"name": "x", "passed": True, "n": 3}]
    write_result(folder / "7.json", {"brick": 7, "recipe": "r", "limits": {}, "gates": gates})
    return folder / "7.json"


def job_log(folder):
    path = folder / "logs" / "render" / "1.log"
    path.parent.mkdir(parents=True)
    path.write_text("csstsim 0.1.0 render: campaign mini\nrender done: 12.5 s, CPU 11.0 s, memory 300 MB\n")
    return path


def light_curves(folder):
    table = Table({"curve": ["nova", "nova", "flat"], "mjd": [60999.0, 61001.0, 61000.0], "dmag": [0.0, 2.0, 1.0]})
    table.write(folder / "curves.csv")
    return folder / "curves.csv"


def own_table(suffix):
    def make(folder):
        columns = {"ra": [60.0, 60.01], "dec": [-40.0, -40.01], "mag_r": [20.0, 21.0], "mag_g": [20.5, np.nan]}
        table = Table(columns | {"type": ["star", "galaxy"], "size": [0.0, 0.5]})
        table.write(folder / f"objects{suffix}")
        return folder / f"objects{suffix}"

    return make


def picture_fits(folder):
    fits.writeto(folder / "galaxy.fits", np.add.outer(np.arange(7.0), np.arange(9.0)))
    return folder / "galaxy.fits"


def picture_hdf5(folder):
    with h5py.File(folder / "galaxy.h5", "w") as file:
        file["light"] = np.add.outer(np.arange(7.0), np.arange(9.0))
    return folder / "galaxy.h5"


def spectrum(folder):
    Table({"WAVELENGTH": [3000.0, 5000.0, 9000.0], "FLUX": [1.0, 2.0, 1.5]}).write(folder / "spectrum.csv")
    return folder / "spectrum.csv"


def c9_stars(folder):
    return Path(write_stars(folder / "stars.h5", *PLACES))


def c9_galaxies(folder):
    return next(Path(write_galaxies(folder / "galaxies", *PLACES)).glob("*.h5"))


def c9_spectra(folder):
    return Path(write_basis(folder / "basis.h5"))
