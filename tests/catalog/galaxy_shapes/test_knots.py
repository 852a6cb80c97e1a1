"""Knots of galaxies: the disk's profile, no direction, the same for the same galaxy, and what a table must have."""

import numpy as np
import pytest
from astropy.table import Table
from scipy.special import gammainc, gammaincinv
from scipy.stats import kstest
from support.csst import BANDS

from csstsim.base.errors import InputError
from csstsim.catalog.galaxy_shapes.knots import knots_of
from csstsim.catalog.table import ObjectTable

WITHIN = 0.98  # of the disk's light


def galaxies(**more):
    columns = {"id": [11, 12, 13], "obj_type": 1, "size_disk": [0.5, 2.0, 0.3], "knots": [7, 0, 5],
               "knots_frac": [0.4, 0.3, 0.2]}  # fmt: skip
    return ObjectTable.complete(columns | more, BANDS)


@pytest.mark.parametrize("n", [None, 0.5, 2.5])
def test_knots_follow_the_light_of_the_disk(n):
    """Share of the light within each knot's radius: uniform up to 0.98, for a Sersic profile in closed form."""
    more = {} if n is None else {"n_disk": [n]}
    some = knots_of(galaxies(id=[3], size_disk=[1.7], knots=[4_000], knots_frac=[1.0], **more))
    index = n or 1.0
    b = gammaincinv(2 * index, 0.5)
    share = gammainc(2 * index, b * (np.hypot(some.u, some.v) / 1.7) ** (1 / index))
    assert share.max() <= WITHIN + 2e-3 and kstest(share / WITHIN, "uniform").statistic < 0.03
    angle = np.arctan2(some.v, some.u)
    assert kstest(angle, "uniform", (-np.pi, 2 * np.pi)).pvalue > 1e-4
    assert abs(np.corrcoef(np.abs(angle), share)[0, 1]) < 0.08


def test_only_galaxies_with_light_in_knots_have_them():
    some = knots_of(galaxies(id=[1, 2, 3, 4, 5], obj_type=[1, 0, 1, 1, 2], size_disk=0.5, knots=[2, 3, 0, 4, 5],
                             knots_frac=[0.3, 0.3, 0.3, 0.0, 0.3]))  # fmt: skip
    assert some.rows.tolist() == [0] and some.counts.tolist() == [2] and len(some.u) == len(some.v) == 2
    mixed = knots_of(galaxies())
    assert mixed.rows.tolist() == [0, 2] and mixed.counts.tolist() == [7, 5]
    assert mixed.fraction == pytest.approx([0.4, 0.2]) and mixed.size == pytest.approx([0.5, 0.3])


def test_a_galaxy_has_its_knots_in_any_table_and_its_size_is_their_scale():
    both = knots_of(galaxies())
    alone = knots_of(galaxies(id=[13], size_disk=[0.6], knots=[5], knots_frac=[0.9]))
    np.testing.assert_allclose([alone.u, alone.v], 2 * np.array([both.u[7:], both.v[7:]]), rtol=1e-6)
    other = knots_of(galaxies(id=[14], size_disk=[0.6], knots=[5], knots_frac=[0.9]))
    assert not np.isin(other.u, alone.u).any()
    more = knots_of(galaxies(id=[13], size_disk=[0.6], knots=[9], knots_frac=[0.9]))
    np.testing.assert_array_equal(more.u[:5], alone.u)


def test_each_galaxy_has_its_own_index():
    """Profiles of index 4 reach much further than those of 0.5, whatever their order."""
    table = galaxies(id=[3, 4], size_disk=1.0, knots=3000, knots_frac=1.0, n_disk=[4.0, 0.5])
    some = knots_of(table)
    wide, narrow = np.split(np.hypot(some.u, some.v), 2)
    assert np.median(wide) == pytest.approx(np.median(narrow), rel=0.1)
    assert wide.max() > 5 * narrow.max()


def test_turned_knots_are_a_quarter_turn_further():
    plain = knots_of(galaxies())
    turned = knots_of(galaxies(knots_turned=[0, 0, 1]))
    np.testing.assert_array_equal(turned.u, np.concatenate([plain.u[:7], -plain.v[7:]]))
    np.testing.assert_array_equal(turned.v, np.concatenate([plain.v[:7], plain.u[7:]]))


def test_the_truth_of_a_frame_has_the_same_knots():
    table = galaxies()
    truth = Table({"obj_ID" if name == "id" else name: table[name] for name in table.names})
    for one, other in zip(knots_of(table), knots_of(truth), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("name", ["id", "obj_type", "size_disk"])
def test_a_table_without_a_column_is_refused(name):
    table = galaxies()
    with pytest.raises(InputError, match=f"{name}: the table lacks a column"):
        knots_of(ObjectTable({n: table[n] for n in table.names if n != name}))


def test_no_knots_are_empty_columns():
    none = knots_of(galaxies(knots=0))
    assert all(len(values) == 0 for values in none)
