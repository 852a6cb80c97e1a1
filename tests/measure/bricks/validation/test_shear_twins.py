"""Shear from twins: intrinsic shapes cancel, m and c are recovered, galaxies of one twin only do not count."""

import numpy as np
import pytest
from support.commands import command
from support.mini_campaign import POINTINGS, write_campaign

from csstsim.campaign.thresholds import ValidateConfig
from csstsim.catalog.table import GALAXY, STAR, ObjectTable
from csstsim.measure.bricks.validation.gates.record import MIN_SOURCES
from csstsim.measure.bricks.validation.measured_frame import MeasuredFrame
from csstsim.measure.bricks.validation.shear import SHAPE_MAX, SNR_MIN, calibration, pair_means, shapes, shear_gates
from csstsim.measure.bricks.validation.trials import RESOLVED

SHEARS = [(0.03, 0.0), (-0.03, 0.0), (0.0, 0.03), (0.0, -0.03)]


def twins(shear, m, c, n=4000, noise=0.05, seed=1):
    """Lists of shapes of both twins, in two frames; exact lensing of complex ellipticities."""
    rng = np.random.default_rng(seed)
    source = 0.25 * (rng.normal(size=n) + 1j * rng.normal(size=n))
    source = source[abs(source) < 0.8]
    g = complex(*shear)
    out = []
    for turn in (1, -1):
        seen = (turn * source + g) / (1 + np.conj(g) * turn * source)
        frames = []
        for _ in range(2):
            e = np.stack([(1 + m) * seen.real + c, seen.imag], axis=1) + noise * rng.normal(size=(len(seen), 2))
            frames.append(dict(enumerate(e)))
        out.append(frames)
    return out


def fitted(m, c):
    means = [pair_means(*twins(shear, m, c, seed=k)) for k, shear in enumerate(SHEARS)]
    return calibration(SHEARS, means)


@pytest.mark.parametrize(("m", "c"), [(0.0, 0.0), (0.1, 0.005), (-0.2, -0.01)])
def test_m_and_c_come_out(m, c):
    """Within 5 sigma; errors of noise alone, a tenth of those with shape noise."""
    first, second = fitted(m, c)
    assert abs(first["m"] - m) < 5 * first["m_err"] and abs(first["c"] - c) < 5 * first["c_err"]
    assert abs(second["m"]) < 5 * second["m_err"] and abs(second["c"]) < 5 * second["c_err"]
    assert first["c_err"] < 0.1 * 0.25 / np.sqrt(len(SHEARS) * 4000) * 5


def test_gates_fail_when_m_or_c_is_beyond_them():
    thresholds = ValidateConfig(shear_m_max=0.02, shear_c_max=1e-3)
    good = shear_gates(fitted(0.0, 0.0), thresholds)
    assert [gate["passed"] for gate in good] == [True] * 4
    bad = shear_gates(fitted(0.2, 0.02), thresholds)
    assert {gate["name"] for gate in bad if not gate["passed"]} == {"shear m1", "shear c1"}
    none = ValidateConfig(shear_m_max=None, shear_c_max=None)
    assert {gate["passed"] for gate in shear_gates(fitted(0.0, 0.0), none)} == {None}


def test_only_galaxies_of_both_twins_count_once():
    one, two = {1: np.array([0.2, 0.0]), 2: np.array([9.0, 9.0])}, {1: np.array([-0.1, 0.1]), 3: np.array([9.0, 9.0])}
    means = pair_means([one, one], [two, two])
    assert means == pytest.approx(np.array([[0.05, 0.05]]))
    assert pair_means([], []).shape == (0, 2)


def test_one_shear_gives_c_alone_and_too_few_are_refused():
    fits = calibration([(0.03, 0.0)], [pair_means(*twins((0.03, 0.0), 0.0, 0.0))])
    assert fits[0]["m"] is None and abs(fits[0]["c"]) < 5 * fits[0]["c_err"]
    with pytest.raises(ValueError, match="fewer than two"):
        calibration([(0.03, 0.0)], [np.zeros((1, 2))])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ([{}, {}], "same shear and shapes as"),  # the first of them would not have counted
        ([{}, {"shapes": "rotated90"}, {}], "same shear and shapes as"),
        ([{}], "has no twin"),
        ([{}, {"shapes": "rotated90", "seed": 4}], "has no twin"),  # other galaxies by the same numbers
        ([{}, {"shapes": "rotated90", "mag_limit": 24.0}], "has no twin"),
        ([{}, {"shapes": "rotated90", "fidelity": "preview"}], "has no twin"),
        ([{}, {"shapes": "rotated90", "pointings": POINTINGS[1:2]}], "has no twin"),
        ([{}, {"shapes": "rotated90"}], "not made yet"),  # twins: what they measured is opened
    ],
)
def test_what_are_no_twins_is_refused(tmp_path, changes, words):
    files = []
    for k, change in enumerate(changes):
        change = dict(change)
        catalog = {"lensing": {"field": "constant", "gamma1": 0.03}, "shapes": change.pop("shapes", "normal")}
        if "mag_limit" in change:
            catalog["mag_limit"] = change.pop("mag_limit")
        (tmp_path / str(k)).mkdir()
        pointings = change.pop("pointings", POINTINGS[:1])
        files.append(write_campaign(tmp_path / str(k), pointings, catalog=catalog, **change))
    found = command("shear", *files)
    assert found.exit_code == 2 and words in found.output.lower(), found.output
    assert len(found.output.splitlines()) == 1


