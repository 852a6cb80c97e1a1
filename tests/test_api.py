"""The Python interface: the same pixels as in the files, copies that leave the original alone, tables as catalogues."""

import copy
import gc
import importlib
import pickle
import re
import shutil
import subprocess
import sys
import warnings
import weakref
from datetime import datetime

import numpy as np
import pytest
import yaml
from astropy import units as u
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.table import QTable, Table
from astropy.time import Time
from support.commands import done
from support.mini_campaign import write_campaign

import csstsim
from csstsim.base.errors import InputError
from csstsim.base.shipped import SHIPPED
from csstsim.base.units import ab_photon_density
from csstsim.campaign.aiming import chips_for
from csstsim.catalog.base import CatalogBase
from csstsim.catalog.mock_object import MockObject
from csstsim.catalog.open import TABLE_KIND
from csstsim.catalog.table import ObjectTable
from csstsim.instrument.camera import load_camera
from csstsim.io.level0 import read_level0

OBSID, CHIP = "10100000001", 9
SIGMA = 5.0
ROUNDING = 0.2  # electrons: the bias in the header has few digits
DATES = {"DATE", "CHECKSUM", "DATASUM"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("api")


@pytest.fixture(scope="module")
def sim(folder):
    return csstsim.Simulation(write_campaign(folder), cache=folder / "cache")


@pytest.fixture(scope="module")
def frame(sim):
    return sim.chip(OBSID, CHIP)


def one_star(sim, mag=20.0, chip=CHIP):
    job = sim._run.job(OBSID, chip)
    ra, dec = (float(v.mean()) for v in job.footprint())
    return Table({"ra": [ra], "dec": [dec], "mag_r": [mag]})


def test_what_is_dropped_is_freed(sim):
    """A loop over keys keeps the camera of the last at most; each is 13 MB."""
    cameras = []
    for noise in (1, 2, 3):
        changed = sim.replace(instrument={"detector.read_noise": noise}, catalog=one_star(sim))
        changed.light(OBSID, CHIP)
        cameras.append(weakref.ref(changed._run.camera))
    del changed
    gc.collect()
    assert [camera() is None for camera in cameras[:-1]] == [True, True]


def test_it_gives_what_the_command_writes(sim, frame, folder):
    done("chip", folder / "campaign.yaml", "--obsid", OBSID, "--chip", CHIP)
    [path] = (folder / "out").glob(f"level0/{OBSID}/*.fits")
    file = read_level0(path)
    assert np.array_equal(frame.image, file.assembled()) and np.array_equal(frame.raw, file.frame())
    truth = ObjectTable.read(path.with_suffix(".truth.parquet"))
    assert list(truth.names) == frame.truth.colnames and len(truth)
    for name in set(truth.names) - {"ms"}:  # CPU time
        values = truth[name]
        same = np.array_equal(values, frame.truth[name], equal_nan=values.dtype.kind == "f")
        assert same and (values.dtype == object or values.dtype == frame.truth[name].dtype), name
    with fits.open(path) as hdus:
        cards = {card.keyword: card.value for hdu in hdus[:2] for card in hdu.header.cards}
    same = [key for key in frame.header if not key.startswith(("CPU_", "WALL_", "HISTORY", "COMMENT"))]
    assert {"OBSID", "EXPTIME", "CRVAL1", "GAIN01", "SIMSEED"} <= set(same)
    assert {key: frame.header[key] for key in set(same) - DATES} == {key: cards[key] for key in set(same) - DATES}


def test_the_wcs_is_of_the_windows_pixels(sim):
    """A star in the middle of the chip, on the whole chip and on a window."""
    columns = {name: one_star(sim)[name].tolist() for name in ("ra", "dec", "mag_r")}
    star = sim.replace(catalog={"kind": TABLE_KIND, "options": {"columns": columns}})
    for each in (star.chip(OBSID, CHIP), star.replace(window=(30, 100, 20, 120)).chip(OBSID, CHIP)):
        x, y = each.wcs.world_to_pixel_values(each.truth["ra_epoch"], each.truth["dec_epoch"])
        assert len(x) == 1 and each.image.shape == each.window.shape
        assert np.abs(x - (each.truth["xImage"] - 1 - each.window.x0)).max() < 1e-2  # px
        assert np.abs(y - (each.truth["yImage"] - 1 - each.window.y0)).max() < 1e-2


def test_a_catalogue_by_its_path(sim, tmp_path):
    """The same pixels as of the table itself; what is no path, table or class is refused with what may be given."""
    table = one_star(sim)
    table.write(tmp_path / "star.csv")
    image = sim.replace(catalog=tmp_path / "star.csv").chip(OBSID, CHIP).image
    assert np.array_equal(image, sim.replace(catalog=table).chip(OBSID, CHIP).image)
    for wrong, words in ((3, "a path to a table's file"), (str(tmp_path / "none.csv"), "none.csv")):
        with pytest.raises(InputError, match=words):
            sim.replace(catalog=wrong)


def test_it_travels_to_other_processes(sim):
    """Pickled, deep-copied: the same bits; neither its options nor its campaign can be changed from outside."""
    columns = {name: one_star(sim)[name].tolist() for name in ("ra", "dec", "mag_r")}
    catalog = {"kind": TABLE_KIND, "options": {"columns": columns}}
    star = sim.replace(catalog=catalog, seed=8)
    image = star.chip(OBSID, CHIP).image
    columns["mag_r"][0] = star.config.catalog.options["columns"]["mag_r"][0] = 14.0
    for other in (star, pickle.loads(pickle.dumps(star)), copy.deepcopy(star)):
        assert np.array_equal(other.chip(OBSID, CHIP).image, image)


def test_the_same_bits_again_and_a_copy_leaves_the_original_alone(sim, frame):
    star = sim.replace(catalog=one_star(sim))
    other, before = star.replace(seed=4), star.chip(OBSID, CHIP).image
    assert not np.array_equal(other.chip(OBSID, CHIP).image, before)
    assert np.array_equal(other.replace(seed=3).chip(OBSID, CHIP).image, before)
    assert sim.config.seed == 3 and np.array_equal(sim.chip(OBSID, CHIP).image, frame.image)


def test_what_is_printed_of_a_frame_and_a_simulation(sim, frame):
    window = f"x {frame.window.x0} to {frame.window.x1}, y {frame.window.y0} to {frame.window.y1}"
    assert repr(frame) == (
        f"<Frame: exposure {OBSID}, chip {CHIP}, {window}, uint16 [DN], {len(frame.truth)} objects in truth>"
    )
    assert "float32 [electron]" in repr(sim.light(OBSID, CHIP))
    assert re.fullmatch(r"<Simulation: mini, \d+ chips? of \d exposures?, fidelity standard, seed 3>", repr(sim))


def test_layers_are_changed_and_left_out(sim):
    even = sim.replace(layers={"Bias": {"bias_16channel": False}}, catalog=one_star(sim, 60.0))
    bare = even.replace(layers={"cosmic_rays": None})  # on top of the change before
    for changed, rays in ((even, True), (bare, False)):
        header = changed.chip(OBSID, CHIP).header
        assert np.ptp([header[f"DETBIA{n:02d}"] * header[f"GAIN{n:02d}"] for n in range(1, 17)]) < ROUNDING
        assert ("CRCOUNT" in header) == rays
        assert {"bias_16channel": False}.items() <= next(e["bias"] for e in changed.layers if "bias" in e).items()
    with pytest.raises(InputError, match=r"allowed: \{keyword: \{parameter: value\}, or None\}"):
        sim.replace(layers={"bias": False})
    with pytest.raises(InputError, match=r"layers: not a layer of the list \(got 'bloom'\); allowed: scie_obs"):
        sim.replace(layers={"bloom": None})
    with pytest.raises(InputError, match="bias_16chanel"):
        sim.replace(layers={"bias": {"bias_16chanel": False}})


def test_electrons_are_light_and_dark_current(sim):
    """Sky and dark current of a frame without objects, after bias and gain: within 5 sigma of the mean's own noise."""
    sim = sim.replace(catalog=one_star(sim, 60.0), layers={"cosmic_rays": None, "detector_defects": None})
    frame, light = sim.chip(OBSID, CHIP), sim.replace(fidelity="noise_free").light(OBSID, CHIP)
    dark = sim._run.camera.detector.dark * 150.0
    expected = light.image.mean() + dark
    noise = np.sqrt((expected + 25.0) / frame.image.size)  # 25: read noise squared
    assert abs(frame.electrons.mean() - expected) < SIGMA * noise + ROUNDING
    with pytest.raises(ValueError, match="in electrons already"):
        _ = light.electrons


def test_light_has_the_electrons_of_the_truth(sim):
    sim = sim.replace(catalog=one_star(sim, 18.0), fidelity="noise_free")
    light, empty = sim.light(OBSID, CHIP), sim.replace(catalog=one_star(sim, 60.0)).light(OBSID, CHIP)
    assert light.header is None and light.raw is None and light.image.dtype == np.float32
    drawn = float(light.image.sum(dtype=float) - empty.image.sum(dtype=float))
    assert drawn == pytest.approx(float(light.truth["drawn"][0]), rel=1e-3)


def test_a_table_is_a_catalogue(sim):
    """AB magnitudes are those of the truth, and electrons follow from the zero point."""
    job = sim._run.job(OBSID, CHIP)
    filter_, telescope = sim._run.camera.filters["r"], sim._run.camera.telescope
    frame = sim.replace(catalog=one_star(sim, 19.0)).chip(OBSID, CHIP)
    rate = 10 ** (-0.4 * (19.0 - filter_.zeropoint(telescope)))
    assert frame.truth["mag"][0] == pytest.approx(19.0, abs=1e-3)
    assert frame.truth["electrons"][0] == pytest.approx(rate * job.pointing.exptime, rel=1e-3)
    units = QTable(one_star(sim, 19.0))
    units["ra"], units["dec"] = units["ra"].value / 15.0, units["dec"].value * 60.0
    units["ra"].unit, units["dec"].unit = "hourangle", "arcmin"
    again = sim.replace(catalog=units).chip(OBSID, CHIP)
    assert again.truth["xImage"][0] == pytest.approx(frame.truth["xImage"][0], abs=1e-6)


class Mine(CatalogBase):
    """A catalogue class, as one writes it in a notebook."""

    def __init__(self, options, region):
        super().__init__(options, region)
        self._load()

    def _load(self):
        self.objs = [MockObject(id=7, type="star", ra=np.mean(self.region.ra), dec=np.mean(self.region.dec))]

    def load_sed(self, obj):
        wave = np.linspace(2000.0, 11000.0, 1801)
        return Table({"WAVELENGTH": wave, "FLUX": ab_photon_density(wave, 20.0)})

    def load_norm_filt(self, obj):
        return None


def test_a_class_is_a_catalogue(sim):
    assert sim.replace(catalog=Mine).config.catalog.kind == f"{__name__}:Mine"
    assert list(sim.replace(catalog=Mine, psf={"grid": 2}).light(OBSID, CHIP).truth["obj_ID"]) == [7]


def test_a_spectroscopic_chip_has_orders(sim):
    spectra = sim.replace(select={"types": ["SCIE"], "chips": [29]})
    frame = spectra.replace(catalog=one_star(spectra, chip=29)).chip(OBSID, 29)
    assert frame.truth["obj_ID"].tolist() == [1] == sorted(set(frame.orders["id"]))
    assert {"order", "grating", "electrons"} <= set(frame.orders.colnames)


def test_new_observations_undo_changed_layers(sim, tmp_path):
    """Layers are changed in the list that is in force, and a new list is taken as it is."""
    file = tmp_path / "list.yaml"
    text = (SHIPPED / "observations" / "science.yaml").read_text()
    file.write_text("".join(line for line in text.splitlines(True) if "- cosmic_rays" not in line))
    bare = sim.replace(layers={"gain": {"gain_16channel": False}}).replace(observations={"SCIE": file})
    both = sim.replace(observations={"SCIE": file}, layers={"gain": {"gain_16channel": False}})
    for found, channels in ((bare, True), (both, False)):
        layers = {name: param for entry in found.layers for name, param in entry.items()}
        assert "cosmic_rays" not in layers and layers["gain"]["gain_16channel"] == channels


def test_magnitudes_are_of_the_campaigns_own_bands(sim, tmp_path):
    """A camera with another r: a table's magnitude is that in this r."""
    folder = shutil.copytree(sim.config.instrument, tmp_path / "camera")
    filters = yaml.safe_load((folder / "filters.yaml").read_text())
    nodes = filters["r"]["nodes"]
    nodes["values"] = [node for node in nodes["values"] if node[0] < 6300] + [[6310, 0.0]]
    (folder / "filters.yaml").write_text(yaml.safe_dump(filters))
    table = one_star(sim, 20.0)
    table["mag_g"], table["mag_i"] = [22.0], [18.0]
    other = sim.replace(instrument=folder, catalog=table)
    assert other.light(OBSID, CHIP).truth["mag"][0] == pytest.approx(20.0, abs=2e-3)
    back = other.replace(instrument=sim.config.instrument)
    assert back.light(OBSID, CHIP).truth["mag"][0] == pytest.approx(20.0, abs=2e-3)


def test_paths_are_those_of_the_folder_in_which_they_were_given(tmp_path, monkeypatch):
    """Of a campaign file, and of changes to it: the process goes elsewhere before they are used."""
    here, elsewhere = tmp_path / "here", tmp_path / "elsewhere"
    here.mkdir(), elsewhere.mkdir()
    file = write_campaign(here)
    relative = {"survey_table": "table.csv", "instrument": "instrument", "universe": "universe", "output": "out"}
    file.write_text(yaml.safe_dump(yaml.safe_load(file.read_text()) | relative))
    (here / "mine.yaml").write_text((SHIPPED / "observations" / "bias.yaml").read_text())
    monkeypatch.chdir(here)
    sim = csstsim.Simulation("campaign.yaml", cache="cache")
    changed = sim.replace(**relative, observations={"BIAS": "mine.yaml"})
    monkeypatch.chdir(elsewhere)
    aimed, sent = sim.aim(10.0, 20.0, size=64), pickle.loads(pickle.dumps(changed))
    for one in (sim, changed, sent, changed.replace(seed=9), aimed):
        assert len(one.exposures) >= 1 and one.config.instrument == here / "instrument"
    assert changed.config.observations == {"BIAS": here / "mine.yaml"} and not list(elsewhere.iterdir())


def test_a_wrong_obsid_of_what_was_aimed_names_what_was_aimed(folder):
    aimed = csstsim.Simulation(cache=folder / "cache").aim(10.0, 20.0, chip=24, size=200, obsid="10100000077")
    for ask in (lambda: aimed.chip("1", 24), lambda: aimed.replace(select={"obsids": ["1"]})):
        with pytest.raises(InputError, match=r"10100000077 of the given pointings|the 1 obsid of the given"):
            ask()


def test_aim_puts_a_place_on_the_middle(folder):
    sim = csstsim.Simulation(cache=folder / "cache")
    assert len(sim.exposures) == 6 and sim.exposures["chips"][0] == (8,)
    aimed = sim.aim(0.0, 0.0, chip=24, size=200)
    table = Table({"ra": [0.0], "dec": [0.0], "mag_i": [20.0]})
    truth = aimed.replace(catalog=table, psf={"grid": 2}).light("10100000001", 24).truth
    assert truth["xImage"][0] - 1 == pytest.approx(4607.5, abs=1e-6)
    assert truth["yImage"][0] - 1 == pytest.approx(4615.5, abs=1e-6)
    bent = sim.replace(layers={"scie_obs": {"field_dist": False}}).aim(10.0, 20.0, chip=24, size=200)
    table["ra"], table["dec"] = [10.0], [20.0]
    truth = bent.replace(catalog=table, psf={"grid": 2}).light("10100000001", 24).truth
    assert truth["xImage"][0] - 1 == pytest.approx(4607.5, abs=1e-6)
    sizes = {"size": "x"}, {"size": 0}, {"size": 10_000}, {"obsid": "one"}, {"exposures": 0}, {"exposures": 1.5}
    for wrong in (*sizes, {"ra": "10h"}, {"chip": 31}, {"dec": 91.0}, {"exptime": 0.0}, {"time": "today"}):
        with pytest.raises(InputError):
            sim.aim(**({"ra": 10.0, "dec": 0.0} | wrong)).chip("10100000001", 9)


def test_exposures_differ_in_noise_and_share_the_detector(folder):
    """Two of one aim: differences have twice the variance of each, uncorrelated pixels, 5 sigma; one bias, one gain."""
    table = Table({"ra": [10.0], "dec": [0.5], "mag_r": [27.0]})
    sim = csstsim.Simulation(cache=folder / "cache").replace(catalog=table, psf={"grid": 2}, seed=77)
    sim = sim.replace(layers={"cosmic_rays": None, "detector_defects": None})
    pair = sim.aim(10.0, 0.5, size=200, obsid="20200000098", exposures=2)
    assert list(pair.exposures["obsid"]) == ["20200000098", "20200000099"]
    start, later = (datetime.fromisoformat(time) for time in pair.exposures["time"])
    assert (later - start).total_seconds() == 150.0 + 60.0
    one, two = (pair.chip(obsid, 9) for obsid in pair.exposures["obsid"])
    a, b = (frame.electrons.astype(float) - np.median(frame.electrons) for frame in (one, two))
    count = a.size
    assert (a - b).var() / (a.var() + b.var()) == pytest.approx(1.0, abs=5 * np.sqrt(2 / count))
    assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 5 / np.sqrt(count)
    levels = [name for name in one.header if name.startswith(("DETBIA", "GAIN"))]
    assert len(levels) == 32 and all(one.header[name] == two.header[name] for name in levels)
    assert two.truth["xImage"][0] == pytest.approx(one.truth["xImage"][0], abs=1e-6)  # aimed anew
    alone = sim.aim(10.0, 0.5, size=200, obsid="20200000098")
    assert np.array_equal(alone.chip("20200000098", 9).image, one.image)
    with pytest.warns(UserWarning, match="one obsid has one noise"):
        later = sim.aim(10.0, 0.5, size=200, obsid="20200000098", time="2027-11-21T01:20:00")
    again = later.chip("20200000098", 9).electrons.astype(float)
    assert np.corrcoef(a.ravel(), again.ravel())[0, 1] > 0.99


def test_nothing_is_written_but_the_cache(sim, folder):
    assert {path.name for path in folder.iterdir() if path.is_dir()} <= {"cache", "out", "instrument", "universe"}
    kept = {path.suffix for path in (folder / "cache").rglob("*") if path.is_file()}
    assert kept == {".h5", ".parquet"}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seeds": 2}, "unknown key"),
        ({"window": (0, 1, 2)}, "window: must be four numbers"),
        ({"window": (0, 1.5, 0, 2)}, "must be a whole number"),
        ({"window": (False, True, 0, 2)}, "must be a whole number"),
        ({"window": "region"}, "'region' needs select.region"),
        ({"catalog": type("Local", (), {})}, "derived from CatalogBase"),
        ({"window": (50, 50, 0, 10)}, "must exceed"),
        ({"catalog": [1, 2]}, "allowed: an astropy Table"),
        ({"fidelity": "fast"}, "fidelity"),
    ],
)
def test_what_cannot_be_used_is_refused(sim, change, message):
    with pytest.raises(InputError, match=message):
        sim.replace(**change)
    with pytest.raises(InputError, match="not an exposure"):
        sim.chip("1", CHIP)


