"""What the figure of extracted spectra shows: which objects, columns, traces and words."""

from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

from csstsim.catalog.table import GALAXY, STAR, ObjectTable
from csstsim.instrument.chip import Window
from csstsim.measure.spectra import spectrum_columns as bits
from csstsim.measure.spectra.spectra_figures import (
    COLUMNS_MIN,
    chosen,
    cutout_panel,
    good_rows,
    line_strength,
    none_shown,
    spectrum_panels,
    title,
)

COUNT = 240


def table_of(*objects):
    """Rows of objects (row, level, height of a line, flags): models of a flat spectrum with a line of one column."""
    parts = []
    for row, level, line, flags in objects:
        model = np.full(COUNT, float(level))
        model[120] += line
        parts.append({
            "row": np.full(COUNT, row), "model": model, "sensitivity": np.full(COUNT, 2.0),
            "electrons_err": np.full(COUNT, 5.0), "electrons": model + 10.0, "contamination": np.full(COUNT, 3.0),
            "wavelength": 5000.0 + 2 * np.arange(COUNT), "flags": np.asarray(flags) + np.zeros(COUNT, int),
        })  # fmt: skip
    return ObjectTable({name: np.concatenate([part[name] for part in parts]) for name in parts[0]})


def truth_of(kinds):
    n = len(kinds)
    return {"obj_type": np.array(kinds), "mag": 20.0 + np.arange(n), "z": 0.1 + 0.2 * np.arange(n),
            "size_disk": 0.3 + np.arange(n)}  # fmt: skip


def test_shown_are_the_brightest_star_and_the_galaxy_with_the_strongest_line():
    truth = truth_of([STAR, STAR, GALAXY, GALAXY, STAR])
    table = table_of((0, 100, 900, 0), (1, 300, 0, 0), (2, 500, 40, 0), (3, 50, 60, 0), (4, 900, 0, bits.LOST))
    assert chosen(truth, table) == [1, 3]
    assert chosen(truth, table.take(table["row"] > 1)) == [3] and chosen(truth, table.take(table["row"] < 0)) == []


@pytest.mark.parametrize("bit", [bits.DIM, bits.LOST, bits.CUT, bits.SATURATED, bits.CONTAMINATED, bits.BESIDE,
                                 bits.UNEVEN, bits.IMAGED])  # fmt: skip
def test_columns_with_a_doubt_are_no_good_ones(bit):
    for good, shown in ((COLUMNS_MIN, True), (COLUMNS_MIN - 1, False)):
        table = table_of((0, 10, 0, np.zeros(COUNT, int)), (7, 10, 0, np.where(np.arange(COUNT) < good, 0, bit)))
        rows = good_rows(table, 7)
        assert (rows is not None) == shown
    assert good_rows(table_of((7, 10, 0, bits.MASKED | bits.COSMIC | bits.EDGE)), 7).tolist() == list(range(COUNT))


def test_a_line_stands_above_its_continuum_by_so_many_errors():
    table = table_of((0, 100, 35, 0))
    assert line_strength(table, np.arange(COUNT)) == pytest.approx(7.0)
    hidden = table_of((0, 100, 35, np.where(np.arange(COUNT) == 120, bits.DIM, 0)))
    assert line_strength(hidden, np.arange(COUNT)) == pytest.approx(0.0)


def test_titles_and_the_words_for_nothing():
    truth = truth_of([STAR, GALAXY])
    assert title(truth, 0) == "star, 20.00 mag"
    assert title(truth, 1) == "galaxy, 21.00 mag, z = 0.300, half-light radius 1.30 arcsec"
    table = table_of((0, 1, 0, 0), (4, 1, 0, 0))
    assert none_shown(table) == "2 spectra extracted, none with 200 columns free of contamination and defects"
    assert none_shown(table.take(table["row"] == 0)).startswith("1 spectrum extracted")
    assert none_shown(table.take(table["row"] < 0)) == "no spectrum was bright enough to be extracted"


def test_panels_have_the_columns_that_can_be_used():
    flags = np.where(np.arange(COUNT) < 10, bits.LOST, np.where(np.arange(COUNT) < 30, bits.DIM, 0))
    table = table_of((0, 100, 0, flags))
    table["electrons"][30::2] -= 10.0
    above, below = Figure().subplots(2)
    spectrum_panels((above, below), table, np.arange(COUNT), "a star")
    lines = {line.get_label(): line for line in above.lines}
    assert np.array_equal(lines["true spectrum x throughput, at the resolution"].get_ydata(), table["model"])
    assert np.array_equal(lines["subtracted contamination"].get_ydata(), table["contamination"])
    (pulls,) = (line for line in below.lines if line.get_marker() == ".")
    assert len(pulls.get_xdata()) == COUNT - 10 and pulls.get_ydata()[:3] == pytest.approx([2.0, 2.0, 2.0])
    assert below.texts[0].get_text() == "mean +1.00, scatter 1.00" and above.get_title() == "a star"
    assert not above.get_legend(), "one legend of the figure has them, off the data"
    assert below.get_ylim() == (-5, 5) and below.get_xlabel() == "wavelength [angstrom]"


def test_a_cutout_has_the_pixels_and_the_traces_of_those_that_have_light_there():
    """Of two gratings the one with more light; a faint order and one elsewhere are not marked; dots are ringed."""
    orders = {
        "row": [3, 3, 5, 6, 7, 3], "order": [1, 1, 2, 1, -1, 0], "drawn": [1e3, 1e5, 1e5, 150.0, 1e5, 1e4],
        "x": [900.0, 1000.0, 1000.0, 1000.0, 1000.0, 1100.0], "y": [2000.0, 2050.0, 2060.0, 2050.0, 2300.0, 2051.0],
        "p": [0.0, 0, 0, 0, 0, 0], "q": [0.1, 0.1, 0.1, 0.1, 0.1, 0.0], "r": [2.0, 2, 2, 2, 2, 2], "s": [0.001] * 6,
        "wave_min": [1000.0] * 6, "wave_max": [2000.0] * 6,
    }  # fmt: skip
    orders = {name: np.array(values) for name, values in orders.items()}
    window = Window(500, 1400, 1900, 2400)
    image = np.arange(window.nx) + 1000.0 * np.arange(window.ny)[:, None]
    frame = SimpleNamespace(window=window, electrons=image, noise=5.0)
    axis = Figure().subplots()
    cutout_panel(axis, frame, orders, 3, "mine")
    # the trace: x from 1100 to 1200, y from 2053 to 2054
    assert np.array_equal(axis.images[0].get_array(), image[2023 - 1900 : 2083 - 1900, 1040 - 500 : 1260 - 500])
    assert axis.get_xlim() == (1039.5, 1259.5) and axis.get_ylim() == (2022.5, 2082.5)
    assert axis.images[0].get_extent() == [1039.5, 1259.5, 2022.5, 2082.5]
    level = np.median(np.asarray(axis.images[0].get_array()))
    assert axis.images[0].get_clim() == (level - 15, level + 60)
    lines = [(line.get_linestyle(), line.get_xdata().tolist(), line.get_ydata().tolist())
             for line in axis.lines if line.get_marker() == "None"]  # fmt: skip
    assert lines == [
        ("-", [1100, 1200], [2047, 2048]), ("-", [1100, 1200], [2059, 2060]), ("--", [1100, 1200], [2057, 2058]),
        ("--", [1100, 1200], [2069, 2070]),
    ]  # fmt: skip
    (ring,) = (line for line in axis.lines if line.get_marker() == "o")
    assert (ring.get_xdata()[0], ring.get_ydata()[0]) == pytest.approx((1100.0, 2054.5))