def test_which_galaxies_have_a_shape():
    """One a row: what takes it out. The rest keep both components, by their own number."""
    n = 14
    truth = ObjectTable({
        "id": 100 + np.arange(n), "x": 50.0 * np.arange(n), "y": np.full(n, 9.0),
        "obj_type": np.where(np.arange(n) == 1, STAR, GALAXY), "blended": np.arange(n) == 2,
        **{name: np.zeros(n) for name in ("size_disk", "size_bulge", "bulge_frac")},
    })  # fmt: skip
    columns = {
        "x": truth["x"] + 0.4, "y": truth["y"] - 0.3, "snr": np.full(n, 50.0), "resolution": np.full(n, 0.9),
        "flags": np.zeros(n, int), "g1": 0.01 * np.arange(n), "g2": -0.02 * np.arange(n),
    }  # fmt: skip
    columns["x"][3] += 3.0
    columns["snr"][4], columns["resolution"][5] = SNR_MIN, RESOLVED
    columns["flags"][6:11] = 1, 2, 4, 8, 128
    columns["g2"][11] = np.nan
    columns["g1"][12], columns["g2"][12] = 0.8 * SHAPE_MAX, -0.6 * SHAPE_MAX
    columns["flags"][13] = 16 | 32 | 64 | 256
    order = np.arange(n)[::-1]
    measured = ObjectTable({name: values[order] for name, values in columns.items()}, {"filter": "r"})
    found = shapes(MeasuredFrame(truth, measured, 5000, 0.074), truth)
    assert {name: g.tolist() for name, g in found.items()} == {100: [0.0, 0.0], 113: [0.13, -0.26]}


def test_a_fit_of_unequal_campaigns_in_closed_form():
    """Three shears of 2, 3 and 4 galaxies: against numpy's weighted line, with the errors of the weights."""
    shears = [(0.05, 0.01), (-0.02, 0.01), (0.03, 0.01)]
    means = [
        np.array([[0.04, 0.0], [0.08, 0.02]]), np.array([[-0.03, 0.02], [-0.01, 0.03], [-0.05, 0.04]]),
        np.array([[0.02, 0.01], [0.04, 0.03], [0.05, 0.0], [0.03, 0.02]]),
    ]  # fmt: skip
    first, second = calibration(shears, means)
    y, error = ([part(m[:, 0]) for m in means] for part in (np.mean, lambda v: np.std(v, ddof=1) / len(v) ** 0.5))
    (slope, offset), covariance = np.polyfit([0.05, -0.02, 0.03], y, 1, w=1 / np.array(error), cov="unscaled")
    assert (first["component"], first["n"], second["component"]) == (1, 9, 2)
    assert (first["m"], first["c"]) == (pytest.approx(slope - 1), pytest.approx(offset))
    assert [first["m_err"], first["c_err"]] == pytest.approx(np.sqrt(np.diag(covariance)))
    weight = [len(m) / m[:, 1].var(ddof=1) for m in means]
    assert second["m"] is None and second["c_err"] == pytest.approx(sum(weight) ** -0.5)
    assert second["c"] == pytest.approx(np.dot(weight, [m[:, 1].mean() - 0.01 for m in means]) / sum(weight))


@pytest.mark.parametrize(("m", "n", "passed"), [
    (0.069, MIN_SOURCES, True), (-0.069, MIN_SOURCES, True), (0.071, MIN_SOURCES, False), (-0.071, MIN_SOURCES, False),
    (0.5, MIN_SOURCES - 1, None),
])  # fmt: skip
def test_gates_allow_five_errors_beyond_the_limit(m, n, passed):
    fit = {"component": 2, "m": m, "m_err": 0.01, "c": 0.0, "c_err": 0.001, "n": n}
    first, second = shear_gates([fit], ValidateConfig(shear_m_max=0.02, shear_c_max=None))
    assert first == {"name": "shear m2", "band": "all", "value": m, "threshold": 0.02, "n": n, "passed": passed}
    assert second["name"] == "shear c2" and second["passed"] is None