def test_a_cache_that_cannot_be(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"cache: cannot be made: .*CSSTSIM_CACHE"):
        csstsim.Simulation(cache=tmp_path / "file" / "cache")


def test_faint_objects_of_a_table_are_drawn(folder):
    """The starter's mag_limit, 25.5, is not that of one's own table."""
    sim = csstsim.Simulation(cache=folder / "cache").aim(10.0, 0.0, size=64)
    table = Table({"ra": [10.0], "dec": [0.0], "mag_r": [28.0]})
    assert len(sim.replace(catalog=table, psf={"grid": 2}).light(OBSID, 9).truth) == 1


def test_the_root_imports_nothing_heavy():
    code = "import csstsim, sys; print(*sorted({'numpy', 'numba', 'astropy', 'pydantic', 'galsim'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""
    assert (
        set(csstsim.__all__) <= set(dir(csstsim))
        and csstsim.Simulation is importlib.import_module("csstsim.api").Simulation
    )
    with pytest.raises(AttributeError, match="no attribute 'simulate'"):
        _ = csstsim.simulate


def test_what_an_own_layer_adds_to_the_header_is_in_its_history(sim, tmp_path, monkeypatch):
    (tmp_path / "sticker").mkdir()
    (tmp_path / "sticker" / "label.py").write_text(
        "from csstsim.layers.param import LayerParam as Param\n"
        'STAGE, UNITS = "render", ("electron", "electron")\n'
        'def apply(state, param, rng):\n    state.header["trail"] = 0.5\n    return state\n'
    )
    monkeypatch.syspath_prepend(tmp_path)
    first, *others = yaml.safe_load((SHIPPED / "observations" / "science.yaml").read_text())["layers"]
    file = tmp_path / "science.yaml"
    file.write_text(yaml.safe_dump({"layers": [first, {"sticker.label": {}}, *others]}))
    frame = sim.replace(observations={"SCIE": str(file)}).chip(OBSID, CHIP)
    assert "value trail = 0.5" in [line.strip() for line in frame.header["HISTORY"]]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda sim: sim.aim(60.1, -40.0, time="1949-01-01T00:00:00"), "years 1950 to 2099"),
        (lambda sim: sim.aim(60.1, -40.0, time=None), "not an ISO UTC time"),
        (lambda sim: sim.aim(60.1, -40.0, time=61729.0), "not an ISO UTC time"),
        (lambda sim: sim.aim(60.1, -40.0, chip=[9]), "chip: must be a whole number"),
        (lambda sim: sim.aim(60.1, -40.0, obsid="99999999999999", exposures=2), "no observation id is left"),
        (lambda sim: sim.inject(None, {}), "not a Frame"),
        (lambda sim: sim.inject(np.zeros((3, 3)), {}), "not a Frame"),
        (lambda _: csstsim.Simulation(5), "not a campaign"),
        (lambda _: csstsim.Simulation({}), "not a campaign"),
    ],
)
def test_values_of_a_wrong_kind_are_refused_in_a_line(sim, change, message):
    with pytest.raises(InputError, match=message):
        change(sim)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (None, "not a table"),
        (5, "not a table"),
        ([], "not a table"),
        ({"ra": 1.0, "dec": 2.0}, "for each row"),
    ],
)
def test_what_is_no_table_is_not_injected(sim, frame, table, message):
    with pytest.raises(InputError, match=message):
        sim.inject(frame, table)
    with pytest.raises(InputError, match="realisation"):
        sim.inject(frame, {"ra": [1.0]}, realisation=-1)


