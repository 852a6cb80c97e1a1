"""The hidden objects of a pack, of truth tables made by hand: which are kept, and each column."""

from types import SimpleNamespace

import galsim
import numpy as np
import pytest

from csstsim.catalog.flags import NOT_RENDERED, OFF_CHIP
from csstsim.catalog.table import ObjectTable
from csstsim.instrument.chip import Window
from csstsim.studies.release.pack_truth import true_objects

ROW = {
    "id": 1, "obj_type": 1, "x": 12.0, "y": 6.0, "flags": 0, "electrons": 1000.0, "ra_epoch": 10.0, "dec_epoch": 5.0,
    "z": 0.7, "size": 0.3, "e1": 0.2, "e2": -0.1, "g1": 0.03, "g2": 0.05, "mag_g": 24.5, "mag_r": 23.5, "snr": 3.0,
}  # fmt: skip


def table(*changes):
    rows = [ROW | change for change in changes]
    return ObjectTable({name: np.array([row[name] for row in rows]) for name in rows[0]})


def packed(monkeypatch, **frames):
    """Objects of one frame a band, whose zero point is 25 and whose exposure is 100 s; ROW is within its window."""
    telescope, filter_ = None, SimpleNamespace(zeropoint=lambda telescope: 25.0)
    camera = SimpleNamespace(filters=dict.fromkeys(frames, filter_), telescope=telescope)
    window, pointing = Window(10, 20, 0, 8), SimpleNamespace(exptime=100.0)
    jobs = [SimpleNamespace(window=window, chip=SimpleNamespace(filter=f), pointing=pointing) for f in frames]
    monkeypatch.setattr("csstsim.stages.level0.truth_of", lambda run, job: frames[job.chip.filter])
    return true_objects(SimpleNamespace(camera=camera), jobs)


@pytest.mark.parametrize(
    "change",
    [
        {"trail_length": 30.0}, {"flags": NOT_RENDERED}, {"flags": OFF_CHIP}, {"electrons": 0.0}, {"x": 9.4},
        {"y": 7.6},
    ],
    ids=str,
)  # fmt: skip
def test_moving_unrendered_and_outside_objects_are_left_out(monkeypatch, change):
    still = {"trail_length": 0.0}
    found = packed(monkeypatch, r=table(still, still | {"id": 2} | change, still | {"id": 3}))
    assert found["id"].tolist() == [1, 3]


def test_columns_of_an_object_on_frames_of_two_bands(monkeypatch):
    """S/N add in quadrature, magnitudes are means, a magnitude that is missing is that of the electrons."""
    star = {"id": 9, "obj_type": 0, "ra_epoch": 359.9999, "mag_r": np.nan, "electrons": 1000.0}
    found = packed(
        monkeypatch, g=table({"snr": 4.0}),
        r=table(star, {"snr": 3.0}, {"snr": 4.0, "mag_r": 23.7, "ra_epoch": 10.0002}),
    )  # fmt: skip
    assert found["id"].tolist() == [1, 9] and found["obj_type"].tolist() == [1, 0]
    assert found["n_g"].tolist() == [1, 0] and found["n_r"].tolist() == [2, 1]
    np.testing.assert_allclose(found["snr_g"], [4.0, 0.0])
    np.testing.assert_allclose(found["snr_r"], [5.0, 3.0])
    np.testing.assert_allclose(found["mag_g"], [24.5, np.nan])
    np.testing.assert_allclose(found["mag_r"], [23.6, 22.5])  # 25 - 2.5 lg 10
    np.testing.assert_allclose(found["ra"], [10.0 + 0.0002 / 3, 359.9999], rtol=0, atol=1e-9)
    np.testing.assert_allclose(found["dec"], [5.0, 5.0], atol=1e-9)
    np.testing.assert_allclose(found["size"], [0.3, 0.0], rtol=1e-6)
    lensed = galsim.Shear(g1=0.03, g2=0.05) + galsim.Shear(g1=0.2, g2=-0.1)
    np.testing.assert_allclose(found["e1"], [lensed.g1, 0.0], atol=1e-12)
    np.testing.assert_allclose(found["e2"], [lensed.g2, 0.0], atol=1e-12)
    np.testing.assert_allclose((*found["z"], *found["g1"], *found["g2"]), (0.7, 0.7, 0.03, 0.03, 0.05, 0.05), rtol=1e-6)


def test_points_have_no_shape_and_no_size(monkeypatch):
    """Whatever the columns of a star or a quasar say of the galaxy that it may lie in."""
    found = packed(monkeypatch, r=table({}, {"id": 2, "obj_type": 0}, {"id": 3, "obj_type": 2}))
    for name in ("e1", "e2", "size"):
        assert (found[name] != 0).tolist() == [True, False, False], name
    assert found["obj_type"].tolist() == [1, 0, 2] and found["z"][2] > 0
