"""The readers to which hostile files are given, called as a campaign's commands do; each takes a path."""

from functools import cache
from pathlib import Path
from types import SimpleNamespace

from csstsim.base.shipped import SHIPPED

PSF_CHIP = 9  # r
LIBRARY_CHIP = 10  # of the external PSF library


@cache
def camera():
    from csstsim.instrument.camera import load_camera

    return load_camera(SHIPPED / "instrument")


def campaign(path):
    """A campaign file, and its digest, which walks through all of it."""
    from csstsim.campaign.config import load_campaign

    load_campaign(path).digest()


def observation(path):
    """A layer list: its layers, the options they check against camera and exposure."""
    from support.readout_state import POINTING

    from csstsim.instrument.pointing import Pointing
    from csstsim.simulation.sim_steps import SimSteps

    SimSteps(path, "SCIE").check(camera(), Pointing(**POINTING))


def survey_table(path):
    from csstsim.campaign.survey_table import load_survey_table

    load_survey_table(path)


def pointing_list(path):
    """Another's list of pointings whose columns are called as a survey table's: each row converted or refused."""
    from csstsim.campaign.pointing_lists.convert import convert
    from csstsim.campaign.pointing_lists.mapping import Mapping
    from csstsim.campaign.pointing_lists.read_list import read_list

    table = read_list(path)
    mapping = Mapping().completed(table.names)
    mapping.check(table)
    convert(table, mapping, camera().orbit)


def scored_catalogue(path):
    """A catalogue that is scored, whose columns are called as quantities."""
    from csstsim.studies.release.score.catalogue import read_catalogue

    read_catalogue(path, {}, ("r",))


def truth_of_a_pack(path):
    """The list of a pack's frames."""
    from csstsim.studies.release.score.field import read_frames

    read_frames(path)


def pointing_mapping(path):
    """The mapping of a list's columns, as --mapping takes it."""
    from csstsim.campaign.pointing_lists.mapping import load_mapping
    from csstsim.campaign.pointing_lists.read_list import PointingList

    mapping = load_mapping(path)
    mapping.check(PointingList(path, list(dict.fromkeys(mapping.columns.values())), []))


def instrument(path):
    """An instrument folder, given by any file in it: what commands make of its files before and in their work."""
    from csstsim.campaign.checks import check_maps
    from csstsim.instrument.camera import load_camera
    from csstsim.layers import brighter_fatter
    from csstsim.optics.geometry.distortion import load_distortion
    from csstsim.optics.geometry.focal_plane import load_focal_plane
    from csstsim.optics.psf.wavefront import load_wavefront
    from csstsim.optics.scatter.scattered_light import scattered_light
    from csstsim.optics.sky.parameters import sky_numbers
    from csstsim.optics.throughput.flat import check_flat

    folder = Path(path).parent
    if folder.name in ("gratings", "maps"):
        folder = folder.parent
    made = load_camera(folder)
    check_maps(made.chips.values(), read=True)
    _ = made.gratings
    filter_ = next(iter(made.filters.values()))
    load_distortion(folder / "distortion.fits"), load_focal_plane(folder / "distortion.yaml")
    scattered_light(made, filter_), sky_numbers(made.sky), check_flat(made.leds), load_wavefront(made.psf)
    brighter_fatter.check(None, made, None)
    _header(made)


def _header(made):
    """The Level-0 header of the camera's table of keywords."""
    from support.readout_state import POINTING

    from csstsim.instrument.pointing import Pointing
    from csstsim.io.keywords import header_cards, header_values
    from csstsim.optics.geometry.wcs import ChipWCS

    chip, pointing = next(iter(made.chips.values())), Pointing(**POINTING)
    state = SimpleNamespace(
        chip=chip, telescope=made.telescope, pointing=pointing, window=chip.full_window, header={}, mask=None,
        wcs=ChipWCS(chip, pointing),
    )  # fmt: skip
    for hdu in (0, 1):
        header_cards(made.keywords, header_values(state, {}, "channels"), hdu)


def universe(path):
    from csstsim.universe.parameters import load_universe

    load_universe(Path(path).parent).check()


def star_spectra(path):
    from csstsim.universe.stars.star_sed import StarSeds

    StarSeds(path, camera().filters["r"].throughput)


def galaxy_spectra(path):
    from csstsim.instrument.load import read_data
    from csstsim.universe.galaxies.galaxy_sed import GalaxySeds

    igm = read_data(SHIPPED / "universe" / "galaxies.yaml")["igm"]
    GalaxySeds(path, igm, camera().filters["r"].throughput)


def dust_map(path):
    from csstsim.universe.dust.dust_map import DustMap

    found = DustMap({"map": str(path), "columns": ["EBV"], "coordsys": "galactic"})
    _ = found.nside, found.digest, found.ebv(10.0, 20.0)


def c9_stars(path):
    from csstsim.catalog.c9_files import read_stars

    list(read_stars([path], _bricks()))