@pytest.fixture(scope="module")
def starter(folder):
    """The campaign of `csstsim init`, of the shipped camera; what is tested with it makes no pixel."""
    return csstsim.Simulation(cache=folder / "cache")


@pytest.mark.parametrize("size", [200, 201, 1])
def test_aim_hands_on_what_it_is_given_and_the_window_is_about_the_middle(starter, size):
    """The place is on 4607.5, 4615.5 px: of an even size exactly in the middle, of an odd one half a pixel off."""
    given = {"pa": 33.0, "time": "2027-12-01T01:00:00", "exptime": 90.0, "obsid": f"404000000{size:03d}"}
    aimed = starter.aim(60.1, -40.0, chip=9, size=size, **given)
    (row,) = aimed.exposures
    assert {name: row[name] for name in given} == given and row["chips"] == (9,)
    window = aimed.config.window
    assert window.x1 - window.x0 == window.y1 - window.y0 == size
    off = (window.x0 + window.x1 - 1) / 2 - 4607.5, (window.y0 + window.y1 - 1) / 2 - 4615.5
    assert np.abs(off).max() <= (size % 2) / 2


@pytest.mark.parametrize("chip", [1, 2, 30])
def test_a_window_about_orders_is_on_the_chip_and_warns_where_it_cuts_them(starter, chip, recwarn):
    """As large as the chip it is the chip's, on the side of the wider grating."""
    whole = starter.aim(60.1, -40.0, chip=chip, size=9216, obsid="40500000001").config.window
    assert (whole.x0, whole.x1) == (0, 9216) and whole.y0 >= 0 and whole.y1 <= 9232
    assert not recwarn.list
    with pytest.warns(UserWarning, match="cuts the zeroth or the first order: they span") as caught:
        starter.aim(60.1, -40.0, chip=chip, size=600, obsid="40500000001")
    span = int(str(caught[0].message).partition("they span ")[2].split()[0])
    with pytest.warns(UserWarning, match="they span"):
        starter.aim(60.1, -40.0, chip=chip, size=span - 2, obsid="40500000001")
    recwarn.clear()
    starter.aim(60.1, -40.0, chip=chip, size=span + 2, obsid="40500000001")
    assert not recwarn.list


