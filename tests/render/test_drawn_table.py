"""The table of drawn objects: which missed the window, flags of the stamps, time per object."""

from types import SimpleNamespace

import numpy as np
import pytest
from render.imaging.test_reference import EXPTIME, objects
from support.canvases import blank

from csstsim.catalog.flags import (
    BAD_VALUE,
    NEGATIVE_CLIPPED,
    OFF_CHIP,
    OUTSIDE_PSF_HULL,
    STRONG_LENSING,
    TRUNCATED_STAMP,
)
from csstsim.catalog.table import GALAXY, STAR, ObjectTable
from csstsim.instrument.chip import Window
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.optics.scatter.scattered_light import Scattered
from csstsim.render.drawing import Drawing
from csstsim.render.drawn_table import ADDED, DrawnTable
from csstsim.render.imaging import stamps
from csstsim.render.imaging.draw import draw_objects
from csstsim.render.imaging.methods.photons import PHOTONS
from csstsim.render.imaging.stamps import _clip_negative
from csstsim.render.method import Targets
from csstsim.render.scene import make_scene
from csstsim.render.wings import core_fraction

WINDOW = Window(4000, 4200, 4000, 4120)
X, Y = 4100.2, 4060.3  # its middle


@pytest.fixture(scope="module")
def drawn(camera, make_pointing, psf_r, psf_tables):
    wcs = ChipWCS(camera.chips[9], make_pointing())

    def draw(x, y, electrons, fidelity="standard", reach=None, **columns):
        table = objects(wcs, x, y, **columns)
        rate = np.broadcast_to(np.asarray(electrons, float), len(table)) / EXPTIME / 4
        table = table.with_columns(**{f"flux{i}": rate for i in range(4)})
        if reach is not None:
            table = table.with_columns(reach=np.full(len(table), reach, np.int32))
        canvas = blank(WINDOW)
        drawing = Drawing(wcs, psf_r, EXPTIME, Scattered(), fidelity, 60.0, np.uint64(5), psf_tables)
        result = draw_objects(canvas, table, drawing)
        return result, canvas.counted, make_scene(table, wcs, psf_r, EXPTIME)

    return draw


@pytest.mark.parametrize("fidelity", ["standard", "noise_free"])
@pytest.mark.parametrize(("dx", "dy"), [(1, 0), (-1, 0), (0, 1), (0, -1)])
def test_an_object_beyond_an_edge_is_off_the_chip_and_one_that_reaches_over_is_not(drawn, fidelity, dx, dy):
    """Beside the middle of each side, at 1.5 reaches and at half of one."""
    reach = 40  # more than half the box of the PSF, which photons keep to
    half = (WINDOW.nx if dx else WINDOW.ny) / 2
    off, over = (half + part * reach for part in (1.5, 0.5))
    table, _, _ = drawn([X + dx * off, X + dx * over], [Y + dy * off, Y + dy * over], 4000.0, fidelity, reach=reach)
    assert ((table["flags"] & OFF_CHIP) > 0).tolist() == [True, False]
    assert table["method"][0] == "none" and table["drawn"][0] == 0 and table["drawn"][1] > 0


def test_what_the_stamps_flag_is_in_the_table(drawn, monkeypatch):
    """With a limit below zero every galaxy is said to be clipped; stars are never clipped."""
    monkeypatch.setattr(stamps, "_NEGATIVE_LIMIT", -1.0)
    shape = {"obj_type": np.array([GALAXY, STAR]), "size_disk": 0.3, "e1": np.array([0.97, 0.0]), "e2": np.zeros(2)}
    shape |= {"size_bulge": 0.1, "bulge_frac": 0.0}
    table, _, _ = drawn([X, X + 20], [Y, Y], 1e8, "noise_free", reach=30, **shape)
    assert ((table["flags"] & NEGATIVE_CLIPPED) > 0).tolist() == [True, False]


def test_time_is_shared_out_by_cost(drawn):
    """Photons are shot together: an object of many electrons has the more milliseconds, as its cost says."""
    electrons = np.array([30.0, 3000.0, 30000.0])
    table, _, scene = drawn(X + np.array([-40.0, 0.0, 40.0]), np.full(3, Y), electrons)
    assert (table["method"] == "photons").all()
    work = PHOTONS.cost(Targets(scene, None))
    assert table["ms"] / table["ms"].sum() == pytest.approx(work / work.sum(), rel=1e-4)


def test_clipping_keeps_the_light():
    """Below zero is nothing, and what that was is taken from the others, all alike."""
    rng = np.random.default_rng(6)
    stamp = rng.normal(1.0, 0.7, (40, 30))
    before = stamp.copy()
    _clip_negative(stamp)
    assert (before < 0).any() and stamp.min() >= 0
    assert stamp.sum() == pytest.approx(before.sum(), rel=1e-12)
    lit = before > 0
    assert np.ptp(stamp[lit] / before[lit]) < 1e-12 and not stamp[~lit].any()