def c9_galaxies(path):
    from csstsim.catalog.c9_files import read_galaxies

    list(read_galaxies(Path(path).parent, _bricks(), partial=True))


@cache
def _bricks():
    from csstsim.catalog.contract import sky_region

    return sky_region(60.0, -40.0, 0.05).bricks


def c9_spectra(path):
    from csstsim.catalog.c9_files import read_array

    read_array(path, "wavelength", 1), read_array(path, "components", 2)


def scene(path):
    """A table of objects of the embedded universe as a catalogue of the user's."""
    from csstsim.catalog.embedded import SceneCatalog
    from csstsim.catalog.open import make_catalog

    make_catalog(SceneCatalog, {"file": str(path)}, None)


def own_table(path):
    """A table of the user's objects: columns, ids, types, and the spectra of its first rows."""
    from csstsim.catalog.open import make_catalog
    from csstsim.catalog.own_table import TableCatalog

    catalog = make_catalog(TableCatalog, {"file": str(path)}, None)
    catalog.load_seds(range(min(len(catalog.table), 3)))


def light_curves(path):
    """The light curves of a table of objects, and what they say of an exposure."""
    from csstsim.catalog.changing.light_curves import LightCurves
    from csstsim.catalog.object_table import read_table

    curves = LightCurves(read_table(path), path)
    curves.check(["nova"])
    curves.at("nova", [61000.0], "i")


def galaxy_image(path):
    """An image of a galaxy that a table names: its pixels, sizes and place on the sky."""
    from csstsim.catalog.galaxy_shapes.images import read_image

    found = read_image.__wrapped__(str(path))
    assert found.half_light <= 2 * found.radius + 1


def spectrum(path):
    """A spectrum that a table names."""
    from csstsim.catalog.light.file_spectra import load_spectrum

    load_spectrum.__wrapped__(str(path))


def psf(path):
    """A PSF set: opened, its wings, and the PSF at a place."""
    from csstsim.optics.psf.psf_file import PsfSet
    from csstsim.optics.scatter.scattered_light import read_scattered

    found = PsfSet(path, chip=PSF_CHIP)
    read_scattered(found), found.at(100.0, 2000.0)


def psf_tables(path):
    from csstsim.optics.psf.psf_file import PsfSet
    from csstsim.render.psf_table import read_tables

    read_tables(path, PsfSet(Path(path).with_name("psf.h5")))


def psf_library(path):
    from csstsim.optics.psf.psf_c9 import convert

    chip = camera().chips[LIBRARY_CHIP]
    filter_, made = camera().filters[chip.filter], Path(path).with_name("converted.h5")
    convert(Path(path).parent, made, chip, filter_, sample="cell_integral", camera_digest="d")


def level0(path):
    """A Level-0 file with and without its checksums: header, pixels, mask, channels, spacecraft."""
    from csstsim.io.level0 import read_level0

    read_level0(path, verify=True)
    file = read_level0(path)
    _ = file.gain, file.nonlinearity, file.observer, list(file.channels())
    file.frame(), file.mask(), file.assembled(full=True)


def frame(path):
    from csstsim.io.frames import load_frame

    load_frame(path)


def picture(path):
    """Any image that `csstsim show` is asked for, drawn."""
    from csstsim.report.quicklook.show import show

    show(path, Path(path).with_name("picture.png"))


def table(path):
    from csstsim.catalog.table import ObjectTable

    ObjectTable.read(path)


def truth(path):
    from csstsim.io.truth import read_truth

    read_truth(path)


def cat(path):
    from csstsim.io.cat import read_cat

    read_cat(path)


def recreated(path):
    """What `csstsim recreate` and `compare --truth` read of a frame."""
    from csstsim.instrument.camera import load_camera
    from csstsim.studies.recreate.frame import read_frame
    from csstsim.studies.recreate.pixels import read_electrons

    frame, (folder, *_) = read_frame(path), Path(path).parent.glob("*/detector.yaml")
    _ = frame.exposure, frame.chip, frame.layers(), frame.camera_changes()
    read_electrons(frame, load_camera(folder.parent).detector)


def foreign(path):
    from csstsim.inject.others.frame import read_foreign

    read_foreign(path)


def stamps(path):
    from csstsim.inject.others.psf_models import read_psf

    read_psf(path).at(3.0, 4.0)


def orders(path):
    from csstsim.io.orders import check_orders, read_orders

    check_orders(path, read_orders(path), 3, camera().gratings[1])


def brick(path):
    from csstsim.catalog.truth_bricks import read_brick

    read_brick(path, {"seed": 3})


def compared(path):
    """`csstsim compare` with the sound file: seeds.beside_a_sound_one."""
    from csstsim.studies.compare.compare import facts

    path = Path(path)
    list(facts(path.with_name(f"sound{path.suffix}"), path))


def validation(path):
    from csstsim.measure.bricks.validation.result_file import read_result

    read_result(Path(path))


def job_log(path):
    """Logs of jobs, as the report sums them."""
    from csstsim.campaign.running.run_times import measured

    measured(Path(path).parents[2])