def test_a_filter_is_its_chip_nearest_to_the_middle_as_in_the_command(starter):
    for name in ("GV", "r", "NUV"):
        [chip] = chips_for(load_camera(), filters=(name,))
        aimed = starter.aim(60.1, -40.0, filter=name, size=None, obsid="40700000001")
        assert aimed.config.select.chips == (chip.id,) and chip.filter == name
        where = starter.aim(60.1, -40.0, chip.id, size=None, obsid="40700000001")
        assert aimed.exposures["ra"][0] == where.exposures["ra"][0]
    assert starter.aim(60.1, -40.0, size=None, obsid="40700000001").config.select.chips == (9,)


@pytest.mark.parametrize(("given", "words"), [
    ({"filter": "q"}, "filter: no such filter (got 'q'); allowed: NUV, u, "),
    ({"filter": "r", "chip": 9}, "filter: a chip and a filter are given (got 'r'); allowed: one of them"),
    ({"filter": ["r"]}, "filter: must be a name"), ({"filter": 9}, "filter: must be a name"),
    ({"chip": 31}, "chip: no such chip"), ({"chip": 0}, "chip: no such chip"),
])  # fmt: skip
def test_what_is_no_filter_or_no_chip_is_refused(starter, given, words):
    with pytest.raises(InputError) as caught:
        starter.aim(60.1, -40.0, **given)
    assert str(caught.value).startswith(words)