@pytest.mark.parametrize(("cells", "per_pixel"), [(256, 2), (256, 4), (128, 2)])
def test_the_box_keeps_the_same_on_all_sides(cells, per_pixel):
    fraction = core_fraction(cells, per_pixel)
    for mirrored in (fraction[::-1], fraction[:, ::-1], fraction.T):
        np.testing.assert_allclose(fraction, mirrored, atol=1e-12)
    middle = slice(cells // 2 - 1, cells // 2 + 1)
    assert (fraction[middle, middle] == 1).all() and fraction[0, 0] == 0


def blank_table(electrons, flags=0, wing=0.0):
    n = len(electrons)
    table = ObjectTable({"flags": np.full(n, flags, np.int32), "wing": np.full(n, wing), "id": np.arange(n)})
    return DrawnTable(table, np.asarray(electrons, float))


def test_rows_that_can_be_drawn_have_light_and_no_flag_against_it():
    flags = np.array([0, BAD_VALUE, STRONG_LENSING, OFF_CHIP, 0], np.int32)
    out = DrawnTable(ObjectTable({"flags": flags, "wing": np.array([0, 9, 9, 9.0, 0])}), np.array([1.0, 1, 1, 1, 0]))
    assert out.rows.tolist() == [0, 3]
    out.flag_optics(np.array([True, False]), None)
    assert out.flags.tolist() == [OUTSIDE_PSF_HULL, BAD_VALUE, STRONG_LENSING, OFF_CHIP | TRUNCATED_STAMP, 0]
    assert flags.tolist() == [0, BAD_VALUE, STRONG_LENSING, OFF_CHIP, 0]
    some = blank_table([1.0], wing=9.0)
    some.flag_optics(np.array([False]), object())
    assert some.flags.tolist() == [0]


def test_of_parts_errors_add_up_and_snr_in_squares():
    """Objects 2, 0, 2, 2 of four: the last part has no light, so that its error is none."""
    out = blank_table(np.ones(4))
    choice = SimpleNamespace(snr=np.array([3.0, 7.0, 4.0, 12.0]), error=np.array([0.25, 0.5, 1.0, 8.0]))
    out.note_choice(np.array([2, 0, 2, 2]), choice, np.array([1.0, 1.0, 1.0, 0.0]))
    assert out.snr.tolist() == [7.0, 0.0, 13.0, 0.0] and out.error.tolist() == [0.5, 0.0, 1.25, 0.0]
    whole = blank_table(np.ones(3))
    whole.note_choice(np.array([2, 0]), SimpleNamespace(snr=np.array([3.0, 7.0]), error=np.array([0.25, 0.5])), None)
    assert whole.snr.tolist() == [7.0, 0.0, 3.0] and whole.error.tolist() == [0.5, 0.0, 0.25]


def test_what_is_noted_of_parts_adds_up_and_boxes_grow():
    out = blank_table(np.full(3, 10.0))
    out.note(np.array([2, 0, 2]), np.array([1.0, 2.0, 3.0]), np.array([[5, 9, 30, 34], [0, 0, 0, 0], [7, 12, 20, 31]]))
    assert out.drawn.tolist() == [2.0, 0.0, 4.0] and out.box.tolist() == [[0] * 4, [0] * 4, [5, 12, 20, 34]]
    out.note(np.array([0, 2]), np.array([5.0, 0.5]), np.array([[0, 3, 0, 2], [6, 40, 25, 26]]))
    assert out.drawn.tolist() == [7.0, 0.0, 4.5] and out.box.tolist() == [[0, 3, 0, 2], [0] * 4, [5, 40, 20, 34]]
    table = out.table()
    assert table["fraction"] == pytest.approx([0.7, 0.0, 0.45])
    assert [table[name].tolist() for name in ("x0", "x1", "y0", "y1")] == [
        [0, 0, 5],
        [3, 0, 40],
        [0, 0, 20],
        [2, 0, 34],
    ]
    dark = blank_table([0.0, 4.0])
    dark.note(np.array([1]), np.array([5.0]), np.array([[1, 2, 1, 2]]))
    assert dark.table()["fraction"].tolist() == [0.0, 1.25]  # a ghost is light on top


def test_a_method_is_that_of_the_brightest_part_and_a_side_holds_stamp_and_wing():
    out = blank_table(np.ones(3))
    names = np.array(["photons", "stamp", "photons", "none"])
    out.name_methods(np.array([1, 1, 2, 1]), names, np.array([5.0, 9.0, 1.0, 3.0]))
    assert out.method.tolist() == ["none", "stamp", "photons"]
    out.note_sides(np.array([2, 0]), np.array([20, 64]), np.array([30.2, 0.0]))
    assert out.stamp.tolist() == [129, 0, 63]
    out.miss(np.array([1]))
    assert out.method.tolist() == ["none", "none", "photons"] and out.flags.tolist() == [0, OFF_CHIP, 0]
    assert set(ADDED) <= set(out.table())
