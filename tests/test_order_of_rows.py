"""The rows of a catalogue may be in any order: pixels, draws and the truth of each object are the same bits."""

import numpy as np
import pytest
from astropy.table import Table
from support.csst import BANDS
from support.mini_campaign import write_campaign

import csstsim
from csstsim.base.units import ab_photon_density
from csstsim.catalog.base import CatalogBase
from csstsim.catalog.mock_object import MockObject
from csstsim.catalog.selection.row_order import back, canonical_order
from csstsim.catalog.table import ObjectTable
from csstsim.instrument.filter import GRID

OBSID, IMAGING, GRATING = "10100000001", 9, 29
COUNTS = {  # objects; GalSim is slow, slabs of bright objects are
    (IMAGING, "reference"): 8, (IMAGING, "standard"): 60, (IMAGING, "preview"): 60, (IMAGING, "noise_free"): 60,
    (GRATING, "reference"): 3, (GRATING, "standard"): 60, (GRATING, "preview"): 60, (GRATING, "noise_free"): 6,
}  # fmt: skip


@pytest.fixture(scope="module")
def sim(tmp_path_factory):
    folder = tmp_path_factory.mktemp("order")
    chips = {"types": ["SCIE"], "chips": [IMAGING, GRATING]}
    return csstsim.Simulation(write_campaign(folder, select=chips), cache=folder / "cache")


def crowd(sim, chip, count, seed=1):
    """Return {name: (count,) values} of stars and galaxies of many brightnesses upon each other."""
    rng, job = np.random.default_rng(seed), sim._run.job(OBSID, chip)
    ra, dec = (float(v.mean()) for v in job.footprint())
    spread = 2.0 / 3600.0  # deg: 27 px
    return {
        "id": rng.permutation(count) + 1, "type": np.where(rng.random(count) < 0.5, "star", "galaxy"),
        "ra": ra + rng.uniform(-spread, spread, count) / np.cos(np.radians(dec)),
        "dec": dec + rng.uniform(-spread, spread, count), "mag_r": rng.uniform(17.0, 27.0, count),
        "mag_g": rng.uniform(17.0, 27.0, count), "size": rng.uniform(0.1, 0.8, count),
        "bulge_frac": rng.random(count), "e1": rng.uniform(-0.3, 0.3, count), "e2": rng.uniform(-0.3, 0.3, count),
    }  # fmt: skip


def by_id(table, *more):
    return table[np.lexsort([np.asarray(table[name]) for name in more] + [np.asarray(table["obj_ID"])])]


SLOW = (GRATING, "reference"), (GRATING, "preview"), (IMAGING, "preview")  # the last two go the way of noise_free


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("chip", "fidelity"),
    [pytest.param(*key, marks=[pytest.mark.slow] if key in SLOW else []) for key in COUNTS],
)
def test_the_rows_order_is_in_no_bit(sim, chip, fidelity):
    """Every fidelity, imaging and dispersed: as drawn by chance and by brightness, the same float32 sums and truth."""
    count, frames = COUNTS[chip, fidelity], []
    columns = crowd(sim, chip, count)
    for shuffle in (np.arange(count), np.argsort(columns["mag_r"])):
        rows = {name: values[shuffle] for name, values in columns.items()}
        frame = sim.replace(catalog=Table(rows), fidelity=fidelity).light(OBSID, chip)
        reach = np.isin(rows["id"], frame.truth["obj_ID"])
        assert frame.truth["obj_ID"].tolist() == rows["id"][reach].tolist()  # truth is in the catalogue's order
        if frame.orders is not None:
            assert frame.truth["obj_ID"][frame.orders["row"]].tolist() == frame.orders["id"].tolist()
            assert list(zip(frame.orders["row"], frame.orders["order"], strict=True)) == sorted(
                zip(frame.orders["row"], frame.orders["order"], strict=True)
            )
        frames.append(frame)
    first = frames[0]
    assert (first.image > 0).any()
    for other in frames[1:]:
        assert np.array_equal(first.image, other.image)
        _same(by_id(first.truth), by_id(other.truth), {"ms", "catalog_row"})
        if first.orders is not None:
            pairs = [frame.orders[np.lexsort((frame.orders["order"], frame.orders["id"]))] for frame in (first, other)]
            _same(*pairs, {"row"})


def _same(one, other, but):
    for name in set(one.colnames) - but:
        values = np.asarray(one[name])
        assert np.array_equal(values, other[name], equal_nan=values.dtype.kind == "f"), name


class Twins(CatalogBase):
    """Objects that share ids, places, or everything; the option `order` is that of the rows."""

    def __init__(self, options, region):
        super().__init__(options, region)
        self._load()

    def _load(self):
        ra, dec = self.options["ra"], self.options["dec"]
        rows = [{"id": k % 3, "ra": ra + (k % 2) * 1e-4, "dec": dec, "mag": 20.0 + 0.5 * (k % 4)} for k in range(12)]
        rows += rows[:4]  # equal in everything
        self.objs = [MockObject(type="star", **rows[k]) for k in self.options["order"]]

    def load_sed(self, obj):
        return Table({"WAVELENGTH": GRID, "FLUX": ab_photon_density(GRID, obj.mag)})

    def load_norm_filt(self, obj):
        return None


@pytest.mark.parametrize("chip", [IMAGING, GRATING])
def test_objects_that_share_an_id_are_told_by_what_they_are(sim, chip):
    ra, dec = (float(v.mean()) for v in sim._run.job(OBSID, chip).footprint())
    images = []
    for seed in range(3):
        order = np.random.default_rng(seed).permutation(16).tolist()
        options = {"ra": ra, "dec": dec, "order": order}
        catalog = {"kind": f"{__name__}:Twins", "options": options}
        images.append(sim.replace(catalog=catalog, fidelity="standard").light(OBSID, chip).image)
    assert np.array_equal(images[0], images[1]) and np.array_equal(images[0], images[2])


def test_canonical_order_of_random_tables():
    """Property: shuffled tables have the same rows in canonical order, ties and NaN included; `back` undoes it."""
    rng = np.random.default_rng(4)
    for _ in range(200):
        count = int(rng.integers(0, 12))
        table = ObjectTable.complete({
            "id": rng.integers(0, rng.integers(1, 20), count), "ra": rng.integers(0, 2, count) * 1.0,
            "dec": np.where(rng.random(count) < 0.3, np.nan, rng.integers(0, 2, count)),
            "obj_type": rng.integers(0, 3, count),
        }, BANDS)  # fmt: skip
        shuffled = table.take(rng.permutation(count))
        order, other = canonical_order(table), canonical_order(shuffled)
        assert table.take(order) == shuffled.take(other)
        assert table.take(order).take(back(order)) == table