def test_aim_warns_of_the_sun_and_the_earth_at_the_callers_line(starter, recwarn):
    with pytest.warns(
        UserWarning, match="too near the Sun or towards the Earth: 2 of 2; obsid 40800000001: "
    ) as caught:
        aimed = starter.aim(236.0, -19.0, size=10, obsid="40800000001", exposures=2)
    [warning] = caught
    said = str(warning.message)
    assert "angle to the Sun 0.9 deg (limit: 50), angle from the Earth's limb -1" in said and said.endswith("try time=")
    assert warning.filename == __file__ and len(aimed.exposures) == 2
    recwarn.clear()
    starter.aim(236.0, -19.0, size=10, obsid="40800000003", time="2027-05-20T01:00:00")
    assert not recwarn.list


def test_one_obsid_has_another_noise_under_another_seed(starter, recwarn):
    for seed, hour in ((5, 1), (6, 3)):
        starter.replace(seed=seed).aim(60.1, -40.0, size=10, obsid="40600000001", time=f"2027-12-01T0{hour}:00:00")
    assert not recwarn.list
    with pytest.warns(UserWarning, match="obsid 40600000001 was aimed before, at 2027-12-01T01:00:00"):
        starter.replace(seed=5).aim(60.1, -40.0, size=10, obsid="40600000001", time="2027-12-01T03:00:00")


