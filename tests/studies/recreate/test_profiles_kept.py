"""Sersic indices and knots of a truth table are rendered again; a missing image is reported."""

import numpy as np

from csstsim.catalog.table import GALAXY, STAR, ObjectTable
from csstsim.studies.recreate.objects import _sizes


def test_profiles_of_a_truth_table_are_kept():
    notes, two = [], np.array([0.3, 0.2])
    table = ObjectTable({
        "obj_type": np.array([GALAXY, STAR]), "size_disk": two, "size_bulge": two, "bulge_frac": two,
        "n_disk": np.array([2.0, 3.0]), "knots": np.array([4, 4]), "knots_frac": np.array([0.1, 0.1]),
        "image_file": np.array(["a.fits", ""]),
    })  # fmt: skip
    found = _sizes(table, notes)
    assert found["n_disk"].tolist() == [2.0, 1.0] and found["knots"].tolist() == [4, 0]
    assert found["knots_frac"].tolist() == [0.1, 0.0] and found["size_disk"].tolist() == [0.3, 0.0]
    assert notes == ["image_file: galaxies of an image are disks of its size"]
    plain = ObjectTable({name: table[name] for name in ("obj_type", "size_disk", "size_bulge", "bulge_frac")})
    assert set(_sizes(plain, notes)) == {"size_disk", "size_bulge", "bulge_frac"} and len(notes) == 1
