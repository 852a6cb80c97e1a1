"""Gates and their inputs, by hand: the sign of the tolerance, rows to the amplifier, blends, depth, sizes."""

from types import SimpleNamespace

import numpy as np
import pytest
from csst import PIXEL

from csstsim.bricks.validation import compare
from csstsim.bricks.validation.exposures import _depth
from csstsim.bricks.validation.gates import CHANCE, FEW, WORST, at_least, at_most, between
from csstsim.bricks.validation.trials import trials
from csstsim.bricks.validation.validate import MeasuredFrame, blended
from csstsim.campaign.thresholds import ValidateConfig
from csstsim.catalog.table import GALAXY, STAR, ObjectTable


@pytest.mark.parametrize(
    ("gate", "value", "passed"),
    [
        (at_most, 0.02, True), (at_most, -0.02, True), (at_most, 0.021, False), (at_most, -0.021, False),
        (at_least, 0.95, True), (at_least, 0.95 - CHANCE * np.sqrt(0.95 * 0.05 / 100) + 1e-9, True),
        (at_least, 0.95 - CHANCE * np.sqrt(0.95 * 0.05 / 100) - 1e-9, False), (at_least, 1.0, True),
    ],
)  # fmt: skip
def test_a_number_is_judged_on_both_sides_and_chance_is_forgiven(gate, value, passed):
    limit = 0.02 if gate is at_most else 0.95
    assert gate("a gate", "r", value, limit, 100)["passed"] is passed
    assert gate("a gate", "r", value, limit, FEW - 1)["passed"] is None
    assert gate("a gate", "r", None, limit, 100)["passed"] is None


def test_a_width_is_judged_at_both_ends():
    chance = WORST * 1.17 / 10
    for width, passed in ((0.9 * (1 - chance) + 1e-9, True), (0.9 * (1 - chance) - 1e-9, False),
                          (1.2 * (1 + chance) - 1e-9, True), (1.2 * (1 + chance) + 1e-9, False)):  # fmt: skip
        assert between("a width", "r", width, (0.9, 1.2), 100)["passed"] is passed


def truth_of(**columns):
    n = len(columns["x"])
    full = {
        "id": np.arange(n), "obj_type": np.full(n, STAR), "electrons": np.full(n, 1e5), "mag_r": np.full(n, 20.0),
        "blended": np.zeros(n, bool), "half_light": np.zeros(n),
        "half_light_px": np.zeros(n), "crowd": np.zeros(n),
    }  # fmt: skip
    return ObjectTable({name: np.asarray(values) for name, values in (full | columns).items()})


def test_rows_to_the_amplifier_and_charge_left_behind():
    """A chip of 20 rows: rows 0 and 19 are read first, 9 and 10 last. A trail lies away from either amplifier."""
    y = np.array([0.0, 9.0, 10.0, 19.0])
    truth = truth_of(x=np.full(4, 5.0), y=y)
    trail = np.array([0.1, 0.1, -0.1, -0.1])  # px, away from the amplifier
    measured = ObjectTable(
        {"x": np.full(4, 5.2), "y": y + trail, "flux_psf": np.full(4, 1e5), "flags": np.zeros(4, int)},
        {"filter": "r", "n_eff": 9.0, "rms": 7.0},
    )
    table = trials(truth, MeasuredFrame(truth, measured, seam=10, pixel=PIXEL))
    assert table["transfers"].tolist() == [0.0, 9.0, 9.0, 0.0]
    assert table["deferred_mas"] == pytest.approx(np.full(4, 7.4)) and table["across_mas"] == pytest.approx(14.8)


@pytest.mark.parametrize(("distance", "share", "spoilt"), [
    (5.0, 0.05, False), (5.0, 0.2, True), (35.0, 0.2, False), (35.0, 50.0, False), (35.0, 150.0, True),
    (45.0, 150.0, False),
])  # fmt: skip
def test_a_neighbour_matters_by_its_distance_and_light(distance, share, spoilt):
    x, y = np.array([100.0, 100.0 + distance]), np.array([50.0, 50.0])
    assert blended(x, y, np.array([1000.0, 1000.0 * share]))[0] == spoilt


def test_a_galaxys_half_light_radius_is_of_both_components():
    galaxy, star = truth_of(x=[1.0], y=[1.0]), truth_of(x=[1.0], y=[1.0])
    shape = {"size_disk": np.array([1.0]), "size_bulge": np.array([3.0]), "bulge_frac": np.array([0.25])}
    galaxy = galaxy.with_columns(obj_type=np.array([GALAXY]), **shape)
    assert compare.half_light(galaxy) == pytest.approx([1.5])
    assert compare.half_light(star.with_columns(**shape)) == pytest.approx([0.0])


def test_number_counts_are_of_sources_in_the_band():
    """Of ten bright objects one has no source and one a source without a detection in the band: 20% fewer."""
    truth = truth_of(x=np.arange(10.0), y=np.zeros(10))
    match = np.array([0, 1, 2, 3, 4, 5, 6, 7, 8, -1])
    sources = ObjectTable({
        "star": np.ones(9), "mag_r": np.full(9, 20.0), "total_mag_r": np.full(9, 20.0), "flux_r": np.full(9, 100.0),
        "flux_err_r": np.full(9, 0.1), "n_r": np.array([1] * 8 + [0]),
    })  # fmt: skip
    real, infos = np.ones(9, bool), [{"zeropoint": 31.5, "n_eff": 9.0, "rms": 7.7}]
    assert compare.counts("r", truth, sources, match, real, [19, 21], infos)["excess"] == pytest.approx(-0.2)
    real[0] = False  # nobody's, though one matches it: counted as false besides
    assert compare.counts("r", truth, sources, match, real, [19, 21], infos)["excess"] == pytest.approx(-0.1)


@pytest.mark.parametrize(("depth", "off"), [(25.7, -0.2), (25.95, 0.0), (26.0, 0.0), (26.1, 0.0), (26.4, 0.3)])
def test_depth_is_judged_against_the_range_of_the_published_ones(depth, off):
    frame = MeasuredFrame(
        None, ObjectTable({}, {"filter": "r", "depth_5sigma": depth}), seam=10, pixel=PIXEL, depth=(25.9, 26.1)
    )
    asked = SimpleNamespace(at_most=lambda name, value, threshold, n: (value, threshold))
    ((value, threshold),) = _depth(frame, ValidateConfig(), asked)
    assert value == pytest.approx(off) and threshold == ValidateConfig().depth_off_max