def test_changes_of_a_camera_add_up_and_those_of_a_catalogue_keep_shapes_and_limit(starter):
    changed = starter.replace(instrument={"detector.gain": 1.3}).replace(instrument={"detector.dark": 0.5})
    assert (changed._run.camera.detector.gain, changed._run.camera.detector.dark) == (1.3, 0.5)
    turned = starter.replace(catalog={"shapes": "rotated90", "mag_limit": 21.5})
    for mine in (Mine, Table({"ra": [60.0], "dec": [-40.0], "mag_r": [20.0]})):
        catalog = turned.replace(catalog=mine).config.catalog
        assert catalog.shapes == "rotated90"
        assert catalog.mag_limit == (21.5 if mine is Mine else None)


def test_a_window_of_pixels_takes_the_place_of_a_circle_on_the_sky(starter):
    region = starter.config.select.region
    assert region is not None and starter.config.window == "region"
    assert starter.replace(window=(0, 50, 0, 40)).config.select.region is None
    assert starter.replace(window="region").config.select.region == region
    assert starter.replace(seed=9).config.select.region == region


@pytest.mark.parametrize(("text", "level"), [("3 not rendered: too large", "WARNING"), ("made: x.h5", "INFO")])
def test_objects_that_are_not_rendered_are_a_warning(caplog, text, level):
    with caplog.at_level("INFO", logger="csstsim"):
        csstsim.api._log(text)
    assert [(record.levelname, record.getMessage()) for record in caplog.records] == [(level, text)]


