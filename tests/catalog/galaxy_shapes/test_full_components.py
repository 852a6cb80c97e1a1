"""Indices and knots of the embedded universe's galaxies: laws, limits, and the same galaxy in every table."""

import numpy as np
import pytest
from support.csst import BANDS

from csstsim.catalog.galaxy_shapes.components import components
from csstsim.catalog.galaxy_shapes.full_components import full_components, load_numbers
from csstsim.catalog.selection.renderable import reasons
from csstsim.catalog.table import GALAXY, QUASAR, STAR, ObjectTable

COUNT, SIGMA = 40_000, 5.0


@pytest.fixture(scope="module")
def galaxies():
    rng = np.random.default_rng(4)
    return ObjectTable.complete({
        "id": rng.permutation(10**6)[:COUNT], "obj_type": GALAXY, "size_disk": 0.4, "size_bulge": 0.2,
        "bulge_frac": rng.uniform(0, 1, COUNT), "bulgemass": 10 ** rng.uniform(8, 12, COUNT), "ra": 1.0, "dec": 2.0,
        "gal_type": rng.integers(0, 2, COUNT),
    }, BANDS)  # fmt: skip


def test_indices_follow_their_law(galaxies):
    made, law = full_components(galaxies), load_numbers().bulge_index
    assert all(not mask.any() for mask in reasons(made).values())
    n, decades = made["n_bulge"].astype(float), np.log10(galaxies["bulgemass"].astype(float)) - 10
    middle = np.abs(decades) < 0.2  # where no limit is near
    off = n[middle] - law.index - law.slope * decades[middle]
    assert off.mean() == pytest.approx(0, abs=SIGMA * law.scatter / np.sqrt(middle.sum()))
    assert off.std() == pytest.approx(law.scatter, rel=0.05)
    assert n.min() == np.float32(law.least) and n.max() == np.float32(law.most)
    disks = made["n_disk"].astype(float)
    assert disks.mean() == pytest.approx(load_numbers().disk_index.index, abs=0.01)
    assert abs(np.corrcoef(disks, n)[0, 1]) < SIGMA / np.sqrt(COUNT)


def test_star_forming_galaxies_have_knots(galaxies):
    made, law = full_components(galaxies), load_numbers().knots
    forming, disk = galaxies["gal_type"] == 0, 1 - galaxies["bulge_frac"].astype(float)
    assert not made["knots"][~forming].any() and not made["knots_frac"][~forming].any()
    knots = made["knots"][forming]
    assert knots.min() == law.least and knots.max() == law.most
    assert knots.mean() == pytest.approx((law.least + law.most) / 2, abs=SIGMA * 7.5 / np.sqrt(len(knots)))
    share = made["knots_frac"][forming] / disk[forming]
    assert share.max() <= law.share * (1 + 1e-6)
    assert share.mean() == pytest.approx(law.share / 2, abs=SIGMA * law.share / np.sqrt(12 * len(knots)))


def test_a_galaxy_is_the_same_in_any_table(galaxies):
    rows = np.random.default_rng(1).permutation(COUNT)[:100]
    assert full_components(galaxies.take(rows)) == full_components(galaxies).take(rows)


def test_light_and_points_stay_as_they_are(galaxies):
    made = full_components(galaxies)
    for before, after in zip(components(galaxies), components(made), strict=True):
        assert np.array_equal(before[0], after[0]) and np.array_equal(before[2], after[2])
    points = full_components(ObjectTable.complete({"id": [1, 2], "obj_type": [STAR, QUASAR]}, BANDS))
    assert not points["knots"].any() and points["n_disk"].tolist() == [1, 1] and points["n_bulge"].tolist() == [4, 4]


def test_no_mass_and_no_objects(galaxies):
    unknown = galaxies.with_columns(bulgemass=np.full(COUNT, np.nan))
    assert np.isfinite(full_components(unknown)["n_bulge"]).all()
    assert len(full_components(galaxies.take(slice(0, 0)))) == 0


def test_disks_scatter_about_theirs_within_limits_and_draws_are_apart(galaxies):
    """Steps of 1/32; mean, scatter and limits of the disk's law; number of knots and their share know nothing of it."""
    made, law = full_components(galaxies), load_numbers().disk_index
    disks = made["n_disk"].astype(float)
    assert disks.std() == pytest.approx(law.scatter, rel=0.04)
    assert disks.min() == pytest.approx(law.least, abs=1e-6) and disks.max() == pytest.approx(law.most, abs=1e-6)
    inside = (disks > law.least + 1e-6) & (disks < law.most)
    assert not ((disks[inside] * 32) % 1).any()
    forming = galaxies["gal_type"] == 0
    share = (made["knots_frac"] / np.maximum(1 - galaxies["bulge_frac"], 1e-6))[forming]
    knots, disks = made["knots"][forming], disks[forming]
    for one, other in ((knots, share), (disks, share), (disks, knots)):
        assert abs(np.corrcoef(one, other)[0, 1]) < SIGMA / np.sqrt(forming.sum())
    counts = np.bincount(made["knots"][forming])[5:31]
    assert np.abs(counts / counts.mean() - 1).max() < SIGMA / np.sqrt(counts.mean()) and len(counts) == 26


def test_a_galaxy_that_is_all_bulge_has_no_knots():
    table = ObjectTable.complete({"id": [1, 2], "obj_type": GALAXY, "gal_type": 0, "bulge_frac": [1.0, 0.999]}, BANDS)
    made = full_components(table)
    assert made["knots"][0] == 0 < made["knots"][1] and made["knots_frac"][0] == 0 < made["knots_frac"][1] < 3.1e-4