def test_aim_takes_values_of_astropy(sim):
    """A SkyCoord, quantities and a Time give the pointing of the numbers that they stand for."""
    obsid = "10100000077"
    plain = sim.aim(150.1, 2.2, chip=CHIP, size=64, obsid=obsid, pa=45.0, exptime=90.0, time="2027-11-20T02:00:00")
    sky = SkyCoord(150.1, 2.2, unit="deg")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # leap seconds of 2027
        utc = Time("2027-11-20T02:00:00", scale="utc")
        time = utc.tt
    others = (
        sim.aim(sky.galactic, chip=CHIP, size=64, obsid=obsid, pa=0.25 * np.pi * u.rad, exptime=1.5 * u.min, time=time),
        sim.aim(
            sky.ra.to(u.arcmin), sky.dec, CHIP, size=64, obsid=obsid, pa=45 * u.deg, exptime=90 * u.s, time=time.utc
        ),
    )
    [wanted] = plain.exposures
    for other in others:
        [row] = other.exposures
        assert row["time"] == wanted["time"] and row["exptime"] == 90.0
        assert all(abs(row[name] - wanted[name]) < 1e-9 for name in ("ra", "dec", "pa"))
    for wrong in ({"pa": 3 * u.s}, {"time": Time([1.0, 2.0], format="jyear")}, {"exptime": 1 * u.m}):
        with pytest.raises(InputError, match=next(iter(wrong))):
            sim.aim(150.1, 2.2, **wrong)


def test_units_of_a_mapping_are_read(sim, frame):
    """Quantities of a mapping of columns are converted, as those of a table; they were taken for degrees."""
    star = one_star(sim)
    mapping = {"ra": star["ra"] * u.deg, "dec": (star["dec"] * u.deg).to(u.rad), "mag_r": [20.0]}
    assert (sim.inject(frame, mapping).image == sim.inject(frame, star).image).mean() > 0.999


def test_public_names_alone_are_listed():
    """`dir(csstsim)` has what one may use, and each of them is there."""
    assert set(dir(csstsim)) == {*csstsim.__all__, "__version__"}
    assert all(getattr(csstsim, name) for name in csstsim.__all__)
